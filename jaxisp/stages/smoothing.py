"""Smoothing and sharpening by several rival filters at once: what is known is that it was done, not how."""

import math
from collections.abc import Callable
from functools import partial, reduce
from typing import Any

import jax
import jax.numpy as jnp
from jax import lax

from jaxisp.arrays.barriers import materialize
from jaxisp.arrays.linear import inner_product, linear_call
from jaxisp.arrays.planes import interleaved, per_plane, planes
from jaxisp.arrays.shares import weighted
from jaxisp.arrays.stencils import filter_rows_columns, gaussian_blur, pad, views
from jaxisp.color import luma, rgb_to_ycbcr_planes, ycbcr_to_rgb_planes
from jaxisp.domains import EncodedRGB, LinearRGB
from jaxisp.params import Leaf, param, parameters
from jaxisp.pipeline import register
from jaxisp.stages.denoise.bilateral import bilateral_plane
from jaxisp.stages.denoise.guided import guided_plane
from jaxisp.stages.denoise.median import median_plane
from jaxisp.stages.denoise.nonlocal_means import nonlocal_planes
from jaxisp.stages.denoise.wavelet import core_plane
from jaxisp.stages.detail import deconvolved
from jaxisp.stages.transfer import srgb_eotf, srgb_oetf

Filter = Callable[[jax.Array, jax.Array], jax.Array]
"""Of a plane, and of the luma beside it."""


def _local_linear(plane: jax.Array, deviation: float, radius: int = 2) -> jax.Array:
    """Lee 1980: what varies by less than `deviation` is averaged."""
    taps = (1 / (2 * radius + 1),) * (2 * radius + 1)
    mean, square = (materialize(filter_rows_columns(v, taps, taps)) for v in (plane, plane * plane))
    variance = jnp.maximum(square - mean * mean, 1e-9)
    return mean + jnp.maximum(1 - deviation**2 / variance, 0) * (plane - mean)


def _nonlocal(plane: jax.Array, luma: jax.Array, likeness: float) -> jax.Array:
    return nonlocal_planes((plane,), luma, likeness, search=4, patch=1)[0]


LUMA_FILTERS: tuple[Filter, ...] = (
    lambda y, _: bilateral_plane(y, y, 1.5, 0.03, 2),
    lambda y, _: bilateral_plane(y, y, 2.0, 0.1, 3),
    lambda y, _: median_plane(y, "3x3"),
    lambda y, _: _local_linear(y, 0.01),
    lambda y, _: _local_linear(y, 0.03),
    lambda y, _: guided_plane(y, y, 0.03, 3),
    lambda y, _: _nonlocal(y, y, 0.03),
    lambda y, _: core_plane(y, 0.01, 1.0, levels=3, method="fixed"),
)
CHROMA_FILTERS: tuple[Filter, ...] = (
    lambda c, _: gaussian_blur(c, 1.0, 3),
    lambda c, _: gaussian_blur(c, 2.5, 8),
    lambda c, _: median_plane(c, "3x3"),
    lambda c, _: median_plane(c, "5x5"),
    lambda c, _: bilateral_plane(c, c, 2.0, 0.05, 3),
    lambda c, y: guided_plane(c, y, 0.03, 4),
    lambda c, _: core_plane(c, 0.02, 1.0, levels=4, method="fixed"),
)


@parameters
class LumaDenoising:
    """The share of each filter."""

    shares: Leaf = param(
        (0.0,) * len(LUMA_FILTERS),
        (-0.5, 1.5),
        "1",
        doc="bilateral (1.5 px, 0.03), bilateral (2 px, 0.1), median 3x3, local linear (0.01), (0.03), "
        "guided (3 px, 0.03), non-local means (0.03), wavelets (0.01)",
    )


@register
def luma_denoising(params: LumaDenoising, image: EncodedRGB) -> EncodedRGB:
    """Smooth luma with edges kept, by a mix of filters.

    `Y' = Y + sum_k share_k (F_k(Y) - Y)`; chroma stays. A filter whose share is 0 is not run (under
    `vmap`, and for gradients to the shares, all are).

    Args:
        params: shares.
        image: (H, W, 3) encoded, any range.

    Returns:
        (H, W, 3) encoded, not clipped.

    Gradient: exact.

    Source: Tomasi & Manduchi 1998; Lee 1980, "Digital image enhancement and noise filtering by use of
    local statistics"; He, Sun & Tang 2010; Buades, Coll & Morel 2005; Donoho & Johnstone 1994.
    """
    y, cb, cr = rgb_to_ycbcr_planes(*planes(image))
    return interleaved(ycbcr_to_rgb_planes(_mixed(y, y, params.shares, LUMA_FILTERS), cb, cr))


