"""JPEG against Pillow (libjpeg-turbo), bit for bit; gradients by what they are for."""

import functools
import io

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from PIL import Image, JpegPresets

from jaxisp.jpeg.tables import PHOTOSHOP_CHROMA, PHOTOSHOP_LUMA, quality_tables
from jaxisp.stages.jpeg import Jpeg, JpegPhotoshop, JpegTables, jpeg, jpeg_photoshop, jpeg_tables
from jaxisp.testing import smooth_image
from tests.gradients import both_modes

SAMPLINGS = ("4:4:4", "4:2:2", "4:2:0")


def picture(shape: tuple[int, int], kind: str = "smooth") -> np.ndarray:
    """An 8-bit picture: ordinary, noise, or noise of black and white alone."""
    if kind == "smooth":
        return np.round(smooth_image((*shape, 3), 1) * 255).astype(np.uint8)
    noise = np.random.default_rng(0).integers(0, 256, (*shape, 3), np.uint8)
    return noise if kind == "noise" else (noise > 127).astype(np.uint8) * 255


def pillow(image: np.ndarray, subsampling: str, **options) -> np.ndarray:
    with io.BytesIO() as file:
        Image.fromarray(image).save(file, "JPEG", subsampling=SAMPLINGS.index(subsampling), **options)
        return np.asarray(Image.open(file).convert("RGB"))


def floats(image: np.ndarray) -> np.ndarray:
    return (image / 255).astype(np.float32)


def levels(image) -> np.ndarray:
    whole = np.asarray(image, np.float64) * 255
    assert np.abs(whole - np.round(whole)).max() < 1e-4
    return np.round(whole).astype(np.uint8)


@functools.cache
def by_quality(subsampling: str):
    """Compiled: qualities (N,) and one image to N images."""

    def one(quality, image):
        return jpeg(Jpeg(quality=quality), image, subsampling=subsampling)

    return jax.jit(jax.vmap(one, in_axes=(0, None)))


@pytest.mark.optimised
@pytest.mark.parametrize("subsampling", SAMPLINGS)
@pytest.mark.parametrize("kind", ["smooth", "noise", "binary"])
def test_every_quality_is_pillows(subsampling, kind):
    image, qualities = picture((21, 34), kind), np.arange(1, 101)
    got = levels(by_quality(subsampling)(qualities.astype(np.float32), floats(image)))
    want = [pillow(image, subsampling, quality=int(q)) for q in qualities]
    np.testing.assert_array_equal(got, want)


SHAPES = ((1, 1), (1, 35), (2, 19), (7, 9), (9, 4), (17, 5), (17, 33))
# rows of chroma are halved as columns are: of the finer two one size of several blocks, and one of one
ENOUGH = {"4:2:0": SHAPES, "4:2:2": ((7, 9), (17, 5)), "4:4:4": ((7, 9), (17, 5))}


@pytest.mark.parametrize(
    ("shape", "subsampling"),
    [
        pytest.param(shape, name, marks=[pytest.mark.slow] * (shape not in ENOUGH[name]))
        for shape in SHAPES
        for name in SAMPLINGS
    ],
)
def test_every_size_is_pillows(subsampling, shape):
    qualities = np.array([1, 30, 75, 98])
    image = picture(shape, "noise")
    got = levels(by_quality(subsampling)(qualities.astype(np.float32), floats(image)))
    np.testing.assert_array_equal(got, [pillow(image, subsampling, quality=int(q)) for q in qualities])


@pytest.mark.optimised
@pytest.mark.parametrize("subsampling", SAMPLINGS)
def test_custom_tables_are_pillows(subsampling, rng):
    """Another picture and other tables in each place of a batch."""
    run = jax.jit(jax.vmap(functools.partial(jpeg_tables, subsampling=subsampling)))
    tables = np.stack([rng.integers(low, high + 1, (2, 8, 8)) for low, high in ((1, 3), (1, 255), (20, 60))])
    images = np.stack([picture((30, 41), kind) for kind in ("smooth", "noise", "binary")])
    luma, chroma = np.moveaxis(tables, 1, 0).astype(np.float32)
    got = run(JpegTables(luma_table=luma, chroma_table=chroma), floats(images))
    want = [pillow(i, subsampling, qtables=t.reshape(2, 64).tolist()) for i, t in zip(images, tables)]
    np.testing.assert_array_equal(levels(got), want)


