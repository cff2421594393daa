"""Registration: where a rendered picture lies on the camera's own, whatever the tone of the two.

Both are reduced to planes that a global monotone curve does not change; a phase correlation finds the
shift, Gauss-Newton from coarse to fine refines shift and scale. `warp` then applies the result.
"""

from collections.abc import Sequence
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from jaxisp.fit.planes import SAMPLE, SMALLEST, factors, luma, normalise, ranks, reduce
from jaxisp.fit.sampling import sample
from jaxisp.io.orientation import INVERSE, orient

PATCH = 30.0  # px whose normalised values are about as good as one independent one
_CHANCE = 5.0  # standard deviations that are not reached by chance
_ALIKE = 0.2  # what different scenes reach by being built alike (a bright sky, an upright figure)
_ALIKE_PART = 0.5  # of which one is put on the best of all places in the other
_PART = 0.75  # share of the larger that is no longer the whole, cut by a border
_PLAIN = 0.9  # a correlation that no other orientation is better than by
_BETTER = 0.15
_PART_SCALES = (1.0, 0.95, 1.05, 0.9, 1.1, 0.85, 1.17, 0.8, 1.24)  # of a part against the whole
_APART = 3  # reduced px between two places of a part
SCALE_DEVIATION = 0.01  # how far the scales of two pictures of one size differ, a priori


class Alignment(NamedTuple):
    """`reference[y, x] ~ moving[cy' + scale_y * (y - cy) + dy, cx' + scale_x * (x - cx) + dx]`.

    (cy, cx) is the centre of the reference, (cy', cx') that of the moving picture: half of (size - 1).
    """

    dy: Any = 0.0
    dx: Any = 0.0
    scale_y: Any = 1.0
    scale_x: Any = 1.0
    correlation: Any = 1.0


def estimate(reference: np.ndarray, moving: np.ndarray) -> Alignment:
    """Find where `moving` lies on `reference`; `warp(moving, result, reference.shape)` lays it there.

    Args:
        reference: (H, W, 3) or (H, W), at least 16 px on the shorter side.
        moving: likewise; size, tone, colour, noise and sharpness may differ from the reference's. Of another
            size it is the whole resized, or one is a part of the other, 0.8 to 1.25 times as large.

    Returns:
        The alignment, in Python floats. `correlation` is that of the two normalised pictures (reduced to
        at most 384 px), times the square root of the share that overlaps; see `same_scene`.

    Raises:
        ValueError: a picture is too small or not finite.
    """
    still, moved = luma("reference", reference), luma("moving", moving)
    sizes = factors(still.shape, moved.shape)
    place = _search(still, moved, sizes[0])[0]
    prior = place.scale
    correlation = 0.0
    for index, factor in enumerate((*sizes, sizes[-1])):
        a, b = reduce(still, factor), reduce(moved, factor)
        if index == len(sizes) and np.ndim(moving) == 3:  # aligned well enough to compare colours
            b = _recolor(a, [reduce(np.asarray(moving)[..., c], factor) for c in range(3)], place.at(factor))
        refined, agreement = _refine(a, b, place.at(factor), prior)
        if factor == sizes[0]:
            correlation = agreement
        if agreement < _chance(min(a.size, b.size)):
            break  # only noise is left at this size
        place = refined.full(factor)
    return _alignment(place, still.shape, moved.shape, correlation)


def same_scene(alignment: Alignment, *shapes: tuple[int, ...]) -> bool:
    """Whether the correlation is above what two pictures of different scenes reach by chance.

    Args:
        alignment: what `estimate` returned.
        shapes: of the smaller picture, or of the reference and the other, which tells a part from a whole;
            the smaller it is, the more chance gives. Below about 64 px a true pair that is noisy may not
            stand out from it.
    """
    sizes = [shape[0] * shape[1] for shape in shapes]
    share = sizes[0] * alignment.scale_y * alignment.scale_x / sizes[1] if len(sizes) > 1 else 1.0
    alike = _ALIKE_PART if min(share, 1 / share) < _PART else _ALIKE
    return bool(alignment.correlation > max(_chance(min(sizes) / factors(*shapes)[0] ** 2), alike))


