"""What was asked for at the outset, and what was measured: one row for each, met or missed.

The goals of the cases were set later, from prototypes, and most are harder.
"""

from collections.abc import Iterator
from typing import Any

Results = dict[str, Any]
Row = list[str]

HEAD = ("stage", "size", "against", "goal", "measured", "")
BATCH, LARGE = "batch", "1 MP"
_PLANES = ", 3 planes each"
_WAVELET = f"wavelet db2, 3 levels there and back{_PLANES}"
_CV_BILATERAL, _KORNIA_BILATERAL = "OpenCV float32, all threads", "kornia (square window)"

AGAINST_PEERS: tuple[tuple[str, str, str, dict[str, float]], ...] = (
    ("demosaic", "bilinear", "colour-demosaicing, bilinear", {BATCH: 14, LARGE: 24}),
    ("demosaic", "bilinear", "OpenCV, 16 bits", {BATCH: 0.6, LARGE: 0.6}),
    ("demosaic", "Malvar", "colour-demosaicing, Malvar2004", {BATCH: 40, LARGE: 33}),
    ("demosaic", "Menon", "colour-demosaicing, Menon2007", {BATCH: 20, LARGE: 20}),
    ("demosaic", "Hibbard", "OpenCV, edge-aware", {BATCH: 1.3, LARGE: 0.3}),
    ("demosaic", "AHD, 3 medians", "LibRaw AHD, 3 median passes", {"12 MP": 1}),
    ("denoise", f"bilateral d5{_PLANES}", _CV_BILATERAL, {BATCH: 1, LARGE: 0.6}),
    ("denoise", f"bilateral d5{_PLANES}", _KORNIA_BILATERAL, {BATCH: 2.5, LARGE: 4}),
    ("denoise", f"bilateral d11{_PLANES}", _CV_BILATERAL, {BATCH: 1, LARGE: 0.6}),
    ("denoise", f"bilateral d11{_PLANES}", _KORNIA_BILATERAL, {BATCH: 2.5, LARGE: 4}),
    *(
        ("denoise", f"median {side}{_PLANES}", peer, {BATCH: least, LARGE: least})
        for side in ("3x3", "5x5")
        for peer, least in (("SciPy", 50), ("kornia", 12), ("OpenCV float32", 0.4))
    ),
    ("denoise", _WAVELET, "PyWavelets", {BATCH: 18, LARGE: 4}),
    *(
        ("filters", stage, peer, {BATCH: least, LARGE: least})
        for stage in ("unsharp mask", "Gaussian")
        for peer, least in (("OpenCV", 0.7), ("kornia", 5))
    ),
    ("filters", "chromatic aberration", "OpenCV, remap", {BATCH: 1, LARGE: 0.8}),
    ("jpeg", "JPEG 4:2:0", "Pillow", {BATCH: 1.5, LARGE: 0.5}),
    ("jpeg", "JPEG 4:2:0", "kornia", {BATCH: 3, LARGE: 8}),
    ("chain", "chain of nine stages", "OpenCV, two images at a time", {BATCH: 1.5}),
    ("chain", "chain of nine stages", "OpenCV, its own threads", {LARGE: 1}),
    ("chain", "chain of nine stages", "kornia", {BATCH: 20, LARGE: 20}),
    ("chain", "develop, AHD", "rawpy postprocess, AHD", {"12 MP": 1}),
)
"""Family, stage, peer, and by size the least that its time over ours may be."""

AGAINST_STATED: tuple[tuple[str, str, str, float, float], ...] = (
    ("demosaic", "AHD, 3 medians", BATCH, 315, 60),
    ("demosaic", "AHD, 3 medians", LARGE, 1628, 20),
    ("denoise", "bilateral grid, chroma by luma", BATCH, 2293, 100),
    ("denoise", "bilateral grid, chroma by luma", LARGE, 9025, 100),
)
"""Family, stage, size, the milliseconds that the paper's own code was said to take, and the least ratio."""

PATCHES, PAPERS_IMAGES_PER_S = 32, 46


def rows(results: Results, start: Results | None) -> Iterator[Row]:
    """The table, as far as there are results."""
    for family, stage, peer, musts in AGAINST_PEERS:
        for size, least in musts.items():
            row = _row(results, family, stage, size)
            entry = next((p for p in row.get("peers", ()) if p["name"] == peer and "ratio" in p), None)
            if entry:
                yield _least(stage, size, peer, least, entry["ratio"])
    for family, stage, size, stated, least in AGAINST_STATED:
        if "ms" in (row := _row(results, family, stage, size)):
            yield _least(stage, size, "the paper's code (stated)", least, stated / row["ms"])
    yield from _phone(_row(results, "chain", "recipe phone", BATCH))
    yield from _start(start or {})


def _row(results: Results, family: str, stage: str, size: str) -> Results:
    found = results.get(family, {}).get("rows", ())
    return next((r for r in found if r["stage"] == stage and r["size"] == size), {})


def _phone(row: Results) -> Iterator[Row]:
    if "ms" not in row:
        return
    speed, stage = 1e3 * PATCHES / row["ms"], "recipe phone"
    yield _least(stage, BATCH, "the paper's code (stated)", 30, speed / PAPERS_IMAGES_PER_S)
    yield [stage, BATCH, "", "1500 images/s", f"{speed:.0f} images/s", _verdict(speed >= 1500)]
    slope = row["gradient"]["ratio"]
    yield [f"{stage}, gradient to all parameters", BATCH, "its forward call", "at most 4 x", f"{slope:.2f} x",
           _verdict(slope <= 4)]  # fmt: skip


def _start(start: Results) -> Iterator[Row]:
    if not start:
        return
    compiled, second = start["first"]["degrade_s"], start["second"]
    again = second["import_s"] + second["degrade_s"]
    memory = start["develop"]["peak_mb"] / 1024
    stage = "recipe phone"
    yield [f"{stage}, first call", BATCH, "", "below 20 s", f"{compiled:.1f} s", _verdict(compiled < 20)]
    yield [f"{stage}, second start with a cache, imports included", BATCH, "", "below 6 s", f"{again:.1f} s",
           _verdict(again < 6)]  # fmt: skip
    yield ["develop, AHD, peak memory of the process", "12 MP", "", "at most 2 GB", f"{memory:.2f} GB",
           _verdict(memory <= 2)]  # fmt: skip


def _least(stage: str, size: str, against: str, least: float, ratio: float) -> Row:
    return [stage, size, against, f"{least:g} x", f"{ratio:.2f} x", _verdict(ratio >= least)]


def _verdict(met: bool) -> str:
    return "met" if met else "**missed**"
