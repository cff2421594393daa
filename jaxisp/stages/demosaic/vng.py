"""Variable number of gradients: colours averaged over the directions in which the picture is smooth."""

from functools import partial, reduce

import jax
import jax.numpy as jnp

from jaxisp.arrays.barriers import materialize
from jaxisp.arrays.planes import interleaved, planes
from jaxisp.arrays.stencils import pad, views
from jaxisp.cfa import Bayer, check_bayer
from jaxisp.domains import CameraRGB, Mosaic
from jaxisp.pipeline import register
from jaxisp.stages.demosaic.common import Pair, Sites, sites
from jaxisp.stages.demosaic.linear import piecewise_linear

Offset = tuple[int, int]
_STRAIGHT: list[Offset] = [(-1, 0), (1, 0), (0, -1), (0, 1)]
_DIAGONAL: list[Offset] = [(-1, -1), (-1, 1), (1, -1), (1, 1)]


@register(reach=2, symmetric=True)
def demosaic_vng(image: Mosaic, *, cfa: Bayer = "RGGB") -> CameraRGB:
    """Take colour differences from those of eight directions whose gradients are small.

    A direction's gradient is a sum of absolute differences of like samples in the 5x5 window; those count
    that are at most `min + max / 2` of the eight. `C = x + sum(C_d - X_d) / n` over them, where `C_d` is
    the mean of a missing colour and `X_d` that of the pixel's own colour on that side.

    Args:
        image: (H, W) mosaic, any range.
        cfa: colour filters of the top-left 2x2 cell, row by row.

    Returns:
        (H, W, 3) camera RGB that keeps the measured samples. Borders are reflected in phase.

    Raises:
        ValueError: cfa is not a Bayer pattern.

    Gradient: surrogate: the choice of directions is held constant, exact in all else.

    Source: Chang, Cheung & Pang 1999, with the threshold that converters use (theirs is
    `1.5 min + 0.5 (min + max)`).
    """
    check_bayer(cfa)
    forward = partial(_with_weights, cfa)
    return piecewise_linear(partial(_evaluate, cfa), forward, partial(_collected, cfa))(image)


def _evaluate(cfa: str, image: jax.Array) -> tuple[jax.Array, tuple[jax.Array, ...]]:
    """The picture, and each direction's weight: 1 / n of those that count, or 0."""
    gradients = materialize(_gradients(sites(image.shape, cfa), pad(image, 2)))
    limit = reduce(jnp.minimum, gradients) + 0.5 * reduce(jnp.maximum, gradients)
    chosen = [(g <= limit).astype(image.dtype) for g in gradients]
    share = 1 / reduce(jnp.add, chosen)
    weights = materialize(tuple(c * share for c in chosen))
    return _with_weights(cfa, *weights, image), weights


def _gradients(at: Sites, padded: jax.Array) -> tuple[jax.Array, ...]:
    def change(a: Offset, b: Offset) -> jax.Array:
        first, second = views(padded, [a, b], 2)
        return jnp.abs(first - second)

    def straight(dy: int, dx: int) -> jax.Array:
        sides = [
            0.5 * (change((dy + s * dx, dx + s * dy), (-dy + s * dx, -dx + s * dy))
                   + change((2 * dy + s * dx, 2 * dx + s * dy), (s * dx, s * dy)))
            for s in (-1, 1)
        ]  # fmt: skip
        return change((dy, dx), (-dy, -dx)) + change((2 * dy, 2 * dx), (0, 0)) + sum(sides)

    def diagonal(dy: int, dx: int) -> jax.Array:
        near = 0.5 * (change((dy, 0), (0, -dx)) + change((0, dx), (-dy, 0)))
        far = 0.5 * (change((2 * dy, dx), (dy, 0)) + change((dy, 2 * dx), (0, dx)))
        on_green = change((2 * dy, dx), (0, -dx)) + change((dy, 2 * dx), (-dy, 0))
        both = change((dy, dx), (-dy, -dx)) + change((2 * dy, 2 * dx), (0, 0))
        return both + jnp.where(at.green, on_green, near + far)

    return (*(straight(*d) for d in _STRAIGHT), *(diagonal(*d) for d in _DIAGONAL))


