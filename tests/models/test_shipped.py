"""The network that comes with the package."""

import json
import subprocess
import sys
from importlib import resources

import numpy as np
import pytest

from jaxisp.cli import main
from jaxisp.io import read_image, write_png
from jaxisp.models.apply import SHIPPED, shipped_denoiser
from jaxisp.testing import smooth_image

MOST = 4_000_000
"""Bytes."""


def psnr(image, clean):
    return -10 * np.log10(((image - clean) ** 2).mean())


@pytest.fixture(scope="module")
def pair():
    clean = smooth_image((96, 112, 3), 5, 0.1, 0.9)
    noise = 0.06 * np.random.default_rng(0).standard_normal(clean.shape)
    return clean.astype(np.float32), np.clip(clean + noise, 0, 1).astype(np.float32)


def test_it_is_small_and_says_what_it_is():
    file = resources.files("jaxisp.models") / SHIPPED
    assert len(file.read_bytes()) < MOST
    about = shipped_denoiser()[1]
    assert {"model", "options", "light", "recipe", "patches"} <= set(about)


def test_it_takes_white_noise_off(pair):
    clean, noisy = pair
    denoiser = shipped_denoiser()[0]
    gain = psnr(denoiser(noisy), clean) - psnr(noisy, clean)
    assert gain > 3
    np.testing.assert_allclose(denoiser(noisy, strength=0.0), noisy, atol=1e-6)
    changes = [np.std(denoiser(noisy, strength=strength) - noisy) for strength in (0.5, 1.0, 2.0)]
    assert 0 < changes[0] < changes[1] < changes[2]


@pytest.mark.parametrize("std", [0.005, 0.01, 0.02, 0.05, 0.1])
def test_weak_noise_is_taken_off_as_strong_noise_is(std):
    """A network that has to divide by its map leaves half of it on an even picture."""
    noise = std * np.random.default_rng(1).standard_normal((96, 96, 3))
    left = shipped_denoiser()[0]((0.5 + noise).astype(np.float32))[16:-16, 16:-16].std()
    assert left < 0.4 * std


def test_the_command_works_without_a_run(pair, tmp_path, capsys):
    write_png(tmp_path / "photo.png", pair[1])
    out = tmp_path / "out.png"
    assert main(["denoise", str(tmp_path / "photo.png"), "-o", str(out), "--strength", "0.5", "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["images"] == 1
    assert psnr(read_image(out), pair[0]) > psnr(pair[1], pair[0]) + 1
    with pytest.raises(SystemExit):
        main(["denoise", str(tmp_path / "photo.png"), "-o", str(out), "--strength", "5"])
    assert "5 is not from 0 to 4" in capsys.readouterr().err


def test_it_is_read_without_the_code_that_trains():
    code = "import sys, jaxisp.models.apply as a; a.shipped_denoiser(); print(*sys.modules)"
    loaded = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=True
    ).stdout.split()
    assert "jaxisp.train" not in loaded
