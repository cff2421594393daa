"""Demosaicking alone, by three algorithms."""

from experiments.denoisers.pairs import REAL, SIMULATED
from experiments.denoisers.study import Table, main

TABLE = Table(
    "demosaicking",
    "Demosaicking alone in training: Kodak (Hibbard 1995), AHD (Hirakawa & Parks 2005), bilinear",
    ("phone-kodak", "phone-ahd", "phone-bilinear"),
    (*REAL, SIMULATED),
)

if __name__ == "__main__":
    main(TABLE)
