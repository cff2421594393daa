"""The two pictures of a pair laid on each other: sizes, shifts, and pairs that are none."""

import dataclasses
from collections.abc import Sequence
from typing import Any

import jax.numpy as jnp
import numpy as np

from jaxisp.camera import shaded_mosaic
from jaxisp.cfa import shifted
from jaxisp.errors import InputError
from jaxisp.fit.align import Alignment, estimate, same_scene, warp
from jaxisp.gap.residual import BORDER
from jaxisp.io.datasets import Loaded

_STRETCH = 0.75  # px at the border by which two scales may differ and count as one
_UNLIKE = 0.1  # a correlation that even noisy or flat pairs of one scene reach
_ALIKE = 0.4  # what most pairs of a set reach that is neither


def scene_of(pair: Loaded) -> np.ndarray:
    """The half of a pair that comes first: (H, W) mosaic, or (H, W, 3) clean."""
    first = pair.clean if pair.raw is None else shaded_mosaic(pair.raw)
    assert first is not None
    return np.asarray(first)


def placed(scene: np.ndarray, picture: np.ndarray) -> Alignment:
    """Where the picture lies on the scene; a mosaic is seen through the means of its 2x2 cells."""
    if scene.ndim == 3:
        return estimate(scene, picture)
    cell = scene[:-1, :-1] + scene[1:, :-1] + scene[:-1, 1:] + scene[1:, 1:]
    # one fewer and half a pixel later than the pixels: about the same centre
    return estimate(np.sqrt(np.clip(cell, 0, None)), picture)


def in_one_frame(loaded: Sequence[Loaded]) -> tuple[list[Loaded], list[tuple[str, str]]]:
    """Pairs whose halves have one size, and (name, reason) of those left out.

    A picture of another size is laid where it belongs: cut, or resampled where its scale is another. One of
    the same size is moved by whole pixels, at most as far as the border that is not counted; what is not a
    whole pixel stays in the gap. A pair of two scenes is left out.

    Raises:
        InputError: no pair is left.
    """
    found = [placed(scene_of(pair), pair.picture) for pair in loaded]
    usual = float(np.median([f.correlation for f in found]))
    kept: list[Loaded] = []
    failed = []
    for pair, place in zip(loaded, found):
        scene = scene_of(pair)
        other_size = scene.shape[:2] != pair.picture.shape[:2]
        doubtful = not same_scene(place, pair.picture.shape)
        if doubtful and (other_size or usual > _ALIKE or place.correlation < _UNLIKE):
            reason = f"the two files do not show one scene: their correlation is {place.correlation:.2f}"
            failed.append((pair.name, f"{pair.name}: {reason}"))
            continue
        if other_size:
            kept.append(_cut(pair, scene, place, kept[0].raw.cfa if kept and kept[0].raw else None))
        else:
            kept.append(_moved(pair, place))
    if not kept:
        raise InputError("; ".join(reason for _, reason in failed))
    return kept, failed


def _moved(pair: Loaded, place: Alignment) -> Loaded:
    if not same_scene(place, pair.picture.shape):
        return pair
    move = [-int(np.clip(round(float(v)), -BORDER, BORDER)) for v in (place.dy, place.dx)]
    return dataclasses.replace(pair, picture=np.roll(pair.picture, move, (0, 1)))


def _cut(pair: Loaded, scene: np.ndarray, place: Alignment, cfa: str | None) -> Loaded:
    """Both halves cut to what they share; a mosaic starts at a site that gives it the pattern wanted."""
    picture, sizes = pair.picture, np.array(scene.shape[:2])
    stretch = max(abs(s - 1) * n / 2 for s, n in zip((place.scale_y, place.scale_x), sizes))
    if stretch > _STRETCH:
        picture, offsets = np.asarray(warp(jnp.asarray(picture), place, scene.shape[:2])), [0, 0]
    else:
        centres = (np.array(picture.shape[:2]) - sizes) / 2
        offsets = [round(float(c + d)) for c, d in zip(centres, (place.dy, place.dx))]
    starts = [max(0, -o) for o in offsets]
    stops = [min(n, m - o) for n, m, o in zip(sizes, picture.shape, offsets)]
    if pair.raw is not None and cfa is not None:
        starts = next(
            [starts[0] + y, starts[1] + x]
            for y in (0, 1) for x in (0, 1)
            if shifted(pair.raw.cfa, starts[0] + y, starts[1] + x) == cfa
        )  # fmt: skip
    of_scene = tuple(slice(a, b) for a, b in zip(starts, stops))
    of_picture = tuple(slice(a + o, b + o) for a, b, o in zip(starts, stops, offsets))
    halves: dict[str, Any] = {"picture": picture[of_picture]}
    if pair.raw is None:
        halves["clean"] = scene[of_scene]
    else:
        halves["raw"] = dataclasses.replace(
            pair.raw, mosaic=scene[of_scene], gain_map=None, cfa=shifted(pair.raw.cfa, *starts)
        )
    return dataclasses.replace(pair, **halves)
