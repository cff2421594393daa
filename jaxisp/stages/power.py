"""Gamma: a power law whose slope at black is finite, and its inverse."""

import jax
import jax.numpy as jnp

from jaxisp.arrays.linear import pointwise
from jaxisp.domains import Image
from jaxisp.params import Leaf, param, parameters
from jaxisp.pipeline import register

TOE = 1e-3
"""Below it a power gives way to a parabola, whose slope at 0 is finite."""


def power(x: jax.Array, exponent: jax.Array) -> jax.Array:
    """x**exponent from TOE up; below, the parabola through 0 that joins it with the same slope. Odd.

    Monotone for exponents in (0, 2).
    """
    negative = x < 0
    x = jnp.where(negative, -x, x)
    share = jnp.minimum(x, TOE) / TOE
    toe = share * (2 - exponent - (1 - exponent) * share)
    # of the ratio to TOE, so that both branches carry the same factor
    body = jnp.exp(exponent * jnp.log(jnp.maximum(x, TOE) / TOE))
    y = TOE**exponent * jnp.where(x < TOE, toe, body)
    return jnp.where(negative, -y, y)


def inverse_power(y: jax.Array, exponent: jax.Array) -> jax.Array:
    """The inverse of `power` with the same exponent."""
    negative = y < 0
    y = jnp.where(negative, -y, y)
    joint = TOE**exponent
    share = jnp.minimum(y / joint, 1.0)
    b = 2 - exponent
    root = jnp.sqrt(b * b - 4 * (1 - exponent) * share)  # at least the exponent: never 0
    x = TOE * jnp.where(
        y < joint, 2 * share / (b + root), jnp.exp(jnp.log(jnp.maximum(y / joint, 1.0)) / exponent)
    )
    return jnp.where(negative, -x, x)


@parameters
class Gamma:
    """The exponent's inverse."""

    gamma: Leaf = param(2.2, (0.6, 4.0), "1", log=True, doc="above 1 lifts the shadows")


@register(reach=0)
def gamma_compression(params: Gamma, image: Image) -> Image:
    """Compress by a power law.

    `y = x**(1 / gamma)` from 0.001 up, 0 to 0 and 1 to 1; below 0.001 a parabola that joins with the same
    slope and whose slope at 0 is finite; odd about 0.

    Args:
        params: gamma.
        image: (H, W) or (H, W, 3), any range.

    Returns:
        The same shape in the domain of the image, not clipped.

    Gradient: exact.

    Source: Jaroensri et al. 2019, section 3; Poynton 2012, chapter 27.
    """
    return pointwise(power, (image,), 1 / params.gamma)


@register(reach=0)
def gamma_expansion(params: Gamma, image: Image) -> Image:
    """Undo `gamma_compression` of the same gamma.

    `y = x**gamma` from 0.001**(1 / gamma) up; below, the inverse of the parabola; odd about 0.

    Args:
        params: gamma.
        image: (H, W) or (H, W, 3), any range.

    Returns:
        The same shape in the domain of the image, not clipped.

    Gradient: exact.

    Source: Jaroensri et al. 2019, section 3; Poynton 2012, chapter 27.
    """
    return pointwise(inverse_power, (image,), 1 / params.gamma)
