"""Demosaicking against colour-demosaicing, and against plain NumPy written from the papers."""

import functools

import colour
import colour_demosaicing as peer
import cv2
import jax
import jax.numpy as jnp
import numpy as np
import pytest
import scipy.ndimage as ndi
import skimage.data

from jaxisp.arrays.extents import Extent
from jaxisp.cfa import PATTERNS, masks, shifted, size
from jaxisp.pipeline import stage
from jaxisp.stages.demosaic.homogeneity import _cube_root
from jaxisp.testing import smooth_image

SHAPE = (29, 34)
NAMES = (
    "bilinear", "malvar", "hibbard", "ahd", "menon", "hamilton_adams", "vng", "edge_aware",
    "ppg", "dcb", "rcd", "lmmse",
)  # fmt: skip
ALGORITHMS = tuple(f"demosaic_{name}" for name in NAMES)
PEERS = {
    "demosaic_bilinear": (peer.demosaicing_CFA_Bayer_bilinear, 1),
    "demosaic_malvar": (peer.demosaicing_CFA_Bayer_Malvar2004, 2),
    "demosaic_menon": (peer.demosaicing_CFA_Bayer_Menon2007, 8),
}


@functools.cache
def compiled(name, **static):
    node = stage(name, **static)
    return jax.jit(lambda image: node({}, image))


def run(name, image, **static):
    return np.asarray(compiled(name, **static)(image))


def mosaic_of(rgb, cfa="RGGB"):
    """By NumPy: a dozen operations of each size would be compiled one by one."""
    n, (rows, columns) = size(cfa), np.indices(rgb.shape[:2])
    filters = np.array(["RGB".index(name) for name in cfa]).reshape(n, n)
    return np.take_along_axis(np.asarray(rgb), filters[rows % n, columns % n][..., None], -1)[..., 0]


@functools.cache
def photograph():
    """Linear light, on a grid of 2**-12: sums of a few samples are exact, so ties are ties."""
    rgb = skimage.data.astronaut()[20:180, 150:310] / 255.0
    return np.round(4096 * rgb**2.2) / 4096


def inside(image, border):
    return image[border:-border, border:-border]


# ---- against colour-demosaicing


@pytest.mark.parametrize("cfa", PATTERNS)
@pytest.mark.parametrize("name", PEERS)
def test_matches_colour_demosaicing_inside(name, cfa, x64):
    reference, border = PEERS[name]
    for mosaic in (smooth_image(SHAPE), mosaic_of(photograph(), cfa)[: SHAPE[0], : SHAPE[1]]):
        got = inside(run(name, mosaic, cfa=cfa), border)
        np.testing.assert_allclose(got, inside(reference(mosaic, cfa), border), atol=1e-12)


@pytest.mark.parametrize("name", PEERS)
def test_matches_colour_demosaicing_in_single_precision(name):
    reference, border = PEERS[name]
    mosaic = mosaic_of(photograph())
    got = run(name, mosaic.astype(np.float32))
    assert got.dtype == np.float32
    np.testing.assert_allclose(inside(got, border), inside(reference(mosaic), border), atol=1e-5)


def test_menon_without_refining(x64):
    mosaic = mosaic_of(photograph())[: SHAPE[0], : SHAPE[1]]
    want = peer.demosaicing_CFA_Bayer_Menon2007(mosaic, "RGGB", refining_step=False)
    got = run("demosaic_menon", mosaic, refining=False)
    np.testing.assert_allclose(inside(got, 6), inside(want, 6), atol=1e-12)
    assert np.abs(got - run("demosaic_menon", mosaic)).max() > 1e-3


# ---- against loops and arrays written from the papers


def colour_at(cfa, y, x):
    return cfa[2 * (y % 2) + x % 2]


