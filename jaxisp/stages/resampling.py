"""Change of size, and what a change of size and back leaves of a picture."""

from functools import partial
from typing import Annotated, Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax

from jaxisp.arrays.barriers import materialize, store, unknown_zeros
from jaxisp.arrays.extents import Extent, whole
from jaxisp.arrays.linear import fused_sum
from jaxisp.arrays.planes import interleaved, per_plane, planes
from jaxisp.arrays.rows import as_rows, from_rows
from jaxisp.arrays.safe_math import safe_divide
from jaxisp.arrays.shares import weighted
from jaxisp.domains import RGB
from jaxisp.options import one_of, positive
from jaxisp.params import Leaf, param, parameters
from jaxisp.pipeline import register


def _triangle(t: Any) -> Any:
    return jnp.maximum(0, 1 - jnp.abs(t))


def _keys(t: Any) -> Any:
    """Keys' cubic with a = -1/2."""
    t = jnp.abs(t)
    near = (1.5 * t - 2.5) * t * t + 1
    far = ((-0.5 * t + 2.5) * t - 4) * t + 2
    return jnp.where(t < 1, near, jnp.where(t < 2, far, 0))


KERNELS = {"bilinear": _triangle, "bicubic": _keys}
_SUPPORT = {"bilinear": 1, "bicubic": 2}  # of a kernel, to either side
_BLOCK = 64  # rows of a block of a banded matrix
_AT_ONCE = 17  # taps of a kernel
_LARGEST = 4  # factor of `Resampling`
METHODS = {"bilinear": "linear", "bicubic": "cubic", "lanczos3": "lanczos3"}


Sides = tuple[jax.Array, ...]  # rows and columns of the picture, as floats
Factor = Annotated[float, positive]
Method = Annotated[str, one_of("nearest", "area", *METHODS)]
Kernel = Annotated[str, one_of(*KERNELS)]
KernelOrNone = Annotated[str, one_of("", *KERNELS)]


