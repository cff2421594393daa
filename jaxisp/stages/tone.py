"""Tone: s-curves, the paper's tone curve, zones, grey-pivot gamma, highlight roll-off.

A curve runs on each channel, or on luma with the chroma kept: then every channel gets what luma got
added, which leaves Cb and Cr as they were. Outside [0, 1] curves go on so that they stay monotone.
"""

from collections.abc import Callable
from typing import Annotated

import jax
import jax.numpy as jnp

from jaxisp.arrays.linear import pointwise
from jaxisp.arrays.planes import planes
from jaxisp.arrays.safe_math import clip, straight_through
from jaxisp.color import luma
from jaxisp.domains import RGB
from jaxisp.options import one_of
from jaxisp.params import Leaf, param, parameters
from jaxisp.pipeline import register
from jaxisp.stages.power import power

Curve = Callable[..., jax.Array]


def _apply(curve: Curve, image: jax.Array, on: str, *scalars: jax.Array) -> jax.Array:
    if on == "channels":
        return pointwise(curve, (image,), *scalars)
    if on == "luma":
        y = luma(*planes(image))
        return image + (pointwise(curve, (y,), *scalars) - y)[..., None]
    raise ValueError(f'on={on!r} is neither "luma" nor "channels"')


Which = Annotated[str, one_of("luma", "channels")]


@parameters
class SCurve:
    """Contrast about a midpoint."""

    strength: Leaf = param(0.5, (-2.0, 2.0), "1", doc="log of the slope at the midpoint; 0 is off")
    midpoint: Leaf = param(0.5, (0.1, 0.9), "level", doc="the level that stays and where it is steepest")


def _s_curve(x: jax.Array, strength: jax.Array, midpoint: jax.Array) -> jax.Array:
    slope = jnp.exp(strength)
    inside = clip(x, 0, 1)
    dark = inside < midpoint
    share = jnp.where(dark, inside / midpoint, (1 - inside) / (1 - midpoint))
    bent = share / (share + slope * (1 - share))
    y = jnp.where(dark, midpoint * bent, 1 - (1 - midpoint) * bent)
    return y + (x - inside) / slope


@register(reach=0)
def s_curve(params: SCurve, image: RGB, *, on: Which = "channels") -> RGB:
    """Raise the contrast about a midpoint, and lower it near black and white.

    With m the midpoint and s = exp(strength), t = x / m below m and (1 - x) / (1 - m) above:
    `h = t / (t + s (1 - t)); y = m h below m, 1 - (1 - m) h above`. Through 0, m and 1; the slope is s at
    m and 1/s at 0 and 1, where it goes on straight. A negative strength is the inverse.

    Args:
        params: strength and midpoint.
        image: (H, W, 3), any range.
        on: "channels", or "luma" with the chroma kept.

    Returns:
        (H, W, 3) in the domain of the image.

    Raises:
        ValueError: `on` is neither.

    Gradient: exact.

    Source: Schlick 1994, "Fast alternatives to Perlin's bias and gain functions".
    """
    return _apply(_s_curve, image, on, params.strength, params.midpoint)


@register(reach=0)
def inverse_s_curve(params: SCurve, image: RGB, *, on: Which = "channels") -> RGB:
    """Undo `s_curve` of the same parameters.

    `s_curve` with `-strength`.

    Args:
        params: strength and midpoint.
        image: (H, W, 3), any range.
        on: "channels", or "luma" with the chroma kept.

    Returns:
        (H, W, 3) in the domain of the image.

    Raises:
        ValueError: `on` is neither.

    Gradient: exact.

    Source: Schlick 1994, "Fast alternatives to Perlin's bias and gain functions".
    """
    return _apply(_s_curve, image, on, -params.strength, params.midpoint)


@parameters
class ToneCurve:
    """Contrast of the paper's cubic."""

    amount: Leaf = param(
        0.2, (-0.9, 0.45), "1", doc="a fifth of it is what is taken off at 1/4 and added at 3/4; 0 is off"
    )


@register(reach=0)
def tone_curve(params: ToneCurve, image: RGB, *, on: Which = "luma") -> RGB:
    """A cubic contrast curve.

    `y = A x**3 + B x**2 + C x` with a = 0.2 amount, A = -64 a / 3, B = 32 a, C = 1 - 32 a / 3: through
    0, (1/4, 1/4 - a), 1/2, (3/4, 3/4 + a) and 1. Beyond 0 and 1 it goes on straight, with the slope C.

    Args:
        params: amount; monotone within its bounds.
        image: (H, W, 3), any range.
        on: "luma" with the chroma kept, or "channels".

    Returns:
        (H, W, 3) in the domain of the image.

    Raises:
        ValueError: `on` is neither.

    Gradient: exact.

    Source: Jaroensri et al. 2019, section 3 (tone curve).
    """

    def curve(x: jax.Array, amount: jax.Array) -> jax.Array:
        a = 0.2 * amount
        end_slope = 1 - 32 * a / 3
        inside = clip(x, 0, 1)
        cubic = inside * (end_slope + inside * (32 * a - inside * (64 * a / 3)))
        return cubic + end_slope * (x - inside)

    return _apply(curve, image, on, params.amount)


@parameters
class ZoneCurve:
    """Lift of each zone, from the shadows to the highlights."""

    offsets: Leaf = param(
        (0.0, 0.0, 0.0), (-0.5, 0.5), "zone", any_length=True, doc="lift of each zone, darkest first"
    )


