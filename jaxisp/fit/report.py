"""Show a fit: figures, pictures before and after, and what is left."""

from pathlib import Path

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt
import numpy as np

from jaxisp.fit.fitter import FitResult
from jaxisp.io.files import output_folder
from jaxisp.params import specs
from jaxisp.report import Page

SET_FROM_FILE = ("mosaic_white_balance", "jpeg_tables")


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
    page.table(
        (
            "pair",
            "PSNR fitted [dB]",
            "SSIM fitted",
            "PSNR held out [dB]",
            "SSIM held out",
            "RAW to JPEG shift [px]",
        ),
        [
            (
                p.name,
                f"{p.psnr:.2f}",
                f"{p.ssim:.4f}",
                f"{p.held_out_psnr:.2f}",
                f"{p.held_out_ssim:.4f}",
                f"y {p.shift[0]:+.2f}, x {p.shift[1]:+.2f}",
            )
            for p in result.pairs
        ],
    )
    for pair in result.pairs[:most]:
        difference = 0.5 + 5 * (pair.render - pair.target)
        page.figures(
            [
                (f"{pair.name}: before (exposure and matrix by least squares)", pair.start),
                ("after the fit", pair.render),
                ("the camera's own picture", pair.target),
                ("what is left, five times, around grey", difference),
            ]
        )
    page.heading("The camera that was found", "Parameters with their bounds; a value at a bound is marked.")
    page.table(("stage", "parameter", "value", "bounds", "unit"), parameter_rows(result))
    page.figures([("loss by step", _loss_figure(result.losses))])


def parameter_rows(result: FitResult) -> list[tuple[str, str, str, str, str]]:
    """(stage, parameter, value, bounds, unit) of everything in the fitted camera."""
    rows = []
    for name, values in result.camera.prior.items():
        if name in SET_FROM_FILE:
            rows.append((name, "", "set from the file", "", ""))
            continue
        for field, spec in specs(type(values)).items():
            value = np.asarray(getattr(values, field))
            low, high = spec.bounds
            at_bound = ((value - low < 1e-3 * (high - low)) | (high - value < 1e-3 * (high - low))).any()
            shown = np.array2string(value, precision=3, suppress_small=True) + (
                " (at a bound)" if at_bound else ""
            )
            rows.append((name, field, shown, f"{low:g} to {high:g}", spec.unit))
    return rows


def _loss_figure(losses: np.ndarray) -> plt.Figure:
    figure, axes = plt.subplots(figsize=(6, 2.6))
    axes.semilogy(losses, color="#3b6ea5", linewidth=1.2)
    axes.set(xlabel="step", ylabel="loss")
    axes.spines[["top", "right"]].set_visible(False)
    plt.close(figure)
    return figure