@register
def resize(
    image: RGB,
    *,
    factor: Factor = 0.5,
    method: Method = "bicubic",
    antialias: bool = True,
) -> RGB:
    """Resize to `max(1, round(factor * size))` on each axis.

    `y[i] = sum_j w((x_i - j) / s) x[j] / sum_j w(.)`, `x_i = (i + 1/2) * size / new_size - 1/2`, and s
    the step where it is over 1 and `antialias` is on, else 1.

    Args:
        image: (H, W, 3), any range; bicubic and lanczos3 may overshoot it.
        factor: new size over old.
        method: "nearest", "bilinear", "bicubic" (Keys, a = -1/2), "lanczos3", or "area" (the mean over
            the pixel's footprint, parts of pixels included).
        antialias: widen the kernel when shrinking, which "area" always does and "nearest" never.

    Returns:
        The resized image, in the domain of the image.

    Raises:
        ValueError: an unknown method, or a factor that is not positive.

    Gradient: exact.

    Source: Keys 1981 (bicubic); Turkowski 1990 (lanczos3).
    """
    known = ["nearest", "area", *METHODS]
    if method not in known:
        raise ValueError(f"resize: method must be one of {', '.join(known)}, got {method!r}")
    if not factor > 0:
        raise ValueError(f"resize: factor must be positive, got {factor}")
    height, width = (max(1, round(factor * n)) for n in image.shape[:2])
    if method == "nearest":
        # in whole numbers: in float32 a centre that falls between two pixels lands on either
        row, column = ((2 * np.arange(m) + 1) * n // (2 * m) for m, n in zip((height, width), image.shape))
        return image[row][:, column]
    if method == "area":
        rows, columns = (
            jnp.asarray(_overlap(m, n), image.dtype) for m, n in zip((height, width), image.shape[:2])
        )
        return per_plane(lambda p: _on_both_axes(p, rows, columns), image)
    shape = (height, width, 3)
    return jax.image.resize(image, shape, METHODS[method], antialias, lax.Precision.HIGHEST)


def _overlap(new: int, old: int) -> np.ndarray:
    """(new, old): the share of each new pixel that each old one covers."""
    edges = np.arange(new + 1) * (old / new)
    low, high = edges[:-1, None], edges[1:, None]
    j = np.arange(old)
    return np.clip(np.minimum(high, j + 1) - np.maximum(low, j), 0, None) * (new / old)


def _on_both_axes(plane: jax.Array, rows: jax.Array, columns: jax.Array) -> jax.Array:
    half = jnp.matmul(rows, plane, precision=lax.Precision.HIGHEST)
    return jnp.matmul(half, columns.T, precision=lax.Precision.HIGHEST)


@parameters
class Resampling:
    """How far the picture was shrunk before it was enlarged again."""

    factor: Leaf = param(1.5, (1.0, float(_LARGEST)), "1", log=True, doc="size over the smaller size")


class _Way(NamedTuple):
    """The kernels of the way down and the way back, and whether the first is widened."""

    shrink: str
    enlarge: str
    antialias: bool

    @property
    def margin(self) -> int:
        """The support of both together, at the largest factor [px]."""
        return (_SUPPORT[self.shrink] + _SUPPORT[self.enlarge]) * _LARGEST

    def down(self, sample: jax.Array, pixel: jax.Array, factor: jax.Array, size: jax.Array) -> jax.Array:
        """The weight of a pixel in a sample, by where they stand [px] on an axis of `size`."""
        if self.antialias:
            return KERNELS[self.shrink]((sample - pixel) / factor)
        return KERNELS[self.shrink](jnp.minimum(sample, size - 1) - pixel)  # the last may stand outside

    def up(self, distance: jax.Array) -> jax.Array:
        """The weight of a sample this far [samples] from a pixel."""
        return KERNELS[self.enlarge](distance)


@register
def resampling(
    params: Resampling,
    image: RGB,
    *,
    method: Kernel = "bilinear",
    back: KernelOrNone = "",
    antialias: bool = True,
    extent: Extent | None = None,
) -> RGB:
    """Shrink by a factor and enlarge to the old size, as a digital zoom or a rescaled upload.

    `y = U(f) D(f) x` on each axis: D takes samples every f px with the kernel f times as wide (as it is
    where `antialias` is off), U interpolates them with the kernel.

    Args:
        params: the factor; the smaller size need not come out whole.
        image: (H, W, 3), any range; bicubic may overshoot it.
        method: "bilinear" or "bicubic" (Keys, a = -1/2), both ways.
        back: the method of the way back, where it is another.
        antialias: widen the kernel that shrinks.
        extent: of the picture, where the image is a larger frame.

    Returns:
        (H, W, 3) in the domain of the image; exactly the image at factor 1.

    Raises:
        ValueError: an unknown method.

    Gradient: exact, but for the factors at which a row or column of the smaller image comes or goes.

    Source: Keys 1981; Turkowski 1990.
    """
    way = _Way(method, back or method, antialias)
    for name in (way.shrink, way.enlarge):
        if name not in KERNELS:
            raise ValueError(f"resampling: method must be one of {', '.join(KERNELS)}, got {name!r}")
    sides = tuple(n.astype(image.dtype) for n in extent or whole((image.shape[0], image.shape[1])))
    return _resampled(image, params.factor.astype(image.dtype), sides, way)


@partial(jax.custom_jvp, nondiff_argnums=(3,))
def _resampled(image: jax.Array, factor: jax.Array, sides: Sides, way: _Way) -> jax.Array:
    """Tap after tap: a picture has the same bits in a larger frame."""
    across, down = (_taps(n, size, factor, way) for n, size in zip(image.shape[1::-1], sides[::-1]))
    rows = _tapped(as_rows(image), jnp.repeat(across, 3, 1)[:, None], 1, 3)
    return from_rows(_tapped(rows, down[:, :, None], 0, 1), image.shape)


@_resampled.defjvp
def _resampled_jvp(way: _Way, primals: Any, tangents: Any) -> tuple[jax.Array, jax.Array]:
    # by products: a tap at a time the slope to the factor would be as many sums over the image
    fn = partial(_by_products, sides=primals[2], way=way)
    return _resampled(*primals, way), jax.jvp(fn, primals[:2], tangents[:2])[1]


def _tapped(x: jax.Array, taps: jax.Array, axis: int, step: int) -> jax.Array:
    """`y[i] = sum_t taps[t, i] x[i + step * (t - (T - 1) / 2)]` along an axis of (H, W); T is odd."""
    far = step * (len(taps) // 2)
    padded = store(jnp.pad(x, [(far, far) if a == axis else (0, 0) for a in range(2)]))
    total = unknown_zeros(x.shape, x, taps)
    for t, tap in enumerate(store(taps)):
        total += tap * lax.slice_in_dim(padded, t * step, t * step + x.shape[axis], axis=axis)
        if t % _AT_ONCE == _AT_ONCE - 1:
            total = store(total)
    return total


def _taps(count: int, size: jax.Array, factor: jax.Array, way: _Way) -> jax.Array:
    """(2 m + 1, count): row i of `_there_and_back` from column i - m on, m the margin."""
    support, margin = _SUPPORT[way.enlarge], way.margin
    i = jnp.arange(count, dtype=factor.dtype)[None]
    k = i + np.arange(-margin, margin + 1, dtype=factor.dtype)[:, None]
    inside = ((k >= 0) & (k < size)).astype(factor.dtype)
    at = (i + 0.5) / factor - 0.5
    first = lax.stop_gradient(jnp.ceil(at - support))
    total, norm = jnp.zeros_like(k), jnp.zeros_like(i)
    for j in (first + s for s in range(2 * support)):
        shrink = way.down((j + 0.5) * factor - 0.5, k, factor, size) * inside
        exists = ((j >= 0) & (j * factor < size - 1e-3)).astype(factor.dtype)
        enlarge = way.up(at - j) * exists
        # the last sample may stand nearly a step outside, with weights of 5e-4; less is none that is used
        total += enlarge * safe_divide(shrink, fused_sum(shrink, 0)[None], 1e-5)
        norm += enlarge
    return safe_divide(total, norm)


def _by_products(image: jax.Array, factor: jax.Array, sides: Sides, way: _Way) -> jax.Array:
    """The same as products of matrices, banded ones for large images."""
    axes = tuple(zip(image.shape[:2], sides))
    if min(image.shape[:2]) <= 2 * (_BLOCK + 2 * way.margin):
        rows, columns = (_there_and_back(*axis, factor, way) for axis in axes)
        return per_plane(lambda p: _on_both_axes(p, rows, columns), image)
    rows, columns = (_blocks(*axis, factor, way) for axis in axes)
    turned = [materialize(_along_rows(p, rows)) for p in planes(image)]
    return interleaved([_along_rows(p, columns) for p in turned])


def _there_and_back(count: int, size: jax.Array, factor: jax.Array, way: _Way) -> jax.Array:
    """(count, count): U(f) D(f) of an axis of `size`. Sample j of the smaller stands at (j + 1/2) f - 1/2."""
    at = jnp.arange(count, dtype=factor.dtype)
    exists = at * factor < size - 1e-3
    centre = (at + 0.5) * factor - 0.5
    shrink = way.down(centre[:, None], at[None], factor, size) * (at < size)[None].astype(factor.dtype)
    enlarge = way.up((at[:, None] + 0.5) / factor - 0.5 - at[None]) * exists[None].astype(factor.dtype)
    # a sample that does not exist keeps a weight sum of 1, so that nothing is divided by a tiny number
    shrink = jnp.where(exists[:, None], shrink, 0) / jnp.where(exists, shrink.sum(1), 1)[:, None]
    enlarge = safe_divide(enlarge, enlarge.sum(1, keepdims=True))
    return jnp.matmul(enlarge, shrink, precision=lax.Precision.HIGHEST)


def _blocks(count: int, size: jax.Array, factor: jax.Array, way: _Way) -> jax.Array:
    """(n, T, T + 2 m): the blocks of `_there_and_back` on its diagonal, with the m columns around each.

    The matrix is 0 further than m from the diagonal, which is the support of both kernels together.
    """
    support, margin = _SUPPORT[way.enlarge], way.margin
    start = jnp.arange(0, count, _BLOCK, dtype=factor.dtype)[:, None]
    i = start + jnp.arange(_BLOCK, dtype=factor.dtype)[None]
    k = start - margin + jnp.arange(_BLOCK + 2 * margin, dtype=factor.dtype)[None]
    first = lax.stop_gradient(jnp.ceil((start + 0.5) / factor - 0.5 - support))
    j = first + jnp.arange(_BLOCK + 2 * support, dtype=factor.dtype)[None]
    exists = (j >= 0) & (j * factor < size - 1e-3)
    inside = (k >= 0) & (k < size)
    centre = (j[..., None] + 0.5) * factor - 0.5
    shrink = way.down(centre, k[:, None], factor, size) * inside[:, None].astype(factor.dtype)
    enlarge = way.up((i[..., None] + 0.5) / factor - 0.5 - j[:, None]) * exists[:, None].astype(factor.dtype)
    # the last sample may stand nearly a step outside, with weights of 5e-4; less is no row that a block uses
    shrink = safe_divide(shrink, shrink.sum(2, keepdims=True), 1e-5)
    enlarge = safe_divide(enlarge, enlarge.sum(2, keepdims=True))
    return jnp.matmul(enlarge, shrink, precision=lax.Precision.HIGHEST)


def _along_rows(plane: jax.Array, blocks: jax.Array) -> jax.Array:
    """(W, H): the transpose of the matrix of `_blocks` times (H, W). The product leaves it so at no cost."""
    (height, width), (n, rows, band) = plane.shape, blocks.shape
    margin = (band - rows) // 2
    padded = jnp.pad(plane, ((rows, (n + 1) * rows - height), (0, 0))).reshape(n + 2, rows, width)
    window = jnp.concatenate([padded[:n, rows - margin :], padded[1:-1], padded[2:, :margin]], axis=1)
    turned = jnp.einsum("nbw,nrb->nwr", materialize(window), blocks, precision=lax.Precision.HIGHEST)
    return jnp.moveaxis(turned, 0, 1).reshape(width, n * rows)[:, :height]


_OTHER_WAYS: tuple[dict[str, Any], ...] = (
    {"method": "bilinear", "back": "bicubic", "antialias": False},
    {"method": "bicubic"},
    {"method": "bicubic", "back": "bilinear", "antialias": False},
)


@parameters
class Rescaling:
    """How far the picture was shrunk before it was enlarged again, and in which ways."""

    factor: Leaf = param(1.5, (1.0, float(_LARGEST)), "1", log=True, doc="size over the smaller size")
    shares: Leaf = param(
        (0.0,) * len(_OTHER_WAYS),
        (-0.5, 1.5),
        "1",
        doc="bilinear then bicubic, not antialiased; bicubic; bicubic then bilinear, not antialiased",
    )


@register
def rescaling(params: Rescaling, image: RGB) -> RGB:
    """`resampling` by a mix of ways, for a factor whose kernels are not known.

    `y = R_0 x + sum_k share_k (R_k x - R_0 x)`, R_0 antialiased and bilinear. A way whose share is 0 is
    not run (under `vmap`, and for gradients to the shares, all are).

    Args:
        params: the factor and the shares.
        image: (H, W, 3), any range.

    Returns:
        (H, W, 3) in the domain of the image; exactly the image at factor 1 and shares 0.

    Gradient: exact, but for the factors at which a row or column of the smaller image comes or goes.

    Source: Keys 1981; Turkowski 1990.
    """

    def resampled(factor: jax.Array, x: jax.Array, **way: Any) -> jax.Array:
        return as_rows(resampling(Resampling(factor=factor), x, **way))

    def beyond(factor: jax.Array, x: jax.Array, first: jax.Array, **way: Any) -> jax.Array:
        return resampled(factor, x, **way) - first

    first = resampled(params.factor, image)

    mixed = first
    for share, way in zip(params.shares, _OTHER_WAYS):
        mixed = mixed + weighted(partial(beyond, **way), share, params.factor, image, first)
    return from_rows(mixed, image.shape)
