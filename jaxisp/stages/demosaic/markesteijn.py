"""Markesteijn's demosaicking of X-Trans mosaics."""

from collections.abc import Iterable
from functools import partial, reduce
from typing import Annotated

import jax
import jax.numpy as jnp
from jax import lax

from jaxisp.arrays.barriers import materialize
from jaxisp.arrays.planes import interleaved
from jaxisp.arrays.stencils import square
from jaxisp.arrays.strips import in_strips_on_cpu
from jaxisp.cfa import XTRANS, XTrans, check_xtrans
from jaxisp.domains import CameraRGB, Mosaic
from jaxisp.options import Limit
from jaxisp.pipeline import register
from jaxisp.registry import LARGEST_CELL
from jaxisp.stages.demosaic.common import Planes
from jaxisp.stages.demosaic.homogeneity import lab
from jaxisp.stages.demosaic.lattice import (
    BESIDE,
    CORNERS,
    SOLITARY,
    Frame,
    Place,
    Stored,
    at,
    frame,
    join,
    red_and_blue,
    split,
    store,
)

LINES: tuple[Place, ...] = ((0, 1), (1, 0), (1, 1), (1, -1))
"""The directions of the four candidates: along rows, along columns, and the two diagonals."""
Passes = Annotated[int, Limit("1 or 3", lambda passes: passes in (1, 3))]
_JUDGED = 4  # px around a pixel on which the choice among its candidates depends


@register(reach=lambda o: _reach(o["passes"]), block=LARGEST_CELL)
def demosaic_markesteijn(
    image: Mosaic, *, cfa: XTrans = XTRANS, passes: Passes = 3, clipped: bool = True
) -> CameraRGB:
    """Interpolate X-Trans along four directions, and average the candidates that look most homogeneous.

    Green on red and blue, in each direction, is interpolated from the hexagon of six greens around such a
    pixel and from its own colour, and kept within the hexagon's range. Red and blue follow by differences
    from green: first on the greens that have no green beside them, then on each other's pixels, then on
    the 2x2 blocks of green. Each further pass finds green anew from the red and blue of the last.

    A candidate is homogeneous at a pixel where the second difference of Lab along its direction is at most 8
    times the least of all candidates. It counts over 3x3 and is summed over 5x5. Candidates whose
    sum is at least 7/8 of the largest are averaged. With three passes the four of the first pass compete
    too, each with its successor.

    Args:
        image: (H, W) mosaic of 6 x 6 pixels or more, any range, white balanced: it is taken for linear sRGB
            to find Lab.
        cfa: the 6x6 colour filters of X-Trans, row by row, in any phase.
        passes: 1, or 3: finer detail, in three times the time.
        clipped: keep interpolated red and blue in [0, 1], which makes less false colour. False takes
            samples of any range for what they are, as below black or above white.

    Returns:
        (H, W, 3) camera RGB that keeps the measured samples. Borders are mirrored in phase.

    Raises:
        ValueError: cfa is not X-Trans, the mosaic is smaller, or passes is neither 1 nor 3.

    Gradient: surrogate: the choice of candidates, and of directions within them, is held constant, exact in
    all else.

    Source: Markesteijn's algorithm, as in Coffin's dcraw 9.28 and LibRaw 0.22.
    """
    check_xtrans(cfa)
    if passes not in (1, 3):
        raise ValueError(f"demosaic_markesteijn: passes must be 1 or 3, got {passes}")
    if min(image.shape) < 6:
        raise ValueError(f"demosaic_markesteijn: takes 6 x 6 pixels or more, got {image.shape}")
    rgb = in_strips_on_cpu(partial(_demosaic, cfa, passes, clipped), image, _reach(passes), unit=LARGEST_CELL)
    return interleaved(rgb)


def _reach(passes: int) -> int:
    """How far from a pixel its result depends on the mosaic [px]."""
    return _JUDGED + {1: 8, 3: 22}[passes]


def _demosaic(cfa: str, passes: int, clipped: bool, image: jax.Array) -> Planes:
    on = frame((image.shape[0], image.shape[1]), cfa, _reach(passes))
    candidates = _candidates(split(image, on), on, passes, clipped)
    weights = lax.stop_gradient(_weights(candidates))
    inner = slice(_JUDGED, -_JUDGED)
    total = reduce(jnp.add, weights)

    def mean(color: jax.Array) -> jax.Array:
        return reduce(jnp.add, (w * plane for w, plane in zip(weights, color[:, inner, inner]))) / total

    red, green, blue = candidates
    return mean(red), mean(green), mean(blue)


def _candidates(mosaic: dict[Place, jax.Array], on: Frame, passes: int, clipped: bool) -> Planes:
    """Red, green and blue (candidates, H, W), with the margin that judging them takes."""
    stored = store(mosaic)
    ranges = materialize({place: _range(stored, place) for place in BESIDE})
    green = {place: plane[None] for place, plane in mosaic.items()}
    green |= {place: _first_green(stored, ranges[place], place) for place in BESIDE}
    differences = _differences(mosaic, store(green), clipped)
    found = [_colors(green, differences, on)]
    for _ in range(passes - 1):
        green |= {p: _next_green(mosaic, green, differences, ranges[p], p) for p in BESIDE}
        differences = _differences(mosaic, store(green), clipped)
    if passes > 1:
        found.append(_colors(green, differences, on))
    red, greens, blue = (jnp.concatenate(of) for of in zip(*found))
    return red, greens, blue


