"""Evaluation: figures of NumPy, displaced and re-toned clean pictures, large pictures by their middle."""

import json

import jax.numpy as jnp
import numpy as np
import pytest
from flax import nnx
from skimage.metrics import structural_similarity

from jaxisp.errors import InputError
from jaxisp.io import read_image, write_png
from jaxisp.models.apply import Denoiser, denoise_files
from jaxisp.stages.transfer import srgb_eotf
from jaxisp.testing import smooth_image
from jaxisp.train import evaluate_dataset


@pytest.fixture
def dataset(tmp_path):
    """One pair in place, one whose clean picture is displaced by (2, -3) px and of another tone and size."""
    rng = np.random.default_rng(1)
    scene = smooth_image((110, 124, 3), 2, 0.1, 0.9)
    noisy = np.clip(scene + 0.05 * rng.standard_normal(scene.shape), 0, 1)
    write_png(tmp_path / "a.noisy.png", noisy)
    np.save(tmp_path / "a.clean.npy", scene.astype(np.float32))
    write_png(tmp_path / "b.noisy.png", noisy[5:-5, 5:-5])
    np.save(tmp_path / "b.clean.npy", (0.6 * scene[3:-7, 8:-2] ** 1.2).astype(np.float32))
    return tmp_path


def by_name(result):
    return {row["name"]: row for row in result["pairs"]}


@pytest.mark.parametrize("light", ["linear", "encoded"])
def test_figures_are_those_of_numpy(dataset, light):
    pairs = by_name(evaluate_dataset(lambda x: 0.5 * x + 0.2, dataset, light=light))
    a = pairs["a"]
    assert a["aligned"] and np.abs(a["shift_px"]).max() < 0.05
    clean = np.load(dataset / "a.clean.npy")
    noisy = read_image(dataset / "a.noisy.png")
    for suffix, picture in (("_in", noisy), ("", 0.5 * noisy + 0.2)):
        x, y = (np.asarray(srgb_eotf(jnp.asarray(v))) if light == "linear" else v for v in (clean, picture))
        x, y = np.float64(x), np.float64(y)
        x = (x - x.mean((0, 1))) / x.std((0, 1)) * y.std((0, 1)) + y.mean((0, 1))
        wanted = -10 * np.log10(((x - y) ** 2).mean())
        assert a[f"psnr{suffix}"] == pytest.approx(wanted, abs=0.1)
        alike = structural_similarity(
            x, y, channel_axis=-1, data_range=1, gaussian_weights=True, use_sample_covariance=False
        )
        assert a[f"ssim{suffix}"] == pytest.approx(alike, abs=0.005)


def test_displaced_clean_pictures_are_aligned(dataset):
    result = evaluate_dataset(lambda x: x, dataset, light="encoded")
    a, b = (by_name(result)[n] for n in "ab")
    assert b["aligned"] and b["shift_px"] == pytest.approx([2, -3], abs=0.1)
    assert b["psnr_in"] == pytest.approx(a["psnr_in"], abs=0.7)  # another tone, and another crop
    assert a["psnr"] == a["psnr_in"] and a["ssim"] == a["ssim_in"]
    assert result["mean"]["psnr"] == pytest.approx((a["psnr"] + b["psnr"]) / 2)
    json.dumps(result)


@pytest.mark.parametrize("turn", [lambda a: a[::-1, ::-1], np.rot90])
def test_a_clean_picture_that_is_turned_is_turned_back(dataset, turn):
    upright = by_name(evaluate_dataset(lambda x: x, dataset))["a"]
    np.save(dataset / "a.clean.npy", turn(np.load(dataset / "a.clean.npy")))
    turned = by_name(evaluate_dataset(lambda x: x, dataset))["a"]
    assert turned["aligned"] and turned["psnr"] == pytest.approx(upright["psnr"], abs=0.01)


def test_linear_light_may_be_below_black_and_above_white(dataset, tmp_path):
    (dataset / "dataset.toml").write_text('clean_encoding = "linear"\n')
    for name in "ab":
        clean = np.load(dataset / f"{name}.clean.npy").astype(float) ** 2.2
        np.save(dataset / f"{name}.clean.npy", 1.5 * clean - 0.02)
    result = evaluate_dataset(lambda x: x, dataset)
    assert not result["failed"] and all(row["aligned"] for row in result["pairs"])
    np.save(dataset / "a.clean.npy", np.full((110, 124, 3), 4000.0))
    assert "linear light whose white is 1" in evaluate_dataset(lambda x: x, dataset)["failed"][0][1]


def test_a_crop_is_the_middle_of_the_picture(dataset):
    row = by_name(evaluate_dataset(lambda x: x, dataset, crop=20, light="encoded"))["a"]
    middle = np.s_[45:65, 52:72]
    x, y = np.load(dataset / "a.clean.npy")[middle], read_image(dataset / "a.noisy.png")[middle]
    x = (x - x.mean((0, 1))) / x.std((0, 1)) * y.std((0, 1)) + y.mean((0, 1))
    assert row["psnr"] == pytest.approx(-10 * np.log10(((x - y) ** 2).mean()), abs=0.1)


def test_bad_pairs_are_listed(dataset):
    (dataset / "c.noisy.png").write_bytes(b"nothing")
    np.save(dataset / "c.clean.npy", np.zeros((9, 9, 3), np.float32))
    result = evaluate_dataset(lambda x: x, dataset)
    assert len(result["pairs"]) == 2 and result["failed"][0][0] == "c"
    with pytest.raises(InputError):
        evaluate_dataset(lambda x: x, dataset / "missing")


def test_linear_networks_see_linear_light(tmp_path):
    class Model(nnx.Module):
        reach, multiple = 1, 1

        def __call__(self, x):
            return 0.5 * x

    image = np.full((8, 9, 3), 0.8, np.float32)
    out = Denoiser(Model(), "linear")(image)
    assert float(srgb_eotf(jnp.asarray(out))[0, 0, 0]) == pytest.approx(
        0.5 * float(srgb_eotf(jnp.asarray(image))[0, 0, 0]), rel=1e-4
    )
    np.testing.assert_allclose(Denoiser(Model())(image), 0.4, atol=1e-6)
    write_png(tmp_path / "x.png", image)
    done = denoise_files(Denoiser(Model()), [tmp_path], tmp_path / "out")
    assert done["images"] == 1 and not done["failed"] and (tmp_path / "out" / "x.png").is_file()
    assert denoise_files(Denoiser(Model()), [tmp_path / "x.png"], tmp_path)[
        "failed"
    ]  # would replace its input
