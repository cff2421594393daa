"""What the parts share: scenes, seed, and the figures that are kept of a fit."""

import tempfile
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from jaxisp.fit import Example, FitResult, fit_dataset, fit_examples
from jaxisp.samples import scene, scene_names

Run = Callable[[], dict[str, Any]]
Cases = dict[str, dict[str, Any]]

SEED = 7
SIZE = 208
WINDOWS = ((0.1, 0.2, 0.7), (0.9, 0.8, 0.7))


def framed(size: int = SIZE) -> dict[str, np.ndarray]:
    """Eight scenes: two windows of each photograph."""
    return {
        f"{name}{i}": scene(name, size, window)
        for name in scene_names()
        for i, window in enumerate(WINDOWS)
    }  # fmt: skip


def fitted(name: str, folder: str | Path, **options: Any) -> FitResult:
    """The fit of a folder; one of that name that was stopped goes on where it was."""
    return _resumed(name, partial(fit_dataset, folder, **options))


def fitted_examples(name: str, examples: Sequence[Example], **options: Any) -> FitResult:
    """The same of pairs in memory."""
    return _resumed(name, partial(fit_examples, examples, **options))


def _resumed(name: str, fit: Callable[..., FitResult]) -> FitResult:
    journal = Path(tempfile.gettempdir()) / f"fit-phones-{name}.partial"
    result = fit(journal=journal)
    journal.unlink(missing_ok=True)
    return result


@contextmanager
def changed(table: dict[str, Any], name: str, function: Any) -> Iterator[None]:
    """One of the reference phone's own steps put in another's place."""
    before, table[name] = table[name], function
    try:
        yield
    finally:
        table[name] = before


def short(result: FitResult) -> dict[str, Any]:
    return {
        "held_out_psnr": float(np.mean([p.held_out_psnr for p in result.pairs])),
        "held_out_ssim": float(np.mean([p.held_out_ssim for p in result.pairs])),
        "worst": float(np.min([p.held_out_psnr for p in result.pairs])),
        "design": result.design,
        "flags": [f for p in result.pairs for f in p.flags],
        "unidentified": result.unidentified,
    }


def noise_table(figures: dict[str, Any]) -> list[str]:
    lines = [
        "| held-out flat regions | std, render / JPEG | lag-1 autocorrelation, render - JPEG |",
        "| --- | --- | --- |",
    ]
    for kind in ("luma", "chroma"):
        noise = figures[kind]
        lines.append(f"| {kind} | {noise['std_ratio']:.3f} | {noise['lag1_difference']:+.3f} |")
        for row in noise["by_level"]:
            ratio, grain = row["std"][0] / row["std"][1], row["lag1"][0] - row["lag1"][1]
            lines.append(f"| {kind}, level {row['level']:.2f} | {ratio:.3f} | {grain:+.3f} |")
    return lines