def test_coarsest_tables_on_the_strongest_pictures_are_exact():
    """Where the sums inside are largest: blocks made of one basis function each, full swing."""
    y, x, v, u = np.ogrid[:8, :8, :8, :8]
    waves = np.cos((2 * y + 1) * v * np.pi / 16) * np.cos((2 * x + 1) * u * np.pi / 16) >= 0
    image = (255 * waves.transpose(2, 0, 3, 1).reshape(64, 64, 1).repeat(3, 2)).astype(np.uint8)
    run = jax.jit(jax.vmap(functools.partial(jpeg_tables, subsampling="4:4:4"), in_axes=(0, None)))
    steps = np.array([1, 7, 128, 200, 255])
    tables = np.broadcast_to(steps[:, None, None], (5, 8, 8))
    got = run(JpegTables(luma_table=np.float32(tables), chroma_table=np.float32(tables)), floats(image))
    want = [pillow(image, "4:4:4", qtables=[t.ravel().tolist()] * 2) for t in tables]
    np.testing.assert_array_equal(levels(got), want)


def test_without_compilation_it_is_pillows():
    image = picture((7, 9))
    got = jpeg(Jpeg(quality=jnp.float32(50)), jnp.asarray(floats(image)), subsampling="4:4:4")
    np.testing.assert_array_equal(levels(got), pillow(image, "4:4:4", quality=50))


def test_photoshop_levels_are_pillows_with_their_tables():
    run = jax.jit(jax.vmap(lambda level, x: jpeg_photoshop(JpegPhotoshop(level=level), x), in_axes=(0, None)))
    image = picture((21, 34))
    got = levels(run(np.arange(13, dtype=np.float32), floats(image)))
    for level in range(13):
        tables = [t[level].ravel().tolist() for t in (PHOTOSHOP_LUMA, PHOTOSHOP_CHROMA)]
        want = pillow(image, "4:2:0" if level < 7 else "4:4:4", qtables=tables)
        np.testing.assert_array_equal(got[level], want)


def test_photoshop_tables_are_the_known_ones():
    """Pillow ships four of the levels; GIMP's sums over luma and chroma are known for all thirteen."""
    for name, level in {"low": 3, "medium": 5, "high": 8, "maximum": 10}.items():
        luma, chroma = JpegPresets.presets[name]["quantization"]
        np.testing.assert_array_equal(PHOTOSHOP_LUMA[level].ravel(), luma)
        np.testing.assert_array_equal(PHOTOSHOP_CHROMA[level].ravel(), chroma)
    sums = [1582, 1484, 1281, 1068, 962, 844, 717, 786, 649, 539, 406, 232, 95]
    assert PHOTOSHOP_LUMA.sum((1, 2)).tolist() == sums
    sums = [1108, 1083, 998, 941, 892, 849, 782, 926, 853, 801, 722, 443, 166]
    assert PHOTOSHOP_CHROMA.sum((1, 2)).tolist() == sums


def test_quality_tables_are_those_in_pillows_files():
    for quality in range(1, 101):
        with io.BytesIO() as file:
            Image.new("RGB", (8, 8)).save(file, "JPEG", quality=quality)
            stored = Image.open(file).quantization
        for got, want in zip(quality_tables(quality), (stored[0], stored[1])):
            np.testing.assert_array_equal(got.ravel(), want)
    with pytest.raises(ValueError, match="quality"):
        quality_tables(0)


