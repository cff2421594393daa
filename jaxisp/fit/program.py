"""What runs on the device: tiles rendered with many parameter vectors at once, and their normal equations.

Derivatives are forward differences. `jax.jacfwd` goes through the same chain and is more exact, but runs 1.4
times as long and compiles four times as long (`experiments.fit_derivatives`); differences also see through
rounding, medians and choices. Reading the tiles and denoising are done again only for the parameters before
or in them; the others start from what they gave. What is switched off (the lens, until it shows; a median
that is not there) is not rendered.
"""

import functools
from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax.flatten_util import ravel_pytree

from jaxisp.arrays.barriers import materialize
from jaxisp.arrays.planes import planes
from jaxisp.color import rgb_to_ycbcr_planes
from jaxisp.fit import lens, model, noise
from jaxisp.fit.problem import UNITS, Given, Normal, Problem
from jaxisp.fit.sampling import sample
from jaxisp.fit.sharing import CAMERA, IMAGE, as_arrays
from jaxisp.fit.tiles import HALO, SIDE, TILE, TILES, Chunk, no_chunk
from jaxisp.pipeline import Chain, Params, stage
from jaxisp.stages.optics.light import radial_gain

AFTER = 8  # px of the halo that are seen after denoising: unsharp mask 6, chroma sampling 2
ROBUST = 0.02  # level; larger residuals count less than by their square
COLOURS = 8  # steps of each channel of the cells that `Normal.scores` are of
CHROMA = 0.5  # weight of a squared error of Cb or Cr against one of luma


def _places(at: Any, geometry: jax.Array, optics: lens.Lens, corner: Any) -> tuple[list[jax.Array], Any]:
    """Rows and columns of a tile from the RAW's centre, before the lens, and its pixels' squared radius.

    at: of `Chunk.place`; geometry: shift [px] and scale, each in y and x.
    """
    index = jnp.arange(SIDE, dtype=jnp.float32)
    lines = [geometry[2 + a] * (at[a] + index) + geometry[a] for a in range(2)]
    y, x = optics.bent(lines[0][:, None], lines[1][None], corner)
    return lines, (y * y + x * x) / corner


def _warped(source: jax.Array, at: jax.Array, lines: Any, optics: lens.Lens, corner: Any, bends: Any) -> Any:
    """(SIDE, SIDE, 3) camera RGB under one tile of the picture."""

    def straight() -> jax.Array:
        return sample(jnp, sample(jnp, source, lines[0] - at[2], 0), lines[1] - at[3], 1)

    def bent() -> jax.Array:
        return lens.warped(source, optics, lines[0], lines[1], at[2:], corner)

    return jax.lax.cond(bends, bent, straight)


def _front(place: str, median: Any, params: Params, warped: jax.Array, radius2: jax.Array) -> jax.Array:
    """Vignetting and `model.front`; `median` is the index of its footprint in `model.MEDIANS`."""
    shading = params["vignetting"]
    gain = radial_gain(radius2, shading.a2, shading.a4, shading.a6)
    before, after = model.around_median(place)
    filters = [stage("median", footprint=size) if size else Chain((), "no median") for size in model.MEDIANS]
    image = materialize(before(params, warped * gain[..., None]))
    branches = [functools.partial(node.apply, params, key=None) for node in filters]
    image = jax.lax.switch(median, branches, image)
    return after(params, materialize(image))


class At(NamedTuple):
    """A place: bounded parameters, and how far the geometry is from the alignment's, in `UNITS`."""

    params: Params
    moved: jax.Array


class _Steps(NamedTuple):
    """What a place does to the tiles of a chunk."""

    problem: Problem
    given: Given
    chunk: Chunk

    def at(self, vector: jax.Array) -> At:
        """The place of a vector: camera, image, geometry."""
        layout = self.problem.layout
        camera, image, moved = jnp.split(vector, np.cumsum([layout.size(CAMERA), layout.size(IMAGE)]))
        return At(layout.params(self.given.fixed, camera, image), moved)

    def lines(self, at: At, place: jax.Array, optics: lens.Lens) -> tuple[list[jax.Array], Any]:
        geometry = self.given.geometry + at.moved * jnp.asarray(UNITS, at.moved.dtype)
        return _places(place, geometry, optics, self.chunk.corner)

    def warp(self, at: At) -> jax.Array:
        optics, corner, bends = lens.Lens.of(at.params), self.chunk.corner, self.given.bends

        def tile(source: jax.Array, place: jax.Array) -> jax.Array:
            return _warped(source, place, self.lines(at, place, optics)[0], optics, corner, bends)

        return jax.vmap(tile)(self.chunk.source, self.chunk.place)

    def denoise(self, at: At, warped: jax.Array) -> jax.Array:
        """What is seen afterwards of the tiles."""

        def tile(image: jax.Array, place: jax.Array) -> jax.Array:
            radius2 = self.lines(at, place, lens.Lens.of(at.params))[1]
            return _front(self.problem.place, self.given.median, at.params, image, radius2)

        seen = slice(HALO - AFTER, AFTER - HALO)
        return jax.vmap(tile)(warped, self.chunk.place)[:, seen, seen]

    def finish(self, at: At, denoised: jax.Array, sampled: Any) -> "Seen":
        shares = jax.tree.map(lambda share: share * sampled, at.params[model.SAMPLING])
        tail = model.back(self.problem.place, self.problem.inserted)
        images = jax.vmap(lambda image: tail({**at.params, model.SAMPLING: shares}, image))(denoised)
        images = materialize(jnp.clip(images[:, AFTER:-AFTER, AFTER:-AFTER], 0, 1))  # as every file is
        return Seen(_residual(images, self.chunk).ravel(), _sums(images, self.chunk), images)


