"""Sharpening that is cored and limited, and equalisation tile by tile."""

import cv2
import numpy as np
import pytest
import skimage.data

from jaxisp.color import luma, srgb_to_linear
from jaxisp.pipeline import run, stage
from jaxisp.stages.look import LocalToneMapping
from jaxisp.stages.smoothing import Sharpening
from jaxisp.testing import smooth_image


def sharpened(image, **fields):
    own = Sharpening(**{k: np.float32(v) for k, v in fields.items()})
    return np.asarray(run(stage("sharpening"), {"sharpening": own}, image))


def test_coring_and_limit_scale_the_detail():
    image = smooth_image((40, 48, 3)).astype(np.float32)
    y = np.asarray(luma(*np.moveaxis(image, -1, 0)))
    detail = y - cv2.GaussianBlur(y, (11, 11), 1.5, borderType=cv2.BORDER_REFLECT_101)
    for threshold, limit in ((0.0, 0.0), (0.02, 0.0), (0.0, 30.0), (0.01, 15.0)):
        share = detail**2 / (detail**2 + threshold**2 + 1e-12) / (1 + (limit * detail) ** 2)
        want = image + (0.8 * detail * share)[..., None]
        got = sharpened(image, amounts=[0, 0.8, 0], threshold=threshold, limit=limit)
        np.testing.assert_allclose(got, want, atol=2e-4)


def test_small_detail_is_left_alone_and_halos_are_bounded():
    step = np.where(np.arange(48) < 24, 0.2, 0.8) + 0.002 * np.random.default_rng(0).standard_normal((40, 48))
    image = np.repeat(step[..., None], 3, -1).astype(np.float32)
    plain = sharpened(image, amounts=[0, 2, 0]) - image
    shaped = sharpened(image, amounts=[0, 2, 0], threshold=0.02, limit=20.0) - image
    flat = np.s_[:, :12]
    assert np.abs(shaped[flat]).max() < 0.1 * np.abs(plain[flat]).max()
    assert np.abs(shaped).max() <= 2 * 0.5 / 20 + 1e-6 < np.abs(plain).max()


def equalised(picture, clip):
    """Of an 8-bit grey picture: encoded, in 8-bit steps."""
    light = np.repeat(srgb_to_linear(picture / 255.0)[..., None], 3, -1).astype(np.float32)
    own = LocalToneMapping(equalization=np.float32(1), clip=np.float32(clip))
    out = run(stage("local_tone_mapping"), {"local_tone_mapping": own}, light)
    return 255 * np.asarray(run(stage("srgb_oetf"), {}, out))[..., 1]


def by_loops(picture, clip, tiles=8):
    """Zuiderveld 1994, one tile and one level at a time."""
    size, tables = len(picture) // tiles, np.zeros((tiles, tiles, 256))
    for i, j in np.ndindex(tiles, tiles):
        tile = picture[i * size : (i + 1) * size, j * size : (j + 1) * size]
        counts = np.bincount(tile.ravel(), minlength=256).astype(float)
        most = clip * size**2 / 256
        counts = np.minimum(counts, most) + np.maximum(counts - most, 0).sum() / 256
        tables[i, j] = np.cumsum(counts) / size**2
    place = (np.arange(len(picture)) + 0.5) / size - 0.5
    first, share = np.floor(place).astype(int), place % 1
    out = np.zeros(picture.shape)
    for side, weight in ((0, 1 - share), (1, share)):
        for side_too, weight_too in ((0, 1 - share), (1, share)):
            rows, columns = (np.clip(first + s, 0, tiles - 1) for s in (side, side_too))
            out += np.outer(weight, weight_too) * tables[rows[:, None], columns, picture]
    return 255 * out


@pytest.mark.parametrize("clip", [2.0, 4.0])
def test_equalisation_is_zuidervelds(clip):
    picture = skimage.data.camera()[:256, :256]
    got, want = equalised(picture, clip), by_loops(picture, clip)
    assert np.sqrt(np.mean((got - want) ** 2)) < 1.2 < 15 < np.sqrt(np.mean((want - picture) ** 2))
    # which spreads what it clips over the lower levels first
    theirs = cv2.createCLAHE(clipLimit=clip, tileGridSize=(8, 8)).apply(picture)
    assert np.corrcoef((got - picture).ravel(), (theirs - picture.astype(float)).ravel())[0, 1] > 0.95


def test_contrast_raises_what_is_above_its_surround():
    image = smooth_image((64, 80, 3), 1).astype(np.float32)
    still = run(stage("local_tone_mapping"), {"local_tone_mapping": LocalToneMapping()}, image)
    np.testing.assert_array_equal(still, image)
    own = LocalToneMapping(contrast=np.float32(0.5))
    more = np.asarray(run(stage("local_tone_mapping"), {"local_tone_mapping": own}, image))
    encoded, lifted = (np.asarray(run(stage("srgb_oetf"), {}, x))[..., 1] for x in (image, more))
    y = np.asarray(
        run(stage("srgb_oetf"), {}, np.repeat(luma(*np.moveaxis(image, -1, 0))[..., None], 3, -1))
    )[..., 0]
    wide = cv2.GaussianBlur(y, (0, 0), 14, borderType=cv2.BORDER_REFLECT_101)
    assert np.corrcoef((lifted - encoded).ravel(), (y - wide).ravel())[0, 1] > 0.99