@pytest.mark.parametrize("subsampling, margin", [("4:4:4", 8), ("4:2:0", 18)])
def test_phase_places_a_crop_on_the_grid_of_its_file(subsampling, margin):
    """Away from the cut edges, a crop with its phase decodes to the crop of the whole file."""
    whole = picture((64, 80))
    decoded = pillow(whole, subsampling, quality=60)
    params, crop = Jpeg(quality=np.float32(60)), floats(whole[5:, 11:])
    run = jax.jit(functools.partial(jpeg, subsampling=subsampling, row_phase=5, column_phase=11))
    inside = np.s_[margin:, margin:]
    np.testing.assert_array_equal(levels(run(params, crop))[inside], decoded[5:, 11:][inside])
    unaware = levels(by_quality(subsampling)(np.float32([60]), crop))[0]
    assert (unaware[inside] != decoded[5:, 11:][inside]).any()


def test_second_compression_on_another_grid_is_pillows():
    """A file decoded, cropped off its grid and saved again, as the stage twice: the first with a phase."""
    whole = picture((64, 80))
    cropped = pillow(whole, "4:4:4", quality=40)[5:, 11:]
    twice = pillow(cropped, "4:4:4", quality=85)

    @jax.jit
    def run(first, second, image):
        once = jpeg(Jpeg(quality=first), image, subsampling="4:4:4", row_phase=5, column_phase=11)
        return jpeg(Jpeg(quality=second), once, subsampling="4:4:4")

    got = levels(run(np.float32(40), np.float32(85), floats(whole[5:, 11:])))
    np.testing.assert_array_equal(got[8:, 8:], twice[8:, 8:])
    assert (pillow(whole[5:, 11:], "4:4:4", quality=85)[8:, 8:] != twice[8:, 8:]).any()


def test_input_is_clipped_and_rounded_like_an_encoders():
    image = smooth_image((9, 14, 3)).astype(np.float32) * 1.4 - 0.2
    want = pillow(np.round(image.clip(0, 1) * 255).astype(np.uint8), "4:2:0", quality=75)
    np.testing.assert_array_equal(levels(by_quality("4:2:0")(np.float32([75]), image))[0], want)


@pytest.mark.parametrize(
    "coder",
    [
        functools.partial(jpeg, Jpeg(quality=jnp.float32(60))),
        functools.partial(jpeg, Jpeg(quality=jnp.float32(60)), row_phase=5, column_phase=11),
        functools.partial(jpeg_photoshop, JpegPhotoshop(level=jnp.float32(6))),
        functools.partial(jpeg_tables, JpegTables(), subsampling="4:4:4"),
    ],
)
def test_nan_stays_nan(coder):
    """The integers of the coder would make a level of it; all other pixels are those of a black one there."""
    image = floats(picture((64, 80)))
    bad = image.copy()
    bad[3, 70, 1], image[3, 70] = np.nan, 0
    run = jax.jit(jax.vmap(coder))
    got, want = np.asarray(run(np.stack([bad, image])))
    assert np.isnan(got[3, 70]).all() and np.isnan(got).any(-1).sum() == 1
    known = ~np.isnan(got)
    np.testing.assert_array_equal(got[known], want[known])


def test_double_precision_gives_the_same_pixels(x64):
    image = picture((21, 34))
    got = jax.jit(jpeg)(Jpeg(quality=jnp.float64(60)), jnp.asarray(image / 255))
    assert got.dtype == jnp.float64
    np.testing.assert_array_equal(levels(got), pillow(image, "4:2:0", quality=60))


@functools.cache
def quality_error(true: float):
    """Compiled: a quality to the error against the picture at the true quality, and its slope."""
    image = floats(picture((64, 80)))
    target = by_quality("4:4:4")(np.float32([true]), image)[0]

    def error(quality):
        return jnp.mean((jpeg(Jpeg(quality=quality), image, subsampling="4:4:4") - target) ** 2)

    return jax.jit(jax.value_and_grad(error))


