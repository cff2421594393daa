"""What runs on the device: tiles rendered with many parameter vectors at once, and their normal equations.

Derivatives are forward differences. The neighbourhood stages have reverse-mode rules only, and a
Jacobian with one column a parameter needs the other direction; it also costs less to compile, and
sees through rounding, medians and choices. Denoising is rendered again only for the parameters
before or in it; the others start from what it gave. What is switched off (the lens, until it shows; a
median that is not there) is not rendered.
"""

import functools
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from jaxisp.color import rgb_to_ycbcr_planes
from jaxisp.fit import lens, model, noise
from jaxisp.fit.align import _sample
from jaxisp.fit.sharing import CAMERA, IMAGE, Layout
from jaxisp.fit.tiles import HALO, SIDE, TILES, Chunk
from jaxisp.numerics import materialize, planes
from jaxisp.pipeline import Chain, Params, stage
from jaxisp.stages.optics import _radial_gain

GEOMETRY = ("shift_y", "shift_x", "scale_y", "scale_x")
UNITS = (1.0, 1.0, 1e-3, 1e-3)
"""Of the geometry on the real line: px, and a thousandth."""
STEP = 3e-3  # of a difference, on the real line; px for the geometry
STEP_DISTORTION = 0.2  # of that, for distortion: a step moves the corner by a small share of a pixel
ROBUST = 0.02  # level; larger residuals count less than by their square
CHROMA = 0.5  # weight of a squared error of Cb or Cr against one of luma


class Normal(NamedTuple):
    """One chunk at a place: its normal equations, and the sums for the noise statistics with their slopes.

    Args:
        matrix, vector: (columns, columns) and (columns,) of the robust residual.
        loss: its sum.
        weight: how many pixels.
        sums, slopes: for the statistics, and (columns, m) how they move.
        jacobian: (columns, N) of the plain residual.
        chord: (columns,) the gradient of the loss with the Jacobian that was given.
        render: the tiles.
    """

    matrix: Any
    vector: Any
    loss: Any
    weight: Any
    sums: Any
    slopes: Any
    jacobian: Any
    chord: Any
    render: Any


class Given(NamedTuple):
    """What is known while one pair is fitted.

    Args:
        fixed: the parameters that do not move (and, for the rest, their classes).
        median: index in `model.MEDIANS`.
        geometry: (4,) shift [px] and scale in y and x that the alignment found.
        bends: whether the lens is rendered.
        moving: (columns,) which parameters move; the derivative of the others is 0.
    """

    fixed: Params
    median: Any
    geometry: Any
    bends: Any
    moving: Any


class Problem(NamedTuple):
    """The static part: where denoising is, and which parameters move. Hashable.

    Demosaicking is done before, and the size of the median is traced: all designs share one compile.
    """

    place: str
    layout: Layout

    @property
    def columns(self) -> list[tuple[str, str]]:
        """(stage, field) of each column: the camera's, the image's, then the geometry."""
        names = self.layout.names
        return [*names[CAMERA], *names[IMAGE], *(("geometry", g) for g in GEOMETRY)]

    @property
    def before(self) -> list[int]:
        """The columns that change what denoising gives."""
        before, after = model.around_median(self.place)
        stages = {"vignetting", "geometry", "median", *model.LENS, *before.names(), *after.names()}
        return [i for i, (stage, _) in enumerate(self.columns) if stage in stages]

    def moving(self, bends: bool, median: bool) -> np.ndarray:
        """Which columns can change the picture."""
        still = (() if bends else model.LENS) + (() if median else ("median",))
        return np.asarray([stage not in still for stage, _ in self.columns])

    @property
    def steps(self) -> np.ndarray:
        """Of the difference along each column."""
        distorts = [stage == "geometric_distortion" for stage, _ in self.columns]
        return np.where(distorts, STEP * STEP_DISTORTION, STEP).astype(np.float32)


def _warped(
    source: jax.Array, place: jax.Array, geometry: jax.Array, optics: lens.Lens, chunk: Chunk, bends: Any
) -> Any:
    """(SIDE, SIDE, 3) camera RGB under one tile of the picture, and its squared radius in the RAW.

    geometry: shift [px] and scale, each in y and x.
    """
    index = jnp.arange(SIDE, dtype=jnp.float32)
    lines = [geometry[2 + a] * (place[a] + index) + geometry[a] for a in range(2)]  # from the RAW's centre

    def straight() -> jax.Array:
        return _sample(jnp, _sample(jnp, source, lines[0] - place[2], 0), lines[1] - place[3], 1)

    def bent() -> jax.Array:
        return lens.warped(source, optics, lines[0], lines[1], place[2:], chunk.corner)

    y, x = optics.bent(lines[0][:, None], lines[1][None], chunk.corner)
    return jax.lax.cond(bends, bent, straight), (y * y + x * x) / chunk.corner


def _front(place: str, median: Any, params: Params, warped: jax.Array, radius2: jax.Array) -> jax.Array:
    """Vignetting and `model.front`; `median` is the index of its footprint in `model.MEDIANS`."""
    shading = params["vignetting"]
    gain = _radial_gain(radius2, shading.a2, shading.a4, shading.a6)
    before, after = model.around_median(place)
    filters = [stage("median", footprint=size) if size else Chain((), "no median") for size in model.MEDIANS]
    image = materialize(before(params, warped * gain[..., None]))
    branches = [functools.partial(node.apply, params, key=None) for node in filters]
    image = jax.lax.switch(median, branches, image)
    return after(params, materialize(image))


