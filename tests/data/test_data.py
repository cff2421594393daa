"""Clean patches: downsampling in linear light, order and crops by index, bad files, grain."""

import itertools

import jax
import numpy as np
import pytest
from PIL import Image

import jaxisp.data.clean as clean_module
from jaxisp.data import CleanImages, CleanPatches, DegradedBatches, downsample_linear, load_clean, patches
from jaxisp.errors import InputError
from jaxisp.recipes import RECIPES
from jaxisp.testing import smooth_image


@pytest.fixture
def folder(tmp_path):
    (tmp_path / "below").mkdir()
    for i, shape in enumerate(((41, 52, 3), (37, 64, 3), (48, 48, 3))):
        place = tmp_path / "below" if i else tmp_path
        Image.fromarray(np.uint8(255 * smooth_image(shape, i))).save(place / f"p{i}.png")
    return tmp_path


def test_downsampling_is_a_mean_in_linear_light():
    image = np.zeros((5, 6, 3), np.float32)
    image[::2] = 1  # rows of white and black: half the light
    small = downsample_linear(image, 2)
    assert small.shape == (2, 3, 3)
    np.testing.assert_allclose(small, 1.055 * 0.5 ** (1 / 2.4) - 0.055, atol=1e-6)
    flat = np.full((8, 8, 3), 0.3, np.float32)
    np.testing.assert_allclose(downsample_linear(flat, 4), 0.3, atol=1e-6)


def test_downsampling_softens_as_asked():
    rng = np.random.default_rng(0)
    image = np.clip(rng.normal(0.5, 0.05, (256, 320, 3)), 0, 1).astype(np.float32)
    sharp, soft = (downsample_linear(image, 2, softness) - 0.5 for softness in (0.0, 0.8))
    kernel = np.exp(-0.5 * (np.arange(-4, 5) / 0.8) ** 2)
    kernel /= kernel.sum()
    # white noise through a separable kernel keeps the square of its energy, for each axis
    want = (kernel**2).sum() * sharp[4:-4, 4:-4].std()
    np.testing.assert_allclose(soft[4:-4, 4:-4].std(), want, rtol=0.03)


def test_bad_photographs_are_listed_and_skipped(folder):
    (folder / "broken.png").write_bytes(b"\x89PNG\r\n\x1a\nnot a picture")
    Image.fromarray(np.zeros((20, 20, 3), np.uint8)).save(folder / "small.png")
    images = load_clean(folder, patch=16, downsample=2)
    assert len(images.images) == 3 and {i.dtype for i in images.images} == {np.dtype("uint16")}
    assert images.images[0].shape == (18, 32, 3)  # below/p1.png
    reasons = dict((name.rpartition("/")[2], reason) for name, reason in images.skipped)
    assert set(reasons) == {"broken.png", "small.png"}
    assert "10x10 px after downsampling by 2 is smaller than a patch of 16 px" in reasons["small.png"]
    with pytest.raises(InputError, match="no photograph can be used"):
        load_clean(folder, patch=16, downsample=20)


def coloured(count=4, size=24):
    return CleanImages(
        tuple(map(str, range(count))),
        tuple(np.full((size, size, 3), 1000 * (i + 1), np.uint16) for i in range(count)),
    )


def test_an_epoch_takes_each_photograph_equally_often_in_a_new_order():
    source = CleanPatches(coloured(), 8, per_image=3, seed=1)
    assert len(source) == 12
    shades = np.round(source.batch(range(36))[:, 0, 0, 0] * 65535).reshape(3, 12)
    for epoch in shades:
        np.testing.assert_array_equal(np.unique(epoch, return_counts=True)[1], 3)
    assert not np.array_equal(shades[0], shades[1])


def test_a_patch_follows_from_its_index_alone(folder):
    images = load_clean(folder, patch=16, downsample=2)
    one, two = (CleanPatches(images, 16, seed=3) for _ in range(2))
    backwards = [two.sample(i) for i in reversed(range(40))][::-1]
    np.testing.assert_array_equal(one.batch(range(40)), backwards)
    assert not np.array_equal(CleanPatches(images, 16, seed=4).batch(range(8)), one.batch(range(8)))


@pytest.mark.parametrize("fresh", [True, False])
def test_crops_are_fresh_each_epoch_or_the_same(folder, fresh):
    images = load_clean(folder, patch=16, downsample=2)
    source = CleanPatches(images, 16, per_image=2, fresh=fresh)
    first, second = (
        {p.tobytes() for p in source.batch(range(e * len(source), (e + 1) * len(source)))} for e in (0, 1)
    )
    assert (first == second) == (not fresh)


def test_what_does_not_fit_is_kept_as_crops(folder, monkeypatch):
    whole = load_clean(folder, patch=8, downsample=1, per_image=2)
    monkeypatch.setattr(clean_module, "WHOLE_BYTES", 0)
    images = load_clean(folder, patch=8, downsample=1, per_image=2, seed=1)
    assert all(i.shape == (2, 16, 16, 3) for i in images.images)
    kept, full = images.images[2], whole.images[2]
    windows = np.lib.stride_tricks.sliding_window_view(full, (16, 16, 3))
    assert all((windows == crop).all(axis=(-3, -2, -1)).any() for crop in kept)
    assert CleanPatches(images, 8, per_image=2).batch(range(9)).shape == (9, 8, 8, 3)


def test_held_out_photographs_are_spread_and_left_out():
    training, held_out = coloured(10).split(3)
    assert len(training.names) == 7 and len(held_out.names) == 3
    assert not set(training.names) & set(held_out.names)
    assert np.diff([int(n) for n in held_out.names]).min() >= 2


def test_the_iterator_goes_on_where_another_stopped(folder):
    batches = [patches(folder, 16, batch=4, downsample=2, start=s) for s in (0, 2)]
    first = list(itertools.islice(batches[0], 3))
    np.testing.assert_array_equal(first[2], next(batches[1]))
    assert first[0].shape == (4, 16, 16, 3) and first[0].dtype == np.float32 and first[0].min() >= 0


def test_grain_reads_patches_and_degraded_batches(folder):
    grain = pytest.importorskip("grain")
    source = CleanPatches(load_clean(folder, patch=16, downsample=2), 16, per_image=2)
    dataset = grain.MapDataset.source(source).shuffle(seed=0).batch(3)
    assert len(dataset) == 2 and dataset[0].shape == (3, 16, 16, 3)
    recipe = RECIPES["awgn"]()
    degraded = DegradedBatches(source, recipe, batch=4, seed=5, epochs=2)
    assert len(degraded) == 3
    (batch,) = itertools.islice(grain.MapDataset.source(degraded).slice(slice(2, 3)), 1)
    key = jax.random.fold_in(jax.random.key(5), 0)
    clean = source.batch(range(8, 12))
    np.testing.assert_array_equal(batch["clean"], clean)
    np.testing.assert_array_equal(batch["noisy"], recipe.degrade(key, clean, 8)[0])
    with pytest.raises(IndexError):
        degraded[3]