@parameters
class ChromaDenoising:
    """The share of each filter."""

    shares: Leaf = param(
        (0.0,) * len(CHROMA_FILTERS),
        (-0.5, 1.5),
        "1",
        doc="Gaussian 1 px, Gaussian 2.5 px, median 3x3, median 5x5, bilateral (2 px, 0.05), "
        "guided by luma (4 px, 0.03), wavelets (0.02)",
    )


@register
def chroma_denoising(params: ChromaDenoising, image: EncodedRGB) -> EncodedRGB:
    """Smooth Cb and Cr, by a mix of filters.

    `C' = C + sum_k share_k (F_k(C) - C)`; luma stays. A filter whose share is 0 is not run (under
    `vmap`, and for gradients to the shares, all are).

    Args:
        params: shares.
        image: (H, W, 3) encoded, any range.

    Returns:
        (H, W, 3) encoded, not clipped.

    Gradient: exact.

    Source: Jaroensri et al. 2019, section 3 (chroma is smoothed more than luma); He, Sun & Tang 2010;
    Donoho & Johnstone 1994.
    """
    y, *chroma = rgb_to_ycbcr_planes(*planes(image))
    cb, cr = (_mixed(c, y, params.shares, CHROMA_FILTERS) for c in chroma)
    return interleaved(ycbcr_to_rgb_planes(y, cb, cr))


@partial(jax.jit, static_argnums=3)  # traced once for Cb and Cr
def _mixed(plane: jax.Array, luma: jax.Array, shares: jax.Array, filters: tuple[Filter, ...]) -> jax.Array:
    change = jnp.zeros_like(plane)
    for share, smooth in zip(shares, filters):
        change = change + weighted(lambda y, p, smooth=smooth: smooth(p, y) - p, share, luma, plane)
    return plane + change


_FLAT = 1e-10  # of white squared: keeps the share of no detail at all finite
WIDTHS = (0.7, 1.5, 3.0)
"""Standard deviations of the masks of `sharpening` [px]."""
_ITERATIONS, _REACH = 8, 5
_DARKEST = 1e-3  # of encoded white


@parameters
class Sharpening:
    """The amount of each form, and which detail it is for."""

    amounts: Leaf = param((0.0,) * len(WIDTHS), (-0.5, 4.0), "1", doc="of masks of 0.7, 1.5 and 3 px")
    deconvolution: Leaf = param(
        (0.0, 0.0), (-0.5, 3.0), "1", doc="of Richardson-Lucy deconvolution, encoded and in linear light"
    )
    sigma: Leaf = param(
        0.7, (0.1, 1.6), "px", log=True, doc="standard deviation of the blur that deconvolution undoes"
    )
    threshold: Leaf = param(
        0.0, (0.0, 0.1), "level", doc="detail of this size is added by half, less by less"
    )
    limit: Leaf = param(
        0.0, (0.0, 100.0), "1/level", doc="one over the size beyond which less than half is; 0 adds all"
    )


@register
def sharpening(params: Sharpening, image: EncodedRGB) -> EncodedRGB:
    """Unsharp masks of three widths and deconvolution on luma, cored and limited.

    `y = x + sum_k amount_k d_k d_k**2 / (d_k**2 + threshold**2) / (1 + (limit d_k)**2)`, the same for every
    channel. Of masks `d_k = Y - G_k(Y)`, G_k a Gaussian. Of deconvolution d_k is what eight iterations of
    `richardson_lucy` change of luma, as it is encoded or in linear light.

    Args:
        params: amounts; the width of deconvolution; threshold and limit, which leave plain forms where they
            are 0.
        image: (H, W, 3) encoded, any range.

    Returns:
        (H, W, 3) encoded, not clipped. A form whose amount is 0 is not run.

    Gradient: exact.

    Source: Polesel, Ramponi & Mathews 2000; see `unsharp_mask`. Richardson 1972; Lucy 1974; see
    `richardson_lucy`. Coring and a limit of the halo are what cameras and converters commonly add.
    """
    y = luma(*planes(image))
    change = jnp.zeros_like(y)
    for amount, sigma in zip(params.amounts, WIDTHS):
        add = partial(_detail, sigma)
        change = change + weighted(add, amount, params.threshold, params.limit, y)
    for amount, sharpened in zip(params.deconvolution, (_deconvolved, _deconvolved_light)):
        change = change + weighted(sharpened, amount, params.sigma, params.threshold, params.limit, y)
    return image + change[..., None]


