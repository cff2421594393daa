"""Standard transfer functions. Negative values take the curve's mirror image, values above 1 its power law.

The power is exp(log) on values that are kept above the knee, so its gradient is finite everywhere.
"""

from collections.abc import Callable

import jax
import jax.numpy as jnp

from jaxisp.arrays.rows import elementwise
from jaxisp.domains import EncodedProPhotoRGB, EncodedRGB, LinearRGB, ProPhotoRGB
from jaxisp.pipeline import register


def _power(x: jax.Array, exponent: float, least: float) -> jax.Array:
    """max(x, least)**exponent for a positive `least`."""
    return jnp.exp(exponent * jnp.log(jnp.maximum(x, least)))


def _odd(curve: Callable[[jax.Array], jax.Array], x: jax.Array) -> jax.Array:
    """`curve` of the magnitude with the sign of x; unlike sign(x) * abs(x) it has a slope at 0."""

    def both(x: jax.Array) -> jax.Array:
        negative = x < 0
        y = curve(jnp.where(negative, -x, x))
        return jnp.where(negative, -y, y)

    return elementwise(both, x)


_SRGB_KNEE = 0.0031308


@register(reach=0)
def srgb_oetf(image: LinearRGB, *, legacy: bool = False) -> EncodedRGB:
    """Linear sRGB to display-encoded sRGB.

    `y = 12.92 x` up to 0.0031308, `1.055 x**(1/2.4) - 0.055` above; odd about 0.

    Args:
        image: (H, W, 3) linear light, any range.
        legacy: the formula of Jaroensri et al.'s code, `1.055 (x + .001)**(1/2.4) - .055` above the
            knee, where it jumps, and a line below, negative values too.

    Returns:
        (H, W, 3) encoded sRGB, not clipped.

    Gradient: exact.

    Source: IEC 61966-2-1:1999.
    """

    def curve(x: jax.Array) -> jax.Array:
        moved = x + 0.001 if legacy else x
        return jnp.where(x <= _SRGB_KNEE, 12.92 * x, 1.055 * _power(moved, 1 / 2.4, _SRGB_KNEE) - 0.055)

    return elementwise(curve, image) if legacy else _odd(curve, image)


@register(reach=0)
def srgb_eotf(image: EncodedRGB, *, legacy: bool = False) -> LinearRGB:
    """Display-encoded sRGB to linear sRGB: the inverse of `srgb_oetf`.

    `y = x / 12.92` up to 0.04045, `((x + 0.055) / 1.055)**2.4` above; odd about 0.

    Args:
        image: (H, W, 3) encoded sRGB, any range.
        legacy: the formula of Jaroensri et al.'s code, `(x + .055)**2.4 / 1.055` above the knee, which
            is no inverse (7.8 % too bright), and a line below, negative values too.

    Returns:
        (H, W, 3) linear light, not clipped.

    Gradient: exact.

    Source: IEC 61966-2-1:1999. The knee is 12.92 * 0.0031308 (0.0404499), so that it is an inverse.
    """
    knee = 0.04045 if legacy else 12.92 * _SRGB_KNEE
    scale = 1 / 1.055 if legacy else 1.055**-2.4

    def curve(x: jax.Array) -> jax.Array:
        return jnp.where(x <= knee, x / 12.92, scale * _power(x + 0.055, 2.4, knee))

    return elementwise(curve, image) if legacy else _odd(curve, image)


@register(reach=0)
def rec709_oetf(image: LinearRGB) -> EncodedRGB:
    """Linear light to Rec. 709 video signal.

    `y = 4.5 x` below 0.018, `1.099 x**0.45 - 0.099` from there; odd about 0. The standard's rounded
    constants leave a step of 2.5e-4 at the knee.

    Args:
        image: (H, W, 3) linear light, sRGB (= Rec. 709) primaries, any range.

    Returns:
        (H, W, 3) encoded RGB, not clipped.

    Gradient: exact.

    Source: ITU-R BT.709-6, item 1.2.
    """

    def curve(x: jax.Array) -> jax.Array:
        return jnp.where(x < 0.018, 4.5 * x, 1.099 * _power(x, 0.45, 0.018) - 0.099)

    return _odd(curve, image)


