"""Power spectra and autocorrelations on the page of a diagnosis."""

from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import numpy as np
from markupsafe import Markup, escape

from jaxisp.gap.features.spectra import LAGS
from jaxisp.gap.report.plots import BOTTOM, HEIGHT, LEFT, RIGHT, WIDTH, svg
from jaxisp.gap.report.words import number

_HEAD, _GUTTER = 26, 12  # height of the legend above a plot, and space between maps
_MAPS = 38  # vertical position of the maps, which are lower than a plot
_DEEPEST = 1e-5  # share of the largest energy; lower energies are drawn at this value
_SAID = {
    "raw+jpeg": {"before": "before", "after": "after", "floor": "floor"},
    "clean+noisy": {"real": "real", "before": "simulator before", "after": "after"},
}
_SAID["jpeg+jpeg"] = _SAID["raw+jpeg"]
_TEXT = {
    "raw+jpeg": "Of the difference of camera and simulator. What lies above the floor is the simulator's "
    "lack; white noise has a flat spectrum and no correlation.",
    "clean+noisy": "Of the noise, without what follows the clean picture. Where the simulator is right, its "
    "curve lies in the band of the real pictures, and its map looks like theirs.",
}

_TEXT["jpeg+jpeg"] = _TEXT["raw+jpeg"]


def spectra_part(kind: str, pictures: Mapping[str, Any]) -> dict[str, Any] | None:
    """The section of the page that shows `jaxisp.gap.features.spectra`; None without spectra.

    Args:
        kind: of the data: "raw+jpeg" or "clean+noisy".
        pictures: as for `jaxisp.gap.report.page.write_report`.
    """
    found = {whose: pictures.get(f"spread_{whose}") for whose in _SAID[kind]}
    shown = {whose: own for whose, own in found.items() if own is not None}
    if not shown:
        return None
    luma, chroma = ([_spectrum(kind, shown, of), _correlation(kind, shown, of)] for of in ("luma", "chroma"))
    return {"text": _TEXT[kind], "luma": luma, "chroma": chroma}


def _spectrum(kind: str, shown: Mapping[str, Any], of: str) -> dict[str, Any]:
    curves = {_SAID[kind][whose]: (own[of].frequency, own[of].energy) for whose, own in shown.items()}
    plot = spectra_plot(curves, list(shown), f"power spectrum of {of}")
    said = "power by cycles per pixel (0.5 is the finest), mean of all directions, squared 8-bit steps"
    return {"name": f"Spectrum, {of}", "plot": Markup(plot), "text": said}


def _correlation(kind: str, shown: Mapping[str, Any], of: str) -> dict[str, Any]:
    maps = {_SAID[kind][whose]: own[of].correlation for whose, own in shown.items()}
    said = (
        f"how a pixel goes with those up to {LAGS} rows and columns away; blue: alike, amber: opposite, "
        f"\N{PLUS-MINUS SIGN}{strongest(maps.values()):.2f} at most beside the pixel itself (the dot)"
    )
    plot = lag_maps(maps, f"autocorrelation of {of}")
    return {"name": f"Autocorrelation, {of}", "plot": Markup(plot), "text": said}


def spectra_plot(
    curves: Mapping[str, tuple[np.ndarray, np.ndarray]], classes: Sequence[str], title: str
) -> str:
    """An SVG of power spectra on a logarithmic scale.

    Args:
        curves: by label: (F,) frequencies in cycles per pixel, 0 to 0.5, and (F,) energies.
        classes: CSS class of each curve, see report.html.
        title: for screen readers.
    """
    highest = max((float(e.max()) for _, e in curves.values()), default=0.0) or 1.0
    least = highest * _DEEPEST
    lowest = max(min((float(e.min()) for _, e in curves.values()), default=least), least)
    low, high = np.log10(lowest) - 0.05, np.log10(highest) + 0.05
    bottom, right = HEIGHT - BOTTOM - 4, WIDTH - RIGHT

    def across(f: float) -> float:
        return LEFT + 2 * f * (right - LEFT)

    def up(energy: float) -> float:
        return _HEAD + (high - np.log10(max(energy, least))) / (high - low) * (bottom - _HEAD)

    marks = "".join(
        f'<polyline class="line {kind}" points="'
        + " ".join(f"{across(f):.1f},{up(e):.1f}" for f, e in zip(*curve))
        + '"/>'
        for kind, curve in zip(classes, curves.values())
    )
    axis = f'<path class="axis" fill="none" d="M{LEFT} {_HEAD}V{bottom:.0f}H{right}"/>'
    numbers = "".join(
        f'<text x="{LEFT - 5}" y="{up(v) + 4:.1f}" text-anchor="end">{number(v)}</text>'
        for v in _round_energies(lowest, highest)
    ) + "".join(
        f'<text x="{across(f):.1f}" y="{bottom + 14:.1f}" text-anchor="middle">{f:g}</text>'
        for f in (0, 0.1, 0.2, 0.3, 0.4, 0.5)
    )
    return svg(title, _legend(list(curves), classes) + axis + marks + numbers)


