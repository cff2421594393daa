"""Show a fit: figures, pictures before and after, and what is left."""

import json
from collections.abc import Sequence
from itertools import groupby
from pathlib import Path
from typing import Any

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from jaxisp.fit.curvature import KNOWN, LEAST, Identified
from jaxisp.fit.model import SET_FROM_FILE, tone
from jaxisp.fit.noise import KINDS
from jaxisp.fit.result import FitResult
from jaxisp.fit.search import GAIN
from jaxisp.io.files import output_folder, write_text
from jaxisp.params import Spec, specs
from jaxisp.pipeline import run
from jaxisp.report import Page

_UNKNOWN, _BOUND = " (not identified)", " (at a bound)"


def write_report(result: FitResult, folder: str | Path) -> Path:
    """Write `report.html` and its figures, `report.json`, into the folder; return the page's path."""
    page = Page("A camera fitted to its own pictures", summary(result))
    add_fit(page, result)
    path = output_folder(folder) / "report.html"
    write_text(path.with_suffix(".json"), json.dumps(result.as_dict(), indent=1) + "\n")
    page.write(path)
    return path


def summary(result: FitResult) -> str:
    """The result in a sentence or two: how well the camera does on what it was not fitted to."""
    many = len(result.pairs)
    pairs = f"{many} pair{'s' * (many != 1)} in {result.seconds:.0f} s."
    if not many:
        return pairs
    held = result.as_dict()["held_out"]
    return f"{held['psnr']:.2f} dB, SSIM {held['ssim']:.4f} held out ({held['how']}). {pairs}"


def doubts(result: FitResult) -> str:
    """The parameters that are not to be believed, in a sentence; empty where there are none."""
    kinds = {"not identified by these pairs": _unidentified(result), "at a bound": result.at_bound}
    said = [f"{what}: {', '.join(names)}" for what, names in kinds.items() if names]
    return f"Not to be believed: {'; '.join(said)}." if said else ""


def add_fit(page: Page, result: FitResult, most: int = 2) -> None:
    """Add the figures of all pairs, and the pictures of the first few, to a page."""
    if result.scenes:
        page.heading("Held out by scene", f"{result.scenes.how.capitalize()}.")
        own = zip(result.scenes.names, result.scenes.psnr, result.scenes.ssim)
        rows = [(name, f"{psnr:.2f}", f"{ssim:.4f}") for name, psnr, ssim in own]
        page.table(("pair", "PSNR [dB]", "SSIM"), rows)
    page.heading("The fit, before and after", f"Held out: {result.how}.")
    _add_pairs(page, result, most)
    if said := doubts(result):
        page.heading("What not to rely on", said)
    told = [(p.name, text) for p in result.pairs for text in (*p.notes, *p.flags)]
    told += [(name, reason) for name, reason in result.failed]
    if told:
        page.heading("What to know about pairs", "")
        page.table(("pair", "what"), told)
    _add_noise(page, result)
    _add_choices(page, result)
    _add_camera(page, result)
    if parts := phases(result):  # none where a fit went on after its last step
        caption = (
            "objective by step, a panel a phase, each with its own scale; the first phases fit the picture, "
            "the last the noise too; the choices between them are in the table above"
        )
        page.figures([(caption, _loss_figure(parts))])


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
        "In flat held-out regions: standard deviation [1/255] and lag-1 autocorrelation of the noise, of the "
        "render and of the camera's picture, by intensity (white is 1). Below, the detail at strong edges, "
        "render over picture.",
    )
    if any(p.noise.get(kind, {}).get("by_level") for p in result.pairs for kind in KINDS):
        drawn = {"std": "standard deviation of the noise", "lag1": "lag-1 autocorrelation of the noise"}
        how = "by intensity: dots the camera's pictures, lines the renders"
        page.figures([(f"{text} {how}", _noise_figure(result, n)) for n, text in drawn.items()])
    head = ("pair", "plane", "intensity", "std, render", "std, picture", "lag 1, render", "lag 1, picture")
    page.table(head, _noise_rows(result))
    page.table(
        ("pair", "detail at edges", "held out with whole-pixel shift [dB]"),
        [
            (p.name, f"{p.noise.get('edge_detail_ratio', float('nan')):.3f}", f"{p.held_out_whole_shift:.2f}")
            for p in result.pairs
        ],
    )


