"""Names of a cause's parameters on the page: members of a family by name instead of index."""

from collections.abc import Mapping
from typing import Any

from jaxisp.gap.report.words import finite, number
from jaxisp.gap.simulator.effects import EFFECTS, Effect
from jaxisp.params import specs
from jaxisp.pipeline import signature
from jaxisp.stages.choice import DEMOSAICKERS
from jaxisp.stages.look import SECTORS
from jaxisp.stages.smoothing import WIDTHS

_COLOURS = ("red", "green", "blue")
_SECTORS = tuple(f"{360 / SECTORS * k:.3g}\N{DEGREE SIGN}" for k in range(SECTORS))
MEMBERS: dict[tuple[str, str], tuple[str, ...]] = {
    ("luma_denoising", "shares"): (
        "bilateral (1.5 px, 0.03 of white)", "bilateral (2 px, 0.1 of white)", "median 3x3",
        "local linear (0.01 of white)", "local linear (0.03 of white)", "guided (3 px, 0.03 of white)",
        "non-local means (0.03 of white)", "wavelets (0.01 of white)",
    ),
    ("chroma_denoising", "shares"): (
        "Gaussian (1 px)", "Gaussian (2.5 px)", "median 3x3", "median 5x5", "bilateral (2 px, 0.05 of white)",
        "guided by luma (4 px, 0.03 of white)", "wavelets (0.02 of white)",
    ),
    ("sharpening", "amounts"): tuple(f"mask of {width:g} px" for width in WIDTHS),
    ("sharpening", "deconvolution"): ("encoded", "in linear light"),
    ("demosaicking", "shares"): tuple(DEMOSAICKERS),
    ("resampling", "shares"): (
        "bilinear down and bicubic up, not antialiased", "bicubic",
        "bicubic down and bilinear up, not antialiased",
    ),
    ("motion_blur", "lengths"): ("along rows", "down right", "along columns", "down left"),
    ("white_balance", "gains"): _COLOURS,
    ("color_matrix", "matrix"): tuple(f"{to} from {of}" for to in _COLOURS for of in _COLOURS),
    ("tone_curve", "offsets"): tuple(f"at {k / 11:.2f} of white" for k in range(12)),
} | {("color_lut", field): _SECTORS for field in ("hue", "saturation", "lightness")}  # fmt: skip
"""Members of each family by effect and field, in the order of the stage's parameters."""
_ZERO = 0.1  # share of the family's largest change; smaller changes are left out
_MOST = 6  # largest number of members shown


def parameters_of(cause: Mapping[str, Any]) -> list[str]:
    """One line for each field of the effect's parameters, with unit and meaning.

    Args:
        cause: a row of `causes` in report.json.
    """
    fields: dict[str, dict[str, Any]] = {}
    for key, value in cause["params"].items():
        field, _, index = key.partition("[")
        fields.setdefault(field, {})[index] = value
    lines = [_line(cause["effect"], field, values) for field, values in fields.items()]
    return [line for line in lines if line]


def _line(effect: str, field: str, values: Mapping[str, Any]) -> str:
    spec = _specs(EFFECTS[effect]).get(field) if effect in EFFECTS else None
    unit = f" {spec.unit}" if spec and spec.unit in ("EV", "px", "rad") else ""
    if "" in values:
        meaning = f" ({spec.doc})" if spec and spec.doc else ""
        return f"{field} {_text(values[''])}{unit}{meaning}"
    shown, more = _members(effect, field, values)
    texts = [f"{_member(effect, field, index)} {_text(values[index])}{unit}" for index in shown]
    return f"{field}: {', '.join(texts)}" + (f"; {more} smaller" if more else "") if texts else ""


def _specs(effect: Effect) -> dict[str, Any]:
    declared = signature(next(effect.node.stages()).fn).params
    return specs(declared) if declared else {}


def _members(effect: str, field: str, values: Mapping[str, Any]) -> tuple[list[str], int]:
    """Indices of the members with the largest changes, in order, and the number of further members.

    Changes below `_ZERO` of the largest are ignored.
    """
    moves = EFFECTS[effect].moves if effect in EFFECTS else ()
    off = {"".join(f"[{n}]" for n in m.index)[1:]: m.off for m in moves if m.field == field}
    change = {i: abs(v - off.get(i, 0.0)) if finite(v) else 0.0 for i, v in values.items()}
    largest = max(change.values())
    counted = [i for i, c in change.items() if c > 0 and c >= _ZERO * largest]
    kept = set(sorted(counted, key=lambda i: -change[i])[:_MOST])
    return [i for i in counted if i in kept], len(counted) - len(kept)


def _member(effect: str, field: str, index: str) -> str:
    names = MEMBERS.get((effect, field))
    if names is None:
        return f"[{index}"
    place = [int(n) for n in index.rstrip("]").split("][")]
    return names[3 * place[0] + place[1] if len(place) == 2 else place[0]]


def _text(value: Any) -> str:
    return number(value) if finite(value) else str(value)
