"""Networks trained on AWGN, AMWGN and simulated cameras, on real and simulated noise."""

from experiments.denoisers.pairs import REAL, SIMULATED
from experiments.denoisers.study import Table, main
from experiments.denoisers.training import FITTED

TABLE = Table(
    "noise_models",
    "What the noise is modelled as in training",
    ("awgn", "amwgn", "phone", "phone-authors-code", "phone-shot", "phone-any", FITTED),
    (*REAL, SIMULATED),
    baselines=True,
)

if __name__ == "__main__":
    main(TABLE)
