"""Features of pixels by axis; the residual is regressed on them to find the share of each axis."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

LUMA = np.linspace(0, 256, 17)
CHROMA = np.array([0, 3, 6, 10, 15, 21, 28, 37, 48, 62, 200.0])
SECTORS = 12
RADII = 16
STRENGTHS = (0, 2, 4, 8, 16, 32, 64, 512)  # bin edges of edge strength, 8-bit steps per pixel

Planes = list[np.ndarray]


def box(plane: np.ndarray, radius: int) -> np.ndarray:
    """Mean of a plane (h, w) over squares of 2 radius + 1 pixels, edges repeated."""
    for _ in range(2):
        padded = np.pad(plane, ((radius + 1, radius), (0, 0)), mode="edge")
        sums = np.cumsum(padded, 0, dtype=np.float64)
        plane = ((sums[2 * radius + 1 :] - sums[: -2 * radius - 1]) / (2 * radius + 1)).astype(np.float32).T
    return plane


def shifted(plane: np.ndarray, dy: int, dx: int) -> np.ndarray:
    """`out[y, x] = plane[y + dy, x + dx]`, edges repeated."""
    reach = max(abs(dy), abs(dx))
    padded = np.pad(plane, ((reach, reach), (reach, reach)), mode="edge")
    h, w = plane.shape
    return padded[reach + dy : reach + dy + h, reach + dx : reach + dx + w]


def _second(plane: np.ndarray, dy: int, dx: int) -> np.ndarray:
    return shifted(plane, dy, dx) + shifted(plane, -dy, -dx) - 2 * plane


def one_hot(index: np.ndarray, count: int) -> Planes:
    """One plane (h, w) of zeros and ones for each of `count` bins; `index` (h, w) holds the bins."""
    return [(index == i).astype(np.float32) for i in range(count)]


@dataclass
class Scene:
    """A picture and the quantities derived from it that the features of the axes use.

    Attributes:
        picture: (h, w, 3) Y'CbCr in 8-bit steps; luma in 0 to 255, chroma centred at 0.
    """

    picture: np.ndarray

    def __post_init__(self) -> None:
        h, w = self.picture.shape[:2]
        self.planes: Planes = [np.ascontiguousarray(self.picture[..., c], np.float32) for c in range(3)]
        self.luma, cb, cr = self.planes
        self.one = np.ones((h, w), np.float32)
        y, x = np.mgrid[:h, :w].astype(np.float32)
        self.rows, self.columns = y.astype(int), x.astype(int)
        self.y, self.x = y - (h - 1) / 2, x - (w - 1) / 2
        self.half_diagonal = float(np.hypot(h, w)) / 2
        self.radius = np.hypot(self.y, self.x) / self.half_diagonal
        self.chroma = np.hypot(cb, cr)
        self.sector = ((np.arctan2(cr, cb) / (2 * np.pi) * SECTORS) % SECTORS).astype(int) % SECTORS
        self.down = [(shifted(p, 1, 0) - shifted(p, -1, 0)) / 2 for p in self.planes]
        self.right = [(shifted(p, 0, 1) - shifted(p, 0, -1)) / 2 for p in self.planes]
        self.vertical = [_second(p, 1, 0) for p in self.planes]
        self.horizontal = [_second(p, 0, 1) for p in self.planes]
        self.edge = np.hypot(box(self.down[0], 1), box(self.right[0], 1))
        self.bands = self._bands()

    def _bands(self) -> Planes:
        found = []
        for plane, vertical, horizontal in zip(self.planes, self.vertical, self.horizontal):
            smooth = [box(plane, r) for r in (1, 2, 4)]
            found += [vertical + horizontal, plane - smooth[0], smooth[0] - smooth[1], smooth[1] - smooth[2]]
        return found

    @property
    def outward(self) -> Planes:
        """Change of each channel (h, w) under a radial scaling that moves the corners by one pixel."""
        d = self.half_diagonal
        return [(self.y * down + self.x * right) / d for down, right in zip(self.down, self.right)]

    @property
    def chroma_directions(self) -> tuple[np.ndarray, np.ndarray]:
        """Unit vector (Cb, Cr), (h, w) each, of the pixel's chroma; zero for grey pixels."""
        safe = np.where(self.chroma > 0.5, self.chroma, np.inf)
        return self.planes[1] / safe, self.planes[2] / safe

    def polar(self, residual: np.ndarray) -> np.ndarray:
        """Rotate the chroma of a residual (h, w, 3) into components along and across the pixel's chroma."""
        c, s = self.chroma_directions
        along = residual[..., 1] * c + residual[..., 2] * s
        return np.stack([residual[..., 0], along, residual[..., 2] * c - residual[..., 1] * s], -1)


def _radius(s: Scene) -> Planes:
    affine = [s.one, *s.planes]
    square = s.radius**2
    curved = [p * f for f in (square, square**2) for p in affine]
    return [*affine, *curved, *s.outward, *(p * square for p in s.outward)]


def _intensity(s: Scene) -> Planes:
    return [s.one, s.luma, *one_hot(np.digitize(s.luma, LUMA[1:-1]), len(LUMA) - 1), *_hinges(s)]


