"""Descriptions of the axes, and of the statistics of clean+noisy pairs."""

import functools
from collections.abc import Iterator, Mapping
from typing import Any

from jaxisp.gap.features.mean import CHANNELS
from jaxisp.gap.features.noise import LEVELS, LUMA
from jaxisp.gap.features.quantization import FREQUENCIES

_LARGEST = 6  # number of statistics shown for an axis
STATISTICS = {
    "radius": "gain and noise towards the corners",
    "row": "offsets of whole rows",
    "column": "offsets of whole columns",
    "intensity": "error and noise by brightness, and how far apart the values are that occur",
    "hue": "error in proportion to chroma, by hue",
    "saturation": "chroma error of the more saturated colours",
    "channel": "how the noise of two channels goes together",
    "frequency": "fine against coarse: what is sharpened or blurred, and how large the grain is",
    "orientation": "error along detail, by its direction",
    "edge": "error and noise at edges; a shift or a wrong scale shows here",
    "cfa_phase": "what repeats every two pixels, as the colour filter array does",
    "block_phase": "what repeats every eight pixels: traces of JPEG compression",
    "neighbourhood": "error that follows the brightness around a pixel",
    "lag": "how the noise of a pixel goes with its neighbours'",
    "tail": "shape of the noise's distribution: outliers and lopsidedness",
    "fixed_pattern": "what stays at the same pixels from picture to picture",
    "frame": "what changes from frame to frame",
}
"""For clean+noisy pairs: the meaning of the statistics on each axis."""
PIXELS = {
    "radius": "across: from the middle (0) to the corners (1)",
    "row": "across: rows from the top",
    "column": "across: columns from the left",
    "intensity": "across: luma of the simulator's picture, 0 to 255",
    "hue": "across: angle of chroma; blue is near 350, red 110, green 230",
    "saturation": "across: distance from grey in Cb and Cr, 8-bit steps",
    "channel": "across: luma (Y) and chroma (Cb, Cr)",
    "frequency": "across: size of the detail that is off",
    "orientation": "across: direction in which the difference changes",
    "edge": "across: strength of edges, 8-bit steps per pixel",
    "cfa_phase": "across: row, column in the cell of the colour filter array",
    "block_phase": "place in the 8x8 blocks of JPEG; the darker, the higher",
    "neighbourhood": "across: brightness of the surroundings less the pixel's own, 8-bit steps",
    "lag": "across: rows down, columns right to the neighbour",
    "tail": "across: beyond how many standard deviations",
    "fixed_pattern": "what stays at the same pixels from picture to picture",
    "frame": "across: scene by scene, what its frames are off by, less what they are on average",
}
"""For RAW+JPEG pairs: the quantity along the profile of each axis."""


ACROSS = {
    "radius": "distance from the middle [of that to a corner]",
    "row": "row from the top",
    "column": "column from the left",
    "intensity": "luma [8-bit steps]",
    "hue": "angle of chroma [degrees]",
    "saturation": "distance from grey [8-bit steps]",
    "channel": "channel",
    "frequency": "size of the detail [px]",
    "orientation": "direction of the change",
    "edge": "strength of edges [8-bit steps per px]",
    "cfa_phase": "row, column in the cell of the colour filters",
    "block_phase": "row and column in the 8x8 blocks of JPEG",
    "neighbourhood": "light around less the pixel's own [8-bit steps]",
    "lag": "rows down, columns right to the neighbour [px]",
    "tail": "beyond [standard deviations]",
    "frame": "frame",
}
"""For RAW+JPEG pairs: names of the horizontal axes of the plots, with their units."""


def statistic_rows(where: Mapping[str, Any]) -> tuple[list[dict[str, Any]], str]:
    """Bars for the statistics of an axis that differ most, and a note on the others.

    Args:
        where: a row of `where` in report.json.
    """
    found = sorted(zip(where["bins"], where["profile"]), key=lambda f: -abs(f[1] or 0))
    shown, rest = found[:_LARGEST], found[_LARGEST:]
    top = abs(shown[0][1] or 0) or 1.0 if shown else 1.0
    rows = [_row(statistic(where["axis"], name), value or 0.0, top) for name, value in shown]
    return rows, f"{len(rest)} more within \N{PLUS-MINUS SIGN}{abs(rest[0][1] or 0):.1f}" if rest else ""


def _row(name: str, value: float, top: float) -> dict[str, Any]:
    width = round(50 * abs(value) / top, 2)
    text = f"{value:+.1f}".replace("-", "\N{MINUS SIGN}")
    return {"name": name, "value": text, "left": 50 if value > 0 else round(50 - width, 2), "width": width}


def statistic(axis: str, name: str) -> str:
    """Description of a statistic; `name` is "kind detail", as in `bins` of report.json."""
    kind, _, what = str(name).partition(" ")
    return statistic_words().get(f"{kind} {axis} {what}", str(name))


@functools.cache
def statistic_words() -> dict[str, str]:
    """Descriptions by the names of `jaxisp.gap.features.residual_statistics.feature_names`."""
    each = [text for channel in CHANNELS for text in _of_channel(channel)]
    return dict([*each, *_of_mean(), *_of_noise(), *_of_levels()])


