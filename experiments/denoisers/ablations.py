"""`phone` without one of its parts."""

from experiments.denoisers.pairs import REAL, SIMULATED
from experiments.denoisers.study import Table, main

TABLE = Table(
    "ablations",
    "Ablations: the simulated phone without one of its parts",
    ("phone", "phone-no-post", "phone-no-denoise", "phone-no-demosaic"),
    (*REAL, SIMULATED),
)

if __name__ == "__main__":
    main(TABLE)