def hibbard_by_loops(mosaic, cfa):
    """One pixel at a time. The mosaic is continued by its mirror image."""
    margin = 2
    x = np.pad(mosaic, margin, mode="reflect")
    height, width = x.shape
    green, out = np.zeros_like(x), np.zeros((*x.shape, 3))
    for i in range(1, height - 1):
        for j in range(1, width - 1):
            dh, dv = abs(x[i, j - 1] - x[i, j + 1]), abs(x[i - 1, j] - x[i + 1, j])
            row, column = (x[i, j - 1] + x[i, j + 1]) / 2, (x[i - 1, j] + x[i + 1, j]) / 2
            estimate = row if dh < dv else column if dh > dv else (row + column) / 2
            green[i, j] = x[i, j] if colour_at(cfa, i, j) == "G" else estimate
    for i in range(2, height - 2):
        for j in range(2, width - 2):
            for c, name in enumerate("RGB"):
                near = [(i + a, j + b) for a in (-1, 0, 1) for b in (-1, 0, 1)]
                own = [(i, j)] if colour_at(cfa, i, j) == name else near
                known = [x[p] - green[p] for p in own if colour_at(cfa, *p) == name]
                out[i, j, c] = green[i, j] + (np.mean(known) if name != "G" else 0)
    return out[margin:-margin, margin:-margin]


@pytest.mark.parametrize("cfa", PATTERNS)
def test_hibbard_matches_the_patents_equations(cfa, x64):
    for mosaic in (smooth_image(SHAPE), mosaic_of(photograph(), cfa)[: SHAPE[0], : SHAPE[1]]):
        want = hibbard_by_loops(mosaic, cfa)
        np.testing.assert_allclose(run("demosaic_hibbard", mosaic, cfa=cfa), want, atol=1e-12)
        single = run("demosaic_hibbard", mosaic.astype(np.float32), cfa=cfa)
        np.testing.assert_allclose(single, want, atol=1e-6)


def test_hibbard_takes_the_mean_of_four_on_a_tie(x64):
    mosaic = np.zeros((6, 6))
    mosaic[2, 1], mosaic[1, 2] = 1.0, 1.0  # the site (2, 2) is red: left 1, right 0, up 1, down 0
    assert run("demosaic_hibbard", mosaic)[2, 2, 1] == 0.5


