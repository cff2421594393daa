"""How much light arrives: exposure, shading, glare."""

import jax
import jax.numpy as jnp

from jaxisp.arrays.linear import pointwise
from jaxisp.arrays.planes import interleaved, planes
from jaxisp.domains import LinearRGB
from jaxisp.params import Leaf, param, parameters
from jaxisp.pipeline import register
from jaxisp.stages.optics.centre import radius_squared


@parameters
class Exposure:
    """Exposure compensation."""

    exposure_ev: Leaf = param(0.0, (-8.0, 8.0), "EV", doc="one more doubles the light")


@register(reach=0)
def exposure(params: Exposure, image: LinearRGB) -> LinearRGB:
    """Give more or less light.

    `y = 2**exposure_ev * x`, not clipped.

    Args:
        params: exposure [EV].
        image: (H, W, 3) linear light, any range.

    Returns:
        (H, W, 3) linear light.

    Gradient: exact.

    Source: Jaroensri et al. 2019, section 3.
    """
    return pointwise(jnp.multiply, (image,), jnp.exp2(jnp.asarray(params.exposure_ev, image.dtype)))


@parameters
class AffineExposure:
    """A gain and a pedestal."""

    gain: Leaf = param(1.0, (1 / 64, 64.0), "1", log=True, doc="multiplies the light")
    offset: Leaf = param(0.0, (-0.5, 0.5), "level", doc="is added after the gain")


@register(reach=0)
def affine_exposure(params: AffineExposure, image: LinearRGB) -> LinearRGB:
    """Scale the light and add a constant.

    `y = gain * x + offset`, not clipped.

    Args:
        params: gain; offset in shares of the white level.
        image: (H, W, 3) linear light, any range.

    Returns:
        (H, W, 3) linear light.

    Gradient: exact.

    Source: Jaroensri et al. 2019, section 3.
    """
    return pointwise(lambda x, gain, offset: x * gain + offset, (image,), params.gain, params.offset)


@parameters
class Vignetting:
    """Coefficients of the gain in EV; their sum is the gain in the corners."""

    a2: Leaf = param(0.0, (-3.0, 3.0), "EV", doc="coefficient of r**2; negative darkens the corners")
    a4: Leaf = param(0.0, (-3.0, 3.0), "EV", doc="coefficient of r**4")
    a6: Leaf = param(0.0, (-3.0, 3.0), "EV", doc="coefficient of r**6")


@register
def vignetting(params: Vignetting, image: LinearRGB) -> LinearRGB:
    """Darken, or brighten, the picture towards its corners.

    `y = x * 2**(a2 r**2 + a4 r**4 + a6 r**6)`, with r = 1 in the corner. The exponent keeps the gain
    positive, and the opposite coefficients are the correction.

    Args:
        params: coefficients [EV].
        image: (H, W, 3) linear light, any range.

    Returns:
        (H, W, 3) linear light, not clipped.

    Gradient: exact.

    Source: Goldman 2010, "Vignette and exposure calibration and compensation": its even polynomial,
    here of the logarithm; r as in DNG's FixVignetteRadial.
    """
    r2 = radius_squared(image.shape, image.dtype)
    return image * radial_gain(r2, params.a2, params.a4, params.a6)[..., None]


@parameters
class ColorShading:
    """Coefficients of the gains of red and blue against green, in EV."""

    red_a2: Leaf = param(0.0, (-1.5, 1.5), "EV", doc="coefficient of r**2 for red")
    red_a4: Leaf = param(0.0, (-1.5, 1.5), "EV", doc="coefficient of r**4 for red")
    blue_a2: Leaf = param(0.0, (-1.5, 1.5), "EV", doc="coefficient of r**2 for blue")
    blue_a4: Leaf = param(0.0, (-1.5, 1.5), "EV", doc="coefficient of r**4 for blue")


@register
def color_shading(params: ColorShading, image: LinearRGB) -> LinearRGB:
    """Let the colour drift towards the corners; green stays.

    `y_c = x_c * 2**(c_a2 r**2 + c_a4 r**4)` for c red and blue, with r = 1 in the corner.

    Args:
        params: coefficients [EV].
        image: (H, W, 3) linear light, any range.

    Returns:
        (H, W, 3) linear light, not clipped.

    Gradient: exact.

    Source: as `vignetting`, one gain a colour (DNG Specification 1.6: a FixVignetteRadial a plane).
    """
    r2 = radius_squared(image.shape, image.dtype)
    r, g, b = planes(image)
    red = radial_gain(r2, params.red_a2, params.red_a4)
    return interleaved([r * red, g, b * radial_gain(r2, params.blue_a2, params.blue_a4)])


def radial_gain(r2: jax.Array, *coefficients: jax.Array) -> jax.Array:
    """2 to the even polynomial of r, whose coefficients [EV] begin with that of `r2`, r squared."""
    ev = jnp.zeros_like(r2)
    for a in reversed(coefficients):
        ev = r2 * (jnp.asarray(a, r2.dtype) + ev)
    return jnp.exp2(ev)


@parameters
class VeilingGlare:
    """Stray light."""

    share: Leaf = param(0.0, (0.0, 0.5), "1", doc="of the light that is spread over the frame")


@register
def veiling_glare(params: VeilingGlare, image: LinearRGB) -> LinearRGB:
    """Spread a share of the light evenly over the frame: blacks are lifted, the mean stays.

    `y = (1 - share) x + share * mean(x)`, the mean of each channel.

    Args:
        params: share.
        image: (H, W, 3) linear light, any range.

    Returns:
        (H, W, 3) linear light.

    Gradient: exact.

    Source: ISO 9358:1994 (veiling glare index), for glare that is uniform over the frame.
    """
    share = jnp.asarray(params.share, image.dtype)
    mean = image.mean(axis=0).mean(axis=0)  # in two steps, which rounds less on a large image
    return image + share * (mean[None, None] - image)
