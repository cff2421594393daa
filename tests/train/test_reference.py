"""The clean picture as a reference: tone curves, matrices and displaced channels that are known."""

import numpy as np
import pytest
from scipy import ndimage
from skimage import data

from jaxisp.io import read_image, write_png
from jaxisp.train import evaluate_dataset
from jaxisp.train.reference import channel_shifts, fit_tone

MATRIX = np.array([[0.8, 0.15, 0.05], [0.1, 0.8, 0.1], [0.0, 0.2, 0.75]])


def encode(light):
    return np.where(light <= 0.0031308, 12.92 * light, 1.055 * np.maximum(light, 1e-9) ** (1 / 2.4) - 0.055)


@pytest.fixture(scope="module")
def clean():
    """Linear light, with colours and edges."""
    scene = data.astronaut()[100:260, 100:260] / 255
    return np.where(scene <= 0.04045, scene / 12.92, ((scene + 0.055) / 1.055) ** 2.4)


@pytest.fixture(scope="module")
def shown(clean):
    """As a camera with a matrix and a curve shows it, encoded."""
    encoded = encode(clean @ MATRIX.T)
    return encoded + 0.35 * encoded * (1 - encoded)


def displaced(image, shifts):
    """Each channel moved by (dy, dx)."""
    planes = [ndimage.shift(image[..., c], s, order=5, mode="nearest") for c, s in enumerate(shifts)]
    return np.stack(planes, axis=-1)


@pytest.mark.parametrize("exposure", [1.0, 3.0])
def test_a_tone_that_is_known_is_found(clean, shown, exposure, rng):
    np.testing.assert_allclose(fit_tone(exposure * clean, shown)(exposure * clean), shown, atol=0.005)
    noisy = np.clip(shown + 0.05 * rng.standard_normal(shown.shape), 0, 1)
    assert np.sqrt(((fit_tone(clean, noisy)(clean) - shown) ** 2).mean()) < 0.007


def test_a_soft_camera_keeps_its_contrast(clean):
    """A regression on single pixels would give back less contrast than the camera has."""
    soft = ndimage.gaussian_filter(encode(clean), (1.2, 1.2, 0))
    contrast = fit_tone(clean, soft)(clean).std() / encode(clean).std()
    assert contrast == pytest.approx(1, abs=0.015)


@pytest.mark.parametrize(
    ("shifts", "how"),
    [
        ([[-0.5, 0.5], [0, 0], [0.5, -0.5]], "channels"),
        ([[0.3, 1.4], [0.3, 1.4], [-0.7, 0.2]], "channels"),
        ([[0.6, -0.4]] * 3, "refined"),
        ([[0, 0]] * 3, "whole"),
    ],
)
def test_channels_are_found_where_they_lie(clean, shown, shifts, how, rng):
    soft = ndimage.gaussian_filter(shown, (0.8, 0.8, 0))
    noisy = np.clip(soft + 0.03 * rng.standard_normal(shown.shape), 0, 1)
    found, told = channel_shifts(displaced(clean, shifts), noisy)
    assert told == how
    np.testing.assert_allclose(found, shifts, atol=0.12)


def test_noise_alone_displaces_nothing(clean, rng):
    found, told = channel_shifts(clean, rng.random(clean.shape))
    assert told == "whole" and not found.any()


@pytest.fixture(scope="module")
def dataset(clean, shown, tmp_path_factory):
    """The same pair, once with displaced channels."""
    folder = tmp_path_factory.mktemp("pairs")
    noise = 0.03 * np.random.default_rng(2).standard_normal(shown.shape)
    (folder / "dataset.toml").write_text('clean_encoding = "linear"\n')
    for name, shifts in (("apart", [[-0.6, 0.6], [0, 0], [0.6, -0.6]]), ("good", [[0, 0]] * 3)):
        write_png(folder / f"{name}.noisy.png", np.clip(shown + noise, 0, 1))
        np.save(folder / f"{name}.clean.npy", displaced(clean, shifts).astype(np.float32))
    return folder


def test_displaced_channels_cost_nothing_once_aligned(dataset):
    whole, channels = (
        {row["name"]: row for row in evaluate_dataset(None, dataset, align=align)["pairs"]}
        for align in ("whole", "channels")
    )
    good = channels["good"]
    assert good["aligned_by"] == "whole" and good["psnr_in"] == whole["good"]["psnr_in"]
    assert whole["apart"]["psnr_in"] < good["psnr_in"] - 2
    assert channels["apart"]["psnr_in"] > good["psnr_in"] - 0.5
    apart = channels["apart"]
    moved = np.asarray(apart["channel_shift_px"]) + apart["shift_px"]
    np.testing.assert_allclose(moved, [[-0.6, 0.6], [0, 0], [0.6, -0.6]], atol=0.1)


def test_contrast_that_is_lost_is_no_gain_once_the_tone_is_fixed(dataset, shown):
    """The paper's measure gives 20 log10(1 / 0.9) dB in encoded light for it."""
    row = evaluate_dataset(lambda noisy: 0.9 * noisy, dataset, light="encoded")["pairs"][1]
    assert row["psnr"] == pytest.approx(row["psnr_in"] - 20 * np.log10(0.9), abs=0.01)
    assert row["psnr_fixed"] < row["psnr_fixed_in"] - 3
    noise = read_image(dataset / "good.noisy.png") - np.clip(shown, 0, 1)
    assert row["psnr_fixed_in"] == pytest.approx(-10 * np.log10((noise**2).mean()), abs=0.1)
