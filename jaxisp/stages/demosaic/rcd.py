"""Sanz Rodriguez's ratio corrected demosaicing."""

from collections.abc import Sequence

import jax
import jax.numpy as jnp
from jax import lax

from jaxisp.arrays.barriers import materialize
from jaxisp.arrays.planes import interleaved
from jaxisp.arrays.stencils import pad
from jaxisp.cfa import Bayer, check_bayer
from jaxisp.domains import CameraRGB, Mosaic
from jaxisp.pipeline import register
from jaxisp.stages.demosaic.common import DIAGONALS, neighbours, paired_sum, sites

Offset = tuple[int, int]
_ROW, _COLUMN, _FALLING, _RISING = (0, 1), (1, 0), (1, 1), (1, -1)
_MARGIN = 5  # px: the high-pass has three, the sum and the neighbours one each
_TINY = 1e-5  # of white: keeps quotients of flat places finite
_NO_CONTRAST = 1e-10  # likewise, of squares


@register(reach=12, symmetric=True)
def demosaic_rcd(image: Mosaic, *, cfa: Bayer = "RGGB") -> CameraRGB:
    """Interpolate green by ratios of a low-pass of the mosaic, and colours by weighted differences.

    A direction is told by the energy of a high-pass of seven samples along it against that across, or by the
    mean of the four diagonal neighbours where that is clearer. From each side green is
    `g_1 (1 + (l_0 - l_2) / (l_0 + l_2))`, l the mosaic smoothed by [1 2 1] both ways; the two sides of
    a direction are weighed by each other's gradients. Red and blue follow by differences from green, weighed
    likewise: on the opposite colour along the two diagonals, on green sites along rows and columns.

    Args:
        image: (H, W) mosaic, any range.
        cfa: colour filters of the top-left 2x2 cell, row by row.

    Returns:
        (H, W, 3) camera RGB that keeps the measured samples. Borders are reflected in phase.

    Raises:
        ValueError: cfa is not a Bayer pattern.

    Gradient: surrogate: directions, weights and ratios are held constant, exact in all else.

    Source: L. Sanz Rodriguez 2017, the description of Ratio Corrected Demosaicing 2.3.
    """
    check_bayer(cfa)
    at, still = sites(image.shape, cfa), lax.stop_gradient(image)
    by_rows = materialize(_lead(still, (_ROW, _COLUMN)))
    green = materialize(jnp.where(at.green, image, _green(image, still, by_rows)))
    held = lax.stop_gradient(green)
    known = materialize(jnp.where(at.green, 0, image - green))
    # beyond the border, as a mirror swaps the two diagonals
    around = _lead(pad(still, _MARGIN), (_FALLING, _RISING))
    falling = materialize(around[_MARGIN:-_MARGIN, _MARGIN:-_MARGIN])
    opposite = materialize(_between(still, known, held, (_FALLING, _RISING), falling))

    def everywhere(own: jax.Array) -> jax.Array:
        difference = materialize(jnp.where(own, known, opposite))
        color = held + lax.stop_gradient(difference)
        beside = _between(color, difference, held, (_ROW, _COLUMN), by_rows)
        return jnp.where(at.green, beside, difference)

    return interleaved([green + everywhere(at.red), green, green + everywhere(at.blue)])


def _along(direction: Offset, steps: Sequence[int]) -> list[Offset]:
    return [(k * direction[0], k * direction[1]) for k in steps]


def _seen(
    plane: jax.Array, directions: Sequence[Offset], steps: Sequence[int]
) -> list[tuple[jax.Array, ...]]:
    """For each direction the plane seen from each step along it."""
    found = neighbours(plane, [o for d in directions for o in _along(d, steps)])
    return [found[k * len(steps) : (k + 1) * len(steps)] for k in range(len(directions))]


# Of a mirror image all is the mirror image, to the bit: sums have their pairs first, and of two that are
# weighed one has a lead from -1 to 1, of which the sign alone changes where they are swapped.


def _mean(first: jax.Array, second: jax.Array, lead: jax.Array) -> jax.Array:
    """The first for a lead of 1, the second for one of -1. Give them stored: in a sum of two products one may
    be rounded less."""
    return 0.5 * ((first + second) + lead * (first - second))


