"""Names and numbers as report.html writes them."""

import math
from collections.abc import Sequence
from typing import Any

import numpy as np

_PER_CENT = "\N{NO-BREAK SPACE}%"
_FIXED = {
    "cfa_phase": "colour filter phase",
    "block_phase": "8x8 block phase",
    "prnu": "PRNU",
    "lag": "noise correlation",
    "tail": "noise tails",
    "primaries": "to the sensor's primaries",
    "balanced_noise": "shot and read noise",
    "mosaic_white_balance": "white balance of the mosaic",
    "to_raw": "white balance undone",
    "early_balance": "white balance before demosaicking",
    "later_balance": "white balance after demosaicking",
    "companding": "square roots",
    "expansion": "squares",
    "white_level": "clipping at white",
    "mixing": "from the sensor's primaries",
    "display_range": "clipping to the display's range",
    "file": "the file's compression",
    "encoded": "sRGB encoding of the scene",
    "scene_encoded": "sRGB encoding of the scene",
    "scene_tone": "the scene's tone curve",
    "scene_light": "the scene's light again",
    "scene_matrix": "the scene's colour matrix",
}
"""Names of axes, effects and base nodes that are not the identifier with blanks for underscores."""
_PARTS = {
    "adc": "ADC", "cfa": "CFA", "color": "colour", "jpeg": "JPEG", "lut": "LUT", "oetf": "OETF",
    "srgb": "sRGB",
}  # fmt: skip


def words(name: str) -> str:
    """The name of an axis, effect or stage within a sentence."""
    return _FIXED.get(name) or " ".join(_PARTS.get(part, part) for part in str(name).split("_"))


def begun(text: str) -> str:
    """Capitalise the first letter; the other letters stay as they are."""
    return text[:1].upper() + text[1:]


def any_of(names: Sequence[str]) -> str:
    """Join the names of effects with "or"."""
    return " or ".join(map(words, names))


def listed(texts: Sequence[str]) -> str:
    """Join texts with commas, and with "and" before the last."""
    return " and ".join(filter(None, (", ".join(texts[:-1]), *texts[-1:])))


def counted(count: int, noun: str) -> str:
    """A count with its noun, in the plural unless it is 1."""
    return f"{count} {noun}" + ("" if count == 1 else "s")


def finite(value: Any) -> bool:
    """Whether the value is a finite number."""
    return isinstance(value, (int, float, np.number)) and math.isfinite(value)


def percent(share: Any) -> str:
    """A share in per cent; "unknown" if it is not a finite number."""
    if not finite(share):
        return "unknown"
    value = 100 * float(share)
    digits = 1 if 0.05 <= abs(value) < 0.95 else 0
    return f"{value:.{digits}f}{_PER_CENT}".replace("-0" + _PER_CENT, "0" + _PER_CENT)


def span(ci: Sequence[Any]) -> str:
    """An interval [low, high] of shares, in per cent."""
    return "[" + ",\N{NO-BREAK SPACE}".join(percent(v).removesuffix(_PER_CENT) for v in ci) + "]"


def number(value: Any) -> str:
    """A number with three significant digits; without an exponent below one million."""
    if not finite(value):
        return "unknown"
    value = float(value)
    return f"{value:.0f}" if 1000 <= abs(value) < 1e6 else f"{value:.3g}"


def chance(p: Any) -> str:
    """A p-value with its relation sign, such as "= 0.02"; "unknown" if it is not a finite number."""
    return "unknown" if not finite(p) else "< 0.001" if p < 0.001 else f"= {p:.2g}"