def warp(image: jax.Array, alignment: Alignment, shape: tuple[int, ...] | None = None) -> jax.Array:
    """Sample `image` where `alignment` says: the image laid on the reference it was aligned to.

    Bicubic (Keys 1981, a = -1/2), separable; outside the image its edge pixel is repeated. The identity
    returns the image bit by bit. It does not low-pass first: scales are to stay near 1.

    Args:
        image: (H, W) or (H, W, C).
        alignment: may be traced.
        shape: of the result, its first two sizes; that of the image if None. Static.

    Returns:
        (H', W') or (H', W', C).

    Gradient: exact, to the image and to the alignment.
    """
    h, w = image.shape[:2] if shape is None else shape[:2]
    rows = _positions(h, image.shape[0], alignment.scale_y, alignment.dy, jnp.arange(h, dtype=image.dtype))
    columns = _positions(w, image.shape[1], alignment.scale_x, alignment.dx, jnp.arange(w, dtype=image.dtype))
    return sample(jnp, sample(jnp, image, rows, 0), columns, 1)


def covered(
    alignment: Alignment, image_shape: tuple[int, ...], shape: tuple[int, ...] | None = None
) -> jax.Array:
    """(H', W') boolean: where `warp` reads inside the image, its repeated edge left out."""
    (h, w), (size_y, size_x) = (image_shape if shape is None else shape)[:2], image_shape[:2]
    rows = _positions(h, size_y, alignment.scale_y, alignment.dy, jnp.arange(float(h)))
    columns = _positions(w, size_x, alignment.scale_x, alignment.dx, jnp.arange(float(w)))
    inside_y = (rows >= 0) & (rows <= size_y - 1)
    inside_x = (columns >= 0) & (columns <= size_x - 1)
    return inside_y[:, None] & inside_x[None]


def best_orientation(reference: np.ndarray, moving: np.ndarray) -> int:
    """The EXIF orientation, 1 to 8, that turns `moving` so that it agrees best with `reference`.

    See `jaxisp.io.orientation.orient` for what each one does.
    """
    still, moved = luma("reference", reference), luma("moving", moving)
    factor = factors(still.shape, moved.shape)[0]
    return max(INVERSE, key=lambda orientation: _search(still, orient(moved, orientation), factor)[1])


def turned_place(reference: np.ndarray, moving: np.ndarray, place: Alignment) -> tuple[Alignment, int]:
    """Where `moving` lies if it was turned or mirrored, and the EXIF orientation that turns it back.

    Args:
        place: where it lies as it is. It stays, with orientation 1, unless another is clearly better: scenes
            may be about symmetric, and noisy ones hardly alike. One that lies across need only be better.
    """
    if float(place.correlation) > _PLAIN:
        return place, 1
    orientation = best_orientation(reference, moving)
    other = estimate(reference, orient(moving, orientation)) if orientation != 1 else place
    shapes = np.shape(reference), np.shape(orient(moving, orientation))
    upright = np.argmax(np.shape(reference)[:2]) == np.argmax(np.shape(moving)[:2])
    margin = _BETTER if upright or same_scene(place, np.shape(reference), np.shape(moving)) else 0.0
    better = float(other.correlation) > float(place.correlation) + margin
    return (other, orientation) if better and same_scene(other, *shapes) else (place, 1)


class _Place(NamedTuple):
    """The same map counted from pixel (0, 0), as `offset + scale * index` a side: (y, x)."""

    offset: np.ndarray
    scale: np.ndarray

    def at(self, factor: int) -> "_Place":
        """As seen in pictures reduced by `factor`, whose first pixel is centred at (factor - 1) / 2."""
        first = (factor - 1) / 2
        return _Place((self.offset + self.scale * first - first) / factor, self.scale)

    def full(self, factor: int) -> "_Place":
        """The inverse of `at`."""
        first = (factor - 1) / 2
        return _Place(factor * self.offset + first - self.scale * first, self.scale)


def _alignment(
    place: _Place, shape: tuple[int, ...], moved: tuple[int, ...], correlation: float
) -> Alignment:
    center, moved_center = (np.asarray(shape) - 1) / 2, (np.asarray(moved) - 1) / 2
    dy, dx = place.offset + place.scale * center - moved_center
    return Alignment(float(dy), float(dx), float(place.scale[0]), float(place.scale[1]), float(correlation))


def _positions(size: int, moved_size: int, scale: Any, shift: Any, index: jax.Array) -> jax.Array:
    return (moved_size - 1) / 2 + scale * (index - (size - 1) / 2) + shift


def recolored(still: np.ndarray, moving: np.ndarray, alignment: Alignment, factor: int) -> np.ndarray:
    """A colour picture reduced by `factor` to one plane that resembles `still`, which is; see `_recolor`.

    Args:
        still: plane of the reference, reduced.
        moving: (H, W, 3), not reduced.
        alignment: of the whole pictures, of which the reference is as large as its plane says.
        factor: of the reduction.
    """
    center, moved_center = (factor * np.asarray(still.shape) - 1) / 2, (np.asarray(moving.shape[:2]) - 1) / 2
    scale = np.asarray([alignment.scale_y, alignment.scale_x], float)
    place = _Place(moved_center + np.asarray([alignment.dy, alignment.dx], float) - scale * center, scale)
    return _recolor(still, [reduce(moving[..., c], factor) for c in range(3)], place.at(factor))


