"""Wavelet coring of luma and chroma, and a noise estimate."""

from typing import Annotated, Any

import jax
import jax.numpy as jnp
import numpy as np

from jaxisp.arrays.barriers import materialize
from jaxisp.arrays.planes import interleaved, planes
from jaxisp.color import rgb_to_ycbcr_planes, ycbcr_to_rgb_planes
from jaxisp.domains import RGB
from jaxisp.options import Positive, one_of
from jaxisp.params import Leaf, param, parameters
from jaxisp.pipeline import register
from jaxisp.stages.denoise.dwt import SCALING, analyse, synthesise

METHODS = ("bayes", "visu", "fixed")


Wavelet = Annotated[str, one_of(*SCALING)]
Method = Annotated[str, one_of(*METHODS)]


@parameters
class WaveletCoring:
    """The noise to remove, and how eagerly."""

    luma_sigma: Leaf = param(
        0.01, (1e-4, 0.3), "level", log=True, doc="standard deviation of the noise in luma"
    )
    chroma_sigma: Leaf = param(
        0.01, (1e-4, 0.3), "level", log=True, doc="standard deviation of the noise in Cb and Cr"
    )
    strength: Leaf = param(1.0, (0.0, 4.0), "1", doc="multiplies every threshold; 0 keeps the image")


@register
def wavelet_coring(
    params: WaveletCoring,
    image: RGB,
    *,
    wavelet: Wavelet = "db2",
    levels: Positive = 3,
    method: Method = "bayes",
) -> RGB:
    """Shrink small wavelet coefficients of luma and chroma to zero.

    `d' = sign(d) max(|d| - strength * t, 0)` for the details of each sub-band, with, for noise of standard
    deviation s, `t = s**2 / sqrt(max(mean(d**2) - s**2, 1e-6 s**2))` (bayes), `t = s sqrt(2 ln(H W))`
    (visu), or `t = s` (fixed).

    Args:
        params: noise per plane in the unit of the image; strength.
        image: (H, W, 3), any range and size.
        wavelet: "haar", "db2", "db3", "db4", "sym4" or "sym8".
        levels: how many times the approximation is split again.
        method: "bayes", "visu" or "fixed".

    Returns:
        (H, W, 3) in the domain of the image. Borders are mirrored (symmetric, half-sample).

    Raises:
        ValueError: an unknown wavelet or method.

    Gradient: exact.

    Source: Jaroensri et al. 2019, section 3; Donoho & Johnstone 1994 (VisuShrink); Chang, Yu & Vetterli
        2000 (BayesShrink); Daubechies 1992.
    """
    if wavelet not in SCALING:
        raise ValueError(f"wavelet_coring: wavelet {wavelet!r} is none of {', '.join(SCALING)}")
    if method not in METHODS:
        raise ValueError(f"wavelet_coring: method {method!r} is none of {', '.join(METHODS)}")
    parts = jnp.stack(rgb_to_ycbcr_planes(*planes(image)))
    sigmas = jnp.stack([params.luma_sigma, params.chroma_sigma, params.chroma_sigma]).astype(parts.dtype)

    def shrink(plane: jax.Array, sigma: jax.Array) -> jax.Array:
        return core_plane(plane, sigma, params.strength, wavelet, levels, method)

    filtered = materialize(jax.vmap(shrink)(materialize(parts), sigmas))
    return interleaved(ycbcr_to_rgb_planes(*filtered))


def core_plane(
    plane: jax.Array,
    sigma: Any,
    strength: Any,
    wavelet: Wavelet = "db2",
    levels: Positive = 3,
    method: Method = "bayes",
) -> jax.Array:
    """Wavelet coring of one (H, W) plane with noise of standard deviation sigma; see `wavelet_coring`."""
    pyramid, low = [], plane
    for _ in range(levels):
        shape = low.shape
        low, *details = materialize(analyse(low, wavelet))
        pyramid.append((shape, details))
    for shape, details in reversed(pyramid):
        h, v, d = (soft_threshold(x, strength * threshold(x, sigma, method, plane.size)) for x in details)
        low = materialize(synthesise((low, h, v, d), shape, wavelet))
    return low


def threshold(band: jax.Array, sigma: Any, method: str, pixels: int) -> jax.Array:
    """The threshold for a sub-band of an image of so many pixels, under noise of standard deviation sigma."""
    if method == "fixed":
        return jnp.asarray(sigma)
    if method == "visu":
        return sigma * np.sqrt(2 * np.log(pixels)).astype(band.dtype)
    signal = jnp.mean(band * band) - sigma**2
    return sigma**2 / jnp.sqrt(jnp.maximum(signal, 1e-6 * sigma**2))


def soft_threshold(x: jax.Array, by: Any) -> jax.Array:
    """Move x towards 0 by so much, and no further."""
    return x - jnp.clip(x, -by, by)


def estimate_noise(plane: jax.Array) -> jax.Array:
    """Robust standard deviation of white noise in an (H, W) plane, whatever the picture under it.

    `median(|d|) / 0.6745` over the finest diagonal details d of "db2" (Donoho & Johnstone 1994).
    Not for inside a pipeline: a median over a plane is slow.
    """
    return jnp.median(jnp.abs(analyse(plane, "db2")[3])) / 0.6744897501960817
