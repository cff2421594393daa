"""Demosaicking of X-Trans against LibRaw, closed forms and SciPy."""

import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import rawpy
import scipy.ndimage as ndi
import skimage.data

from jaxisp.cfa import PATTERNS, XTRANS, is_xtrans, masks, shifted, size
from jaxisp.color import SRGB_TO_XYZ
from jaxisp.io.dng import write_dng
from jaxisp.pipeline import Chain, run, run_in_strips, stage
from jaxisp.stages.choice import XTRANS_DEMOSAICKERS, Demosaicking
from jaxisp.testing import smooth_image
from tests.stages.test_demosaic import inside, mosaic_of

FULL = 65535
PHASES = [shifted(XTRANS, *by) for by in np.ndindex(6, 3)]
MARKESTEIJN = "demosaic_markesteijn"
LINEAR = "demosaic_normalized_convolution"


@functools.cache
def compiled(name, **static):
    node = stage(name, **static)
    return jax.jit(lambda image: node({}, image))


def demosaicked(name, mosaic, **static):
    return np.asarray(compiled(name, **static)(jnp.asarray(mosaic)))


def decibels(error):
    return float(-10 * np.log10(np.mean(np.square(error))))


# ---- the pattern


@pytest.mark.parametrize("cfa", [*PATTERNS, *PHASES])
def test_masks_repeat_the_cell(cfa):
    n = size(cfa)
    cell = np.array(list(cfa)).reshape(n, n)
    for shape in ((7, 20), (1, 3)):
        y, x = np.indices(shape)
        for color, mask in zip("RGB", masks(shape, cfa)):
            np.testing.assert_array_equal(mask, cell[y % n, x % n] == color)
    moved = np.array(list(shifted(cfa, 5, 4))).reshape(n, n)
    np.testing.assert_array_equal(moved, np.roll(cell, (-5, -4), (0, 1)))


def test_what_is_xtrans():
    assert len(set(PHASES)) == 18
    assert all(map(is_xtrans, PHASES))
    # its mirror image and its transpose are itself in other phases; with two filters swapped it is not
    cell = np.array(list(XTRANS)).reshape(6, 6)
    assert all(is_xtrans("".join(c.ravel())) for c in (cell[::-1], cell[:, ::-1], cell.T))
    swapped = XTRANS[1] + XTRANS[0] + XTRANS[2:]
    for wrong in (swapped, "RGGB", XTRANS[:-1], ""):
        assert not is_xtrans(wrong)
    with pytest.raises(ValueError, match=r"mosaic: option cfa must be .*X-Trans"):
        stage("mosaic", cfa=swapped)


BAYER_ONLY = [
    "green_imbalance",
    "defect_correction",
    *(f"demosaic_{n}" for n in ("ahd", "bilinear", "edge_aware", "hamilton_adams")),
    *(f"demosaic_{n}" for n in ("hibbard", "malvar", "menon", "vng")),
]


@pytest.mark.parametrize("name", BAYER_ONLY)
def test_bayer_stages_refuse_xtrans_when_they_are_made(name):
    with pytest.raises(ValueError, match=f"^{name}: option cfa must be one of RGGB.*{MARKESTEIJN}"):
        stage(name, cfa=XTRANS)
    with pytest.raises(ValueError, match="X-Trans"):
        node = stage(name)
        params = [v for v in node.init().values()]
        node.fn(*params, jnp.zeros((12, 12)), cfa=XTRANS)


def test_markesteijn_refuses_what_it_does_not_take():
    with pytest.raises(ValueError, match=r"must be X-Trans.*demosaic_ahd.*'RGGB'"):
        stage(MARKESTEIJN, cfa="RGGB")
    for passes in (0, 2):
        with pytest.raises(ValueError, match="1 or 3"):
            stage(MARKESTEIJN, passes=passes)({}, jnp.zeros((12, 12)))
    with pytest.raises(ValueError, match="6 x 6"):
        stage(MARKESTEIJN)({}, jnp.zeros((5, 12)))


def test_white_balance_goes_by_the_filters():
    rgb = smooth_image((13, 20, 3)).astype(np.float32)
    gains = np.float32([2, 1, 1.5])
    chain = Chain((stage("mosaic", cfa=PHASES[7]), stage("mosaic_white_balance", cfa=PHASES[7])))
    params = chain.init()
    params["mosaic_white_balance"] = type(params["mosaic_white_balance"])(gains=gains)
    np.testing.assert_allclose(run(chain, params, rgb), mosaic_of(rgb * gains, PHASES[7]), rtol=1e-6)


# ---- Markesteijn


