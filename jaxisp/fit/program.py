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


def _each(render: Callable[..., Any], nothing: Any, wanted: jax.Array, *rows: Any) -> Any:
    """`render` of each row that is wanted, `nothing` of the others."""

    def one(row: Any) -> Any:
        return jax.lax.cond(row[0], lambda: render(*row[1:]), lambda: nothing)

    return jax.lax.map(one, (wanted, *rows))


class Rendered(NamedTuple):
    """Row 0 and one row a column: (K, N) residuals, (K, m) sums for the noise statistics, and the picture
    that the encoder gets, (T, TILE, TILE, 3): row 0 with chroma as it was before sampling."""

    residuals: jax.Array
    sums: jax.Array
    image: jax.Array


class _Steps(NamedTuple):
    """What one row of `vectors` (camera, image, geometry) does to the tiles of a chunk."""

    problem: Problem
    given: Given
    chunk: Chunk

    def params(self, vector: jax.Array) -> Params:
        layout = self.problem.layout
        camera, image, _ = jnp.split(vector, np.cumsum([layout.size(CAMERA), layout.size(IMAGE)]))
        return layout.params(self.given.fixed, camera, image)

    def lines(self, vector: jax.Array, at: jax.Array, optics: lens.Lens) -> tuple[list[jax.Array], Any]:
        moved = vector[-len(UNITS) :] * jnp.asarray(UNITS)
        return _places(at, self.given.geometry + moved, optics, self.chunk.corner)

    def warp(self, vector: jax.Array) -> jax.Array:
        optics, corner, bends = lens.Lens.of(self.params(vector)), self.chunk.corner, self.given.bends

        def tile(source: jax.Array, at: jax.Array) -> jax.Array:
            return _warped(source, at, self.lines(vector, at, optics)[0], optics, corner, bends)

        return jax.vmap(tile)(self.chunk.source, self.chunk.place)

    def denoise(self, vector: jax.Array, warped: jax.Array) -> jax.Array:
        """What is seen afterwards of the tiles."""
        values = self.params(vector)

        def tile(image: jax.Array, at: jax.Array) -> jax.Array:
            radius2 = self.lines(vector, at, lens.Lens.of(values))[1]
            return _front(self.problem.place, self.given.median, values, image, radius2)

        seen = slice(HALO - AFTER, AFTER - HALO)
        return jax.vmap(tile)(warped, self.chunk.place)[:, seen, seen]

    def finish(self, vector: jax.Array, denoised: jax.Array, sampled: jax.Array) -> tuple[jax.Array, ...]:
        values = self.params(vector)
        shares = jax.tree.map(lambda share: share * sampled, values[model.SAMPLING])
        tail = model.back(self.problem.place, self.problem.inserted)
        images = jax.vmap(lambda image: tail({**values, model.SAMPLING: shares}, image))(denoised)
        images = materialize(jnp.clip(images[:, AFTER:-AFTER, AFTER:-AFTER], 0, 1))  # as every file is
        return _residual(images, self.chunk).ravel(), _sums(images, self.chunk), images