def _noise_figure(result: FitResult, name: str) -> Figure:
    """One statistic by intensity, luma and chroma: of the renders and of the camera's pictures."""
    figure, axes = plt.subplots(figsize=(5, 3), layout="constrained")
    scale = 255 if name == "std" else 1
    for kind, colour in zip(KINDS, ("#3b6ea5", "#c1622f")):
        for i, pair in enumerate(result.pairs):
            rows = pair.noise.get(kind, {}).get("by_level", [])
            levels = [row["level"] for row in rows]
            render, picture = (scale * np.asarray([row[name][k] for row in rows]) for k in (0, 1))
            axes.plot(levels, render, "-", color=colour, linewidth=1, label=kind if i == 0 else None)
            axes.plot(levels, picture, "o", color=colour, markersize=3.5)
    axes.set(xlabel="intensity", ylabel="std [1/255]" if name == "std" else "correlation")
    axes.spines[["top", "right"]].set_visible(False)
    axes.legend(frameon=False)
    plt.close(figure)
    return figure


def _tone_figure(result: FitResult) -> Figure | None:
    """The curve on greys that the stages of tone make together; None where the camera lacks them."""
    chain = tone()
    if not {*chain.init()} <= {*result.camera.prior}:
        return None
    levels = np.linspace(0, 1, 200, dtype=np.float32)
    grey = np.broadcast_to(levels[:, None, None], (200, 1, 3))
    curve = np.asarray(run(chain, {n: result.camera.prior[n] for n in chain.init()}, grey))[:, 0, 1]
    figure, axes = plt.subplots(figsize=(4, 4), layout="constrained")
    axes.plot(levels, levels, ":", color="#888888", linewidth=1)
    axes.plot(levels, curve, color="#3b6ea5", linewidth=1.5)
    axes.set(xlabel="encoded sRGB without the curve", ylabel="encoded sRGB with it", aspect="equal")
    axes.spines[["top", "right"]].set_visible(False)
    plt.close(figure)
    return figure


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


def _add_choices(page: Page, result: FitResult) -> None:
    best: dict[str, float] = {}
    for text, value in result.tried:
        best[text] = min(value, best.get(text, np.inf))
    starts = {text: value for text, value in best.items() if text.startswith("start ")}
    designs = {text: value for text, value in best.items() if text not in starts}
    common = in_common(list(designs))
    shared = f"All choices: {', '.join(common)}. " if common else ""
    last = "" if result.design in designs else f"In the end: {result.design}."  # without an idle lens, say
    page.heading(
        "What was chosen",
        f"{shared}The objective after a step with each, the best where one was tried again; lower is "
        f"better, and only what is {100 * (1 - GAIN):.1f} % lower replaces the choice before it. {last}"
        if designs
        else f"{result.design}.",
    )
    if starts:
        chosen = min(starts, key=lambda text: starts[text])
        page.table(("start", "objective where it ended"), _choices(starts, chosen))
    if designs:
        own = {without(text, common): value for text, value in designs.items()}
        page.table(("choice", "objective"), _choices(own, without(result.design, common)))


def _choices(values: dict[str, float], chosen: str) -> list[tuple[str, str]]:
    return [
        (text + (" (chosen)" if text == chosen else ""), f"{value:.5f}") for text, value in values.items()
    ]


def in_common(designs: Sequence[str]) -> list[str]:
    """The phrases that all designs share."""
    first, *others = [design.split(", ") for design in designs] or [[]]
    return [phrase for phrase in first if all(phrase in other for other in others)]


def without(design: str, common: Sequence[str]) -> str:
    """What a design says beside some phrases."""
    return ", ".join(p for p in design.split(", ") if p not in common) or "nothing else"


def _add_camera(page: Page, result: FitResult) -> None:
    page.heading(
        "The camera that was found",
        "What these pairs do not identify, and what ended at a bound, is marked. "
        "The standard error, from the curvature at the solution, is told as a share of the number beside it: "
        "the value itself where the parameter varies on a log scale, else the largest entry of the "
        f"parameter, but {LEAST:g} at least, so that a value near zero has one too. Of a vector it is the "
        f"worst entry's. Above {100 * KNOWN:.1f} % an entry is not identified. The exposure holds the scale "
        "of the colour matrix.",
    )
    page.table(("parameter", "value", "standard error", "bounds"), parameter_rows(result))
    if curve := _tone_figure(result):
        page.figures([("tone curve on encoded levels, after exposure and colour matrix", curve)])
    if result.lens_px:
        rows = [(name, f"{value:+.2f}") for name, value in result.lens_px.items()]
        page.table(("displacement in the corner, of red and blue against green", "px"), rows)


