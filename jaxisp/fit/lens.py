"""The lens in the geometry of a fit: radial distortion and lateral colour, or their correction.

Both are in the terms of the stages `geometric_distortion` and `lateral_chromatic_aberration`, about the
centre of the RAW, but sampled by cubic convolution as the rest of the geometry is.
"""

from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from jaxisp.fit.align import PATCH, SCALE_DEVIATION, Alignment, recolored
from jaxisp.fit.model import LENS
from jaxisp.fit.planes import factors, luma, normalise, reduce
from jaxisp.fit.sampling import cubic
from jaxisp.fit.strips import strips
from jaxisp.pipeline import Params

SMALLEST = 0.1  # px in the corner that distortion or lateral colour must reach to be kept
_CERTAIN = 8.0  # by which the log-likelihood must rise
_DEVIATION = 0.02  # of k1, a priori


class Lens(NamedTuple):
    """The picture reads at `q (1 + k1 r**2 + k2 r**4) / scale` of each colour, r = 1 in the RAW's corner."""

    k1: Any = 0.0
    k2: Any = 0.0
    red: Any = 1.0
    blue: Any = 1.0

    @classmethod
    def of(cls, params: Params) -> "Lens":
        """That of fitted parameters; none where they have no such stage."""
        if not set(LENS) <= set(params):
            return cls()
        color, bend = (params[name] for name in LENS)
        return cls(bend.k1, bend.k2, color.red_scale, color.blue_scale)

    def bent(self, y: Any, x: Any, corner: Any) -> tuple[Any, Any]:
        """Coordinates from the centre of the RAW after distortion; `corner`: squared distance of r = 1."""
        r2 = (y * y + x * x) / corner
        factor = 1 + r2 * (self.k1 + self.k2 * r2)
        return y * factor, x * factor

    def in_the_corner(self, corner: float) -> dict[str, float]:
        """Displacements there [px]: of all colours, and of red and blue against green."""
        radius = float(np.sqrt(corner))
        return {
            "distortion": radius * float(self.k1 + self.k2),
            "red": radius * (1 / float(self.red) - 1),
            "blue": radius * (1 / float(self.blue) - 1),
        }


STRAIGHT = Lens()


def warped(image: Any, lens: Lens, rows: Any, columns: Any, first: Any, corner: Any) -> jax.Array:
    """(h, w, 3): an image read where the lens says.

    Args:
        image: (H, W, 3).
        lens: may be traced.
        rows, columns: (h,) and (w,) coordinates from the centre of the RAW, before the lens.
        first: those of the image's first pixel.
        corner: squared distance of the RAW's corners from its centre.
    """
    y, x = lens.bent(rows[:, None], columns[None], corner)
    scales = jnp.stack([jnp.asarray(s, y.dtype) for s in (lens.red, 1.0, lens.blue)])

    def read(plane: jax.Array, scale: jax.Array) -> jax.Array:
        return cubic(jnp, plane, y / scale - first[0], x / scale - first[1])

    return jax.vmap(read, (-1, 0), -1)(image, scales)


def lines(
    alignment: Alignment, shape: tuple[int, ...], raw_shape: tuple[int, ...]
) -> tuple[tuple[np.ndarray, np.ndarray], np.ndarray, np.float32]:
    """Rows and columns of the picture from the centre of the RAW, its first pixel, and its squared corner."""
    where = (alignment.scale_y, alignment.dy), (alignment.scale_x, alignment.dx)
    rows, columns = (
        (float(scale) * (np.arange(n) - (n - 1) / 2) + float(shift)).astype(np.float32)
        for n, (scale, shift) in zip(shape[:2], where)
    )
    first = (1 - np.asarray(raw_shape[:2], np.float32)) / 2
    return (rows, columns), first, np.float32(max(sum((n - 1) ** 2 for n in raw_shape[:2]) / 4, 1))


def covered(
    alignment: Alignment, lens: Lens, raw_shape: tuple[int, ...], shape: tuple[int, ...]
) -> np.ndarray:
    """(H', W') boolean: where the picture reads inside the RAW."""
    (rows, columns), first, corner = lines(alignment, shape, raw_shape)
    inside = np.empty((len(rows), len(columns)), bool)
    for part in strips(len(rows)):
        y, x = lens.bent(rows[part, None], columns[None], corner)
        inside[part] = (np.abs(y) <= -first[0]) & (np.abs(x) <= -first[1])
    return inside


