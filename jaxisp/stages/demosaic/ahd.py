"""Hirakawa & Parks's adaptive homogeneity-directed demosaicking."""

from functools import partial
from typing import Annotated, NamedTuple

import jax
import jax.numpy as jnp

from jaxisp.arrays.barriers import materialize
from jaxisp.arrays.planes import interleaved, planes
from jaxisp.arrays.stencils import pad
from jaxisp.arrays.strips import in_strips_on_cpu
from jaxisp.cfa import Bayer, check_bayer
from jaxisp.domains import CameraRGB, Mosaic
from jaxisp.options import Count, Positive, one_of
from jaxisp.pipeline import register
from jaxisp.stages.demosaic.common import (
    Pair,
    Planes,
    Sites,
    clamped_greens,
    collect_clamped_greens,
    collect_differences,
    collect_greens,
    directional_greens,
    sites,
    spread_differences,
)
from jaxisp.stages.demosaic.homogeneity import homogeneity_lead
from jaxisp.stages.demosaic.linear import mirrored, piecewise_linear
from jaxisp.stages.demosaic.median import smooth_differences

Variant = Annotated[str, one_of("paper", "libraw")]


@register(reach=lambda o: _reach(o["delta"]) + 2 * o["median_passes"], symmetric=True)
def demosaic_ahd(
    image: Mosaic,
    *,
    cfa: Bayer = "RGGB",
    delta: Positive = 2,
    median_passes: Count = 0,
    variant: Variant = "paper",
) -> CameraRGB:
    """Interpolate along rows and along columns, and keep at each pixel the one that looks more homogeneous.

    Homogeneity is the number of pixels p within `delta` for which `|L(p) - L| <= eps_L` and
    `(a(p) - a)**2 + (b(p) - b)**2 <= eps_C**2` in CIELAB, averaged over 3x3. The tolerances adapt:
    the largest difference to the two neighbours along the candidate's own direction, the smaller of
    the two candidates'. Rows win where their count is greater. Median passes as in
    `color_difference_median` follow.

    Args:
        image: (H, W) mosaic, any range, white balanced: it is taken for linear sRGB to find Lab.
        cfa: colour filters of the top-left 2x2 cell, row by row.
        delta: radius of the ball in which homogeneity is counted [px].
        median_passes: passes of the colour-difference median; 0 keeps the measured samples, the paper
            takes a few: less false colour, at some cost to fine detail.
        variant: "paper", or "libraw": green is kept between its two neighbours along the direction, the
            candidates' red and blue are clipped to [0, 1], and the candidates are averaged where they
            are equally homogeneous. LibRaw has `delta` 1.

    Returns:
        (H, W, 3) camera RGB. Borders are reflected in phase.

    Raises:
        ValueError: cfa is not a Bayer pattern, delta is below 1, median_passes negative or variant unknown.

    Gradient: surrogate: the choice of direction is held constant (and LibRaw's of a neighbour), exact in
    all else.

    Source: Hirakawa & Parks 2005, with the green filter [-1, 2, 2, 2, -1] / 4; the variant: Coffin's
    dcraw, as LibRaw 0.22 has it.
    """
    check_bayer(cfa)
    if delta < 1:
        raise ValueError(f"demosaic_ahd: delta must be 1 or more, got {delta}")
    if variant not in ("paper", "libraw"):
        raise ValueError(f"demosaic_ahd: variant {variant!r} is neither 'paper' nor 'libraw'")
    how = _Options(cfa, delta, variant == "libraw", axis=0 if median_passes else -1)
    forward = partial(_decided, how)
    adjoint = mirrored(forward, partial(_collect, how), image.shape, how.axis)
    picture = piecewise_linear(partial(_evaluate, how), forward, adjoint)(image)
    if not median_passes:
        return picture
    red, green, blue = picture
    return interleaved(smooth_differences((red, green, blue), median_passes))


def _reach(delta: int) -> int:
    """How far from a pixel the choice between the candidates depends on the mosaic [px]."""
    return 4 + delta


class _Options(NamedTuple):
    cfa: str
    delta: int
    libraw: bool
    axis: int  # of the colours in the picture


