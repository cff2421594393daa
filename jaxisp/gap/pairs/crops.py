"""Pairs cut to one size, and the pixels that count."""

import dataclasses
from collections.abc import Sequence

import jax.numpy as jnp
import numpy as np

from jaxisp.errors import InputError
from jaxisp.gap.pairs.pairs import Pairs
from jaxisp.io.datasets import Loaded

SMALLEST, LARGEST = 64, 512  # px a side
TILES = " ("  # after the name of a pair that is alone
GRID = 16  # crops start at multiples of this, so that CFA and JPEG blocks keep their phase


def common_crop(loaded: Sequence[Loaded]) -> list[tuple[slice, slice]]:
    """For each pair, whose halves have one size, the middle, of a size that all have, at most 512 px a side.

    Raises:
        InputError: that is too small to be diagnosed.
    """
    sizes = [pair.picture.shape[:2] for pair in loaded]
    size = [min(LARGEST, *(s[axis] for s in sizes)) for axis in (0, 1)]
    if min(size) < SMALLEST:
        smallest = min(loaded, key=lambda pair: min(pair.picture.shape[:2])).name
        raise InputError(
            f"{smallest}: all pairs have {size[1]}x{size[0]} px in common, too few to be diagnosed; expected "
            f"{SMALLEST} or more a side"
        )
    crops = []
    for shape in sizes:
        starts = [(n - wanted) // 2 // GRID * GRID for n, wanted in zip(shape, size)]
        crops.append((slice(starts[0], starts[0] + size[0]), slice(starts[1], starts[1] + size[1])))
    return crops


def in_halves(pairs: Pairs) -> Pairs:
    """A pair that is alone becomes two: the even and the odd tiles of a checkerboard of 64x64."""
    if len(pairs.names) > 1:
        return pairs
    y, x = np.indices(pairs.mask.shape[1:])
    even = (y // 64 + x // 64) % 2 == 0
    names = tuple(f"{pairs.names[0]}{TILES}{which} tiles)" for which in ("even", "odd"))
    twice = np.concatenate([pairs.pictures] * 2)
    relit = pairs.relit(lambda light: jnp.concatenate([light] * 2))
    mask = np.stack([even, ~even]) & pairs.mask
    return dataclasses.replace(relit, names=names, pictures=twice, mask=mask)


def usable(pictures: np.ndarray) -> np.ndarray:
    """Where no channel is at an end of its range."""
    return np.asarray(((pictures > 1.5 / 255) & (pictures < 253.5 / 255)).all(-1))
