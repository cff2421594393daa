"""Small plots and pictures embedded in a page: SVG in the page's colours, and PNG."""

import base64
import io
from collections.abc import Sequence
from typing import Any

import numpy as np
from markupsafe import escape
from PIL import Image

WIDTH, HEIGHT, LEFT, RIGHT, BOTTOM = 300, 170, 46, 10, 28
"""Size of every plot and margins around its axes, SVG user units."""
_TOP = 12
_NAME = 16
"""Room for the name of an axis."""
_MOST_BARS = 16
_GAINS = (32, 16, 8, 4, 2, 1)
_WITHIN = 98  # per cent of the differences that must stay between black and white after the gain


def curve(bins: Sequence[Any], profile: Sequence[float], title: str, across: str, up: str) -> str:
    """An SVG of a profile: bars for few or named bins, a line for many bins, a grid for 64 bins.

    `across` and `up` name the axes, with their units.
    """
    values = np.nan_to_num(np.asarray(profile, float))
    if not len(values):
        return svg(title, f'<text x="{WIDTH / 2}" y="{HEIGHT / 2}" text-anchor="middle">no profile</text>')
    if len(bins) == 64:
        return svg(title, _grid(values.reshape(8, 8), across, up), HEIGHT + 2 * _NAME)
    low, high = min(values.min(), 0), max(values.max(), 0)
    span = (high - low) or 1.0

    def at(v: float) -> float:
        return _TOP + _NAME + (high - v) / span * (HEIGHT - _TOP - BOTTOM)

    edges = np.linspace(LEFT, WIDTH - RIGHT, len(values) + 1)
    centres = (edges[1:] + edges[:-1]) / 2
    named = any(isinstance(b, str) for b in bins)
    if named or len(values) <= _MOST_BARS:
        marks = "".join(
            f'<rect class="fill" x="{a + 1:.1f}" y="{min(at(v), at(0)):.1f}" width="{max(b - a - 2, 1):.1f}" '
            f'height="{max(abs(at(v) - at(0)), 0.5):.1f}"/>'
            for a, b, v in zip(edges, edges[1:], values)
        )
    else:
        points = " ".join(f"{x:.1f},{at(v):.1f}" for x, v in zip(centres, values))
        marks = f'<polyline class="curve" points="{points}"/>'
    zero = f'<line class="axis" x1="{LEFT}" x2="{WIDTH - RIGHT}" y1="{at(0):.1f}" y2="{at(0):.1f}"/>'
    inside = marks + zero + _ticks(low, high, at) + _labels(bins, centres) + _names(across, up)
    return svg(title, inside, HEIGHT + 2 * _NAME)


def _names(across: str, up: str) -> str:
    return (
        f'<text x="4" y="{_NAME - 1}">{escape(up)}</text>'
        f'<text x="{(WIDTH + LEFT - RIGHT) / 2}" y="{HEIGHT + 2 * _NAME - 9}" text-anchor="middle">'
        f"{escape(across)}</text>"
    )


def _ticks(low: float, high: float, at: Any) -> str:
    shown = [v for v in dict.fromkeys((low, 0.0, high)) if v == 0 or abs(v) > 0.12 * (high - low)]
    return "".join(
        f'<text x="{LEFT - 5}" y="{at(v) + 4:.1f}" text-anchor="end">{v:.2g}</text>' for v in shown
    )


def _labels(bins: Sequence[Any], centres: np.ndarray) -> str:
    """Labels of the bins, thinned out to fit the width."""
    texts = [b if isinstance(b, str) else f"{b:.3g}" if b == 0 or abs(b) >= 1 else f"{b:.2f}" for b in bins]
    room = (WIDTH - LEFT - RIGHT) / (6.2 * max((len(t) for t in texts), default=1) + 8)
    step = max(1, int(np.ceil(len(texts) / max(room, 1))))
    return "".join(
        f'<text x="{x:.1f}" y="{HEIGHT + _NAME - 11}" text-anchor="middle">{escape(t)}</text>'
        for t, x in list(zip(texts, centres))[::step]
    )