@functools.cache
def libraws(cfa, algorithm, folder):
    """LibRaw takes 512 x 512 pixels at least. It has 1 pass where PPG is asked for, and 3 with AHD."""
    picture = 0.9 * (skimage.data.astronaut() / 255.0) ** 2.2
    pixels = np.round(FULL * mosaic_of(picture, cfa)).astype(np.uint16)
    # the camera's colours are linear sRGB, which is what ours takes them for
    matrix = np.linalg.inv(SRGB_TO_XYZ)
    path = write_dng(folder / f"{cfa}.dng", pixels, cfa=cfa, black=[0], white=FULL, color_matrix=matrix)
    with rawpy.imread(str(path)) as raw:
        names = np.array(list(raw.color_desc.decode()))
        assert "".join(names[raw.raw_pattern].ravel()) == cfa
        theirs = raw.postprocess(
            demosaic_algorithm=algorithm,
            gamma=(1, 1),
            no_auto_bright=True,
            adjust_maximum_thr=0.0,
            output_color=rawpy.ColorSpace.raw,
            output_bps=16,
            user_wb=[1, 1, 1, 1],
        )
    return picture, pixels / FULL, theirs / FULL


@pytest.mark.parametrize("phase", [(0, 0), (2, 4)])
def test_is_libraws_markesteijn(phase, tmp_path_factory):
    """54 dB and more in either number of passes, and much less in the other. What is left are near-ties that
    LibRaw's 16-bit arithmetic decides the other way."""
    folder, cfa = tmp_path_factory.getbasetemp(), shifted(XTRANS, *phase)
    rows, columns = slice(18, 210), slice(150, 350)
    own = shifted(cfa, rows.start, columns.start)
    theirs, ours = {}, {}
    for passes, algorithm in ((1, rawpy.DemosaicAlgorithm.PPG), (3, rawpy.DemosaicAlgorithm.AHD)):
        picture, mosaic, found = libraws(cfa, algorithm, folder)
        theirs[passes] = inside(found[rows, columns], 9)
        part = np.float32(mosaic[rows, columns])
        ours[passes] = inside(demosaicked(MARKESTEIJN, part, cfa=own, passes=passes), 9)
    truth = inside(picture[rows, columns], 9)
    for passes, other in ((1, 3), (3, 1)):
        agreement = decibels(ours[passes] - theirs[passes])
        assert agreement > 54
        assert agreement > decibels(ours[other] - theirs[passes]) + 3
        # as near to the truth as LibRaw's, and much nearer than linear interpolation
        assert decibels(ours[passes] - truth) > decibels(theirs[passes] - truth) - 0.05
    linear = inside(demosaicked(LINEAR, part, cfa=own), 9)
    assert decibels(ours[3] - truth) > decibels(linear - truth) + 4


@pytest.mark.parametrize("name", [MARKESTEIJN, LINEAR])
def test_a_flat_colour_stays_what_it_is_in_every_phase(name):
    """Borders included, at sizes that are no multiple of the cell."""
    color = np.float32([0.2, 0.5, 0.9])
    static = {"passes": 1} if name == MARKESTEIJN else {}
    for cfa, shape in zip((PHASES[1], PHASES[8], PHASES[15]), ((6, 6), (13, 8), (7, 19))):
        flat = np.broadcast_to(color, (*shape, 3))
        got = demosaicked(name, mosaic_of(flat, cfa), cfa=cfa, **static)
        np.testing.assert_allclose(got, flat, atol=1e-6)


def test_unclipped_it_takes_samples_of_any_range():
    color = np.float32([-0.5, 1.5, 2.5])
    flat = np.broadcast_to(color, (8, 9, 3))
    got = demosaicked(MARKESTEIJN, mosaic_of(flat, XTRANS), passes=1, clipped=False)
    np.testing.assert_allclose(got, flat, atol=1e-6)
    kept = demosaicked(MARKESTEIJN, mosaic_of(flat, XTRANS), passes=1)
    np.testing.assert_allclose(np.unique(kept[..., 0]), (-0.5, 0), atol=1e-6)


def test_the_transposed_mosaic_gives_the_transposed_picture():
    """Borders included: rows are treated as columns are."""
    cfa, mosaic = PHASES[4], smooth_image((21, 34)).astype(np.float32)
    turned = "".join(np.array(list(cfa)).reshape(6, 6).T.ravel())
    got = demosaicked(MARKESTEIJN, mosaic.T, cfa=turned, passes=1)
    want = demosaicked(MARKESTEIJN, mosaic, cfa=cfa, passes=1)
    np.testing.assert_allclose(got, want.transpose(1, 0, 2), atol=1e-6)


