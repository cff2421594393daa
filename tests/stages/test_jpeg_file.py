"""JPEG of three tables, of RGB and in other colour spaces, against libjpeg and littleCMS."""

import functools
import io

import jax
import numpy as np
import pytest
from PIL import Image

from jaxisp.stages.jpeg import JpegTables, jpeg_tables
from jaxisp.stages.jpeg_file import JpegFile, jpeg_file
from tests.stages.test_jpeg import SAMPLINGS, floats, levels, picture


def libjpeg(image: np.ndarray, tables, **options) -> np.ndarray:
    out = io.BytesIO()
    Image.fromarray(image).save(out, "JPEG", qtables=np.reshape(tables, (-1, 64)).tolist(), **options)
    return np.asarray(Image.open(out))


@functools.cache
def coder(**static):
    return jax.jit(functools.partial(jpeg_file, converts=False, **static))


@pytest.mark.parametrize("subsampling", SAMPLINGS)
@pytest.mark.parametrize("shape", [(1, 1), (17, 5), pytest.param((30, 41), marks=pytest.mark.optimised)])
def test_three_tables_are_libjpegs(subsampling, shape, rng):
    run = coder(subsampling=subsampling)
    for most in (3, 60, 255, 2000):
        tables = rng.integers(1, most + 1, (3, 8, 8))
        for kind in ("smooth", "noise", "binary"):
            image = picture(shape, kind)
            got = run(JpegFile(tables=np.float32(tables)), floats(image))
            want = libjpeg(image, tables, subsampling=subsampling)
            np.testing.assert_array_equal(levels(got), want, err_msg=f"{most} {kind}")


@pytest.mark.optimised
@pytest.mark.parametrize("most", [1, 60, 255, 1000, 8191, 65535])
def test_coarse_tables_and_rgb_are_libjpegs(most, rng):
    """From 8192 on 8 q leaves libjpeg-turbo's 16 bits: where the rest is small its encoder is wrong."""
    image = picture((30, 41), "binary")
    tables = rng.integers(1, most + 1, (3, 8, 8))
    tables = np.where(8 * tables % 65536 < 32768, np.minimum(tables, 4095), tables)
    for components in ("YCbCr", "RGB"):
        got = coder(subsampling="4:4:4", components=components)(
            JpegFile(tables=np.float32(tables)), floats(image)
        )
        want = libjpeg(image, tables, subsampling=0, keep_rgb=components == "RGB")
        np.testing.assert_array_equal(levels(got), want, err_msg=components)


def test_alike_tables_are_the_stage_of_two_tables(rng):
    image, tables = picture((30, 41), "noise"), rng.integers(1, 80, (2, 8, 8)).astype(np.float32)
    got = jax.jit(jpeg_file)(JpegFile(tables=tables[[0, 1, 1]]), floats(image))
    want = jax.jit(jpeg_tables)(JpegTables(luma_table=tables[0], chroma_table=tables[1]), floats(image))
    np.testing.assert_allclose(got, want, atol=1e-6)


def test_wrong_options_are_refused():
    image = floats(picture((9, 14)))
    with pytest.raises(ValueError, match="subsampling"):
        jpeg_file(JpegFile(), image, subsampling="4:1:1")
    with pytest.raises(ValueError, match="components"):
        jpeg_file(JpegFile(), image, components="Lab")