def _round_energies(lowest: float, highest: float) -> list[float]:
    """Ticks of a logarithmic axis: up to five powers of ten, or both ends if it spans fewer than two."""
    tens = [10.0**k for k in range(int(np.ceil(np.log10(lowest))), int(np.floor(np.log10(highest))) + 1)]
    return tens[:: -(-len(tens) // 5)] if len(tens) > 1 else [lowest, highest]


def _legend(names: Sequence[str], classes: Sequence[str]) -> str:
    found, x = "", 8.0
    for name, kind in zip(names, classes):
        found += f'<path class="line {kind}" d="M{x:.0f} 13h14"/><text x="{x + 18:.0f}" y="17">{name}</text>'
        x += 18 + 5.7 * len(name) + 9
    return found


def lag_maps(maps: Mapping[str, np.ndarray], title: str) -> str:
    """An SVG of autocorrelations (S, S) on a common colour scale; lag 0 is in the middle."""
    sides = [m.shape[0] for m in maps.values()]
    top = strongest(maps.values())
    step = (WIDTH - _GUTTER) / 3  # the width is the same for two and for three maps
    unit = (step - _GUTTER) / max(sides)
    inside = ""
    for k, (name, values) in enumerate(maps.items()):
        left, side, middle = _GUTTER + k * step, len(values), len(values) // 2
        squares = "".join(
            f'<rect x="{j}" y="{i}" width="1" height="1"{_shade(v / top)}/>'
            for i, row in enumerate(values)
            for j, v in enumerate(row)
            if (i, j) != (middle, middle)
        )
        centre = left + unit * side / 2
        inside += (
            f'<text x="{centre:.1f}" y="{_MAPS - 9}" text-anchor="middle">{escape(name)}</text>'
            f'<g transform="translate({left:.1f} {_MAPS}) scale({unit:.2f})">{squares}'
            f'<circle class="dot" cx="{middle + 0.5}" cy="{middle + 0.5}" r=".2"/></g>'
        )
    return svg(title, inside + _scale(top, _MAPS + unit * max(sides) + 16))


def strongest(maps: Iterable[np.ndarray]) -> float:
    """The largest absolute autocorrelation of maps (S, S) apart from lag 0; at least 0.01."""
    sizes = (np.abs(m).copy() for m in maps)
    beside = (np.delete(m.ravel(), m.size // 2).max() for m in sizes)
    return max([0.01, *map(float, beside)])


def _scale(top: float, y: float) -> str:
    """The legend of the colour scale from -top to top, at height `y`."""
    width, left = 8, (WIDTH - 21 * 8) / 2
    squares = "".join(
        f'<rect x="{left + k * width:.0f}" y="{y:.0f}" width="{width}" height="9"{_shade(k / 10 - 1)}/>'
        for k in range(21)
    )
    ends = ((left - 6, "end", f"\N{MINUS SIGN}{top:.2f}"), (left + 21 * width + 6, "start", f"{top:.2f}"))
    return squares + "".join(
        f'<text x="{x:.0f}" y="{y + 9:.0f}" text-anchor="{anchor}">{text}</text>' for x, anchor, text in ends
    )


def _shade(share: float) -> str:
    """SVG attributes of the colour of a value in [-1, 1]."""
    return f' class="{"fill" if share > 0 else "less"}" opacity="{min(abs(share), 1):.2f}"'