def test_measured_samples_stay():
    mosaic = smooth_image((21, 34), 3, -0.2, 1.4).astype(np.float32)
    for name, static in ((MARKESTEIJN, {"passes": 1}), (LINEAR, {"cfa": XTRANS})):
        got = demosaicked(name, mosaic, **static)
        np.testing.assert_allclose(mosaic_of(got, XTRANS), mosaic, atol=1e-6)


def test_the_gradient_is_that_of_the_choices_made(x64):
    """Away from ties it is the derivative: differences in double precision."""
    node = stage(MARKESTEIJN, passes=1)
    mosaic = smooth_image((15, 18))
    direction = np.random.default_rng(0).standard_normal((2, *mosaic.shape))
    weights = np.random.default_rng(1).standard_normal((*mosaic.shape, 3))

    both = jax.jit(jax.value_and_grad(lambda m: jnp.sum(weights * node({}, m))))
    gradient = both(mosaic)[1]
    for d in direction:
        up, down = (float(both(mosaic + h * d)[0]) for h in (1e-7, -1e-7))
        np.testing.assert_allclose(np.sum(gradient * d), (up - down) / 2e-7, rtol=1e-5)


def test_a_camera_is_the_same_in_strips():
    """Strips begin where a cell of 6 rows does, and a block of the encoder."""
    nodes = [stage(name, cfa=PHASES[5]) for name in ("mosaic", "mosaic_white_balance")]
    nodes += [stage(MARKESTEIJN, cfa=PHASES[5], passes=1), stage("clip"), stage("srgb_oetf"), stage("jpeg")]
    chain = Chain(tuple(nodes))
    params = chain.init()
    balance = params["mosaic_white_balance"]
    params["mosaic_white_balance"] = type(balance)(gains=np.float32([1.6, 1, 1.3]))
    image = smooth_image((230, 16, 3), 1, 0.05, 0.6).astype(np.float32)
    whole = run(chain, params, image)
    np.testing.assert_allclose(run_in_strips(chain, params, image, rows=16), whole, atol=1e-5)


# ---- normalised convolution


@pytest.mark.parametrize("cfa", ["GRBG", PHASES[10]])
def test_is_a_normalised_convolution(cfa):
    mosaic = smooth_image((14, 19), 2).astype(np.float32)
    tent = np.array([1, 2, 1] if size(cfa) == 2 else [1, 2, 3, 2, 1], float)
    got = demosaicked(LINEAR, mosaic, cfa=cfa)
    for channel, mask in enumerate(np.asarray(m, float) for m in masks(mosaic.shape, cfa)):
        near = [ndi.convolve(x, np.outer(tent, tent), mode="constant") for x in (mask * mosaic, mask)]
        np.testing.assert_allclose(got[..., channel], np.where(mask, mosaic, near[0] / near[1]), atol=1e-6)


@pytest.mark.parametrize("cfa", PATTERNS)
def test_is_bilinear_on_bayer(cfa):
    mosaic = smooth_image((13, 16)).astype(np.float32)
    got, want = (inside(demosaicked(name, mosaic, cfa=cfa), 1) for name in (LINEAR, "demosaic_bilinear"))
    np.testing.assert_allclose(got, want, atol=1e-6)


def test_a_frame_without_a_colour_is_finite():
    for shape in ((1, 1), (1, 9), (2, 2)):
        assert np.isfinite(demosaicked(LINEAR, np.ones(shape, np.float32), cfa=XTRANS)).all()


# ---- the choice as a number


def test_demosaicking_chooses_among_those_of_the_pattern():
    mosaic = smooth_image((12, 15)).astype(np.float32)
    shares = np.zeros(8, np.float32)
    shares[list(XTRANS_DEMOSAICKERS).index("normalized-convolution")] = 0.25
    node = stage("demosaicking", cfa=XTRANS, algorithm="markesteijn-1")
    got = run(node, {"demosaicking": Demosaicking(shares=shares)}, mosaic)
    first, other = (demosaicked(MARKESTEIJN, mosaic, passes=1), demosaicked(LINEAR, mosaic, cfa=XTRANS))
    np.testing.assert_allclose(got, 0.75 * first + 0.25 * other, atol=1e-5)
    with pytest.raises(ValueError, match="'malvar' on X-Trans, expected markesteijn"):
        stage("demosaicking", cfa=XTRANS)({"demosaicking": Demosaicking()}, jnp.asarray(mosaic))
    with pytest.raises(ValueError, match="partner 'rcd' on X-Trans, expected markesteijn"):
        node = stage("demosaicking", cfa=XTRANS, algorithm="markesteijn", partner="rcd")
        node({"demosaicking": Demosaicking()}, jnp.asarray(mosaic))