def radial(reference: np.ndarray, moving: np.ndarray, alignment: Alignment) -> tuple[Alignment, float]:
    """The alignment with the radial distortion that explains the two better, and its k1; 0 where none does.

    Looked for at a reduced size by Levenberg-Marquardt, together with shift and scale; what is found is
    refined at full size and on one plane of all colours, for the first falls short by a tenth.

    Args:
        reference: (H, W, 3) the camera's picture.
        moving: (H, W, 3) the RAW's.
        alignment: what `estimate` found.
    """
    still, moved = luma("reference", reference), luma("moving", moving)
    coarse, fine = (factors(still.shape, moved.shape)[i] for i in (0, -1))

    def view(factor: int, b: np.ndarray) -> Any:
        planes = normalise(reduce(still, factor)), normalise(b)
        return partial(_view, *planes, factor, still.shape, moved.shape)

    start = np.asarray([alignment.dy, alignment.dx, alignment.scale_y, alignment.scale_x, 0.0], float)
    seen = view(coarse, reduce(moved, coarse))
    found, score = _climbed(seen, start, start, np.arange(5))
    _, plain = _climbed(seen, start, start, np.arange(4))
    corner = np.hypot(*(n - 1 for n in moved.shape)) / 2
    if score < plain + _CERTAIN or abs(found[4]) * corner < SMALLEST:
        return alignment, 0.0
    colored = recolored(reduce(still, fine), np.asarray(moving, np.float64), alignment, fine)
    found, _ = _climbed(view(fine, colored), found, start, np.arange(5))
    dy, dx, scale_y, scale_x, k1 = (float(v) for v in found)
    return Alignment(dy, dx, scale_y, scale_x, alignment.correlation), k1


def _view(
    a: np.ndarray, b: np.ndarray, factor: int, shape: Any, moved_shape: Any, at: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Residual, Jacobian (5, N) in (px, px, 1, 1, 1), and the mask of what is read inside, all reduced."""
    grids = [factor * np.arange(n) + (factor - 1) / 2 - (full - 1) / 2 for n, full in zip(a.shape, shape)]
    q = at[2] * grids[0][:, None] + at[0], at[3] * grids[1][None] + at[1]
    corner = sum((n - 1) ** 2 for n in moved_shape) / 4
    bent = Lens(at[4]).bent(*q, corner)
    y, x = ((p + (n - 1) / 2 - (factor - 1) / 2) / factor for p, n in zip(bent, moved_shape))
    inside = (y >= 2) & (y <= b.shape[0] - 3) & (x >= 2) & (x <= b.shape[1] - 3)
    seen = cubic(np, b, y, x)
    slope_y, slope_x = (s / factor for s in np.gradient(seen))
    r2 = (q[0] ** 2 + q[1] ** 2) / corner
    columns = [slope_y, slope_x, slope_y * grids[0][:, None], slope_x * grids[1]]
    columns.append((slope_y * q[0] + slope_x * q[1]) * r2)
    gain = (a * seen)[inside].sum() / ((seen[inside] ** 2).sum() + 1e-12)
    return (a - gain * seen)[inside], gain * np.stack([c[inside] for c in columns]), inside


def _climbed(view: Any, start: np.ndarray, prior: np.ndarray, moving: np.ndarray) -> tuple[np.ndarray, float]:
    """Where the likelihood of the shared part is highest, and the likelihood."""
    stiffness = np.asarray([0, 0, SCALE_DEVIATION**-2, SCALE_DEVIATION**-2, _DEVIATION**-2])[moving]

    def score(at: np.ndarray, residual: np.ndarray) -> float:
        strain = (stiffness * (at - prior)[moving] ** 2).sum()
        return -0.5 * residual.size / PATCH * np.log(residual.var() + 1e-9) - 0.5 * strain

    at, damping = start, 1e-3
    residual, jacobian, _ = view(at)
    best = score(at, residual)
    for _ in range(15):
        own = jacobian[moving]
        noise = PATCH * residual.var()
        normal = own @ own.T + noise * np.diag(stiffness)
        right = own @ residual - noise * stiffness * (at - prior)[moving]
        step = np.zeros(5)
        step[moving] = np.linalg.solve(normal + damping * np.diag(normal.diagonal()), right)
        trial = view(at + step)
        value = score(at + step, trial[0])
        if value > best:
            gained, best, at = value - best, value, at + step
            residual, jacobian, _ = trial
            damping /= 4
            if gained < 0.01:
                break
        else:
            damping *= 8
        if damping > 1e4:
            break
    return at, best
