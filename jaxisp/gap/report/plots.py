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
_MOST_BARS = 16
_GAINS = (32, 16, 8, 4, 2, 1)
_WITHIN = 98  # per cent of the differences that must stay between black and white after the gain


def curve(bins: Sequence[Any], profile: Sequence[float], title: str) -> str:
    """An SVG of a profile: bars for few or named bins, a line for many bins, a grid for 64 bins."""
    values = np.nan_to_num(np.asarray(profile, float))
    if not len(values):
        return svg(title, f'<text x="{WIDTH / 2}" y="{HEIGHT / 2}" text-anchor="middle">no profile</text>')
    if len(bins) == 64:
        return svg(title, _grid(values.reshape(8, 8)))
    low, high = min(values.min(), 0), max(values.max(), 0)
    span = (high - low) or 1.0

    def at(v: float) -> float:
        return _TOP + (high - v) / span * (HEIGHT - _TOP - BOTTOM)

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
    return svg(title, marks + zero + _ticks(low, high, at) + _labels(bins, centres))


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
        f'<text x="{x:.1f}" y="{HEIGHT - 9}" text-anchor="middle">{escape(t)}</text>'
        for t, x in list(zip(texts, centres))[::step]
    )


def _grid(values: np.ndarray) -> str:
    """8x8 squares; larger values (8, 8) are drawn darker."""
    spread = np.ptp(values) or 1.0
    size = (HEIGHT - 2 * _TOP) / 8
    left = (WIDTH - 8 * size) / 2
    return "".join(
        f'<rect class="fill" x="{left + j * size:.1f}" y="{_TOP + i * size:.1f}" width="{size - 1:.1f}" '
        f'height="{size - 1:.1f}" opacity="{0.08 + 0.92 * (v - values.min()) / spread:.2f}"/>'
        for i, row in enumerate(values)
        for j, v in enumerate(row)
    )


def svg(title: str, inside: str) -> str:
    """Wrap SVG elements in a plot; screen readers read its title."""
    return (
        f'<svg viewBox="0 0 {WIDTH} {HEIGHT}" role="img" aria-label="{escape(title)}">'
        f"<title>{escape(title)}</title>{inside}</svg>"
    )


def gain_for(residuals: Sequence[Any]) -> int:
    """The largest gain at which all residuals fit between black and white around grey.

    Args:
        residuals: (h, w, 3) each, Y'CbCr in 8-bit steps.
    """
    high = max((float(np.percentile(np.abs(_rgb(r)), _WITHIN)) for r in residuals), default=0.0)
    return next((gain for gain in _GAINS if gain * high <= 127.5), 1)


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
