"""Pairs cut to one size, a sample of those that are many, and the pixels that count."""

import dataclasses
import math
from collections.abc import Sequence
from typing import TypeVar

import jax.numpy as jnp
import numpy as np

from jaxisp.cfa import shifted
from jaxisp.cfa import size as cfa_size
from jaxisp.errors import InputError
from jaxisp.gap.pairs.pairs import Pairs
from jaxisp.gap.pairs.scenes import scene_name
from jaxisp.io.datasets import Loaded

SMALLEST, LARGEST = 64, 512  # px a side
TILES = " ("  # after the name of a pair that is alone
MOST = 5 * 2**17
"""Pixels of all pairs together. Of larger sets a sample is diagnosed, as memory and time grow with them."""
_USUAL = 192  # px a side that a sample keeps, for falloff and filters; beyond that it has fewer pairs
GRID = 16  # crops start at multiples of this, so that CFA and JPEG blocks keep their phase

_Thing = TypeVar("_Thing")


def common_crop(loaded: Sequence[Loaded]) -> list[tuple[slice, slice]]:
    """For each pair, whose halves have one size, the middle, of the size that all have.

    Raises:
        InputError: that is too small to be diagnosed.
    """
    size = common_size(loaded)
    return [_middle(pair, size) for pair in loaded]


def common_size(loaded: Sequence[Loaded]) -> tuple[int, int]:
    """Height and width that all pairs have, at most 512 px.

    Raises:
        InputError: that is too small to be diagnosed.
    """
    height, width = (min(LARGEST, *(p.picture.shape[axis] for p in loaded)) for axis in (0, 1))
    if min(height, width) < SMALLEST:
        smallest = min(loaded, key=lambda pair: min(pair.picture.shape[:2])).name
        raise InputError(
            f"{smallest}: all pairs have {width}x{height} px in common, too few to be diagnosed; expected "
            f"{SMALLEST} or more a side"
        )
    return height, width


def _middle(pair: Loaded, size: tuple[int, int]) -> tuple[slice, slice]:
    grid = GRID if pair.raw is None else math.lcm(GRID, cfa_size(pair.raw.cfa))
    starts = [(n - wanted) // 2 // grid * grid for n, wanted in zip(pair.picture.shape, size)]
    rows, columns = (slice(start, start + wanted) for start, wanted in zip(starts, size))
    return rows, columns


def cut(pair: Loaded, part: tuple[slice, slice]) -> Loaded:
    """Both halves of an aligned pair cut alike, as copies: nothing holds the whole frames."""
    raw, clean = pair.raw, pair.clean
    if raw is not None:
        mosaic, starts = raw.mosaic[part].copy(), [own.start for own in part]
        crop = (raw.crop[0] + starts[0], raw.crop[1] + starts[1], *mosaic.shape)
        raw = dataclasses.replace(raw, mosaic=mosaic, crop=crop, cfa=shifted(raw.cfa, *starts))
    own = None if clean is None else clean[part].copy()
    return dataclasses.replace(pair, raw=raw, clean=own, picture=pair.picture[part].copy())


def sampled(loaded: Sequence[Loaded], count: int) -> list[Loaded]:
    """The middles of the pairs, of a size that all have; of very many pairs some, evenly from all scenes.

    Args:
        loaded: aligned pairs.
        count: as how many they are counted: those of the larger of two sets, so that both are cut alike.

    Returns:
        as many of `count` pairs as have at most `MOST` pixels with at least `_USUAL` px a side.

    Raises:
        InputError: the size that all have is too small to be diagnosed.
    """
    height, width = common_size(loaded)
    most = MOST // (min(height, _USUAL) * min(width, _USUAL))
    kept, count = _spread(loaded, most), min(count, most)
    side = next(s for s in range(LARGEST, 0, -GRID) if count * min(height, s) * min(width, s) <= MOST)
    size = min(height, side), min(width, side)
    return [pair if pair.picture.shape[:2] == size else cut(pair, _middle(pair, size)) for pair in kept]


def _spread(loaded: Sequence[Loaded], most: int) -> list[Loaded]:
    """At most so many pairs, in their order: as many of each scene, spread evenly over its frames."""
    if len(loaded) <= most:
        return list(loaded)
    scenes: dict[str, list[Loaded]] = {}
    for pair in loaded:
        scenes.setdefault(scene_name(pair.name), []).append(pair)
    chosen = _evenly([*scenes.values()], most)
    each = [most // len(chosen) + (k < most % len(chosen)) for k in range(len(chosen))]
    return [pair for frames, n in zip(chosen, each) for pair in _evenly(frames, n)]


def _evenly(things: Sequence[_Thing], most: int) -> list[_Thing]:
    count = min(most, len(things))
    return [things[k * len(things) // count] for k in range(count)]


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