def _with_weights(cfa: str, *args: jax.Array) -> jax.Array:
    *weights, image = args
    at, padded = sites(image.shape, cfa), pad(image, 2)
    # on green sites "first" is the colour of the row and "second" the column's; elsewhere green and the other
    first, second = jnp.zeros_like(image), jnp.zeros_like(image)
    for weight, offset in zip(weights, _STRAIGHT + _DIAGONAL, strict=True):
        means = _straight_means if 0 in offset else _diagonal_means
        own, one, other = means(at, padded, *offset)
        first, second = materialize((first + weight * (one - own), second + weight * (other - own)))
    first, second = image + first, image + second
    green = jnp.where(at.green, image, first)
    red = jnp.where(at.red, image, jnp.where(at.green & at.red_row, first, second))
    blue = jnp.where(at.blue, image, jnp.where(at.green & ~at.red_row, first, second))
    return interleaved([red, green, blue])


def _mean(padded: jax.Array, offsets: list[Offset]) -> jax.Array:
    return reduce(jnp.add, views(padded, offsets, 2)) / len(offsets)


def _straight_offsets(dy: int, dx: int) -> tuple[list[Offset], ...]:
    """Where the own colour is on that side, the nearest, the green beside it and the opposite colour."""
    beside = [(k * dy + s * dx, k * dx + s * dy) for k in (0, 2) for s in (-1, 1)]
    return [(0, 0), (2 * dy, 2 * dx)], [(dy, dx)], beside, [(dy + dx, dx + dy), (dy - dx, dx - dy)]


def _straight_means(at: Sites, padded: jax.Array, dy: int, dx: int) -> tuple[jax.Array, ...]:
    own, near, around, opposite = (_mean(padded, offsets) for offsets in _straight_offsets(dy, dx))
    first, second = (near, around) if dy == 0 else (around, near)
    return own, jnp.where(at.green, first, near), jnp.where(at.green, second, opposite)


def _diagonal_offsets(dy: int, dx: int) -> tuple[list[Offset], ...]:
    """Where the own colour is, the next photosite, and of those between the ones in rows and in columns."""
    return [(0, 0), (2 * dy, 2 * dx)], [(dy, dx)], [(0, dx), (2 * dy, dx)], [(dy, 0), (dy, 2 * dx)]


def _diagonal_means(at: Sites, padded: jax.Array, dy: int, dx: int) -> tuple[jax.Array, ...]:
    far, near, rows, columns = _diagonal_offsets(dy, dx)
    next_to, greens = _mean(padded, near), _mean(padded, rows + columns)
    own = jnp.where(at.green, next_to, _mean(padded, far))
    in_row, in_column = _mean(padded, rows), _mean(padded, columns)
    return own, jnp.where(at.green, in_row, greens), jnp.where(at.green, in_column, next_to)


def _collected(cfa: str, *args: jax.Array) -> jax.Array:
    """The adjoint of `_with_weights`: a photosite collects from the pixels in whose means it is."""
    *weights, cotangent = args
    height, width = cotangent.shape[:2]
    at, (red, green, blue) = sites((height, width), cfa), planes(cotangent)
    of_row, of_column = jnp.where(at.red_row, red, blue), jnp.where(at.red_row, blue, red)
    first, second = jnp.where(at.green, of_row, green), jnp.where(at.green | at.red, of_column, red)
    # a border of two photosites stands before the frame: the pattern goes on in it
    wide = jnp.zeros((height + 4, width + 4), cotangent.dtype)
    on_green = sites(wide.shape, cfa).green
    for weight, offset in zip(weights, _STRAIGHT + _DIAGONAL, strict=True):
        collect = _from_straight if 0 in offset else _from_diagonal
        own, one, other = (
            pad(materialize(weight * v), 4, "constant") for v in (first + second, first, second)
        )
        wide = materialize(wide + jnp.where(on_green, *collect(own, one, other, *offset)))
    back = jax.linear_transpose(
        lambda image: pad(image, 2), jax.ShapeDtypeStruct((height, width), wide.dtype)
    )
    return red + green + blue + back(wide)[0]


def _back(offsets: list[Offset]) -> list[Offset]:
    return [(-dy, -dx) for dy, dx in offsets]


def _from_straight(own: jax.Array, first: jax.Array, second: jax.Array, dy: int, dx: int) -> Pair:
    """What green and other photosites get from cotangents of the means, one direction's."""
    far, near, beside, opposite = map(_back, _straight_offsets(dy, dx))
    in_line, across = (first, second) if dy == 0 else (second, first)
    others = _mean(in_line, near) + _mean(across, beside) + _mean(second, opposite)
    return _mean(first, near) - _mean(own, far), others - _mean(own, far)


def _from_diagonal(own: jax.Array, first: jax.Array, second: jax.Array, dy: int, dx: int) -> Pair:
    far, near, rows, columns = map(_back, _diagonal_offsets(dy, dx))
    others = _mean(second, near) + _mean(first, rows) + _mean(second, columns)
    return _mean(first, rows + columns) - _mean(own, near), others - _mean(own, far)
