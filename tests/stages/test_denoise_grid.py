"""The bilateral grid against the bilateral filter that it stands for, and its gradient."""

from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy import ndimage

from jaxisp.arrays.extents import Extent
from jaxisp.color import rgb_to_ycbcr_planes, ycbcr_to_rgb_planes
from jaxisp.recipes import BILATERAL, RECIPES
from jaxisp.stages.denoise import grid
from jaxisp.stages.denoise.bilateral import Bilateral, bilateral, bilateral_plane
from jaxisp.stages.denoise.grid import grid_planes
from jaxisp.testing import smooth_image
from tests.gradients import both_modes

filtered = jax.jit(grid_planes, static_argnums=(4, 5))
SHAPE = (57, 70)  # of most tests: compilation is what takes time


def folded(n, sigma):
    """(n, n): a Gaussian between samples, over all mirror images of the second (the edge not repeated)."""
    i, period = np.arange(n), max(2 * n - 2, 1)
    out = np.zeros((n, n))
    for k in range(-int(6 * sigma / period) - 2, int(6 * sigma / period) + 3):
        out += np.exp(-((i[:, None] - i - k * period) ** 2) / (2 * sigma**2))
        mirrored = np.exp(-((i[:, None] + i - k * period) ** 2) / (2 * sigma**2))
        mirrored[:, [0, -1]] = 0
        out += mirrored
    return out


def exact(planes, guide, sigma_space, sigma_range):
    """The joint bilateral filter with a window without end, in float64."""
    down, across = (folded(n, sigma_space) for n in guide.shape)
    out = np.empty((len(planes), *guide.shape))
    for y, row in enumerate(guide):
        near = np.exp(-((row[:, None, None] - guide) ** 2) / (2 * sigma_range**2))
        weight = near * down[y][:, None] * across[:, None, :]
        out[:, y] = np.einsum("xij,cij->cx", weight, planes) / weight.sum((1, 2))
    return out