def _recolor(still: np.ndarray, channels: list[np.ndarray], place: _Place) -> np.ndarray:
    """The moving picture's channels made one plane that resembles `still`, by a quadratic of their ranks.

    A curve per channel and a mix of channels do not leave luma a function of luma: edges would seem to move.
    """
    r, g, b = (ranks(c) for c in channels)
    terms = [np.ones_like(r), r, g, b, r * r, g * g, b * b, r * g, g * b, b * r]
    area = _inside(place, still.shape, r.shape)
    seen = [_view(t, place, still.shape)[area].ravel() for t in terms]
    thin = slice(None, None, seen[0].size // SAMPLE + 1)
    wanted = ranks(still)[area].ravel()[thin]
    weights = np.linalg.lstsq(np.stack([t[thin] for t in seen], 1), wanted, rcond=1e-6)[0]
    return np.tensordot(weights, np.stack(terms), 1)


def _search(still: np.ndarray, moved: np.ndarray, factor: int) -> tuple[_Place, float]:
    """The best whole shift (of reduced pixels), at scale 1 and, for other sizes, at that which fits; and
    where one may be a part of the other, of any place in it."""
    a, b = normalise(reduce(still, factor)), normalise(reduce(moved, factor))
    ratio = np.asarray(b.shape) / np.asarray(a.shape)
    scales = [np.ones(2)] + ([ratio] if still.shape != moved.shape else [])
    found = []

    def look(start: _Place, shifts: Sequence[np.ndarray]) -> None:
        for shift in shifts:
            place = _Place(start.offset + start.scale * shift, start.scale)
            correlation, pixels = _agreement(a, b, place)
            found.append((correlation * _share(pixels, a, b), place))  # so that chance favours no shift

    for scale in scales:
        start = _Place((np.asarray(b.shape) - 1) / 2 - scale * (np.asarray(a.shape) - 1) / 2, scale)
        look(start, _peaks(a, _view(b, start, a.shape)))
    for scale in _PART_SCALES if still.shape != moved.shape else ():
        if max(score for score, _ in found) > _PLAIN:
            break
        start = _Place(np.full(2, (scale - 1) / 2), np.full(2, scale))
        whole = _view(b, start, tuple(int(n) for n in np.asarray(b.shape) / scale))
        look(start, _peaks_of_part(a, whole))
    score, place = max(found, key=lambda f: f[0])
    return place.full(factor), score


def _peaks(a: np.ndarray, b: np.ndarray, count: int = 6) -> list[np.ndarray]:
    """Whole shifts at which the phase correlation of two planes of one size is highest; (0, 0) is one."""
    window = np.hanning(a.shape[0] + 2)[1:-1, None] * np.hanning(a.shape[1] + 2)[1:-1]
    size = tuple(2 * n for n in a.shape)  # zeros around, so that a shift does not wrap
    cross = np.fft.rfft2(window * b, size) * np.conj(np.fft.rfft2(window * a, size))
    surface = np.fft.irfft2(cross / (np.abs(cross) + 1e-3 * np.abs(cross).max() + 1e-12), size)
    shifts = [np.zeros(2)]
    for index in np.argsort(surface, axis=None)[: -count - 1 : -1]:
        shift = np.asarray(np.unravel_index(index, size), float)
        shifts.append(np.where(shift >= a.shape, shift - size, shift))
    return shifts


def _peaks_of_part(a: np.ndarray, b: np.ndarray, count: int = 4) -> list[np.ndarray]:
    """Whole shifts at which two planes correlate best where one is a part of the other, or reaches beyond."""
    size = tuple(n + m for n, m in zip(a.shape, b.shape))  # zeros around, so that a shift does not wrap
    cross = np.fft.rfft2(b, size) * np.conj(np.fft.rfft2(a, size))
    surface = np.fft.irfft2(cross, size)
    shifts = []
    for _ in range(count):
        index = np.asarray(np.unravel_index(surface.argmax(), size))
        shifts.append(np.where(index >= b.shape, index - size, index).astype(float))
        around = [np.arange(i - _APART, i + _APART + 1) % n for i, n in zip(index, size)]
        surface[np.ix_(*around)] = -np.inf
    return shifts


def _view(moved: np.ndarray, place: _Place, shape: tuple[int, ...]) -> np.ndarray:
    for axis in (0, 1):
        moved = sample(np, moved, place.offset[axis] + place.scale[axis] * np.arange(shape[axis]), axis)
    return moved


def _inside(place: _Place, shape: tuple[int, ...], moved_shape: tuple[int, ...]) -> tuple[slice, slice]:
    """Rows and columns of the reference that read inside the moving picture, 2 px from its edge."""
    low = np.ceil((2 - place.offset) / place.scale).clip(2, None).astype(int)
    last = np.floor((np.asarray(moved_shape) - 3 - place.offset) / place.scale)
    high = np.minimum(last, np.asarray(shape) - 3).astype(int) + 1
    return slice(low[0], max(high[0], low[0])), slice(low[1], max(high[1], low[1]))


def _agreement(a: np.ndarray, b: np.ndarray, place: _Place) -> tuple[float, int]:
    """Correlation where the two overlap, and over how many pixels."""
    area = _inside(place, a.shape, b.shape)
    b = _view(b, place, a.shape)[area]
    a = a[area] - a[area].mean() if b.size else b
    b = b - b.mean() if b.size else b
    return float((a * b).sum() / (np.sqrt((a**2).sum() * (b**2).sum()) + 1e-12)), b.size


def _chance(pixels: float) -> float:
    """The correlation that a search among shifts finds in unrelated planes."""
    return _CHANCE * np.sqrt(PATCH / pixels)


def _refine(still: np.ndarray, moved: np.ndarray, place: _Place, prior: np.ndarray) -> tuple[_Place, float]:
    """`place` corrected, and the correlation there, times the root of the share that overlaps."""
    area = _inside(place, still.shape, moved.shape)
    a, b = still[area], _view(moved, place, still.shape)[area]
    if min(a.shape) < SMALLEST:
        return place, 0.0
    change, correlation = _fit(normalise(a), normalise(b), prior / place.scale)
    first = np.array([s.start for s in area])
    offset = place.offset + place.scale * (change.offset + first - change.scale * first)
    return _Place(offset, place.scale * change.scale), correlation * _share(a.size, still, moved)


def _share(pixels: int, a: np.ndarray, b: np.ndarray) -> float:
    return float(np.sqrt(min(pixels / min(a.size, b.size), 1.0)))


def _fit(a: np.ndarray, b: np.ndarray, prior: np.ndarray, steps: int = 20) -> tuple[_Place, float]:
    """Levenberg-Marquardt on the difference of two normalised planes, from the identity.

    The scales have a Gaussian prior, so that noise does not turn into a scale in small pictures.
    """
    half = np.asarray(a.shape) / 2

    def score(place: _Place) -> float:
        correlation = _agreement(a, b, place)[0]
        strain = (((place.scale - prior) / SCALE_DEVIATION) ** 2).sum()
        return -0.5 * a.size / PATCH * np.log(1 - min(correlation, 1 - 1e-9) ** 2 + 1e-9) - 0.5 * strain

    place, damping = _Place(np.zeros(2), np.ones(2)), 1e-3
    best = score(place)
    for _ in range(steps):
        step = _step(a, b, place, half * (place.scale - prior), damping)
        scale = place.scale + step[2:] / half
        trial = _Place(place.offset + step[:2] - step[2:], scale)  # the scale turns about the centre
        value = score(trial)
        if value > best:
            place, best, damping = trial, value, damping / 4
        else:
            damping *= 8
        if np.abs(step).max() < 2e-4 or damping > 1e4:
            break
    return place, _agreement(a, b, place)[0]


def _step(a: np.ndarray, b: np.ndarray, place: _Place, strain: np.ndarray, damping: float) -> np.ndarray:
    """Change of the shifts [px], and of the scales as px at the border, that best explains the residual."""
    area = _inside(place, a.shape, b.shape)
    view = _view(b, place, a.shape)
    slopes = [s[area] for s in np.gradient(view)]
    arms = [np.linspace(-1, 1, n) for n in a.shape]
    across, along = arms[0][area[0], None], arms[1][area[1]]
    still, moved = a[area], view[area]
    gain = (still * moved).sum() / ((moved**2).sum() + 1e-12)
    residual = (still - gain * moved).ravel()
    jacobian = np.stack([slopes[0], slopes[1], slopes[0] * across, slopes[1] * along]).reshape(4, -1) * gain
    stiffness = PATCH * residual.var() / (SCALE_DEVIATION * np.asarray(a.shape) / 2) ** 2
    normal = jacobian @ jacobian.T + np.diag([0, 0, *stiffness])
    right = jacobian @ residual - np.array([0, 0, *(stiffness * strain)])
    return np.linalg.solve(normal + damping * np.diag(normal.diagonal()) + 1e-9 * np.eye(4), right)
