"""Networks on demosaicked RAW: noise of the sensor and demosaicking, without a phone's processing."""

from experiments.denoisers.pairs import RAW
from experiments.denoisers.study import Table, main

TABLE = Table(
    "raw_input",
    "Demosaicked RAW as input (simulated: no real burst of a phone's RAW files is at hand)",
    ("awgn", "amwgn", "phone", "phone-kodak"),
    (RAW,),
    baselines=True,
)

if __name__ == "__main__":
    main(TABLE)