_REC709_KNEE = 1.099 * 0.018**0.45 - 0.099


@register(reach=0)
def rec709_eotf(image: EncodedRGB) -> LinearRGB:
    """Rec. 709 video signal back to the linear light of the scene: the inverse of `rec709_oetf`.

    `y = x / 4.5` below 0.08125, `((x + 0.099) / 1.099)**(1 / 0.45)` from there; odd about 0. A
    display shows the signal otherwise (ITU-R BT.1886).

    Args:
        image: (H, W, 3) encoded RGB, any range.

    Returns:
        (H, W, 3) linear light, not clipped.

    Gradient: exact.

    Source: ITU-R BT.709-6, item 1.2, inverted.
    """

    def curve(x: jax.Array) -> jax.Array:
        # in the step of the forward curve lie no values, so the knee may stand anywhere inside it
        knee = _REC709_KNEE - 1e-5
        return jnp.where(x < knee, x / 4.5, _power((x + 0.099) / 1.099, 1 / 0.45, 0.1))

    return _odd(curve, image)


@register(reach=0)
def prophoto_oetf(image: ProPhotoRGB) -> EncodedProPhotoRGB:
    """Linear ProPhoto RGB to ROMM-encoded ProPhoto RGB.

    `y = 16 x` below 1/512, `x**(1/1.8)` from there; odd about 0.

    Args:
        image: (H, W, 3) linear ProPhoto RGB, any range.

    Returns:
        (H, W, 3) encoded ProPhoto RGB, not clipped.

    Gradient: exact.

    Source: ISO 22028-2:2013 (ROMM RGB).
    """

    def curve(x: jax.Array) -> jax.Array:
        return jnp.where(x < 1 / 512, 16 * x, _power(x, 1 / 1.8, 1 / 512))

    return _odd(curve, image)


@register(reach=0)
def prophoto_eotf(image: EncodedProPhotoRGB) -> ProPhotoRGB:
    """ROMM-encoded ProPhoto RGB to linear ProPhoto RGB: the inverse of `prophoto_oetf`.

    `y = x / 16` below 1/32, `x**1.8` from there; odd about 0.

    Args:
        image: (H, W, 3) encoded ProPhoto RGB, any range.

    Returns:
        (H, W, 3) linear ProPhoto RGB, not clipped.

    Gradient: exact.

    Source: ISO 22028-2:2013 (ROMM RGB).
    """

    def curve(x: jax.Array) -> jax.Array:
        return jnp.where(x < 1 / 32, x / 16, _power(x, 1.8, 1 / 32))

    return _odd(curve, image)


_DARKEST = 1e-8


@register(reach=0)
def gamma22_oetf(image: LinearRGB) -> EncodedRGB:
    """Linear light to an encoding by the power 1/2.2, as papers have it that leave out sRGB's straight part.

    `y = max(x, 1e-8)**(1/2.2)`.

    Args:
        image: (H, W, 3) linear light, any range.

    Returns:
        (H, W, 3) encoded, not clipped above.

    Gradient: exact.

    Source: Brooks et al. 2019, "Unprocessing Images for Learned Raw Denoising", section 3.5.
    """
    return elementwise(lambda x: _power(x, 1 / 2.2, _DARKEST), image)


@register(reach=0)
def gamma22_eotf(image: EncodedRGB) -> LinearRGB:
    """Undo `gamma22_oetf`.

    `y = max(x, 1e-8)**2.2`.

    Args:
        image: (H, W, 3) encoded, any range.

    Returns:
        (H, W, 3) linear light, not clipped above.

    Gradient: exact.

    Source: Brooks et al. 2019, "Unprocessing Images for Learned Raw Denoising", section 3.5.
    """
    return elementwise(lambda x: _power(x, 2.2, _DARKEST), image)
