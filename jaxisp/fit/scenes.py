"""Held out by scene: the camera fitted again without some pairs, and measured on those.

The discrete choices stay as they were made on all pairs. Everything else starts anew, so that nothing of the
scene that is left out is in it.
"""

from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np

from jaxisp.errors import InputError
from jaxisp.fit.evaluate import masked_psnr, turned
from jaxisp.fit.pair import Example
from jaxisp.fit.render import render, similarity
from jaxisp.fit.result import Scenes
from jaxisp.fit.search import Outcome, Search
from jaxisp.fit.tiles import BORDER, Shot, halved, split

FOLDS = 4  # most fits: more pairs are left out in as many groups


class _Fold(NamedTuple):
    """What one fit is fitted to, and the pairs that it is measured on: all of them, or some columns."""

    kept: tuple[Shot, ...]
    left_out: tuple[int, ...]
    columns: slice = slice(None)


def held_out(
    outcome: Outcome, search: Search, shots: Sequence[Shot], load: Callable[[int], Example]
) -> Scenes | None:
    """Leave whole pairs out in turn, or the halves of the only one.

    Args:
        outcome: of all pairs together: its choices, and where the pictures lie.
        search: that ended there.
        shots: the pairs.
        load: reads the pair of an index.

    Returns:
        the figures, on the tiles that no fit of pairs takes; None where a half of the only pair has nothing
        to fit or to measure.
    """
    errors: list[list[tuple[float, float]]] = [[] for _ in shots]
    try:
        folds, how = _folds(shots, load)
        for number, fold in enumerate(folds, 1):
            found = search.of(fold.kept).settled(outcome.design, f"without scene {number}")
            for i in fold.left_out:
                errors[i].append(_measured(found, outcome, i, shots[i], load(i), fold.columns))
    except _Nothing:
        return None
    means = [np.mean(own, axis=0) for own in errors]
    return Scenes(
        tuple(shot.name for shot in shots),
        tuple(float(mean[0]) for mean in means),
        tuple(float(mean[1]) for mean in means),
        how,
    )


class _Nothing(Exception):
    """There is nothing to fit or to measure."""


def _folds(shots: Sequence[Shot], load: Callable[[int], Example]) -> tuple[list[_Fold], str]:
    if len(shots) == 1:
        try:
            left, right = halved(shots[0])
        except InputError:
            raise _Nothing from None
        width = turned(load(0), shots[0]).picture.shape[1]
        middle = width // 2
        halves = [
            _Fold((left,), (0,), slice(middle + BORDER, width)),  # BORDER: no filter reaches across
            _Fold((right,), (0,), slice(0, middle - BORDER)),
        ]
        return halves, "one half of the picture is fitted, the other half reported, and back"
    count = min(len(shots), FOLDS)
    groups = [tuple(range(fold, len(shots), count)) for fold in range(count)]
    folds = [_Fold(tuple(s for i, s in enumerate(shots) if i not in group), group) for group in groups]
    turn = "each pair" if count == len(shots) else f"each of {count} groups of pairs"
    return folds, f"{turn} is left out in turn, the others are fitted"


def _measured(
    found: Outcome, outcome: Outcome, pair: int, shot: Shot, example: Example, columns: slice
) -> tuple[float, float]:
    """(PSNR, SSIM) of a camera on a pair that it was not fitted to, which lies where the whole fit says."""
    example = turned(example, shot)
    target = example.picture
    tiles = split(target, shot.alignment, example.raw.mosaic.shape, shot.lens).held_out
    shown, where = np.zeros_like(tiles), np.zeros_like(tiles)
    first, last, _ = columns.indices(target.shape[1])
    shown[:, max(first - BORDER, 0) : last + BORDER] = True  # SSIM looks around each pixel
    where[:, columns] = tiles[:, columns]
    if not where.any():
        raise _Nothing
    image = np.mean(found.state.images, axis=0)
    vector = np.concatenate([found.state.camera, image, outcome.state.places[pair]]).astype(np.float32)
    fit = found.fit.beside(outcome.fit)
    done = render(fit, vector, pair, shot, example, where=shown)
    return masked_psnr(done, target, where), float(similarity(done, target)[where].mean())