def ahd_candidate(x, cfa, axis):
    height, width = x.shape
    names = np.tile(np.array(list(cfa)).reshape(2, 2), (height // 2 + 1, width // 2 + 1))[:height, :width]
    estimate = ndi.correlate1d(x, [-0.25, 0.5, 0.5, 0.5, -0.25], axis=axis, mode="mirror")
    green = np.where(names == "G", x, estimate)
    bilinear = np.outer([0.5, 1, 0.5], [0.5, 1, 0.5])
    red, blue = (green + ndi.correlate((x - green) * (names == c), bilinear, mode="mirror") for c in "RB")
    return np.stack([red, green, blue], axis=-1)


def ahd_by_arrays(mosaic, cfa, delta, passes):
    """The equations of Hirakawa & Parks 2005 on whole arrays, far from the border of a mirrored mosaic."""
    margin = 16
    x = np.pad(mosaic, margin, mode="reflect")
    candidates = [ahd_candidate(x, cfa, axis) for axis in (1, 0)]
    matrix = np.array([[0.4124, 0.3576, 0.1805], [0.2126, 0.7152, 0.0722], [0.0193, 0.1192, 0.9505]])
    white = colour.XYZ_to_xy(matrix.sum(axis=1))
    labs = [colour.XYZ_to_Lab(c @ matrix.T, white) for c in candidates]

    def to(lab, dy, dx):
        move = np.roll(lab, (-dy, -dx), axis=(0, 1)) - lab
        return np.abs(move[..., 0]), np.hypot(move[..., 1], move[..., 2])

    along = [[to(labs[0], 0, d) for d in (-1, 1)], [to(labs[1], d, 0) for d in (-1, 1)]]
    eps = [np.minimum(*(np.maximum(pair[0][k], pair[1][k]) for pair in along)) for k in (0, 1)]
    span = range(-delta, delta + 1)
    ball = [(i, j) for i in span for j in span if np.hypot(i, j) <= delta]
    score = []
    for lab in labs:
        moves = [to(lab, *step) for step in ball]
        # hypot rounds where the tolerance is met by the very neighbour that set it
        close = [(dl <= eps[0] * (1 + 1e-12)) & (dc <= eps[1] * (1 + 1e-12)) for dl, dc in moves]
        score.append(ndi.uniform_filter(np.sum(close, axis=0).astype(float), 3))
    by_rows = score[0] > score[1] + 1e-9
    red, green, blue = np.moveaxis(np.where(by_rows[..., None], *candidates), -1, 0)
    for _ in range(passes):
        red, blue = (ndi.median_filter(c - green, 3) + green for c in (red, blue))
        green = sum(ndi.median_filter(green - c, 3) + c for c in (red, blue)) / 2
    return inside(np.stack([red, green, blue], axis=-1), margin)


@pytest.mark.parametrize(
    ("cfa", "delta", "passes"),
    [("RGGB", 2, 0), ("BGGR", 2, 2), ("GRBG", 1, 0), ("GBRG", 2, 3), ("RGGB", 3, 0)],
)
@pytest.mark.optimised
def test_ahd_matches_the_papers_equations(cfa, delta, passes, x64):
    for mosaic in (smooth_image(SHAPE), 1.5 * smooth_image(SHAPE, 1) - 0.2):
        got = run("demosaic_ahd", mosaic, cfa=cfa, delta=delta, median_passes=passes)
        np.testing.assert_allclose(got, ahd_by_arrays(mosaic, cfa, delta, passes), atol=1e-10)


def test_ahd_decides_alike_in_single_precision():
    mosaic = mosaic_of(photograph())
    got = run("demosaic_ahd", mosaic.astype(np.float32))
    want = ahd_by_arrays(mosaic, "RGGB", 2, 0)
    assert got.dtype == np.float32
    assert np.mean(np.abs(got - want).max(axis=-1) > 1e-5) < 2e-3  # near-ties may fall either way


def test_cube_root():
    t = np.geomspace(1e-3, 1e6, 1001)
    got = _cube_root(jnp.asarray(t, jnp.float32))
    np.testing.assert_allclose(got, np.cbrt(t.astype(np.float32)), rtol=4e-7)


def test_cube_root_in_double_precision(x64):
    t = np.geomspace(1e-3, 1e6, 1001)
    np.testing.assert_allclose(_cube_root(jnp.asarray(t)), np.cbrt(t), rtol=1e-15)


# ---- the colour-difference median


def test_color_difference_median_matches_scipy(x64):
    image = smooth_image((*SHAPE, 3))
    red, green, blue = np.moveaxis(image, -1, 0)
    median = functools.partial(ndi.median_filter, size=3, mode="mirror")
    for passes in (1, 2):
        red, blue = median(red - green) + green, median(blue - green) + green
        green = (median(green - red) + red + median(green - blue) + blue) / 2
        got = run("color_difference_median", image, passes=passes)
        np.testing.assert_allclose(got, np.stack([red, green, blue], axis=-1), atol=1e-12)
    np.testing.assert_array_equal(run("color_difference_median", image, passes=0), image)


def test_color_difference_median_removes_a_coloured_dot():
    image = np.full((9, 11, 3), 0.5, np.float32)
    image[4, 5, 0] = 1
    np.testing.assert_allclose(run("color_difference_median", image, passes=1), 0.5, atol=1e-6)


# ---- what holds for every algorithm


@pytest.mark.parametrize("cfa", PATTERNS)
@pytest.mark.parametrize("name", ALGORITHMS)
def test_constant_colour_and_grey_ramp_come_back(name, cfa):
    colour_image = np.broadcast_to(np.float32([0.7, 0.4, 0.1]), (*SHAPE, 3))
    np.testing.assert_allclose(run(name, mosaic_of(colour_image, cfa), cfa=cfa), colour_image, atol=1e-6)
    y, x = np.mgrid[: SHAPE[0], : SHAPE[1]]
    ramp = np.repeat((0.01 * y + 0.02 * x + 0.1).astype(np.float32)[..., None], 3, axis=-1)
    got = inside(run(name, mosaic_of(ramp, cfa), cfa=cfa), 8)
    np.testing.assert_allclose(got, inside(ramp, 8), atol=1e-6)


@pytest.mark.parametrize(
    "name",
    [f"demosaic_{n}" for n in ("hibbard", "ahd", "menon", "hamilton_adams", "ppg")],
)
@pytest.mark.parametrize("axis", [0, 1])
def test_edge_of_constant_colour_difference_is_kept(name, axis):
    """A grey step along rows or columns: exact where the direction is followed."""
    step = np.where(np.arange(SHAPE[axis]) < SHAPE[axis] // 2, 0.2, 0.8).astype(np.float32)
    grey = np.broadcast_to(step[:, None] if axis == 0 else step, SHAPE)
    image = np.stack([grey + 0.1, grey, grey - 0.1], axis=-1)
    np.testing.assert_allclose(inside(run(name, mosaic_of(image)), 8), inside(image, 8), atol=1e-6)


def test_directed_algorithms_beat_bilinear_on_a_photograph():
    image = photograph()

    def psnr(name):
        got = run(name, mosaic_of(image).astype(np.float32))
        return -10 * np.log10(np.mean((inside(got, 8) - inside(image, 8)) ** 2))

    bilinear = psnr("demosaic_bilinear")
    for name in set(NAMES) - {"bilinear", "edge_aware", "dcb"}:
        assert psnr(f"demosaic_{name}") > bilinear + 2, name
    assert psnr("demosaic_ahd") > psnr("demosaic_hibbard")


@pytest.mark.parametrize("name", ALGORITHMS)
def test_measured_samples_are_kept(name):
    mosaic = smooth_image(SHAPE).astype(np.float32)
    np.testing.assert_allclose(mosaic_of(run(name, mosaic)), mosaic, atol=2e-7)


@pytest.mark.parametrize("name", ALGORITHMS)
def test_cropping_shifts_the_pattern(name):
    height, width = SHAPE
    mosaic = smooth_image((height + 1, width + 1)).astype(np.float32)
    whole = run(name, mosaic[:-1, :-1])
    for rows, columns in ((1, 0), (0, 1), (1, 1)):
        part = mosaic[rows : rows + height, columns : columns + width]
        got = run(name, part, cfa=shifted("RGGB", rows, columns))
        want = whole[rows:, columns:]
        got = got[: height - rows, : width - columns]
        np.testing.assert_allclose(inside(got, 12), inside(want, 12), atol=1e-6)


@pytest.mark.parametrize("name", ALGORITHMS)
def test_border_is_the_mirrored_mosaic(name, x64):
    """Demosaicking what was mirrored beforehand gives the same, up to the border."""
    mosaic = smooth_image(SHAPE)
    want = inside(run(name, np.pad(mosaic, 16, mode="reflect")), 16)
    np.testing.assert_allclose(run(name, mosaic), want, atol=1e-12)


@pytest.mark.parametrize("shape", [pytest.param((5, 6), marks=pytest.mark.slow), (2, 2), (1, 4)])
@pytest.mark.parametrize("name", ALGORITHMS)
def test_tiny_mosaics(name, shape):
    got = run(name, smooth_image(shape).astype(np.float32))
    assert got.shape == (*shape, 3)
    assert np.isfinite(got).all()


@pytest.mark.parametrize("name", ALGORITHMS)
def test_unknown_pattern_is_refused(name):
    with pytest.raises(ValueError, match="RGBG"):
        stage(name, cfa="RGBG")({}, jnp.zeros(SHAPE))


def test_options_out_of_range_are_refused():
    with pytest.raises(ValueError, match="delta"):
        stage("demosaic_ahd", delta=0)({}, jnp.zeros(SHAPE))
    with pytest.raises(ValueError, match="passes"):
        stage("color_difference_median", passes=-1)({}, jnp.zeros((*SHAPE, 3)))


# ---- against OpenCV, and the papers in plain loops


@pytest.mark.parametrize("cfa", PATTERNS)
@pytest.mark.parametrize("name, code", [("bilinear", ""), ("edge_aware", "_EA")])
def test_matches_opencv_inside(name, code, cfa):
    """Its 16 bits round each result; a scale that is a power of two leaves ties as they are."""
    mosaic = np.round(40000 * mosaic_of(photograph(), cfa)).astype(np.uint16)
    want = cv2.demosaicing(mosaic, getattr(cv2, f"COLOR_Bayer{cfa}2RGB{code}")) / 65536
    got = run(f"demosaic_{name}", mosaic.astype(np.float32) / 65536, cfa=cfa)
    np.testing.assert_allclose(inside(got, 2), inside(want, 2), atol=1.01 / 65536)


def test_vng_is_nearer_to_opencv_than_any_other_is():
    """OpenCV's takes 8 bits and averages interpolated neighbours: the family, not the same algorithm."""
    mosaic = np.round(255 * mosaic_of(photograph()) ** 0.45).astype(np.uint8)
    want = inside(cv2.demosaicing(mosaic, cv2.COLOR_BayerRGGB2RGB_VNG) / 255, 4)
    error = {
        n: np.mean((inside(run(f"demosaic_{n}", mosaic / np.float32(255)), 4) - want) ** 2) for n in NAMES
    }
    assert error.pop("vng") < 0.5 * min(error.values())


def test_hamilton_adams_in_loops(x64):
    mosaic = mosaic_of(photograph())[: SHAPE[0], : SHAPE[1]]
    p = np.pad(mosaic, 3, mode="reflect")
    at = np.asarray(masks(p.shape, shifted("RGGB", 1, 1))[1])
    full = p.copy()
    for y in range(2, p.shape[0] - 2):
        for x in range(2, p.shape[1] - 2):
            if at[y, x]:
                continue
            ends = [(p[y, x - 1], p[y, x + 1], p[y, x - 2] + p[y, x + 2]),
                    (p[y - 1, x], p[y + 1, x], p[y - 2, x] + p[y + 2, x])]  # fmt: skip
            costs = [abs(a - b) + abs(2 * p[y, x] - far) for a, b, far in ends]
            guesses = [(a + b) / 2 + (2 * p[y, x] - far) / 4 for a, b, far in ends]
            full[y, x] = np.mean(guesses) if costs[0] == costs[1] else guesses[int(costs[1] < costs[0])]
    got = run("demosaic_hamilton_adams", mosaic)
    np.testing.assert_allclose(got[..., 1], full[3:-3, 3:-3], atol=1e-12)


# ---- Zhang & Wu 2005 in arrays, far from the border of a mirrored mosaic


def lmmse_by_arrays(mosaic, cfa):
    margin = 24
    x = np.pad(mosaic, margin, mode="reflect")
    red, green, blue = (np.asarray(m) for m in masks(x.shape, shifted(cfa, margin, margin)))
    gaussian = np.exp(-(np.arange(-4, 5.0) ** 2) / 8)
    estimates = []
    for axis in (1, 0):
        other = ndi.correlate1d(x, [-0.25, 0.5, 0.5, 0.5, -0.25], axis=axis)
        noisy = np.where(green, x - other, other - x)  # of green and the line's other colour
        mean = ndi.correlate1d(noisy, gaussian / gaussian.sum(), axis=axis)
        average = ndi.uniform_filter1d(mean, 9, axis=axis)
        signal = ndi.uniform_filter1d(mean**2, 9, axis=axis) - average**2 + 1e-7
        noise = ndi.uniform_filter1d((noisy - mean) ** 2, 9, axis=axis) + 1e-7
        estimates.append(
            (mean + signal / (signal + noise) * (noisy - mean), signal * noise / (signal + noise))
        )
    (rows, off_rows), (columns, off_columns) = estimates
    known = np.where(green, 0, -(off_columns * rows + off_rows * columns) / (off_rows + off_columns))
    corners, cross = np.zeros((3, 3)), np.zeros((3, 3))
    corners[::2, ::2] = 0.25
    cross[1, ::2] = cross[::2, 1] = 0.25
    planes = []
    for own in (red, blue):
        there = np.where(own, known, ndi.correlate(known, corners))
        planes.append(np.where(green, ndi.correlate(there, cross), there))
    g = x - known
    return inside(np.stack([g + planes[0], g, g + planes[1]], -1), margin)


@pytest.mark.parametrize("cfa", ["RGGB", "GBRG"])
def test_lmmse_matches_the_papers_equations(cfa, x64):
    mosaic = mosaic_of(photograph(), cfa)[: SHAPE[0], : SHAPE[1]]
    got = run("demosaic_lmmse", mosaic, cfa=cfa)
    np.testing.assert_allclose(got, lmmse_by_arrays(mosaic, cfa), atol=1e-10)


# ---- what RCD's description promises


def test_rcd_follows_an_edge(x64):
    """On a step between rows green follows the rows, where nothing changes."""
    step = np.where(np.arange(24) < 12, 0.2, 0.8)
    mosaic = np.broadcast_to(step[:, None], (24, 24)).copy()
    mosaic[:, ::2] += (
        0.01  # columns are not quite flat, and so rows are not followed for want of any contrast
    )
    got = run("demosaic_rcd", mosaic)
    across = np.ptp(got[:, 8:-8, 1], axis=1)
    assert across.max() < 0.02, "green follows the rows of the step"


@pytest.mark.parametrize("name", ["rcd", "lmmse", "ppg", "dcb"])
def test_gains_go_through(name, x64):
    """Twice the light is twice the picture, but for the terms that keep quotients finite."""
    mosaic = mosaic_of(photograph())[: SHAPE[0], : SHAPE[1]] + 0.05
    one, two = (run(f"demosaic_{name}", gain * mosaic) for gain in (1.0, 2.0))
    np.testing.assert_allclose(two, 2 * one, atol=2e-3)


@pytest.mark.parametrize("name", ["ahd", "menon", "ppg", "dcb", "rcd", "lmmse"])
def test_ties_are_decided_alike_in_a_larger_frame(name):
    """Samples of few levels, whose ties are decided by how sums are rounded: of the mirror image beyond the
    picture too."""
    node, extent = stage(f"demosaic_{name}"), Extent(jnp.int32(41), jnp.int32(52))
    rng, rows, columns = np.random.default_rng(0), np.arange(41)[:, None], np.arange(52)
    smooth = 0.5 + 0.3 * np.sin(columns / 5) * np.cos(rows / 4)
    noisy = np.clip(smooth + 0.05 * rng.standard_normal((24, 41, 52)), 0, 1)
    mosaics = (np.round(noisy * 255) / 255).astype(np.float32)
    frames = np.pad(mosaics, [(0, 0), (0, 23), (0, 20)], constant_values=0.7)
    alone = jax.jit(jax.vmap(lambda x: node({}, x)))(mosaics)
    framed = jax.jit(jax.vmap(lambda x: node({}, x, extent=extent)))(frames)
    np.testing.assert_array_equal(framed[:, :41, :52], alone)