class Seen(NamedTuple):
    """Of tiles: (N,) residuals, (m,) sums for the noise statistics, and (T, TILE, TILE, 3) the picture."""

    residual: jax.Array
    sums: jax.Array
    image: jax.Array


class Rendered(NamedTuple):
    """The tiles at a place, their picture as the encoder gets it, which is with chroma as it was before
    sampling, and (columns, N) and (columns, m) the slopes of residuals and sums, 0 where nothing moves."""

    seen: Seen
    jacobian: jax.Array
    slopes: jax.Array


class _Turn(NamedTuple):
    """A loop over places: which is next, and what was found. Of `warped` and `denoised` there are two each:
    that of row 0 and that of the last row with its own."""

    row: jax.Array
    warped: jax.Array
    denoised: jax.Array
    found: Rendered


def rendered(problem: Problem, given: Given, vector: jax.Array, chunk: Chunk) -> Rendered:
    """The tiles at `vector` and, for each column that moves, a step beside it.

    Row 0 is `vector`, row 1 + i a step along column i. Each step of the pipeline is done again only for the
    rows that change it, the others share that of row 0. Rows of columns that do not move are not visited.
    For the encoder row -1 is row 0 without sampling.
    """
    steps, size = _Steps(problem, given, chunk), problem.steps
    vectors = jnp.concatenate([vector[None], vector[None] + jnp.diag(size)])
    unflat = ravel_pytree(steps.at(vector))[1]
    places = materialize(jax.vmap(lambda v: ravel_pytree(steps.at(v))[0])(vectors))
    count, first = len(size), -given.encodes.astype(jnp.int32)
    warps, denoises = (jnp.asarray(np.isin(np.arange(count + 1) - 1, which)) for which in problem.before)

    def turn(now: _Turn) -> _Turn:
        row, begins = jnp.maximum(now.row, 0), now.row == first
        at = unflat(places[row])
        reads, smooths = (which[row].astype(jnp.int32) for which in (warps, denoises))
        warped = _put(begins | warps[row], now.warped, reads, lambda: steps.warp(at))
        denoised = _put(
            begins | denoises[row], now.denoised, smooths, lambda: steps.denoise(at, warped[reads])
        )
        new, old = steps.finish(at, denoised[smooths], jnp.where(now.row < 0, 0.0, 1.0)), now.found
        seen = Seen(
            jnp.where(now.row <= 0, new.residual, old.seen.residual),
            jnp.where(now.row <= 0, new.sums, old.seen.sums),
            jnp.where(begins, new.image, old.seen.image),
        )
        column = jnp.maximum(now.row - 1, 0)  # of row 0 it gets zeros, until it is that one's turn
        jacobian, slopes = (
            jax.lax.dynamic_update_index_in_dim(a, (b - c) / jnp.asarray(size)[column], column, 0)
            for a, b, c in (
                (old.jacobian, new.residual, seen.residual),
                (old.slopes, new.sums, seen.sums),
            )
        )
        index = jnp.arange(count, dtype=jnp.int32)
        following = jnp.min(jnp.where(given.moving & (index >= now.row), index, count)) + 1
        return _Turn(
            jnp.where(now.row < 0, 0, following),
            warped,
            denoised,
            Rendered(seen, jacobian, slopes),
        )

    side = TILE + 2 * AFTER
    zeros = functools.partial(jnp.zeros, dtype=vector.dtype)  # else float64 with double precision enabled
    nothing = Rendered(
        Seen(zeros(chunk.target.size), zeros(noise.SUMS), zeros(chunk.target.shape)),
        zeros(jacobian_shape(problem)),
        zeros((count, noise.SUMS)),
    )
    warped, denoised = (zeros((2, TILES, n, n, 3)) for n in (SIDE, side))
    start = _Turn(first, warped, denoised, nothing)
    return jax.lax.while_loop(lambda now: now.row <= count, turn, start).found