def _hinges(s: Scene) -> Planes:
    return [np.maximum(s.luma - knot, 0) for knot in LUMA[1:-1:2]]


def _channel(s: Scene) -> Planes:
    return [s.one, s.luma]


def _casts(s: Scene) -> Planes:
    """Polar components of a constant colour cast, and of a cast in proportion to luma."""
    return [p * f for f in s.chroma_directions for p in (s.one, s.luma)]


def _hue(s: Scene) -> Planes:
    sectors = [s.chroma * plane for plane in one_hot(s.sector, SECTORS)]
    return [s.one, s.luma, *_casts(s), s.chroma, *sectors]


def _saturation(s: Scene) -> Planes:
    return [*_casts(s), s.chroma, *one_hot(np.digitize(s.chroma, CHROMA[1:-1]), len(CHROMA) - 1)]


def _frequency(s: Scene) -> Planes:
    return s.bands


def _edge(s: Scene) -> Planes:
    fine, wide = s.bands[1], s.bands[2]
    steep = [band * s.edge / (s.edge + limit) for band in (fine, wide) for limit in (4, 24)]
    bounded = [np.clip(band, -limit, limit) for band in (fine, wide) for limit in (2, 6, 16)]
    return [*s.bands, *_value(s), s.edge, *s.down, *s.right, *steep, *bounded]


def displaced(s: Scene) -> Planes:
    """A constant, the channels, and their gradients, which describe a displacement."""
    return [s.one, *s.planes, *s.down, *s.right]


def _value(s: Scene) -> Planes:
    return [s.one, *s.planes, *_hinges(s)]


def _orientation(s: Scene) -> Planes:
    diagonal = [_second(p, 1, 1) - _second(p, 1, -1) for p in s.planes]
    wide = [_second(p, 0, 2) - _second(p, 2, 0) for p in s.planes]
    return [*s.bands, *(a - b for a, b in zip(s.horizontal, s.vertical)), *diagonal, *wide]


def _neighbourhood(s: Scene) -> Planes:
    level = s.luma / 128
    around = [box(s.luma, r) - s.luma for r in (6, 14, 30)]
    return [*_value(s), *s.bands[:4], *around, *(a * level for a in around)]


def _cfa_phase(s: Scene, period: int) -> Planes:
    plain = [s.one, *s.planes, s.horizontal[0], s.vertical[0]]
    phase = s.rows % period * period + s.columns % period
    return [*plain, *(p * f for f in one_hot(phase, period * period)[1:] for p in plain)]


Features = Callable[[Scene], Planes]

_VALUES, _BANDS = 12, 12  # number of features of `_value` and of `Scene.bands`

POLAR_AXES = ("hue", "saturation")

REGRESSIONS: dict[str, tuple[Features, tuple[int, int, int]]] = {
    "radius": (_radius, (4, 4, 4)),
    "intensity": (_intensity, (0, 2, 2)),
    "channel": (_channel, (2, 0, 0)),
    "hue": (_hue, (6, 7, 6)),
    "saturation": (_saturation, (15, 4, 15)),
    "frequency": (_frequency, (0, 0, 0)),
    "edge": (_edge, (_BANDS + _VALUES,) * 3),
    "orientation": (_orientation, (_BANDS,) * 3),
    "neighbourhood": (_neighbourhood, (_VALUES + 4,) * 3),
}
"""By axis: its features, and by channel the number of leading features that simpler axes already have."""


def cfa_features(period: int) -> tuple[Features, tuple[int, int, int]]:
    """Features of the "cfa_phase" axis for a colour filter array of this period [px]; as in `REGRESSIONS`."""
    return (lambda s: _cfa_phase(s, period)), (6, 6, 6)


def lag_features(residual: np.ndarray, channel: int) -> Planes:
    """Features of one channel of a residual (h, w, 3): its mean 4 to 6 px away, its neighbours at `LAGS`."""
    plane = np.ascontiguousarray(residual[..., channel])
    near = [shifted(plane, dy, dx) + shifted(plane, -dy, -dx) for dy, dx in LAGS]
    return [ring(plane), *near]


LAGS = ((0, 1), (1, 0), (1, 1), (1, -1), (0, 2), (2, 0))


def ring(plane: np.ndarray) -> np.ndarray:
    """Mean of a plane (h, w) over pixels 4 to 6 px away.

    It follows smooth content, and its noise is independent of the pixel's if noise is white.
    """
    return (169 * box(plane, 6) - 49 * box(plane, 3)) / 120


def block_transform(plane: np.ndarray) -> np.ndarray:
    """Cosine transform (h // 8, w // 8, 8, 8) of the 8x8 blocks of a plane (h, w)."""
    h, w = (n // 8 * 8 for n in plane.shape)
    blocks = plane[:h, :w].reshape(h // 8, 8, w // 8, 8).swapaxes(1, 2)
    k, x = np.mgrid[:8, :8]
    basis = np.where(k == 0, np.sqrt(0.125), 0.5) * np.cos((2 * x + 1) * k * np.pi / 16)
    basis = basis.astype(np.float32)
    return basis @ blocks @ basis.T