def _colors(green: dict[Place, jax.Array], differences: Stored, on: Frame) -> Planes:
    """The candidates' red, green and blue, (4, H, W), of green and the differences from it."""
    planes = {p: green[p][:, None] + d[..., 1:-1, 1:-1] for p, d in differences.planes.items()}
    red, blue = red_and_blue(planes, on)
    whole = {p: jnp.broadcast_to(g, (len(LINES), *g.shape[1:])) for p, g in green.items()}
    return join(red, on, _JUDGED), join(whole, on, _JUDGED), join(blue, on, _JUDGED)


def _along(*directions: Place) -> list[Place]:
    """Of these directions, for each candidate the one along its line, if need be turned round."""

    def crossed(a: Place, b: Place) -> int:
        return a[0] * b[1] - a[1] * b[0]

    return [next(d for d in directions if crossed(d, line) == 0) for line in LINES]


def _times(factor: int, offset: Place) -> Place:
    return factor * offset[0], factor * offset[1]


def _plus(a: Place, b: Place) -> Place:
    return a[0] + b[0], a[1] + b[1]


def _across(toward: Place) -> Place:
    return toward[1], toward[0]


def _steps(place: Place) -> tuple[Place, Place, Place, Place]:
    """From a red or blue place: to the other that touches it, at right angles, and aslant on that side."""
    toward, across = place, _across(place)
    return toward, across, _plus(toward, across), _plus(toward, _times(-1, across))


def _range(mosaic: Stored, place: Place) -> tuple[jax.Array, jax.Array]:
    """The least and the greatest of the hexagon of greens around a red or blue place."""
    toward, across, *aslant = _steps(place)
    hexagon = [across, _times(-1, across), _times(2, toward), _times(-1, toward), *aslant]
    greens = [at(mosaic, place, offset) for offset in hexagon]
    return reduce(jnp.minimum, greens), reduce(jnp.maximum, greens)


def _first_green(mosaic: Stored, within: tuple[jax.Array, jax.Array], place: Place) -> jax.Array:
    """(4, M, N) green of the candidates at a red or blue place."""
    toward, across, *aslant = _steps(place)

    def read(factor: int, step: Place) -> jax.Array:
        return at(mosaic, place, _times(factor, step))

    own = read(0, toward)

    def along(step: Place) -> jax.Array:
        if step == across:
            near, far = read(1, step) + read(-1, step), read(2, step) + read(-2, step)
            return (174 * near - 46 * far) / 256
        if step == toward:
            return (223 * read(-1, step) + 33 * read(2, step) + 92 * (own - read(-2, step))) / 256
        curve = (own - read(3, step)) + (own - read(-3, step))
        return (164 * read(1, step) + 92 * read(-2, step) + 33 * curve) / 256

    estimates = jnp.stack([along(step) for step in _along(toward, across, *aslant)])
    return jnp.clip(estimates, *(bound[None] for bound in within))


def _next_green(
    mosaic: dict[Place, jax.Array],
    green: dict[Place, jax.Array],
    differences: Stored,
    within: tuple[jax.Array, jax.Array],
    place: Place,
) -> jax.Array:
    """Green by the difference of the pixel's own colour from green on nearer pixels, all but one of green."""
    toward, across, *aslant = _steps(place)
    own = int(place[0] != 0)

    def estimate(i: int, step: Place) -> jax.Array:
        if step == across:
            return green[place][i]
        near, far = (
            at(differences, place, _times(factor, step), colored=True)[i, own]
            for factor in ((-1, 2) if step == toward else (1, -2))
        )
        return jnp.clip(mosaic[place] - (2 * near + far) / 3, *within)

    return jnp.stack([estimate(i, step) for i, step in enumerate(_along(toward, across, *aslant))])


def _differences(mosaic: dict[Place, jax.Array], green: Stored, clipped: bool) -> Stored:
    """Red and blue less green of the candidates, (4, 2, M, N) at every place."""

    def kept(differences: jax.Array, place: Place) -> jax.Array:
        own = jnp.expand_dims(at(green, place, (0, 0)), range(1, differences.ndim - 2))
        return jnp.clip(differences, -own, 1 - own) if clipped else differences

    inner = (..., slice(1, -1), slice(1, -1))
    known = store({place: mosaic[place][None] - green.planes[place][inner] for place in BESIDE})
    solitary = {SOLITARY: kept(_on_solitary(known, green), SOLITARY)}
    stored, both = store(solitary), {}
    for place in BESIDE:
        planes = [at(known, place, (0, 0)), kept(_on_beside(known, stored, green, place), place)]
        both[place] = jnp.stack(planes if place[0] == 0 else planes[::-1], 1)
    stored = store(both | solitary)
    return store(both | solitary | {place: kept(_on_corner(stored, place), place) for place in CORNERS})