def _grid(values: np.ndarray, across: str, up: str) -> str:
    """8x8 squares; larger values (8, 8) are drawn darker; their range stands in the name."""
    spread = np.ptp(values) or 1.0
    size = (HEIGHT - 2 * _TOP) / 8
    left = (WIDTH - 8 * size) / 2
    top = _TOP + _NAME
    names = _names(across, f"{up}: {values.min():.2g} (light) to {values.max():.2g} (dark)")
    return names + "".join(
        f'<rect class="fill" x="{left + j * size:.1f}" y="{top + i * size:.1f}" width="{size - 1:.1f}" '
        f'height="{size - 1:.1f}" opacity="{0.08 + 0.92 * (v - values.min()) / spread:.2f}"/>'
        for i, row in enumerate(values)
        for j, v in enumerate(row)
    )


def svg(title: str, inside: str, height: float = HEIGHT) -> str:
    """Wrap SVG elements in a plot; screen readers read its title."""
    return (
        f'<svg viewBox="0 0 {WIDTH} {height}" role="img" aria-label="{escape(title)}">'
        f"<title>{escape(title)}</title>{inside}</svg>"
    )


def gain_for(residuals: Sequence[Any]) -> int:
    """The largest gain at which all residuals fit between black and white around grey.

    Args:
        residuals: (h, w, 3) each, Y'CbCr in 8-bit steps.
    """
    high = max((float(np.percentile(np.abs(_rgb(r)), _WITHIN)) for r in residuals), default=0.0)
    return next((gain for gain in _GAINS if gain * high <= 127.5), 1)


CELL = 8
"""Side of the squares of a heat map [px]."""
_COLOURS = "inferno"


def heat(residual: Any) -> np.ndarray:
    """Root mean square of a residual in squares of `CELL` px, over luma and chroma together.

    Args:
        residual: (h, w, 3), Y'CbCr in 8-bit steps.

    Returns:
        (h // CELL, w // CELL), 8-bit steps.
    """
    values = np.nan_to_num(np.asarray(residual, np.float64))
    rows, columns = (max(n // CELL, 1) for n in values.shape[:2])
    whole = values[: rows * CELL, : columns * CELL]
    squares = whole.reshape(rows, len(whole) // rows, columns, whole.shape[1] // columns, 3)
    return np.asarray(np.sqrt((squares**2).sum(-1).mean((1, 3))))


def heat_picture(values: np.ndarray, top: float) -> np.ndarray:
    """Values from 0 to `top` in colours, each a square of `CELL` px: (h, w, 3) in [0, 1]."""
    from matplotlib import colormaps

    coloured = np.asarray(colormaps[_COLOURS](np.clip(values / (top or 1.0), 0, 1)))[..., :3]
    return coloured.repeat(CELL, 0).repeat(CELL, 1)


def heat_scale() -> str:
    """The colours of a heat map, from 0 up, as a CSS gradient."""
    from matplotlib import colormaps, colors

    stops = ", ".join(colors.to_hex(colormaps[_COLOURS](x)) for x in np.linspace(0, 1, 9))
    return f"linear-gradient(to right, {stops})"


def difference_picture(residual: Any, gain: float) -> np.ndarray:
    """Show a residual (h, w, 3), Y'CbCr in 8-bit steps, as RGB around grey; it may leave [0, 1]."""
    return 0.5 + _rgb(residual) * gain / 255


def _rgb(residual: Any) -> np.ndarray:
    y, cb, cr = np.moveaxis(np.nan_to_num(np.asarray(residual, np.float64)), -1, 0)
    return np.stack([y + 1.402 * cr, y - 0.344136 * cb - 0.714136 * cr, y + 1.772 * cb], -1)


def data_uri(picture: Any, longest: int = 512) -> str:
    """Encode a picture (h, w, 3) in [0, 1] as a PNG data URI.

    Pictures longer than `longest` px are reduced by an integer factor.
    """
    levels = np.nan_to_num(np.asarray(picture, np.float64), nan=0.5)
    step = -(-max(levels.shape[:2]) // longest)
    h, w = (n // step * step for n in levels.shape[:2])
    levels = levels[:h, :w].reshape(h // step, step, w // step, step, *levels.shape[2:]).mean((1, 3))
    buffer = io.BytesIO()
    Image.fromarray(np.round(255 * np.clip(levels, 0, 1)).astype(np.uint8)).save(buffer, "PNG", optimize=True)
    return "data:image/png;base64," + base64.b64encode(buffer.getvalue()).decode()