def _lead(image: jax.Array, directions: Sequence[Offset]) -> jax.Array:
    """That of the first of two directions: the energy of the second less its own, over both.

    The energy is of the high-pass [1 -3 -1 6 -1 -3 1] along a direction, summed over three neighbours on it.
    Where the lead of the four diagonal neighbours is on average farther from 0, that is taken.
    """

    def energy(direction: Offset) -> jax.Array:
        far, away, near, near_too, away_too, far_too = _seen(image, [direction], (-3, -2, -1, 1, 2, 3))[0]
        high = 6 * image - (near + near_too) - 3 * (away + away_too) + (far + far_too)
        squared = materialize(high * high)
        return jnp.maximum(squared + paired_sum(_seen(squared, [direction], (-1, 1))[0]), _NO_CONTRAST)

    own, against = map(energy, directions)
    lead = materialize((against - own) / (against + own))
    around = 0.25 * paired_sum(neighbours(lead, DIAGONALS))
    return jnp.where(jnp.abs(lead) < jnp.abs(around), around, lead)


def _smoothed(plane: jax.Array) -> jax.Array:
    """By [1 2 1] / 4 along rows and along columns."""
    for direction in (_ROW, _COLUMN):
        plane = materialize(0.5 * plane + 0.25 * paired_sum(_seen(plane, [direction], (-1, 1))[0]))
    return plane


def _green(image: jax.Array, still: jax.Array, by_rows: jax.Array) -> jax.Array:
    """Green on red and blue sites."""
    low = _smoothed(still)
    ways = (_ROW, _COLUMN)
    sides = zip(_seen(still, ways, range(-4, 5)), _seen(image, ways, (-1, 1)), _seen(low, ways, (-2, 0, 2)))

    def of(samples: Sequence[jax.Array], near: Sequence[jax.Array], lows: Sequence[jax.Array]) -> jax.Array:
        def side(sign: int) -> tuple[jax.Array, jax.Array]:
            here, one, two, three, four = (samples[4 + sign * k] for k in range(5))
            gradient = jnp.abs(samples[3] - samples[5]) + jnp.abs(here - two)
            gradient = _TINY + gradient + jnp.abs(one - three) + jnp.abs(two - four)
            # between -1 and 1, as it is of positive samples
            ratio = jnp.clip((lows[1] - lows[1 + sign]) / _off_zero(lows[1] + lows[1 + sign]), -1, 1)
            return gradient, materialize(near[(sign + 1) // 2] * (1 + ratio))

        return _weighed(side(-1), side(1))

    rows, columns = (of(*own) for own in sides)
    return _mean(rows, columns, by_rows)


def _off_zero(x: jax.Array) -> jax.Array:
    return jnp.where(x < 0, x - _TINY, x + _TINY)


def _weighed(first: tuple[jax.Array, jax.Array], second: tuple[jax.Array, jax.Array]) -> jax.Array:
    """The mean of two (gradient, estimate), each weighed by the other's gradient."""
    (steep, one), (steep_too, other) = first, second
    return _mean(one, other, (steep_too - steep) / (steep + steep_too))


def _between(
    color: jax.Array, difference: jax.Array, green: jax.Array, ways: Sequence[Offset], lead: jax.Array
) -> jax.Array:
    """The differences one step to both sides, weighed by the gradients of the colour and of green.

    They are those along the first of two directions as far as it leads.
    """

    def of(colors: Sequence[jax.Array], greens: Sequence[jax.Array], near: Sequence[jax.Array]) -> jax.Array:
        def side(k: int) -> tuple[jax.Array, jax.Array]:
            beyond = jnp.abs(colors[1 + k] - colors[3 * k]) + jnp.abs(green - greens[k])
            return _TINY + jnp.abs(colors[1] - colors[2]) + beyond, near[k]

        return _weighed(side(0), side(1))

    seen = _seen(color, ways, (-3, -1, 1, 3)), _seen(green, ways, (-2, 2)), _seen(difference, ways, (-1, 1))
    first, second = materialize(tuple(of(*own) for own in zip(*seen)))
    return _mean(first, second, lead)
