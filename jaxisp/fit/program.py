"""What runs on the device: tiles rendered with many parameter vectors at once, and their normal equations.

Derivatives are forward differences. The neighbourhood stages have reverse-mode rules only, and a
Jacobian with one column a parameter needs the other direction; it also costs less to compile, and
sees through rounding, medians and choices. Denoising is rendered again only for the parameters
before or in it; the others start from what it gave.
"""

import functools
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from jaxisp.color import rgb_to_ycbcr_planes
from jaxisp.fit import model, noise
from jaxisp.fit.align import _sample
from jaxisp.fit.sharing import CAMERA, IMAGE, Layout
from jaxisp.fit.tiles import HALO, SIDE, Chunk
from jaxisp.numerics import materialize, planes
from jaxisp.pipeline import Chain, Params, stage
from jaxisp.stages.optics import _radial_gain

GEOMETRY = ("shift_y", "shift_x", "scale_y", "scale_x")
STEP = 3e-3  # of a difference, on the real line; px for the geometry
ROBUST = 0.02  # level; larger residuals count less than by their square
CHROMA = 0.5  # weight of a squared error of Cb or Cr against one of luma


class Normal(NamedTuple):
    """Normal equations of one chunk, and the sums for the noise statistics with their derivatives.

    `matrix` and `vector` are of the robust residual, `loss` its sum, `weight` how many pixels.
    """

    matrix: Any
    vector: Any
    loss: Any
    weight: Any
    sums: Any
    slopes: Any


class Given(NamedTuple):
    """What is known while one pair is fitted.

    Args:
        fixed: the parameters that do not move (and, for the rest, their classes).
        median: index in `model.MEDIANS`.
        geometry: (4,) shift [px] and scale in y and x that the alignment found.
    """

    fixed: Params
    median: Any
    geometry: Any


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
        stages = {"vignetting", "geometry", "median", *before.names(), *after.names()}
        return [i for i, (stage, _) in enumerate(self.columns) if stage in stages]


def _warped(source: jax.Array, place: jax.Array, geometry: jax.Array, corner: Any) -> Any:
    """(SIDE, SIDE, 3) camera RGB under one tile of the picture, and its squared radius in the RAW.

    geometry: shift [px] and scale, each in y and x.
    """
    index = jnp.arange(SIDE, dtype=jnp.float32)
    out, radii = source, []
    for axis in range(2):
        position = geometry[2 + axis] * (place[axis] + index) + geometry[axis]  # from the RAW's centre
        out = _sample(jnp, out, position - place[2 + axis], axis)
        radii.append(position**2)
    return out, (radii[0][:, None] + radii[1]) / corner


def _front(place: str, median: Any, params: Params, warped: jax.Array, radius2: jax.Array) -> jax.Array:
    """Vignetting and `model.front`; `median` is the index of its footprint in `model.MEDIANS`."""
    lens = params["vignetting"]
    gain = _radial_gain(radius2, lens.a2, lens.a4, lens.a6)
    before, after = model.around_median(place)
    filters = [stage("median", footprint=size) if size else Chain((), "no median") for size in model.MEDIANS]
    image = materialize(before(params, warped * gain[..., None]))
    branches = [functools.partial(node.apply, params, key=None) for node in filters]
    image = jax.lax.switch(median, branches, image)
    return after(params, materialize(image))


def _renders(
    problem: Problem, given: Given, vectors: jax.Array, before: np.ndarray, chunk: Chunk
) -> jax.Array:
    """(K, T, TILE, TILE, 3): the tiles rendered with each row of `vectors` (camera, image, geometry).

    Rows that are not in `before` share the denoised picture of row 0, which must be.
    """
    layout, geometry = problem.layout, given.geometry
    cameras = layout.size(CAMERA)
    last = cameras + layout.size(IMAGE)
    tail = model.back(problem.place)

    def params(vector: jax.Array) -> Params:
        return layout.params(given.fixed, vector[:cameras], vector[cameras:last])

    def denoised(vector: jax.Array) -> jax.Array:
        place = jnp.stack(
            [
                geometry[0] + vector[last],
                geometry[1] + vector[last + 1],
                geometry[2] + 1e-3 * vector[last + 2],
                geometry[3] + 1e-3 * vector[last + 3],
            ]
        )

        def tile(source: jax.Array, at: jax.Array) -> jax.Array:
            warped, radius2 = _warped(source, at, place, chunk.corner)
            return _front(problem.place, given.median, params(vector), materialize(warped), radius2)

        return jax.vmap(tile)(chunk.source, chunk.place)

    middles = jax.lax.map(denoised, vectors[before])
    which = np.zeros(vectors.shape[0], np.int32)
    which[before] = np.arange(len(before))

    def finished(row: Any) -> jax.Array:
        vector, index = row
        images = jax.vmap(lambda image: tail(params(vector), image))(middles[index])
        return images[:, HALO:-HALO, HALO:-HALO]

    return jax.lax.map(finished, (vectors, jnp.asarray(which)))


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
def normal_equations(problem: Problem, given: Given, vector: jax.Array, chunk: Chunk) -> Normal:
    """The normal equations of one chunk at `vector`, which is (camera, image, geometry)."""
    count = len(problem.columns)
    vectors = jnp.concatenate([vector[None], vector + STEP * jnp.eye(count)])
    before = np.concatenate([[0], 1 + np.asarray(problem.before, int)]).astype(int)
    renders = _renders(problem, given, vectors, before, chunk)
    residuals = jax.vmap(lambda r: _residual(r, chunk))(renders).reshape(count + 1, -1)
    loss, weight = _robust(residuals[0])
    jacobian = (residuals[1:] - residuals[0]) / STEP
    weighted = jacobian * weight
    sums = jax.vmap(lambda r: _sums(r, chunk))(renders)
    slopes = (sums[1:] - sums[0]) / STEP
    exact = jax.lax.Precision.HIGHEST
    matrix = jnp.matmul(weighted, jacobian.T, precision=exact)
    vector_out = jnp.matmul(weighted, residuals[0], precision=exact)
    return Normal(matrix, vector_out, loss, chunk.mask.sum(), sums[0], slopes)


class Trial(NamedTuple):
    """One chunk rendered: its loss, how many pixels, the sums for the noise statistics, and the tiles."""

    loss: Any
    weight: Any
    sums: Any
    render: Any


@functools.partial(jax.jit, static_argnums=0)
def trial(problem: Problem, given: Given, vector: jax.Array, chunk: Chunk) -> Trial:
    """One chunk at `vector`."""
    render = _renders(problem, given, vector[None], np.zeros(1, int), chunk)[0]
    return Trial(_robust(_residual(render, chunk))[0], chunk.mask.sum(), _sums(render, chunk), render)


@jax.jit
def sums_of(render: jax.Array, chunk: Chunk) -> jax.Array:
    """The sums for the noise statistics of tiles that were rendered."""
    return _sums(render, chunk)


@functools.partial(jax.jit, static_argnums=0)
def render_block(place: str, median: Any, params: Params, warped: jax.Array, radius2: jax.Array) -> jax.Array:
    """A block of camera RGB rendered, before rounding: any size, with its own surroundings."""
    return model.back(place)(params, _front(place, median, params, warped, radius2))