def _on_solitary(known: Stored, green: Stored) -> jax.Array:
    """(4, 2, M, N): each colour from the two next pixels of it along the row, or along the column."""

    def along(step: Place) -> tuple[jax.Array, jax.Array]:
        values, error = [], jnp.zeros((), green.planes[SOLITARY].dtype)
        for distance in (1, 2):
            offsets = [_times(sign * distance, step) for sign in (1, -1)]
            ahead, behind = (at(known, SOLITARY, o) for o in offsets)
            greens = sum(at(green, SOLITARY, o) for o in offsets)
            values.append(0.5 * (ahead + behind))
            error += (ahead - behind) ** 2 + (2 * at(green, SOLITARY, (0, 0)) - greens) ** 2
        nearest = int(step[0] != 0)  # the colour of the neighbours
        return jnp.stack(values[::-1] if nearest else values, -3), lax.stop_gradient(error)

    (rows, by_rows), (columns, by_columns) = along((0, 1)), along((1, 0))
    takes_rows = jnp.stack(
        [jnp.ones_like(by_rows[0], bool), jnp.zeros_like(by_rows[0], bool), *(by_rows < by_columns)[2:]]
    )
    return jnp.where(takes_rows[:, None], rows, columns)


def _on_beside(known: Stored, solitary: Stored, green: Stored, place: Place) -> jax.Array:
    """(4, M, N): the colour that was not measured, from the pixel that touches and the solitary green
    opposite, or from the two three pixels off at right angles."""
    toward, across = place, _across(place)
    own = int(place[0] != 0)
    back = _times(-1, toward)
    touching = 0.5 * (at(known, place, toward) + at(solitary, place, back, colored=True)[:, 1 - own])
    remote = 0.5 * (at(known, place, _times(3, across)) + at(known, place, _times(-3, across)))
    centre = lax.stop_gradient(at(green, place, (0, 0)))

    def steep(*offsets: Place) -> jax.Array:
        return sum(jnp.abs(centre - lax.stop_gradient(at(green, place, o))) for o in offsets)  # type: ignore

    smooth = steep(toward, back) < 2 * steep(_times(3, across), _times(-3, across))
    return jnp.stack(
        [
            jnp.where(smooth[i], touching[i], remote[i]) if step == across else touching[i]
            for i, step in enumerate(_along(*_steps(place)))
        ]
    )


def _on_corner(stored: Stored, place: Place) -> jax.Array:
    """(4, 2, M, N): from the two pixels along the line, by distance: 2/3 and 1/3, or halves."""
    column, row = (-place[0], 0), (0, -place[1])
    in_, past = _plus(row, column), _plus(row, _times(-1, column))

    def along(i: int, step: Place) -> jax.Array:
        def read(factor: int) -> jax.Array:
            return at(stored, place, _times(factor, step), colored=True)[i]

        return 0.5 * (read(1) + read(-1)) if step == past else (2 * read(1) + read(-2)) / 3

    return jnp.stack([along(i, step) for i, step in enumerate(_along(column, row, in_, past))])


def _weights(candidates: Planes) -> jax.Array:
    """(candidates, H, W): 1 for those that are averaged, 0 for others."""
    planes = materialize(lab(lax.stop_gradient(candidates)))
    count = len(LINES)
    by_line = [_bend((p[i::count] for p in planes), line) for i, line in enumerate(LINES)]
    bends = materialize(jnp.concatenate([jnp.stack(each) for each in zip(*by_line)]))
    limit = 8 * reduce(jnp.minimum, bends[:, 1:-1, 1:-1])
    h, w = limit.shape
    near = [bends[:, 1 + y : 1 + y + h, 1 + x : 1 + x + w] <= limit[None] for y, x in square(1)]
    votes = materialize(reduce(jnp.add, [vote.astype(limit.dtype) for vote in near]))
    for axis in (1, 2):
        n = votes.shape[axis] - 4
        votes = materialize(reduce(jnp.add, [lax.slice_in_dim(votes, k, k + n, axis=axis) for k in range(5)]))
    if len(votes) > count:
        first, last = votes[:count], votes[count:]
        votes = jnp.concatenate([jnp.where(first < last, 0, first), jnp.where(first > last, 0, last)])
    most = reduce(jnp.maximum, votes)[None]
    return (votes >= most - jnp.floor(most / 8)).astype(votes.dtype)


def _bend(planes: Iterable[jax.Array], line: Place) -> jax.Array:
    """The squared second difference of Lab along a line: of lightness, and of the ratios X and Z to white
    less half of Y's.

    Args:
        planes: L, a and b, (N, H, W) each.
        line: the direction [px].
    """

    def second(plane: jax.Array) -> jax.Array:
        h, w = plane.shape[1] - 2, plane.shape[2] - 2
        centre, ahead, behind = (
            plane[:, 1 + y : 1 + y + h, 1 + x : 1 + x + w] for y, x in ((0, 0), line, _times(-1, line))
        )
        return 2 * centre - ahead - behind

    light, a, b = map(second, planes)
    return light**2 + (a + 500 / 232 * light) ** 2 + (b - 500 / 580 * light) ** 2
