"""Rounding to output levels."""

from typing import Annotated

import jax
import jax.numpy as jnp

from jaxisp.arrays.rows import elementwise
from jaxisp.arrays.safe_math import clip, straight_through
from jaxisp.domains import EncodedRGB
from jaxisp.options import between
from jaxisp.pipeline import register

Bits = Annotated[int, between(1, 16)]


@register(reach=0)
def rounding(image: EncodedRGB, *, bits: Bits = 8, legacy: bool = False) -> EncodedRGB:
    """Clip to [0, 1] and round to the levels of an integer file.

    `y = round(n * clip(x, 0, 1)) / n`, with `n = 2**bits - 1`; halves go to the even level.

    Args:
        image: (H, W, 3) display-encoded.
        bits: bits a channel, 1 to 16.
        legacy: `floor(2**bits * x) / 2**bits` instead, clipped, as the authors' code rounds: one level
            too many, and half a level too dark on average.

    Returns:
        (H, W, 3) in [0, 1].

    Raises:
        ValueError: bits outside 1 to 16.

    Gradient: surrogate: 1 inside [0, 1] (straight-through), 0 outside.

    Source: Jaroensri et al. 2019, the code that goes with it (legacy).
    """
    if not 1 <= bits <= 16:
        raise ValueError(f"rounding: bits must be in 1..16, got {bits}")
    levels = 2**bits - 1

    def rounded(x: jax.Array) -> jax.Array:
        inside = clip(x, 0, 1)
        if legacy:
            return straight_through(jnp.floor(inside * 2**bits) / 2**bits, inside)
        return straight_through(jnp.round(inside * levels) / levels, inside)

    return elementwise(rounded, image)
