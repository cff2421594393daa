"""Pairs of two sets whose pictures were made of the same RAW files."""

import dataclasses
from collections.abc import Sequence

import numpy as np

from jaxisp.gap.pairs.crops import GRID, SMALLEST, cut
from jaxisp.io import Raw
from jaxisp.io.datasets import Loaded

_GLANCE = 16
"""Rows that are compared first: those of other photographs differ."""
_FEWEST = 2
"""Pairs that a diagnosis needs: one to be fitted, one held out."""


def of_same_raws(loaded: Sequence[Loaded], reference: Sequence[Loaded]) -> tuple[list[Loaded], list[Loaded]]:
    """The pairs whose RAW files the reference has too, and the reference's pairs of these files.

    Files are told by what they hold, not by their names: two are the same where the areas that both sets show
    of them agree, value by value. Alignment may have cut the two differently.

    Args:
        loaded, reference: aligned RAW+JPEG pairs.

    Returns:
        two lists of one length, each pair and its counterpart, which gets its name, cut to the area that both
        show; empty where fewer than two RAW files are shared.
    """
    own, others = [], []
    for pair in loaded:
        found = next((cut for other in reference if (cut := _shared(pair, other)) is not None), None)
        if found is not None:
            own.append(found[0])
            others.append(dataclasses.replace(found[1], name=pair.name))
    if len({pair.name for pair in own}) < min(_FEWEST, len({pair.name for pair in loaded})):
        return [], []
    return own, others


def _shared(one: Loaded, other: Loaded) -> tuple[Loaded, Loaded] | None:
    """Both pairs cut to the area that they share; None if their RAW files are not the same there."""
    assert one.raw is not None and other.raw is not None
    starts, stops = [], []
    for axis in (0, 1):
        begins, ends = zip(*(_extent(raw, axis) for raw in (one.raw, other.raw)))
        late = max(begins) - begins[0]
        starts.append(begins[0] + -(-late // GRID) * GRID)  # the filters and the 8x8 blocks keep their phase
        stops.append(min(ends))
    if min(stop - start for start, stop in zip(starts, stops)) < SMALLEST:
        return None
    for end in (starts[0] + _GLANCE, stops[0]):
        first, second = (r.mosaic[_within(r, starts, (end, stops[1]))] for r in (one.raw, other.raw))
        if not np.array_equal(first, second):
            return None
    return cut(one, _within(one.raw, starts, stops)), cut(other, _within(other.raw, starts, stops))


def _extent(raw: Raw, axis: int) -> tuple[int, int]:
    """First row (or column) of a mosaic in the active area, and the one after its last."""
    return raw.crop[axis], raw.crop[axis] + raw.mosaic.shape[axis]


def _within(raw: Raw, starts: Sequence[int], stops: Sequence[int]) -> tuple[slice, slice]:
    """An area of the active area, as slices of a mosaic."""
    rows, columns = (slice(a - o, b - o) for a, b, o in zip(starts, stops, raw.crop))
    return rows, columns
