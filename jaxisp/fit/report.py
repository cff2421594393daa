"""Show a fit: figures, pictures before and after, and what is left."""

from pathlib import Path

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt
import numpy as np
from matplotlib.figure import Figure

from jaxisp.fit.model import SET_FROM_FILE
from jaxisp.fit.noise import KINDS
from jaxisp.fit.result import FitResult
from jaxisp.io.files import output_folder
from jaxisp.params import specs
from jaxisp.report import Page


def write_report(result: FitResult, folder: str | Path) -> Path:
    """Write `report.html` into the folder; return its path."""
    page = Page(
        "A camera fitted to its own pictures", f"{len(result.pairs)} pairs in {result.seconds:.0f} s."
    )
    add_fit(page, result)
    path = output_folder(folder) / "report.html"
    page.write(path)
    return path


def add_fit(page: Page, result: FitResult, most: int = 2) -> None:
    """Add the figures of all pairs, and the pictures of the first few, to a page."""
    page.heading("The fit, before and after", f"Held out: {result.how}.")
    _add_pairs(page, result, most)
    said = [(p.name, text) for p in result.pairs for text in (*p.notes, *p.flags)]
    said += [(name, reason) for name, reason in result.failed]
    if said:
        page.heading("What to know about pairs", "")
        page.table(("pair", "what"), said)
    _add_noise(page, result)
    page.heading(
        "What was chosen", f"{result.design}. Objective of each choice after a step; lower is better."
    )
    page.table(("choice", "objective"), [(text, f"{value:.5f}") for text, value in result.tried])
    page.heading(
        "The camera that was found",
        "Parameters with their bounds; a value at a bound is marked. The error is the relative standard "
        "error from the curvature at the solution, the largest of a vector's; above 2.5 % a parameter is "
        "not identified by these pairs.",
    )
    page.table(("stage", "parameter", "value", "bounds", "unit", "error"), parameter_rows(result))
    if result.lens_px:
        rows = [(name, f"{value:+.2f}") for name, value in result.lens_px.items()]
        page.table(("displacement in the corner, of red and blue against green", "px"), rows)
    page.figures([("objective by step; each phase has its own scale", _loss_figure(result.losses))])


def _add_pairs(page: Page, result: FitResult, most: int) -> None:
    head = (
        "pair",
        "PSNR fitted [dB]",
        "SSIM fitted",
        "PSNR held out [dB]",
        "SSIM held out",
        "RAW to JPEG shift [px]",
    )
    rows = [
        (
            p.name,
            f"{p.psnr:.2f}",
            f"{p.ssim:.4f}",
            f"{p.held_out_psnr:.2f}",
            f"{p.held_out_ssim:.4f}",
            f"y {p.shift[0]:+.2f}, x {p.shift[1]:+.2f}",
        )
        for p in result.pairs
    ]
    page.table(head, rows)
    for pair in result.pairs[:most]:
        page.figures(
            [
                (f"{pair.name}: before (exposure and matrix by least squares)", pair.start),
                ("after the fit", pair.render),
                ("the camera's own picture", pair.target),
                ("what is left, five times, around grey", 0.5 + 5 * (pair.render - pair.target)),
            ]
        )


def _add_noise(page: Page, result: FitResult) -> None:
    page.heading(
        "Noise and edges",
        "In flat held-out regions: standard deviation and lag-1 autocorrelation of the noise, of the render "
        "and of the camera's picture, by intensity. Below, the detail at strong edges, render over picture.",
    )
    page.table(
        ("pair", "plane", "level", "std [1/255]", "their std", "lag 1", "their lag 1"), _noise_rows(result)
    )
    page.table(
        ("pair", "detail at edges", "held out with whole-pixel shift [dB]"),
        [
            (p.name, f"{p.noise.get('edge_detail_ratio', float('nan')):.3f}", f"{p.held_out_whole_shift:.2f}")
            for p in result.pairs
        ],
    )


def _noise_rows(result: FitResult) -> list[tuple[str, ...]]:
    return [
        (
            p.name,
            kind,
            f"{row['level']:.2f}",
            *(f"{255 * v:.2f}" for v in row["std"]),
            *(f"{v:.2f}" for v in row["lag1"]),
        )
        for p in result.pairs
        for kind in KINDS
        for row in p.noise.get(kind, {}).get("by_level", [])
    ]


def parameter_rows(result: FitResult) -> list[tuple[str, ...]]:
    """(stage, parameter, value, bounds, unit, error) of everything in the fitted camera."""
    errors: dict[str, float] = {}
    for known in result.identified:
        name = known.name.partition("[")[0]
        errors[name] = max(errors.get(name, 0.0), known.error)
    rows: list[tuple[str, ...]] = []
    for name, values in result.camera.prior.items():
        if name in SET_FROM_FILE:
            rows.append((name, "", "set from the file", "", "", ""))
            continue
        for field, spec in specs(type(values)).items():
            value = np.asarray(getattr(values, field))
            low, high = spec.bounds
            path = f"{name}.{field}"
            shown = np.array2string(value, precision=3, suppress_small=True)
            shown += " (at a bound)" if path in result.at_bound else ""
            error = f"{100 * errors[path]:.1f} %" if path in errors else "not fitted"
            rows.append((name, field, shown, f"{low:g} to {high:g}", spec.unit, error))
    return rows


def _loss_figure(losses: np.ndarray) -> Figure:
    figure, axes = plt.subplots(figsize=(6, 2.6))
    axes.semilogy(losses, color="#3b6ea5", linewidth=1.2)
    axes.set(xlabel="step", ylabel="objective")
    axes.spines[["top", "right"]].set_visible(False)
    plt.close(figure)
    return figure
