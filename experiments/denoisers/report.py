"""docs/results/denoisers.md from denoisers.json."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

FINDINGS = Path(__file__).with_name("findings.md")
"""What the tables show, in words."""
NOTE = """## How to read the figures

PSNR [dB] and SSIM (Gaussian window) in linear light. The clean picture is aligned first (translation and
scale, sub-pixel) and given the mean and standard deviation of what it is compared with, per channel, as
in Jaroensri et al. 2019. After +-: the standard deviation over seeds. `change` is the PSNR of a network's
output against its input, encoded: high where it does nothing. All networks of a table share
configuration, clean patches and their order; they differ in the recipe alone. Nothing was chosen by its
figures on iphone8.

Sets: `iphone8`, five crops of 200x200, a phone's JPEG against the mean of a RAW burst; `polyu`, nine
JPEGs of full-frame cameras against means of 500 (middle 512x512); `sidd`, six phone crops before a
phone's own processing (middle 512x512 at most); `cameras`, three simulated cameras that share no code
with the package (own demosaicking, denoising, sharpening, tone and JPEG) on three pictures that no
network has seen; `raw`, those pictures with sensor noise (Poisson factor 0.01, read 0.05) and Kodak
demosaicking alone.
"""


def document(tables: Mapping[str, Mapping[str, Any]]) -> str:
    """The whole page."""
    parts = ["# Denoisers trained on simulated cameras", "", FINDINGS.read_text(), NOTE]
    return "\n".join([*parts, *(table_text(tables[key]) for key in sorted(tables, key=_order))])


_ORDER = ("noise_models", "ablations", "demosaicking", "sanity", "raw_input")


def _order(key: str) -> tuple[int, str]:
    name = key.split()[0]
    return _ORDER.index(name) if name in _ORDER else len(_ORDER), key


def table_text(table: Mapping[str, Any]) -> str:
    """A table: the means of each set, then each picture of iphone8, then what it was made with."""
    rows = table["rows"]
    sets = _unique(row["set"] for row in rows)
    lines = [f"## {table['title']}", "", _means(rows, sets), ""]
    if "iphone8" in sets:
        lines += ["iphone8, each crop (mean over seeds):", "", _per_picture(rows, "iphone8"), ""]
    settings = ", ".join(f"{k} {v}" for k, v in table["settings"].items() if k in _SHOWN)
    seeds = _unique(str(row["seed"]) for row in rows if row["seed"] is not None)
    lines += [
        f"`{table['command']}`",
        "",
        f"Scale `{table['scale']}`: {settings}; seeds {', '.join(seeds)}; {table['machine']['processor']}, "
        f"{table['machine']['cores']} cores.",
        "",
    ]
    return "\n".join(lines)


_SHOWN = ("model", "steps", "batch", "patch", "lr", "schedule", "optimizer", "loss", "light", "ema")


def _means(rows: Sequence[Mapping[str, Any]], sets: Sequence[str]) -> str:
    head = ["trained on", *(f"{s}: {what}" for s in sets for what in ("PSNR", "SSIM", "change"))]
    body = []
    for name in _unique(row["denoiser"] for row in rows):
        cells = [name]
        for which in sets:
            means = [r["mean"] for r in rows if r["denoiser"] == name and r["set"] == which]
            cells += [_spread([m[key] for m in means], digits) for key, digits in _COLUMNS]
        body.append(cells)
    return _markdown(head, body)


_COLUMNS = (("psnr", 2), ("ssim", 3), ("change", 1))


def _per_picture(rows: Sequence[Mapping[str, Any]], which: str) -> str:
    chosen = [row for row in rows if row["set"] == which]
    names = [pair["name"] for pair in chosen[0]["pairs"]]
    body = []
    for denoiser in _unique(row["denoiser"] for row in chosen):
        runs = [row["pairs"] for row in chosen if row["denoiser"] == denoiser]
        body.append(
            [
                denoiser,
                *(f"{_mean(runs, i, 'psnr'):.2f} / {_mean(runs, i, 'ssim'):.3f}" for i in range(len(names))),
            ]
        )
    return _markdown(["trained on", *names], body)


def _mean(runs: Sequence[Sequence[Mapping[str, Any]]], index: int, key: str) -> float:
    return float(np.mean([pairs[index][key] for pairs in runs]))


def _spread(values: Sequence[float], digits: int) -> str:
    if not values:
        return ""
    text = f"{np.mean(values):.{digits}f}"
    return text if len(values) < 2 else f"{text} +- {np.std(values, ddof=1):.{digits}f}"


def _unique(values: Any) -> list[Any]:
    return list(dict.fromkeys(values))


def _markdown(head: Sequence[str], body: Sequence[Sequence[str]]) -> str:
    lines = [head, ["---"] * len(head), *body]
    return "\n".join("| " + " | ".join(line) + " |" for line in lines)