def _evaluate(how: _Options, image: jax.Array) -> tuple[jax.Array, tuple[jax.Array, ...]]:
    """The picture, and the decisions: the share of the candidate along rows, then LibRaw's."""
    rgb, decisions = in_strips_on_cpu(partial(_chosen, how), image, _reach(how.delta))
    return _joined(how, rgb), decisions


def _chosen(how: _Options, image: jax.Array) -> tuple[Planes, tuple[jax.Array, ...]]:
    at = sites(image.shape, how.cfa)
    if how.libraw:
        greens, choices = materialize(clamped_greens(at, image))
    else:
        greens, choices = materialize(directional_greens(at, image)), ()
    rows, columns = (materialize(_candidate(at, image, green)) for green in greens)
    within = ()
    if how.libraw:
        red_and_blue = (rows[0], rows[2], columns[0], columns[2])
        within = tuple((plane >= 0) & (plane <= 1) for plane in red_and_blue)
        rows, columns = materialize((_clipped(rows), _clipped(columns)))
    lead = homogeneity_lead(rows, columns, how.delta)
    on_tie = 0.5 if how.libraw else 0.0
    share = jnp.where(lead > 0, 1.0, jnp.where(lead < 0, 0.0, on_tie)).astype(image.dtype)
    return _blend(how, share, rows, columns), (share, *choices, *within)


def _decided(how: _Options, share: jax.Array, *rest: jax.Array) -> jax.Array:
    """The derivative, with all decisions given: linear in the tangent, which comes last."""
    *decisions, image = rest
    at = sites(image.shape, how.cfa)
    if how.libraw:
        greens, _ = clamped_greens(at, image, (decisions[0], decisions[1]))
    else:
        greens = directional_greens(at, image)
    rows, columns = (materialize(_candidate(at, image, green)) for green in materialize(greens))
    if how.libraw:
        rows, columns = _masked(rows, *decisions[2:4]), _masked(columns, *decisions[4:6])
    return _joined(how, _blend(how, share, rows, columns))


def _joined(how: _Options, rgb: Planes) -> jax.Array:
    return jnp.stack(rgb) if how.axis == 0 else interleaved(rgb)


def _candidate(at: Sites, mosaic: jax.Array, green: jax.Array) -> Planes:
    red_green, blue_green = spread_differences(at, pad(mosaic - green, 1))
    return green + red_green, green, green + blue_green


def _clipped(rgb: Planes) -> Planes:
    return jnp.clip(rgb[0], 0, 1), rgb[1], jnp.clip(rgb[2], 0, 1)


def _masked(rgb: Planes, red_within: jax.Array, blue_within: jax.Array) -> Planes:
    return jnp.where(red_within, rgb[0], 0), rgb[1], jnp.where(blue_within, rgb[2], 0)


def _blend(how: _Options, share: jax.Array, rows: Planes, columns: Planes) -> Planes:
    def of(row: jax.Array, column: jax.Array) -> jax.Array:
        other = jnp.where(share == 0, column, 0.5 * (row + column)) if how.libraw else column
        return jnp.where(share == 1, row, other)

    return of(rows[0], columns[0]), of(rows[1], columns[1]), of(rows[2], columns[2])


def _collect(how: _Options, share: jax.Array, *rest: jax.Array) -> jax.Array:
    """The adjoint of `_decided`; the cotangent comes last."""
    *decisions, cotangent = rest
    at = sites(share.shape, how.cfa)
    rgb = materialize(tuple(cotangent) if how.axis == 0 else planes(cotangent))
    rows: Planes = tuple(share * p for p in rgb)
    columns: Planes = tuple((1 - share) * p for p in rgb)
    if how.libraw:
        rows, columns = _masked(rows, *decisions[2:4]), _masked(columns, *decisions[4:6])
    by_rows, by_columns = (materialize(collect_differences(at, c[0], c[2])) for c in (rows, columns))
    total_rows, total_columns = sum(rows), sum(columns)
    to_greens: Pair = materialize(
        (jnp.where(at.green, 0, total_rows - by_rows), jnp.where(at.green, 0, total_columns - by_columns))
    )
    if how.libraw:
        collected = collect_clamped_greens(at, to_greens, (decisions[0], decisions[1]))
    else:
        collected = collect_greens(at, *to_greens)
    return jnp.where(at.green, total_rows + total_columns, by_rows + by_columns) + collected
