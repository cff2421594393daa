"""A sensor in NumPy whose every number is known."""

import numpy as np

from jaxisp.io.dng import write_dng

SHOT, READ, ROW, COLUMN, PRNU, DSNU = 2e-4, 3e-3, 6e-4, 5e-4, 8e-3, 1.2e-3
RATE, BLACK, TAIL = 0.02, 0.004, 0.08
FLATS = ((0.05, 5), (0.15, 5), (0.35, 5), (0.6, 5))
DARKS = ((0.01, 5), (0.2, 5))
SIZE = (384, 448)
LOW, WHITE = 512, 15000  # DN


def frames(seed: int = 0, *, tail: float = 0.0, shot: float = SHOT, hot: float = 0.0, size=SIZE):
    """[(exposure, frame), ...] of flats and of darks: float64 levels, black subtracted but for BLACK."""
    rng = np.random.default_rng(seed)
    gains = 1 + PRNU * rng.standard_normal(size)
    offsets = DSNU * rng.standard_normal(size) + COLUMN * rng.standard_normal((1, size[1]))
    stuck = 0.3 * (rng.uniform(size=size) < hot)
    y, x = np.meshgrid(*(np.linspace(-1, 1, n) for n in size), indexing="ij")
    shading = 1 - 0.15 * (y * y + x * x)

    def frame(light: float, seconds: float) -> np.ndarray:
        charge = rng.poisson((light * shading * gains + RATE * seconds) / shot) * shot
        normal = rng.standard_normal(size)
        read = READ * normal * np.exp(tail * normal**2 / 2) * (1 - 2 * tail) ** 0.75
        return charge + offsets + stuck + read + ROW * rng.standard_normal((size[0], 1)) + BLACK

    flats = [(0.01, frame(light, 0.01)) for light, count in FLATS for _ in range(count)]
    return flats, [(t, frame(0.0, t)) for t, count in DARKS for _ in range(count)]


def write(folder, kind: str, shots, *, iso: int = 100, profile=None) -> None:
    """Frames as DNGs of 14 bits."""
    (folder / kind).mkdir(parents=True, exist_ok=True)
    for i, (seconds, frame) in enumerate(shots):
        levels = np.clip(np.round(LOW + frame * (WHITE - LOW)), 0, 16383).astype(np.uint16)
        write_dng(
            folder / kind / f"iso{iso}_{i:02d}.dng", levels, cfa="GRBG", black=(LOW,), white=WHITE,
            color_matrix=np.eye(3), iso=iso, exposure_time=seconds, noise_profile=profile, model="known",
        )  # fmt: skip