def _of_channel(c: str) -> Iterator[tuple[str, str]]:
    yield from _mean_of_channel(c)
    for k, light in enumerate(LUMA):
        yield f"logvar intensity {c}{k}", f"{c} noise at luma {light:.0f}"
    for k, size in enumerate(("below 1 px", "1 to 2.5 px", "2.5 to 6 px")):
        yield f"logvar frequency {c}{k}", f"share of {c} noise in grain of {size}"
    yield f"logvar edge {c}", f"{c} noise at edges against flat areas"
    yield f"logvar radius {c}", f"{c} noise at the corners against the middle"
    for place in ("00", "01", "10", "11"):
        yield f"logvar cfa_phase {c}{place}", f"{c} noise at row {place[0]}, column {place[1]} of 2x2 pixels"
    for k, size in enumerate(("coarse", "middle", "fine")):
        yield f"comb block_phase {c}{k}", f"share of {size} {c} DCT coefficients near 0"
    yield f"comb intensity {c}", f"share of equal neighbours in {c}"
    for of in ("row", "column"):
        yield f"corr {of} {c}", f"{c} noise alike along a {of}"
        yield f"corr {of} {c} slow", f"{c} noise alike along bands of {of}s"
        yield f"pattern {of} {c} repeats", f"{c} offsets of {of}s that stay from scene to scene"
    yield f"pattern fixed_pattern {c} pixel", f"{c} differences that stay at their pixels"
    yield f"coarse fixed_pattern {c}", f"{c} spots of some 5 to 20 px that stay at their place"
    for part in ("dark", "bright"):
        yield f"change frame {c} {part}", f"{c} that comes and goes in the {part}er half, 8-bit steps"


def _mean_of_channel(c: str) -> Iterator[tuple[str, str]]:
    for k in range(8):
        yield f"mean intensity {c} {k}", f"{c} error at luma {255 * k / 7:.0f}"
    yield f"mean radius {c} gain", f"{c} error as luma times radius\N{SUPERSCRIPT TWO}"
    yield f"mean radius {c} gain4", f"{c} error as luma times radius\N{SUPERSCRIPT FOUR}"
    yield f"mean edge {c} shift", f"{c} error as of a wrong scale about the middle"
    yield f"mean edge {c} shift3", f"{c} error as of barrel or pincushion distortion"
    yield f"mean edge {c} down", f"{c} error as of a shift up or down"
    yield f"mean edge {c} right", f"{c} error as of a shift left or right"
    yield f"mean frequency {c} fine", f"{c} error that follows its finest detail"
    yield f"mean frequency {c} coarse", f"{c} error that follows its detail of 1 to 2 px"
    yield f"mean frequency {c} luma", f"{c} error that follows fine detail of luma"
    yield f"mean saturation {c} gain", f"{c} error in proportion to saturation"
    yield f"mean cfa_phase {c} rows", f"{c} error alternating row by row"
    yield f"mean cfa_phase {c} columns", f"{c} error alternating column by column"
    yield f"mean cfa_phase {c} checker", f"{c} error alternating as on a chessboard"
    for k, colour in enumerate(("blue", "magenta", "red", "yellow", "green", "cyan")):
        yield f"mean hue {k} {c}", f"{c} error of {colour}"


def _of_mean() -> Iterator[tuple[str, str]]:
    directions = {"x": "along rows", "y": "along columns", "down": "falling right", "up": "rising right"}
    for name, direction in directions.items():
        yield f"mean orientation {name}", f"luma error that follows changes {direction}"
    yield "mean edge asymmetry", "luma error that is darker, or brighter, on both sides of detail"
    yield "mean neighbourhood base", "luma gain that follows the light around"
    yield "mean neighbourhood detail", "luma error that follows the difference to the light around"


def _of_noise() -> Iterator[tuple[str, str]]:
    neighbours = {
        (0, 1): "next in the row", (1, 0): "next in the column", (1, 1): "diagonal, falling right",
        (1, -1): "diagonal, rising right", (0, 2): "second in the row", (2, 0): "second in the column",
    }  # fmt: skip
    for part, where in (("dark", "the dark"), ("light", "the light")):
        for c in CHANNELS:
            for lag, which in neighbours.items():
                yield f"corr lag {c}{lag} {part}", f"{c} noise and its neighbour's ({which}), in {where}"
        for a, b in (("Y", "Cb"), ("Y", "Cr"), ("Cb", "Cr")):
            yield f"corr channel {a}{b} {part}", f"{a} noise and {b} noise together, in {where}"
        yield f"corr orientation diagonals {part}", f"noise along one diagonal against the other, in {where}"
    for part, where in (("dark", "the dark"), ("bright", "the light")):
        yield f"tail tail kurtosis {part}", f"heaviness of both tails (kurtosis), in {where}"
        yield f"tail tail skew {part}", f"lopsidedness (skew), in {where}"
        yield f"tail tail high {part}", f"outliers that are too bright, in {where}"
        yield f"tail tail low {part}", f"outliers that are too dark, in {where}"
    yield "pattern tail peaks", "outliers that stay at their pixels"
    yield "pattern fixed_pattern bright", "luma differences that stay and grow with light"


def _of_levels() -> Iterator[tuple[str, str]]:
    for part, where in (("dark", "the dark"), ("light", "the light")):
        for k, count in enumerate(FREQUENCIES):
            yield f"code intensity {part}{k:02d}", f"RAW values in {count:.0f} even levels, in {where}"
    for count in LEVELS:
        yield f"levels intensity {count:02d}", f"green values in {count} even levels"
    for lines, line in (("columns", "column"), ("rows", "row")):
        for k in range(8):
            which = f"{line} {k} of 8" + (" (a block's border)" if k == 0 else "")
            yield f"logvar block_phase {lines}{k}", f"step of luma into {which}"