def _renders(
    problem: Problem, given: Given, vectors: jax.Array, moving: jax.Array, before: np.ndarray, chunk: Chunk
) -> tuple[jax.Array, jax.Array, jax.Array]:
    """The tiles rendered with each row of `vectors` (camera, image, geometry).

    Rows that are not in `before` share the denoised picture of row 0, which must be; those that are not
    `moving` are left out (zeros).

    Returns:
        (K, N) residuals, (K, m) sums for the noise statistics, and (T, TILE, TILE, 3) of row 0.
    """
    layout, geometry = problem.layout, given.geometry
    cameras = layout.size(CAMERA)
    last = cameras + layout.size(IMAGE)
    tail = model.back(problem.place)

    def params(vector: jax.Array) -> Params:
        return layout.params(given.fixed, vector[:cameras], vector[cameras:last])

    def denoised(row: Any) -> jax.Array:
        vector, wanted = row
        return jax.lax.cond(wanted, denoise, lambda _: jnp.zeros((TILES, SIDE, SIDE, 3)), vector)

    def denoise(vector: jax.Array) -> jax.Array:
        values, place = params(vector), geometry + vector[last:] * jnp.asarray(UNITS)

        def tile(source: jax.Array, at: jax.Array) -> jax.Array:
            warped, radius2 = _warped(source, at, place, lens.Lens.of(values), chunk, given.bends)
            return _front(problem.place, given.median, values, materialize(warped), radius2)

        return jax.vmap(tile)(chunk.source, chunk.place)

    middles = jax.lax.map(denoised, (vectors[before], moving[before]))
    which = np.zeros(vectors.shape[0], np.int32)
    which[before] = np.arange(len(before))

    def finished(row: Any) -> tuple[jax.Array, jax.Array, jax.Array]:
        vector, index, wanted = row

        def finish(middle: jax.Array) -> tuple[jax.Array, jax.Array, jax.Array]:
            images = jax.vmap(lambda image: tail(params(vector), image))(middle)
            images = jnp.clip(images[:, HALO:-HALO, HALO:-HALO], 0, 1)  # as every file is
            return _residual(images, chunk).ravel(), _sums(images, chunk), images

        nothing = jax.tree.map(lambda s: jnp.zeros(s.shape, s.dtype), jax.eval_shape(finish, middles[0]))
        return jax.lax.cond(wanted, finish, lambda _: nothing, middles[index])

    residuals, sums, images = jax.lax.map(finished, (vectors, jnp.asarray(which), moving))
    return residuals, sums, images[0]


def _residual(render: jax.Array, chunk: Chunk) -> jax.Array:
    """(3, T, TILE, TILE) of luma and weighted chroma, 0 where the mask is."""
    y, cb, cr = rgb_to_ycbcr_planes(*planes(render - chunk.target))
    return jnp.stack([y, np.sqrt(CHROMA) * cb, np.sqrt(CHROMA) * cr]) * chunk.mask


def _robust(residual: jax.Array) -> tuple[jax.Array, jax.Array]:
    """The sum of the robust loss, and the weight of each squared residual."""
    root = jnp.sqrt(1 + (residual / ROBUST) ** 2)
    return (residual**2 * 2 / (1 + root)).sum(), 1 / root


def _sums(render: jax.Array, chunk: Chunk) -> jax.Array:
    return jax.vmap(noise.moments)(render, chunk.flat, chunk.edges).sum(0)


@functools.partial(jax.jit, static_argnums=0)
def normal_equations(problem: Problem, given: Given, vector: jax.Array, chunk: Chunk, near: Any) -> Normal:
    """The normal equations of one chunk at `vector`, which is (camera, image, geometry).

    Where nothing moves it is one render; `near` is a Jacobian from a place nearby, or zeros.
    """
    steps = problem.steps
    vectors = jnp.concatenate([vector[None], vector + jnp.diag(steps)])
    before = np.concatenate([[0], 1 + np.asarray(problem.before, int)]).astype(int)
    moving = jnp.concatenate([jnp.ones(1, bool), given.moving])
    residuals, sums, render = _renders(problem, given, vectors, moving, before, chunk)
    loss, weight = _robust(residuals[0])
    share = (given.moving / steps)[:, None]
    jacobian = (residuals[1:] - residuals[0]) * share
    weighted = weight * residuals[0]

    def product(a: jax.Array, b: jax.Array) -> jax.Array:
        return jnp.matmul(a, b, precision=jax.lax.Precision.HIGHEST)

    def square(j: jax.Array) -> jax.Array:
        return product(j * weight, j.T)

    return Normal(
        jax.lax.cond(given.moving.any(), square, lambda j: jnp.zeros((len(j), len(j))), jacobian),
        product(jacobian, weighted),
        loss,
        chunk.mask.sum(),
        sums[0],
        (sums[1:] - sums[0]) * share,
        jacobian,
        product(near, weighted),
        render,
    )


@jax.jit
def sums_of(render: jax.Array, chunk: Chunk) -> jax.Array:
    """The sums for the noise statistics of tiles that were rendered."""
    return _sums(render, chunk)