def scene(shape, noise, seed=0):
    """Luma, smoothed as the stage does, and noisy chroma of patches of colour: linear light."""
    rng = np.random.default_rng(seed)
    patches = rng.uniform(0, 0.9, (4, 5, 3)).repeat(-(-shape[0] // 4), 0).repeat(-(-shape[1] // 5), 1)
    shaded = patches[: shape[0], : shape[1]] * smooth_image(shape, seed, 0.3)[..., None]
    noisy = ndimage.gaussian_filter(shaded + rng.normal(0, noise, shaded.shape), (0.6, 0.6, 0))
    y, *chroma = (np.asarray(p, np.float32) for p in rgb_to_ycbcr_planes(*np.moveaxis(noisy, -1, 0)))
    return np.asarray(bilateral_plane(jnp.asarray(y), jnp.asarray(y), 1.4, 0.04, 3)), chroma


def psnr(a, b):
    return -10 * np.log10(np.mean((np.asarray(a) - b) ** 2))


@pytest.mark.parametrize("noise", [0.005, 0.05])
@pytest.mark.parametrize("sigma_space", [6.0, 15.0, 40.0])
@pytest.mark.parametrize("sigma_range", [0.02, 0.1])
def test_equals_the_wide_bilateral(sigma_space, sigma_range, noise):
    """Of RGB with a peak of 1; without the filter it is far from it."""
    luma, chroma = scene(SHAPE, noise)
    want = exact(np.asarray(chroma, float), luma.astype(float), sigma_space, sigma_range)
    got = filtered(tuple(chroma), luma, sigma_space, sigma_range)
    before, theirs, ours = (np.stack(ycbcr_to_rgb_planes(luma, *c)) for c in (chroma, want, got))
    assert psnr(before, theirs) < 30
    assert psnr(ours, theirs) > 40


@pytest.mark.parametrize("sigma_space", BILATERAL.chroma_sigma_space.support)
def test_the_phones_grid_equals_the_wide_bilateral(sigma_space):
    """With fewer bins, at the narrowest and the widest that are drawn."""
    options = next(s.options for s in RECIPES["phone"]().chain.stages() if s.name == "bilateral")
    luma, chroma = scene(SHAPE, 0.05)
    want = exact(np.asarray(chroma, float), luma.astype(float), sigma_space, BILATERAL.chroma_sigma_range)
    widths = sigma_space, BILATERAL.chroma_sigma_range
    got = filtered(tuple(chroma), luma, *widths, options["chroma_cell"], options["chroma_bins"])
    theirs, ours = (np.stack(ycbcr_to_rgb_planes(luma, *c)) for c in (want, got))
    assert psnr(ours, theirs) > 40


def test_more_bins_and_smaller_cells_come_closer():
    luma, chroma = scene(SHAPE, 0.02)
    want = exact(np.asarray(chroma, float), luma.astype(float), 7.0, 0.02)
    coarse, middle, fine = (
        psnr(filtered(tuple(chroma), luma, 7.0, 0.02, *grid), want) for grid in ((6, 8), (4, 32), (2, 48))
    )
    assert coarse + 3 < middle < fine - 3
    assert fine > 55


@pytest.mark.parametrize("sigma, error", [(2.5, 0.02), (6.0, 0.0105), (20.0, 0.0005)])
def test_flat_guide_gives_a_gaussian_blur(sigma, error):
    """An impulse keeps its mass; the narrower the blur, the more of its shape is the cell's."""
    plane, flat = np.zeros((160, 148), np.float32), np.full((160, 148), 0.3, np.float32)
    plane[80, 70] = 1
    (out,) = map(np.asarray, filtered((plane,), flat, sigma, 0.05, 4, 2))
    np.testing.assert_allclose(out.sum(), 1, rtol=1e-4)
    image = smooth_image(flat.shape).astype(np.float32)
    (got,) = filtered((image,), flat, sigma, 0.05, 4, 2)
    np.testing.assert_allclose(got, ndimage.gaussian_filter(image, sigma, mode="reflect"), atol=error)


def test_colour_stays_inside_its_edge():
    """Ten sigma_range apart nothing leaks, however wide the window."""
    side = np.broadcast_to(np.arange(SHAPE[1]) >= 23, SHAPE)
    guide = np.where(side, 0.6, 0.3).astype(np.float32)
    planes = tuple(np.where(side, a, b).astype(np.float32) for a, b in ((0.2, -0.3), (-0.1, 0.5)))
    for out, plane in zip(filtered(planes, guide, 30.0, 0.03), planes):
        np.testing.assert_allclose(out, plane, atol=2e-4)


@jax.jit
def with_slopes(planes, guide, sigma_space, sigma_range):
    """The planes and the gradient to everything; few bins, as each costs compile time."""
    loss = lambda *a: (jnp.sum(grid_planes(*a, 2, 4)[0] ** 2), grid_planes(*a, 2, 4))  # noqa: E731
    slopes, out = jax.grad(loss, (0, 1, 2, 3), has_aux=True)(planes, guide, sigma_space, sigma_range)
    return out, slopes


@pytest.mark.parametrize("shape", [(1, 6), (9, 14)])
def test_total(shape, rng):
    """Finite values and gradients, a constant stays, and nothing leaves the range of the plane."""
    nearly_flat = 0.4 + 1e-7 * rng.uniform(size=shape)
    for guide in (rng.uniform(-2, 5, shape), np.zeros(shape), nearly_flat):
        plane = rng.uniform(-1, 1, shape).astype(np.float32)
        planes, guide = (plane, np.full(shape, 0.25, np.float32)), guide.astype(np.float32)
        for sigma_space, sigma_range in ((0.3, 0.005), (40.0, 1.0)):
            (out, constant), slopes = with_slopes(planes, guide, sigma_space, sigma_range)
            np.testing.assert_allclose(constant, 0.25, atol=1e-5)
            assert out.min() > plane.min() - 1e-4 and out.max() < plane.max() + 1e-4
            assert all(np.isfinite(s).all() for s in jax.tree.leaves(slopes))


@pytest.mark.parametrize("shape, cell, large", [((7, 10), 4, 70), ((7, 8), 2, 70), ((7, 10), 4, 69)])
def test_gradient_in_both_modes_equals_finite_differences(shape, cell, large, rng, x64, monkeypatch):
    monkeypatch.setattr(grid, "_LARGE", large)
    a, b, guide, weights = rng.uniform(-0.5, 1.5, (4, *shape))
    arguments = (a, b), guide, np.array(4.0), np.array(0.9)
    turn = jax.tree.map(lambda x: rng.standard_normal(np.shape(x)), arguments)

    def loss(arguments):
        first, second = grid_planes(*arguments, cell, 4)
        return jnp.sum(first * weights + second**2)

    @jax.jit  # one program: compilation is what takes time
    def all_of_it(arguments):
        return both_modes(loss, (arguments,), (turn,), 1.0)

    ends = [all_of_it(jax.tree.map(lambda x, d: x + h * d, arguments, turn))[0] for h in (1e-6, -1e-6)]  # noqa: B023
    want = (ends[0] - ends[1]) / 2e-6
    _, forward, (slopes,) = all_of_it(arguments)
    assert all(np.abs(s).max() > 1e-3 for s in jax.tree.leaves(slopes))
    reverse = sum(np.sum(s * d) for s, d in zip(jax.tree.leaves(slopes), jax.tree.leaves(turn)))
    np.testing.assert_allclose(reverse, want, rtol=1e-6)
    np.testing.assert_allclose(forward, want, rtol=1e-6)


def test_stage_filters_chroma_on_the_grid(x64):
    image = jnp.asarray(smooth_image((22, 31, 3)))
    params = Bilateral(chroma_sigma_space=jnp.asarray(12.0), chroma_sigma_range=jnp.asarray(0.2))
    out = jax.jit(lambda p, x: bilateral(p, x, radius=2, chroma_cell=4, chroma_bins=5))(params, image)
    y, cb, cr = rgb_to_ycbcr_planes(*jnp.moveaxis(image, -1, 0))
    got = rgb_to_ycbcr_planes(*jnp.moveaxis(out, -1, 0))
    luma = jax.jit(bilateral_plane, static_argnums=4)
    want_y = luma(y, y, params.luma_sigma_space, params.luma_sigma_range, 2)
    np.testing.assert_allclose(got[0], want_y, atol=1e-12)
    want = filtered((cb, cr), want_y, 12.0, 0.2, 4, 5)
    for g, w in zip(got[1:], want):
        np.testing.assert_allclose(g, w, atol=1e-9)


def test_batch_with_its_own_widths_equals_one_by_one():
    lumas, chromas = zip(*[scene((20, 27), 0.02, seed) for seed in range(3)])
    planes = tuple(jnp.stack([c[i] for c in chromas]) for i in range(2))
    widths = jnp.asarray([6.0, 15.0, 40.0]), jnp.asarray([0.02, 0.05, 0.3])
    together = jax.jit(jax.vmap(partial(grid_planes, bins=4)))(planes, jnp.stack(lumas), *widths)
    for i in range(3):
        alone = filtered(tuple(p[i] for p in planes), lumas[i], widths[0][i], widths[1][i], 4, 4)
        for t, a in zip(together, alone):
            np.testing.assert_allclose(t[i], a, atol=2e-6)


def test_planes_of_a_large_frame_go_one_by_one(monkeypatch):
    luma, chroma = scene(SHAPE, 0.02)
    together = filtered(chroma, luma, 15.0, 0.05, 4, 8)
    loops = filtered.lower(chroma, luma, 15.0, 0.05, 4, 8).as_text().count("stablehlo.while")
    monkeypatch.setattr(grid, "_LARGE", 0)
    one_by_one = jax.jit(jax.vmap(partial(grid_planes, cell=4, bins=8)))
    arguments = [c[None] for c in chroma], luma[None], jnp.full(1, 15.0), jnp.full(1, 0.05)
    # the planes in turn, and the blur's groups of theirs; nothing else of it is a loop more
    assert one_by_one.lower(*arguments).as_text().count("stablehlo.while") == loops + 2
    alone = one_by_one(*arguments)
    for a, t in zip(alone, together):
        np.testing.assert_allclose(a[0], t, atol=2e-6)


@pytest.mark.parametrize("option", [{"chroma_cell": 3}, {"chroma_cell": -2}, {"chroma_bins": 1}])
def test_unusable_grids_are_refused(option):
    with pytest.raises(ValueError, match="chroma_cell must be even"):
        bilateral(Bilateral(), jnp.zeros((8, 9, 3)), **option)


@pytest.mark.parametrize(
    "size, frame", [((21, 34), (30, 90)), ((70, 141), (75, 155)), ((17, 395), (26, 450))], ids=str
)
def test_a_larger_frame_gives_the_same_bits(size, frame, rng):
    """Sums that are one kernel and such as are a loop, and the tiles of more than `_WHOLE` cells."""
    pictures = rng.uniform(size=(3, *size)).astype(np.float32)
    around = [(0, 0), *((0, f - s) for f, s in zip(frame, size))]
    wide = np.pad(pictures, around, mode="reflect")
    extent = Extent(*map(jnp.int32, size))
    for width in (3.0, 11.0, 34.0):
        alone = filtered(tuple(pictures[:2]), pictures[2], width, 0.1, 4, 4)
        inside = filtered(tuple(wide[:2]), wide[2], width, 0.1, 4, 4, extent)
        for a, b in zip(alone, inside):
            np.testing.assert_array_equal(b[: size[0], : size[1]], a)


def test_a_larger_frame_has_the_same_slopes(rng):
    """To the widths: what is beyond the picture must not enter."""
    size, frame = (14, 23), (20, 32)
    pictures = rng.uniform(size=(3, *size)).astype(np.float32)
    wide = np.pad(pictures, [(0, 0), *((0, f - s) for f, s in zip(frame, size))], mode="reflect")

    @jax.jit
    def slopes(pictures, extent):
        def loss(widths):
            planes = grid_planes(tuple(pictures[:2]), pictures[2], *widths, 4, 4, extent)
            return sum((p[: size[0], : size[1]] ** 2).sum() for p in planes)

        return jax.grad(loss)((8.0, 0.3))

    alone, inside = slopes(pictures, None), slopes(wide, Extent(*map(jnp.int32, size)))
    np.testing.assert_allclose(inside, alone, rtol=1e-4)
    assert min(map(abs, alone)) > 1e-2