def _renders(problem: Problem, given: Given, vectors: jax.Array, wanted: jax.Array, chunk: Chunk) -> Rendered:
    """The tiles rendered with each row of `vectors`, row 0 and one a column.

    Each step is done again only for the columns that change it, the others share that of row 0; rows that
    are not `wanted` are left out (zeros).
    """
    steps, count = _Steps(problem, given, chunk), len(vectors)
    warps, denoises = (np.asarray([0, *(1 + i for i in columns)]) for columns in problem.before)
    warped = _each(steps.warp, jnp.zeros((TILES, SIDE, SIDE, 3)), wanted[warps], vectors[warps])
    sources, side = _standing(warps, count)[denoises], TILE + 2 * AFTER
    denoised = _each(
        lambda vector, source: steps.denoise(vector, warped[source]),
        jnp.zeros((TILES, side, side, 3)), wanted[denoises], vectors[denoises], sources,
    )  # fmt: skip
    nothing = jnp.zeros(chunk.target.size), jnp.zeros(noise.SUMS), jnp.zeros(chunk.target.shape)

    def finish(image: jax.Array, row: Any) -> tuple[jax.Array, tuple[jax.Array, jax.Array]]:
        wanted, vector, source, sampled, shown = row
        residual, sums, own = jax.lax.cond(
            wanted, lambda: steps.finish(vector, denoised[source], sampled), lambda: nothing
        )
        return jnp.where(shown, own, image), (residual, sums)

    rows = np.append(np.arange(count), 0)  # the last is what the encoder gets
    needed, shown = (jnp.append(first, given.encodes) for first in (wanted, np.arange(count) == 0))
    sampled = np.append(np.ones(count, np.float32), np.float32(0))
    every = needed, vectors[rows], _standing(denoises, count)[rows], sampled, shown
    image, (residuals, sums) = jax.lax.scan(finish, nothing[-1], every)
    return Rendered(residuals[:-1], sums[:-1], image)


def _compressed(problem: Problem, given: Given, images: jax.Array) -> jax.Array:
    """The tiles, which lie on its grid, as the file's own encoder leaves them; unchanged where none does."""
    encoder = problem.encoder
    assert encoder is not None

    def encode(images: jax.Array) -> jax.Array:
        coded = jax.vmap(lambda image: encoder.apply(given.encoder, image, None))
        return jnp.clip(coded(jnp.round(images * 255) / 255), 0, 1)

    return jax.lax.cond(given.encodes, encode, lambda images: images, images)


def _standing(rows: np.ndarray, count: int) -> np.ndarray:
    """Where among `rows` each of `count` rows is; 0, the place of row 0, for those that are not there."""
    which = np.zeros(count, np.int32)
    which[rows] = np.arange(len(rows))
    return which


def _residual(render: jax.Array, chunk: Chunk) -> jax.Array:
    """(3, T, TILE, TILE) of luma and weighted chroma, 0 where the mask is."""
    y, cb, cr = rgb_to_ycbcr_planes(*planes(render - chunk.target))
    return jnp.stack([y, np.sqrt(CHROMA) * cb, np.sqrt(CHROMA) * cr]) * chunk.mask


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
    steps = problem.steps
    vectors = jnp.concatenate([vector[None], vector + jnp.diag(steps)])
    wanted = jnp.concatenate([jnp.ones(1, bool), given.moving])
    done = _renders(problem, given, vectors, wanted, chunk)
    residual, sums = done.residuals[0], done.sums[0]
    if problem.encoder is not None:
        compared = materialize(_compressed(problem, given, materialize(done.image)))
        residual, sums = _residual(compared, chunk).ravel(), _sums(compared, chunk)
    loss, weight = _robust(residual)
    share = (given.moving / steps)[:, None]
    jacobian = (done.residuals[1:] - done.residuals[0]) * share
    weighted = weight * residual

    def product(a: jax.Array, b: jax.Array) -> jax.Array:
        return jnp.matmul(a, b, precision=jax.lax.Precision.HIGHEST)

    def square(j: jax.Array) -> jax.Array:
        return product(j * weight, j.T)

    def by_colour(j: jax.Array) -> jax.Array:
        own = (j * weighted).reshape(len(j), 3, -1).sum(axis=1)
        return jax.ops.segment_sum(own.T, colour_cells(jnp, chunk.target).ravel(), COLOURS**3)

    return Normal(
        jax.lax.cond(given.moving.any(), square, lambda j: jnp.zeros((len(j), len(j))), jacobian),
        product(jacobian, weighted),
        jax.lax.cond(given.moving.any(), by_colour, lambda j: jnp.zeros((COLOURS**3, len(j))), jacobian),
        loss,
        chunk.mask.sum(),
        sums,
        (done.sums[1:] - done.sums[0]) * share,
        jacobian,
        product(near, weighted),
        done.image,
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
