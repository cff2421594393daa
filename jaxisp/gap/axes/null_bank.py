"""What axes show where nothing is missing: the null bank, which a gap's axes are held against.

That an axis explains something of a residual is soon beyond chance: every camera's curve, borders and
rounding differ a little from the simulator's. What matters is whether it is beyond cameras, written
independently, that lack nothing. `nulls.json` has their sizes; `experiments/null_bank.py` makes it.
"""

import functools
import json
from collections.abc import Mapping
from importlib.resources import files
from typing import Any

from jaxisp.gap.axes import Rows
from jaxisp.gap.simulator.effects import RAW_JPEG


def held_against_nulls(rows: Rows, kind: str, at: float, unit: float) -> list[dict[str, Any]]:
    """Axes as they are located, with what cameras that lack nothing say of them.

    Args:
        rows: the axes.
        kind: of the data.
        at: the gap where they were located.
        unit: what is harmless, in the unit of the gap.

    Returns:
        the rows with `size`: in RAW+JPEG pairs the part of the gap that the axis explains, in units of it, in
        clean+noisy pairs the mean square of its statistics' differences, in units of what is harmless or
        chance. With `usual`, the size that 95 % of the bank's cameras stay below, or None of an axis that
        none of them could show. And with a `p_value` that is the larger of two: of chance, and of a camera
        that lacks nothing having any axis as many times as large as usual.
    """
    nulls = bank()[kind]
    return [_beside(nulls, row, _size(row, kind, at, unit)) for row in rows]


def _size(row: Mapping[str, Any], kind: str, at: float, unit: float) -> float:
    return float(row["share"] * at / unit if kind == RAW_JPEG else row["size"])


def _beside(nulls: Mapping[str, Any], row: Mapping[str, Any], size: float) -> dict[str, Any]:
    usual, p_value = nulls["usual"].get(row["axis"]), row["p_value"]
    if usual is not None:
        p_value = max(p_value, as_large(size / usual, nulls["largest"]))
    return {**row, "size": size, "usual": usual, "p_value": p_value}


def as_large(times: float, largest: list[float]) -> float:
    """The share of cameras whose largest axis is as many times as large as usual, the one at hand counted."""
    return (1 + sum(own >= times for own in largest)) / (1 + len(largest))


@functools.cache
def bank() -> dict[str, Any]:
    """By kind of data: `usual`, by axis the size that 95 % of the cameras stay below, and `largest`, of each
    camera the most times that an axis of its is as large as usual."""
    found: dict[str, Any] = json.loads(files("jaxisp.gap.axes").joinpath("nulls.json").read_text())
    return found