def _put(wanted: jax.Array, pair: jax.Array, index: jax.Array, make: Callable[[], jax.Array]) -> jax.Array:
    """The pair with what `make` gives at an index, where that is wanted.

    A loop of at most one turn changes it in place; a branch would copy it.
    """

    def turn(now: tuple[jax.Array, jax.Array]) -> tuple[jax.Array, jax.Array]:
        return jnp.asarray(False), jax.lax.dynamic_update_index_in_dim(now[1], make(), index, 0)

    return jax.lax.while_loop(lambda now: now[0], turn, (wanted, pair))[1]


def _compressed(problem: Problem, given: Given, images: jax.Array) -> jax.Array:
    """The tiles, which lie on its grid, as the file's own encoder leaves them; unchanged where none does."""
    encoder = problem.encoder
    assert encoder is not None

    def encode(images: jax.Array) -> jax.Array:
        coded = jax.vmap(lambda image: encoder.apply(given.encoder, image, None))
        return jnp.clip(coded(jnp.round(images * 255) / 255), 0, 1)

    return jax.lax.cond(given.encodes, encode, lambda images: images, images)


def _residual(render: jax.Array, chunk: Chunk) -> jax.Array:
    """(3, T, TILE, TILE) of luma and weighted chroma, 0 where the mask is."""
    y, cb, cr = rgb_to_ycbcr_planes(*planes(render - chunk.target))
    root = float(np.sqrt(CHROMA))
    return jnp.stack([y, root * cb, root * cr]) * chunk.mask[None]


def _robust(residual: jax.Array) -> tuple[jax.Array, jax.Array]:
    """The sum of the robust loss, and the weight of each squared residual."""
    root = jnp.sqrt(1 + (residual / ROBUST) ** 2)
    return (residual**2 * 2 / (1 + root)).sum(), 1 / root


def _sums(render: jax.Array, chunk: Chunk) -> jax.Array:
    moments = functools.partial(noise.moments, xp=jnp)
    return jax.vmap(moments)(render, chunk.flat, chunk.edges).sum(0)


@functools.partial(jax.jit, static_argnums=0)
def normal_equations(problem: Problem, given: Given, vector: jax.Array, chunk: Chunk, near: Any) -> Normal:
    """The normal equations of one chunk at `vector`, which is (camera, image, geometry).

    Where nothing moves it is one render; `near` is a Jacobian from a place nearby, or zeros. Derivatives
    are those before the encoder: what it rounds away in one pixel it adds in another.
    """
    (residual, sums, image), jacobian, slopes = rendered(problem, given, vector, chunk)
    if problem.encoder is not None:
        compared = materialize(_compressed(problem, given, materialize(image)))
        residual, sums = _residual(compared, chunk).ravel(), _sums(compared, chunk)
    loss, weight = _robust(residual)
    weighted = weight * residual

    def product(a: jax.Array, b: jax.Array) -> jax.Array:
        return jnp.matmul(a, b, precision=jax.lax.Precision.HIGHEST)

    def normal(j: jax.Array) -> tuple[jax.Array, jax.Array, jax.Array]:
        own = (j * weighted[None]).reshape(len(j), 3, -1).sum(axis=1)
        scores = jax.ops.segment_sum(own.T, colour_cells(jnp, chunk.target).ravel(), COLOURS**3)
        return product(j * weight[None], j.T), product(j, weighted), scores

    count = len(jacobian)
    zeros = functools.partial(jnp.zeros, dtype=jacobian.dtype)
    nothing = zeros((count, count)), zeros(count), zeros((COLOURS**3, count))
    matrix, vector, scores = jax.lax.cond(given.moving.any(), normal, lambda j: nothing, jacobian)
    return Normal(
        matrix,
        vector,
        scores,
        loss,
        chunk.mask.sum(),
        sums,
        slopes,
        jacobian,
        product(near, weighted),
        image,
    )


def colour_cells(xp: Any, target: Any) -> Any:
    """(...) which of COLOURS**3 cells of colour the pixels of (..., 3) pictures are in; `xp` is numpy or
    jax.numpy."""
    steps = xp.clip((target * COLOURS).astype(int), 0, COLOURS - 1)
    return (steps[..., 0] * COLOURS + steps[..., 1]) * COLOURS + steps[..., 2]


def jacobian_shape(problem: Problem) -> tuple[int, int]:
    """Of `Normal.jacobian`."""
    return len(problem.columns), 3 * TILES * TILE * TILE


def on_nothing(problem: Problem) -> tuple[Given, np.ndarray, Chunk]:
    """Arguments for `normal_equations` with which it can be compiled."""
    start, columns = as_arrays(model.start(problem.inserted)), len(problem.columns)
    moving, still = np.zeros(columns, bool), np.asarray([0, 0, 1, 1], np.float32)
    no, encoder = np.bool_(False), problem.encoder.init() if problem.encoder else {}
    given = Given(start, np.int32(0), still, no, no, encoder, moving)
    return given, np.zeros(columns, np.float32), no_chunk()
