"""How noise looks where pictures are flat: on real JPEGs and in the recipes that networks are trained on.

python -m experiments.denoisers.noise_spectra DATA --work RUNS
"""

import argparse
import json
from collections.abc import Sequence
from pathlib import Path

import jax
import numpy as np

from experiments.denoisers import report
from experiments.denoisers.ceilings import in_camera_tone
from experiments.denoisers.pairs import REAL, as_pair, evaluation_set
from experiments.denoisers.report import TILE, WIDE
from experiments.denoisers.training import Place, pictures, recipe_named
from jaxisp.io import read_image
from jaxisp.train import AlignedPair

RECIPES = ("awgn", "phone", "phone-no-denoise", "phone-any")
FLAT = 0.25  # share of the tiles that counts as flat
SIDE, COUNT = 192, 24
BT601 = np.array([[0.299, 0.587, 0.114], [-0.168736, -0.331264, 0.5], [0.5, -0.418688, -0.081312]])  # JFIF


def flat_noise(pair: AlignedPair) -> list[np.ndarray]:
    """(TILE, TILE, 3) Y, Cb, Cr of the noise [8-bit steps] on the flattest tiles, without their plane."""
    noisy, clean = (picture[pair.area] @ BT601.T for picture in (pair.noisy, in_camera_tone(pair)))
    corners = [
        (y, x)
        for y in range(0, clean.shape[0] - TILE + 1, TILE)
        for x in range(0, clean.shape[1] - TILE + 1, TILE)
    ]
    tiles = [(clean[y : y + TILE, x : x + TILE], noisy[y : y + TILE, x : x + TILE]) for y, x in corners]
    seen = [(c, n) for c, n in tiles if 0.05 < n[..., 0].mean() < 0.95]
    seen.sort(key=lambda tile: tile[0][..., 0].std())
    return [_level(255 * (n - c)) for c, n in seen[: max(1, round(FLAT * len(seen)))]]


def _level(tile: np.ndarray) -> np.ndarray:
    y, x = np.mgrid[:TILE, :TILE].reshape(2, -1)
    basis = np.stack([np.ones_like(y), y, x], axis=1).astype(float)
    flat = tile.reshape(-1, 3)
    return (flat - basis @ np.linalg.lstsq(basis, flat, rcond=None)[0]).reshape(tile.shape)


def figures(tiles: Sequence[np.ndarray]) -> dict[str, float]:
    """Of all tiles: luma's standard deviation and autocorrelation, chroma's power and how wide it is."""
    noise = np.stack(tiles)
    luma, chroma = noise[..., 0], noise[..., 1:]
    power = (luma**2).mean()
    return {
        "std": float(np.sqrt(power)),
        "lag1": _correlation(luma, 1),
        "lag2": _correlation(luma, 2),
        "chroma": float((chroma**2).mean() / power),
        "wide": _wide(chroma),
        "wide_luma": _wide(luma[..., None]),
    }


def _correlation(luma: np.ndarray, lag: int) -> float:
    down, right = (luma[:, lag:] * luma[:, :-lag]).mean(), (luma[..., lag:] * luma[..., :-lag]).mean()
    return float((down + right) / 2 / (luma**2).mean())


def _wide(noise: np.ndarray) -> float:
    """Share of the power in wavelengths of WIDE and more."""
    window = np.hanning(TILE + 2)[1:-1]
    spectrum = np.abs(np.fft.fft2(noise * np.outer(window, window)[..., None], axes=(1, 2))) ** 2
    f = np.fft.fftfreq(TILE)
    wide = np.hypot(f[:, None], f[None]) <= 1 / WIDE
    return float(spectrum[:, wide].sum() / spectrum.sum())


def simulated(place: Place, name: str) -> list[AlignedPair]:
    """Middles of the clean pictures, degraded by a recipe."""
    recipe, clean = recipe_named(place, name), []
    for path in sorted(pictures(place, "train").iterdir()):
        image = read_image(path)
        if min(image.shape[:2]) >= SIDE and len(clean) < COUNT:
            y, x = ((n - SIDE) // 2 for n in image.shape[:2])
            clean.append(image[y : y + SIDE, x : x + SIDE])
    noisy = recipe.degrade(jax.random.key(0), np.stack(clean))[0]
    return [as_pair(str(i), np.asarray(n), c) for i, (n, c) in enumerate(zip(noisy, clean))]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("data", type=Path)
    parser.add_argument("--work", type=Path, required=True, help="aligned pairs are kept here")
    parser.add_argument("--out", type=Path, default=Path("docs/results"))
    options = parser.parse_args()
    place = Place(options.data, options.work)
    sets = {name: evaluation_set(place, name) for name in REAL}
    sets |= {f"iphone8 {pair.name}": [pair] for pair in sets["iphone8"]}
    sets |= {name: simulated(place, name) for name in RECIPES}
    rows = [
        {"pictures": name, **figures([tile for pair in pairs for tile in flat_noise(pair)])}
        for name, pairs in sets.items()
    ]
    (options.out / "noise-spectra.json").write_text(json.dumps(rows, indent=1) + "\n")
    report.write(options.out)


if __name__ == "__main__":
    main()
