"""A calibration as a page: figures with their errors, and the plots that show whether to believe them."""

from collections.abc import Callable, Iterator
from pathlib import Path

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure as Plot

from jaxisp.calibrate.noise import FIGURES, Calibrated, Noise
from jaxisp.io.files import PathLike, output_folder
from jaxisp.report import Page

_COLOURS = ("#3b6ea5", "#c1622f")
_POINTS = 3000  # drawn at most


def write_page(found: Calibrated, folder: PathLike) -> Path:
    """Write `report.html` into the folder; return its path."""
    isos = ", ".join("without a number" if n.iso is None else f"{n.iso:g}" for n in found.noise)
    page = Page(f"Sensor noise: {found.camera or 'a camera without a name'}", f"ISO {isos}.")
    for noise in found.noise:
        _add(page, noise)
    if found.notes:
        page.heading("What to know about the frames")
        page.table(("note",), [(note,) for note in found.notes])
    path = output_folder(folder) / "report.html"
    page.write(path)
    return path


def _add(page: Page, noise: Noise) -> None:
    flat, dark = noise.frames
    name = "Without an ISO number" if noise.iso is None else f"ISO {noise.iso:g}"
    page.heading(name, f"{flat} flat and {dark} dark frames. A level is a share of white less black.")
    page.table(("figure", "value", "standard error", "unit", "what it is"), list(figure_rows(noise)))
    electrons = noise.electrons
    if electrons:
        units = {"gain": "DN/e-", "read": "e-", "capacity": "e-", "dynamic_range": "dB"}
        page.table(
            ("in electrons", "value", "unit"),
            [(n.replace("_", " "), f"{v:.4g}", units[n]) for n, v in electrons.items()],
        )
    if noise.shot_by_place:
        places = [f"{c} at row {i // 2}, column {i % 2}" for i, c in enumerate(noise.cfa)]
        rows = [(p, f"{f.value:.4g}", f"{f.error:.1g}") for p, f in zip(places, noise.shot_by_place)]
        page.table(("place of the cell", "shot [level]", "standard error"), rows)
    if noise.stated is not None:
        page.table(
            ("NoiseProfile of the file, green", "stated", "measured"),
            [
                (n, f"{stated:.4g}", f"{noise.value(n):.4g}")
                for n, stated in zip(("shot", "read"), noise.stated)
            ],
        )
    if noise.points:
        page.figures(
            [
                ("photon transfer: temporal variance of blocks, and the fit", _plot(_transfer, noise)),
                ("nonuniformity: what stays from frame to frame, and the fit", _plot(_uneven, noise)),
                ("rows and columns of the dark frames' mean, less a moving mean", _plot(_profiles, noise)),
            ]
        )


def figure_rows(noise: Noise) -> Iterator[tuple[str, str, str, str, str]]:
    """Name, value, standard error, unit and meaning of each figure."""
    for name, (unit, meaning) in FIGURES.items():
        if name in noise.figures:
            value, error = noise.figures[name]
            yield name, f"{value:.4g}", f"{error:.1g}", unit, meaning


def _plot(draw: Callable[[Axes, Noise], None], noise: Noise) -> Plot:
    figure, axes = plt.subplots(figsize=(5, 3.4), layout="constrained")
    draw(axes, noise)
    axes.spines[["top", "right"]].set_visible(False)
    plt.close(figure)
    return figure


def _transfer(axes: Axes, noise: Noise) -> None:
    level, temporal, _ = noise.points
    thin = slice(None, None, -(-len(level) // _POINTS))
    axes.plot(level[thin], temporal[thin], ".", color=_COLOURS[0], markersize=2, alpha=0.4)
    shown = np.linspace(0, max(float(level.max()), 1e-6), 200)
    axes.plot(shown, noise.value("shot") * shown + noise.value("read") ** 2, color=_COLOURS[1])
    axes.set(xlabel="level", ylabel="variance [level²]")


def _uneven(axes: Axes, noise: Noise) -> None:
    level, _, spatial = noise.points
    thin = slice(None, None, -(-len(level) // _POINTS))
    axes.plot(level[thin], spatial[thin], ".", color=_COLOURS[0], markersize=2, alpha=0.4)
    shown = np.linspace(0, max(float(level.max()), 1e-6), 200)
    axes.plot(shown, noise.value("prnu") ** 2 * shown**2 + noise.value("dsnu") ** 2, color=_COLOURS[1])
    axes.set(xlabel="level", ylabel="variance [level²]")


def _profiles(axes: Axes, noise: Noise) -> None:
    rows, columns = (np.concatenate(noise.profiles[k : k + 2]) for k in (0, 2))
    for values, label, colour in ((rows, "rows", _COLOURS[0]), (columns, "columns", _COLOURS[1])):
        axes.hist(values, bins=60, histtype="step", density=True, label=label, color=colour)
    axes.set(xlabel="offset [level]", ylabel="density")
    axes.legend(frameon=False)