@register(reach=0)
def zone_curve(params: ZoneCurve, image: RGB, *, on: Which = "luma") -> RGB:
    """Lift or lower N equally spaced zones: a piecewise linear curve through N control points.

    Control point i = 1..N is at `x = i / (N + 1)` and `y = (i + offset_i) / (N + 1)`; 0 and 1 stay, and
    what is outside them is left alone. The curve is monotone for all offsets within their bounds.

    Args:
        params: N offsets.
        image: (H, W, 3), any range.
        on: "luma" with the chroma kept, or "channels".

    Returns:
        (H, W, 3) in the domain of the image.

    Raises:
        ValueError: `on` is neither.

    Gradient: exact.

    Source: Jaroensri et al. 2019, section 3 (N-zone tone curve).
    """
    zones = params.offsets.shape[0]

    def curve(x: jax.Array, *offsets: jax.Array) -> jax.Array:
        at = x * (zones + 1)
        tents = [offsets[i] * jnp.maximum(0.0, 1 - jnp.abs(at - (i + 1))) for i in range(zones)]
        return x + sum(tents, jnp.zeros_like(x)) / (zones + 1)

    return _apply(curve, image, on, *params.offsets)


@parameters
class Gray18Gamma:
    """Contrast about middle grey."""

    gamma: Leaf = param(1.0, (0.4, 1.6), "1", log=True, doc="log-log slope at 18 %; below 1 is flatter")


@register(reach=0)
def gray18_gamma(params: Gray18Gamma, image: RGB, *, on: Which = "channels") -> RGB:
    """A power law that leaves 18 % grey where it is, as contrast in stops about middle grey.

    `y = 0.18 (x / 0.18)**gamma` from 1.8e-4 up; below, a parabola that joins with the same slope and
    whose slope at 0 is finite; odd about 0.

    Args:
        params: gamma.
        image: (H, W, 3) linear light, any range.
        on: "channels", or "luma" with the chroma kept.

    Returns:
        (H, W, 3) in the domain of the image, not clipped.

    Raises:
        ValueError: `on` is neither.

    Gradient: exact.

    Source: Jaroensri et al. 2019, released code (Gray18Gamma), without its offset of 0.001.
    """
    return _apply(lambda x, gamma: 0.18 * power(x / 0.18, gamma), image, on, params.gamma)


@parameters
class HighlightRolloff:
    """Where the shoulder starts, and what it takes to white."""

    start: Leaf = param(0.8, (0.1, 0.95), "level", doc="below it nothing changes")
    white: Leaf = param(2.0, (1.0, 16.0), "level", log=True, doc="the level that becomes 1; 1 is off")


@register(reach=0)
def highlight_rolloff(params: HighlightRolloff, image: RGB, *, on: Which = "channels") -> RGB:
    """Bring highlights above 1 back by a smooth shoulder instead of a clip.

    With t = (x - start) / (1 - start) and w the same of white:
    `y = start + (1 - start) t (1 + t / w**2) / (1 + t)` above start, x below. The slope is 1 at start;
    white becomes 1.

    Args:
        params: start and white.
        image: (H, W, 3) linear light, any range.
        on: "channels", or "luma" with the chroma kept.

    Returns:
        (H, W, 3) in the domain of the image; above 1 only what was above white.

    Raises:
        ValueError: `on` is neither.

    Gradient: exact.

    Source: Reinhard et al. 2002, equation 4, started at a level instead of at 0.
    """

    def curve(x: jax.Array, start: jax.Array, white: jax.Array) -> jax.Array:
        span = 1 - start
        top = (white - start) / span
        t = jnp.maximum(x - start, 0.0) / span
        shoulder = start + span * t * (1 + t / (top * top)) / (1 + t)
        return jnp.where(x > start, shoulder, x)

    return _apply(curve, image, on, params.start, params.white)


@register(reach=0)
def smoothstep(image: RGB) -> RGB:
    """A cubic contrast curve that is flat at black and white.

    `y = 3 x**2 - 2 x**3`, x clipped to [0, 1].

    Args:
        image: (H, W, 3), any range.

    Returns:
        (H, W, 3) in the domain of the image, in [0, 1].

    Gradient: exact.

    Source: Brooks et al. 2019, "Unprocessing Images for Learned Raw Denoising", section 3.5.
    """
    return pointwise(_smoothstep, (image,))


def _smoothstep(x: jax.Array) -> jax.Array:
    x = clip(x, 0, 1)
    return x * x * (3 - 2 * x)


@register(reach=0)
def inverse_smoothstep(image: RGB) -> RGB:
    """Undo `smoothstep`.

    `y = 1/2 - sin(asin(1 - 2 x) / 3)`, x clipped to [0, 1].

    Args:
        image: (H, W, 3), any range.

    Returns:
        (H, W, 3) in the domain of the image, in [0, 1].

    Gradient: surrogate. Exact from 0.001 to 0.999, 0 beyond: at black and white the slope is infinite.

    Source: Brooks et al. 2019, "Unprocessing Images for Learned Raw Denoising", section 3.5.
    """

    def curve(x: jax.Array) -> jax.Array:
        return 0.5 - jnp.sin(jnp.arcsin(1 - 2 * x) / 3)

    def inverse(x: jax.Array) -> jax.Array:
        value = jax.lax.stop_gradient(curve(jnp.clip(x, 0, 1)))
        return straight_through(value, curve(clip(x, _STEEP, 1 - _STEEP)))

    return pointwise(inverse, (image,))


_STEEP = 1e-3