def _detail(sigma: float, threshold: jax.Array, limit: jax.Array, plane: jax.Array) -> jax.Array:
    return _shaped(plane - gaussian_blur(plane, sigma, math.ceil(3 * sigma)), threshold, limit)


def _deconvolved(sigma: jax.Array, threshold: jax.Array, limit: jax.Array, plane: jax.Array) -> jax.Array:
    data = jnp.maximum(plane, _DARKEST)
    return _shaped(_sharper(data, sigma) - data, threshold, limit)


def _deconvolved_light(
    sigma: jax.Array, threshold: jax.Array, limit: jax.Array, plane: jax.Array
) -> jax.Array:
    data = jnp.maximum(plane, _DARKEST)
    found = srgb_oetf(_sharper(materialize(srgb_eotf(data)), sigma))
    return _shaped(found - data, threshold, limit)


@jax.jit  # traced once for both
def _sharper(data: jax.Array, sigma: jax.Array) -> jax.Array:
    return deconvolved(data, data, sigma, jnp.zeros_like(sigma), _ITERATIONS, _REACH)


def _shaped(detail: jax.Array, threshold: jax.Array, limit: jax.Array) -> jax.Array:
    detail = materialize(detail)
    square = detail * detail + _FLAT
    return detail * (square / (square + threshold * threshold)) / (1 + limit * limit * square)


STEPS = ((0, 1), (1, 1), (1, 0), (1, -1))


@parameters
class DirectionalBlur:
    """How far the picture moved along four directions."""

    lengths: Leaf = param(
        (0.0,) * len(STEPS), (0.0, 12.0), "px", doc="along a row, down right, along a column, down left"
    )


@register
def directional_blur(params: DirectionalBlur, image: LinearRGB) -> LinearRGB:
    """Blur along straight lines: box means along four directions, one after another.

    Along direction d: `y(p) = sum_k w_k x(p + k d)`, `w_k` the share of pixel k in a box of that length.
    Two neighbouring directions together stand for one between them.

    Args:
        params: lengths.
        image: (H, W, 3) linear light, any range.

    Returns:
        (H, W, 3) linear light. Borders are reflected; a length of 0 does nothing.

    Gradient: exact (at 0, that of the side of larger lengths).

    Source: Potmesil & Chakravarty 1983; see `motion_blur` for one path of any direction.
    """
    for length, (dy, dx) in zip(params.lengths, STEPS):
        image = lax.cond(length > 0, partial(_moved_along, dy, dx), _as_it_is, image, length)
    return image


def _as_it_is(image: jax.Array, length: jax.Array) -> jax.Array:
    return image


def _moved_along(dy: int, dx: int, image: jax.Array, length: jax.Array) -> jax.Array:
    return per_plane(lambda plane: _box_along(plane, length, dy, dx), image)


def _box_along(plane: jax.Array, length: jax.Array, dy: int, dx: int, reach: int = 6) -> jax.Array:
    steps = range(-reach, reach + 1)
    inside = jnp.stack([jnp.clip(length / math.hypot(dy, dx) / 2 + 0.5 - abs(k), 0, 1) for k in steps])
    return _line(pad(plane, reach), inside / inside.sum(), (dy, dx))


@partial(jax.custom_jvp, nondiff_argnums=(2,))
def _line(padded: jax.Array, taps: jax.Array, step: tuple[int, int]) -> jax.Array:
    """The sum over taps along a line of `taps[k]` times the plane moved by k steps, without its border."""
    return reduce(jnp.add, (t * v for t, v in zip(taps, _moved(padded, len(taps), step))))


@_line.defjvp
def _line_jvp(step: tuple[int, int], primals: Any, tangents: Any) -> tuple[jax.Array, jax.Array]:
    (padded, taps), (d_padded, d_taps) = primals, tangents

    def spread(taps: jax.Array, y: jax.Array) -> jax.Array:
        return _line(pad(y, len(taps) - 1, "constant"), taps[::-1], step)

    def products(padded: jax.Array, y: jax.Array) -> jax.Array:
        return jnp.stack([inner_product(y, v) for v in _moved(padded, len(taps), step)])

    by_plane = linear_call(lambda t, p: _line(p, t, step), spread, taps, d_padded)
    by_taps = linear_call(lambda p, t: _line(p, t, step), products, padded, d_taps)
    return _line(padded, taps, step), by_plane + by_taps


def _moved(padded: jax.Array, count: int, step: tuple[int, int]) -> list[jax.Array]:
    reach = count // 2
    return views(padded, [(k * step[0], k * step[1]) for k in range(-reach, reach + 1)], reach)