def parameter_rows(result: FitResult) -> list[tuple[str, ...]]:
    """(stage.parameter, value, standard error, bounds with their unit) of everything in the fitted camera."""
    found = _by_parameter(result)
    rows: list[tuple[str, ...]] = []
    for stage, values in result.camera.prior.items():
        if stage in SET_FROM_FILE:
            rows.append((stage, "set from the file", "", ""))
            continue
        for field, spec in specs(type(values)).items():
            path, value = f"{stage}.{field}", np.asarray(getattr(values, field), np.float64)
            shown, error = _shown(value, spec, found.get(path, []))
            if path not in found:
                error = "each image's own" if _differs(result, stage, field) else "not fitted"
            shown += _BOUND if path in result.at_bound else ""
            rows.append((path, shown, error, _bounds(spec)))
    return rows


def _bounds(spec: Spec) -> str:
    low, high = spec.bounds
    return f"{low:g} to {high:g}" + ("" if spec.unit == "1" else f" {spec.unit}")


def _by_parameter(result: FitResult) -> dict[str, list[Identified]]:
    """By stage.field: its entries, in order."""
    found: dict[str, list[Identified]] = {}
    for entry in result.identified:
        found.setdefault(entry.name.partition("[")[0], []).append(entry)
    return found


def _unidentified(result: FitResult) -> list[str]:
    """Names of what is not identified: of a whole parameter where all its entries are not."""
    names = []
    for path, entries in _by_parameter(result).items():
        unknown = [entry.name for entry in entries if not entry.known]
        names += [path] if len(unknown) == len(entries) else unknown
    return names


def _differs(result: FitResult, stage: str, field: str) -> bool:
    """Whether the images have the parameter of their own."""
    own = [values[stage][field] for values in result.per_image.values() if stage in values]
    return any(value != own[0] for value in own)


def _shown(value: np.ndarray, spec: Spec, entries: Sequence[Identified]) -> tuple[str, str]:
    """The value with its entries marked, and the largest error and what it is relative to."""
    flat = np.ravel(value)
    if not entries:
        return _nested(np.reshape([_number(v, 0) for v in flat], value.shape).tolist()), ""
    least = max(float(np.abs(flat).max()), LEAST)
    whole = [float(abs(v)) if spec.scale == "log" else least for v in flat]
    one_by_one = any(entry.known for entry in entries)
    texts = [
        _number(v, e.error * w) + (_UNKNOWN if one_by_one and not e.known else "")
        for v, e, w in zip(flat, entries, whole)
    ]
    shown = _nested(np.reshape(texts, value.shape).tolist()) + ("" if one_by_one else _UNKNOWN)
    worst = max(range(len(flat)), key=lambda i: entries[i].error)
    return shown, f"{_percent(entries[worst].error)} of {_number(whole[worst], 0)}"


def _number(value: float, error: float) -> str:
    """Four digits, and more where the standard error is beyond them."""
    digits = 4
    if value and error:
        digits = int(np.floor(np.log10(abs(value))) - np.floor(np.log10(error))) + 1
    return f"{value + 0.0:.{min(max(digits, 4), 7)}g}"  # adding 0 takes the sign off -0


def _percent(share: float) -> str:
    return f"{100 * share:.1f} %" if share >= 1e-3 else f"{100 * share:.1g} %"


def _nested(texts: Any) -> str:
    return texts if isinstance(texts, str) else f"[{', '.join(map(_nested, texts))}]"


def phases(result: FitResult) -> list[tuple[str, int, np.ndarray]]:
    """The phases of several steps: name, first step (from 1) and the objective after each step.

    Choices take one step each, and stand in a table.
    """
    steps = enumerate(zip(result.phases, result.losses), 1)
    parts = [(name, list(group)) for name, group in groupby(steps, key=lambda step: step[1][0])]
    return [
        (name, part[0][0], np.array([value for _, (_, value) in part]))
        for name, part in parts
        if len(part) > 1
    ]


def _loss_figure(parts: Sequence[tuple[str, int, np.ndarray]]) -> Figure:
    rows = -(-len(parts) // 2)
    figure, grid = plt.subplots(rows, 2, figsize=(5, 1.8 * rows), squeeze=False, layout="constrained")
    for axes, (name, first, values) in zip(grid.flat, parts):
        _draw_phase(axes, first, values)
        axes.set_title(name, fontsize=9)
    for axes in grid.flat[len(parts) :]:
        axes.remove()
    plt.close(figure)
    return figure


def _draw_phase(axes: Axes, first: int, values: np.ndarray) -> None:
    steps = np.arange(first, first + len(values))
    axes.plot(steps, values, "o-", color="#3b6ea5", linewidth=1.2, markersize=3)
    axes.set_yscale("log" if values.max() > 4 * values.min() else "linear")
    axes.xaxis.set_major_locator(MaxNLocator(4, integer=True))
    axes.set(xlabel="step", ylabel="objective")
    axes.spines[["top", "right"]].set_visible(False)
