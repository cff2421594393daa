"""How strong a classical denoiser is to be, by the noise level: the table of `jaxisp.train.classical`.

Chosen on the middles of small Kodak and CBSD68 pictures, with the noise of the recipe `phone-any` and with
white noise of several strengths. Neither they nor their noise are of a set that is reported.

python -m experiments.denoisers.strengths DATA --work RUNS
"""

import argparse
from collections.abc import Iterator
from pathlib import Path

import jax
import numpy as np

from experiments.denoisers.pairs import to_linear
from experiments.denoisers.training import Place, pictures
from jaxisp.cli.devices import use_cores
from jaxisp.io import read_image
from jaxisp.recipes import RECIPES
from jaxisp.train.classical import LEVELS, METHODS, Classical, noise_level

SIDE = 128  # px
WHITE = (2, 4, 8, 16, 32, 48)  # of 255, encoded
WIDTH = 0.6  # octaves of noise level: how near a picture is to count
RATIOS = tuple(0.25 * 2 ** (k / 2) for k in range(10))  # of the noise level, up to 5.7
BLURS = (0.3, 0.4, 0.5, 0.6, 0.7, 0.85, 1.0, 1.2, 1.4, 1.7, 2.0, 2.5)  # px


def training_pairs(place: Place) -> Iterator[tuple[np.ndarray, np.ndarray]]:
    """Noisy and clean, encoded."""
    named = sorted(pictures(place, "train").glob("kodak_*")) + sorted(
        pictures(place, "train").glob("cbsd68_*")
    )
    clean = np.stack([_middle(read_image(path)) for path in named if min(read_image(path).shape[:2]) >= SIDE])
    noisy, target, _ = RECIPES["phone-any"]().degrade(jax.random.key(7), clean)
    yield from zip(np.asarray(noisy), np.asarray(target))
    for i, picture in enumerate(clean):
        noise = np.random.default_rng((7, i)).standard_normal(picture.shape, np.float32)
        yield np.clip(picture + WHITE[i % len(WHITE)] / 255 * noise, 0, 1), picture


def _middle(image: np.ndarray) -> np.ndarray:
    y, x = ((n - SIDE) // 2 for n in image.shape[:2])
    return np.ascontiguousarray(image[y : y + SIDE, x : x + SIDE])


def gains(name: str, noisy: np.ndarray, clean: np.ndarray) -> list[float]:
    """PSNR in linear light [dB] of each strength."""
    in_px = METHODS[name].unit == "px"
    level, light = noise_level(noisy), to_linear(clean)
    found = []
    for strength in BLURS if in_px else RATIOS:
        output = Classical(name, strength if in_px else strength * level)(noisy)
        found.append(-10 * float(np.log10(((to_linear(output) - light) ** 2).mean())))
    return found


def choose(levels: np.ndarray, figures: np.ndarray, strengths: tuple[float, ...]) -> tuple[float, ...]:
    """At each of `LEVELS` the strength of the highest mean PSNR, pictures of such noise counting most.

    Args:
        levels: (pictures,).
        figures: (pictures, strengths) PSNR [dB].
        strengths: that were tried.
    """
    away = np.log2(levels[:, None] / np.asarray(LEVELS)) / WIDTH
    away = away**2 - (away**2).min(axis=0)  # beyond all levels the nearest picture counts
    scores = np.exp(-0.5 * away).T @ (figures - figures.mean(axis=1, keepdims=True))
    return tuple(round(strengths[i], 3) for i in scores.argmax(axis=1))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("data", type=Path)
    parser.add_argument("--work", type=Path, required=True, help="small clean pictures are kept here")
    options = parser.parse_args()
    use_cores()
    pairs = list(training_pairs(Place(options.data, options.work)))
    levels = np.array([noise_level(noisy) for noisy, _ in pairs])
    print("levels of 255 [5, 50, 95 %]:", np.round(255 * np.quantile(levels, (0.05, 0.5, 0.95)), 1))
    for name, method in METHODS.items():
        if missing := Classical(name).missing():
            print(f"{name}: not chosen, {missing} is not installed")
            continue
        figures = np.array([gains(name, *pair) for pair in pairs])
        print(f"{name}: {choose(levels, figures, BLURS if method.unit == 'px' else RATIOS)}")


if __name__ == "__main__":
    main()
