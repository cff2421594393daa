"""The null bank: sizes of the axes for cameras that lack no effect.

The share of an axis is easily significant, since every camera's curve, borders and rounding differ slightly
from the simulator's. A share matters only if it exceeds those of independently written cameras that lack no
effect. `nulls.json` holds their sizes; `experiments/null_bank.py` generates it.
"""

import functools
import json
from collections.abc import Mapping
from importlib.resources import files
from typing import Any

from jaxisp.gap.axes import Rows
from jaxisp.gap.simulator.effects import CLEAN_NOISY, JPEG_JPEG, RAW_JPEG


def held_against_nulls(rows: Rows, kind: str, at: float, unit: float) -> list[dict[str, Any]]:
    """Compare the axes with those of cameras that lack no effect.

    Args:
        rows: the located axes.
        kind: of the data: "raw+jpeg" or "clean+noisy".
        at: the gap at the point where the axes were located.
        unit: the harmless gap, in the unit of the gap.

    Returns:
        the rows with these keys added or replaced:

        - `size`: for RAW+JPEG pairs, the part of the gap that the axis explains, in units of `unit`. For
          clean+noisy pairs, the mean squared difference of its statistics, in units of tolerance and chance.
        - `usual`: the 95th percentile of `size` over the bank; None if no camera there can show the axis.
        - `p_value`: the larger of two p-values. One is of chance. The other is of a camera that lacks no
          effect and has some axis at least as large, relative to `usual`.
    """
    nulls = bank()[kind]
    return [_beside(nulls, row, _size(row, kind, at, unit)) for row in rows]


def _size(row: Mapping[str, Any], kind: str, at: float, unit: float) -> float:
    return float(row["size"] if kind == CLEAN_NOISY else row["share"] * at / unit)


def _beside(nulls: Mapping[str, Any], row: Mapping[str, Any], size: float) -> dict[str, Any]:
    usual, p_value = nulls["usual"].get(row["axis"]), row["p_value"]
    if usual is not None:
        p_value = max(p_value, as_large(size / usual, nulls["largest"]))
    return {**row, "size": size, "usual": usual, "p_value": p_value}


def as_large(times: float, largest: list[float]) -> float:
    """The p-value of an axis that is `times` its usual size, among all axes of the bank's cameras.

    It is the share of cameras with some axis at least as large; the camera under test is counted too.
    """
    return (1 + sum(own >= times for own in largest)) / (1 + len(largest))


@functools.cache
def bank() -> dict[str, Any]:
    """The null bank by kind of data.

    `usual` holds the 95th percentile of each axis's size over the cameras. `largest` holds, for each camera,
    the largest ratio of an axis's size to its usual size.
    """
    found: dict[str, Any] = json.loads(files("jaxisp.gap.axes").joinpath("nulls.json").read_text())
    return found | {JPEG_JPEG: found[RAW_JPEG]}  # pixels are compared alike