@pytest.mark.parametrize("start", [10, 50, 75])
def test_quality_is_found_by_gradient(start):
    """Signed steps that shrink, the best seen kept: the error over quality is rough on a small picture."""
    quality, seen = jnp.float32(start), []
    for i in range(60):
        error, slope = quality_error(60.0)(quality)
        seen.append((float(error), round(float(quality))))
        quality = jnp.clip(quality - 3 * 0.96**i * jnp.sign(slope), 1, 100)
    assert min(seen)[0] < 1e-12 and min(seen)[1] == 60


def test_quality_gradient_points_the_way():
    """Below the true quality it points up everywhere; above, near by, down."""
    slopes = {q: float(quality_error(60.0)(jnp.float32(q))[1]) for q in (*range(10, 59, 6), 62, 66, 70)}
    assert all((slope < 0) == (q < 60) for q, slope in slopes.items()), slopes


def test_image_is_found_through_jpeg_by_gradient():
    """Descending through the code makes an image whose JPEG is nearer to the target's."""
    target = floats(pillow(picture((32, 40)), "4:2:0", quality=80))
    through = functools.partial(jpeg, Jpeg(quality=jnp.float32(80)))
    step = jax.jit(jax.value_and_grad(lambda x: jnp.sum((through(x) - target) ** 2)))
    image, errors = jnp.full_like(target, 0.5), []
    for _ in range(40):
        error, gradient = step(image)
        errors.append(float(error))
        image = image - 0.2 * gradient
    assert errors[-1] < 0.01 * errors[0]


def test_image_gradient_is_straight_through_without_subsampling():
    image = floats(picture((16, 24))) * 0.5 + 0.25
    weights = np.random.default_rng(0).standard_normal(image.shape).astype(np.float32)
    params = Jpeg(quality=jnp.float32(95))
    gradient = jax.jit(jax.grad(lambda x: jnp.sum(jpeg(params, x, subsampling="4:4:4") * weights)))(image)
    np.testing.assert_allclose(gradient, weights, atol=1e-5)


def test_forward_and_reverse_mode_agree():
    rng = np.random.default_rng(0)
    image = jnp.asarray(floats(picture((18, 27))))
    d_image, weights = (jnp.asarray(rng.standard_normal(image.shape), jnp.float32) for _ in range(2))

    @jax.jit
    def both(quality):
        def fn(quality, x):
            return jpeg(Jpeg(quality=quality), x)

        _, change, slopes = both_modes(fn, (quality, image), (jnp.float32(1), d_image), weights)
        return jnp.vdot(change, weights), slopes[0] + jnp.vdot(slopes[1], d_image), slopes[0]

    forward, reverse, to_quality = both(jnp.float32(60))
    np.testing.assert_allclose(forward, reverse, rtol=1e-4)
    assert to_quality != 0


def test_table_gradient_follows_the_error():
    """Averaged over many blocks, the surrogate's slope is that of the coding error itself."""
    rng = np.random.default_rng(0)
    image = jnp.asarray((0.5 + 0.1 * rng.standard_normal((160, 160, 1))).clip(0, 1).repeat(3, 2), jnp.float32)

    def error(step):
        table = jnp.full((8, 8), step)
        out = jpeg_tables(JpegTables(luma_table=table, chroma_table=table), image, subsampling="4:4:4")
        return jnp.sum((out - image) ** 2)

    got = float(jax.jit(jax.grad(error))(jnp.float32(14)))
    value = jax.jit(error)
    want = float(value(jnp.float32(18)) - value(jnp.float32(10))) / 8
    assert 0.6 < got / want < 1.4


def test_wrong_options_are_refused():
    image = floats(picture((9, 14)))
    with pytest.raises(ValueError, match="subsampling"):
        jpeg(Jpeg(), image, subsampling="4:1:1")
    with pytest.raises(ValueError, match="subsampling"):
        jpeg_photoshop(JpegPhotoshop(), image, subsampling="4:1:1")
    with pytest.raises(ValueError, match="phases"):
        jpeg_tables(JpegTables(), image, row_phase=16)
