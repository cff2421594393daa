"""The compiler: our forms on large planes, jitted, against float64 NumPy and SciPy.

A jaxlib that sums wrongly does so without a warning, and only from some size on; so these planes are
larger than those of the other tests. Inputs are positive, so that a relative error says something.
"""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import scipy.ndimage as ndi

from jaxisp.arrays.barriers import materialize
from jaxisp.arrays.linear import inner_product
from jaxisp.arrays.planes import per_plane
from jaxisp.arrays.stencils import filter_rows_columns, gaussian_blur, gaussian_taps, pad, square, views
from jaxisp.stages.denoise.bilateral import bilateral_plane
from jaxisp.stages.denoise.median import median_plane

pytestmark = pytest.mark.optimised

SIDE = 400
HIGHEST = jax.lax.Precision.HIGHEST


@pytest.fixture(scope="module")
def data() -> dict[str, np.ndarray]:
    rng = np.random.default_rng(0)
    shapes = {
        "weights": (5, SIDE, SIDE),
        "stack": (5, 3, SIDE, SIDE),
        "image": (SIDE, SIDE + 13, 3),
        "plane": (SIDE, SIDE + 13),
        "batch": (16, 80, 80, 3),
        "blocks": (2500, 64),
        "basis": (64, 64),
        "matrix": (3, 3),
    }
    return {name: rng.uniform(0.1, 1, shape).astype(np.float32) for name, shape in shapes.items()}


def agrees(fn, reference, data, *names, rtol=3e-6):
    """`jit(fn)` in float32 against the reference in float64, of the same inputs."""
    inputs = [data[n] for n in names]
    want = reference(*(v.astype(np.float64) for v in inputs))
    jax.tree.map(
        lambda g, w: np.testing.assert_allclose(g, w, rtol=rtol), jax.jit(fn)(*inputs), tuple_of(want)
    )


def tuple_of(value):
    return tuple(value) if isinstance(value, tuple | list) else value


@pytest.mark.parametrize("count", [3, 5])
def test_weighted_sum_over_a_leading_axis(count, data):
    """The case that jaxlib 0.10.2 gets wrong by 40 to 70 %."""
    few = {name: data[name][:count] for name in ("weights", "stack")}
    agrees(lambda w, q: (w[:, None] * q).sum(0), lambda w, q: (w[:, None] * q).sum(0), few, *few)
    agrees(lambda w, q: (w * q[:, 0]).sum(0), lambda w, q: (w * q[:, 0]).sum(0), few, *few)

    def mean(w, q):
        return (w[:, None] * q).sum(0) / w.sum(0)

    agrees(mean, mean, few, *few)
    agrees(jax.vmap(mean, (1, 2)), lambda w, q: np.moveaxis(mean(w, q), 1, 0), few, *few)


@pytest.mark.parametrize("axis", [0, 1, 2, 3, (0, 1), (2, 3), None])
def test_reductions(axis, data):
    for name in ("sum", "mean", "max", "min", "var"):
        agrees(lambda q: getattr(q, name)(axis), lambda q: getattr(q, name)(axis), data, "stack", rtol=2e-5)  # noqa: B023


def test_sums_of_products(data):
    agrees(inner_product, lambda x, y: np.sum(x * y), data, "plane", "plane", rtol=2e-5)
    per_image = jax.vmap(inner_product)
    agrees(per_image, lambda x, y: (x * y).sum((1, 2, 3)), data, "batch", "batch", rtol=2e-5)
    agrees(lambda x: jnp.cumsum(x, 0), lambda x: np.cumsum(x, 0), data, "plane", rtol=2e-4)


def test_products_of_matrices(data):
    def product(x, y):
        return jnp.matmul(x, y, precision=HIGHEST)

    agrees(product, np.matmul, data, "blocks", "basis")
    agrees(product, np.matmul, data, "image", "matrix")
    agrees(lambda x: product(x, x.T), lambda x: x @ x.T, data, "plane")
    agrees(jax.vmap(lambda x: product(x[..., 0], x[..., 1])), lambda x: x[..., 0] @ x[..., 1], data, "batch")


@pytest.mark.parametrize("radius", [1, 6, 12])
def test_separable_filters(radius, data):
    taps = np.asarray(gaussian_taps(radius / 3, radius), np.float64)

    def scipy_filter(x):
        for axis in (0, 1):
            x = ndi.correlate1d(x, taps, axis=axis, mode="mirror")
        return x

    for name in ("image", "plane"):
        agrees(lambda x: filter_rows_columns(x, taps, taps), scipy_filter, data, name)
    agrees(lambda x: per_plane(lambda p: filter_rows_columns(p, taps, taps), x), scipy_filter, data, "image")
    each = jax.vmap(lambda x: gaussian_blur(x, np.float32(radius / 3), radius))
    agrees(each, lambda x: np.stack([scipy_filter(v) for v in x]), data, "batch")


def test_chained_stencils(data):
    """A stencil of a stencil, once stored between and once left to the compiler."""

    def box(x):
        return sum(views(pad(x, 1), square(1), 1)) / 9

    def scipy_box(x):
        return ndi.uniform_filter(x, 3, mode="mirror")

    agrees(lambda x: box(box(x)), lambda x: scipy_box(scipy_box(x)), data, "plane")
    agrees(lambda x: box(materialize(box(x))), lambda x: scipy_box(scipy_box(x)), data, "plane")


@pytest.mark.parametrize(("footprint", "size"), [("3x3", 3), ("5x5", 5)])
def test_median_networks(footprint, size, data):
    got = jax.jit(median_plane, static_argnums=1)(data["plane"], footprint)
    np.testing.assert_array_equal(got, ndi.median_filter(data["plane"], size, mode="mirror"))


def test_bilateral(data):
    x, radius, (h, w) = data["plane"], 5, data["plane"].shape
    wide, total, norm = np.pad(x.astype(np.float64), radius, mode="reflect"), 0.0, 0.0
    for dy, dx in square(radius):
        if dy**2 + dx**2 <= radius**2:
            near = wide[radius + dy : radius + dy + h, radius + dx : radius + dx + w]
            weight = np.exp(-(dy**2 + dx**2) / (2 * 2.0**2) - (near - x) ** 2 / (2 * 0.2**2))
            total, norm = total + weight * near, norm + weight
    got = jax.jit(bilateral_plane, static_argnums=4)(x, x, np.float32(2), np.float32(0.2), radius)
    np.testing.assert_allclose(got, total / norm, rtol=1e-5)


def test_gradient_of_a_filter_is_its_adjoint(data):
    """<A x, y> = <x, A' y>, with A of SciPy in float64 and A' compiled."""
    x, y = data["image"].astype(np.float64), data["image"][::-1].copy()
    back = jax.jit(jax.grad(lambda v: jnp.sum(gaussian_blur(v, np.float32(2), 8) * y)))(data["image"])
    want = ndi.gaussian_filter(x, (2, 2, 0), mode="mirror", radius=(8, 8, 0))
    np.testing.assert_allclose(np.sum(np.asarray(back, np.float64) * x), np.sum(want * y), rtol=1e-6)
