"""The command line: results, exit codes, one line for each fault, nothing half-written."""

import argparse
import json
import subprocess
import sys
import time

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from PIL import Image

from jaxisp.cli import common, main, parser
from jaxisp.cli.common import print_table
from jaxisp.io import WarpRectilinear, open_dataset
from jaxisp.recipes import RECIPES
from jaxisp.testing import smooth_image
from tests.io.samples import dng
from tests.mounts import mounted


@pytest.fixture
def photographs(tmp_path):
    folder = tmp_path / "clean photos"
    folder.mkdir()
    for i, shape in enumerate(((24, 32, 3), (24, 32, 3), (33, 25, 3))):
        Image.fromarray(np.uint8(255 * smooth_image(shape, i))).save(folder / f"p{i}.png")
    return folder


def run(capsys, *arguments):
    status = main([str(a) for a in arguments])
    out, err = capsys.readouterr()
    return status, out, err


def test_develop_tells_what_a_file_states_that_is_not_applied(capsys, tmp_path):
    lens = WarpRectilinear(np.eye(1, 6), (0.5, 0.5))
    path = dng(
        tmp_path / "a.dng",
        opcodes_3=[lens],
        extra_tags=[(50717, 4, 1, 0), (51125, 5, 4, (0, 1, 0, 1, 1, 2, 1, 1))],
    )
    status, out, err = run(capsys, "develop", path, "-o", tmp_path / "a.png")
    assert status == 0 and len(err.splitlines()) == 3
    assert all(line.startswith(f"jaxisp: {path}: its ") for line in err.splitlines())
    for words in ("WhiteLevel of 0", "OpcodeList3 has WarpRectilinear", "DefaultUserCrop"):
        assert words in err
    status, out, _ = run(capsys, "develop", path, "-o", tmp_path / "a.png", "--json")
    assert len(json.loads(out)["notes"]) == 3


def test_develop_quad_bayer(capsys, tmp_path):
    cell = bytes([0, 0, 1, 1] * 2 + [1, 1, 2, 2] * 2)
    path = dng(tmp_path / "a.dng", extra_tags=[(33421, 3, 2, (4, 4)), (33422, 1, 16, cell)], black=(64,))
    for option, size in (((), (35, 26)), (("--remosaic",), (70, 52))):
        status, out, err = run(capsys, "develop", path, "-o", tmp_path / "a.png", "--json", *option)
        found = json.loads(out)
        assert (status, found["width"], found["height"]) == (0, *size) and "2 x 2 pixels" in err


def test_stages(capsys):
    status, out, _ = run(capsys, "stages", "--json")
    stages = json.loads(out)
    assert status == 0 and len(stages) >= 45
    assert sum(len(s["params"]) for s in stages) >= 90
    for s in stages:
        assert {"name", "params", "static", "gradient", "source"} <= set(s)
        for p in s["params"]:
            assert {"name", "default", "bounds", "unit", "scale"} <= set(p)
    assert "stages," in run(capsys, "stages")[1]


def test_one_stage_is_told_whole(capsys):
    status, out, _ = run(capsys, "stages", "jpeg")
    assert status == 0 and "gradient: surrogate." in out and "source: ITU-T T.81" in out
    assert "option subsampling, default '4:2:0'" in out and "[1.0, 100.0]" in out
    assert [s["name"] for s in json.loads(run(capsys, "stages", "jpeg", "median", "--json")[1])] == [
        "jpeg",
        "median",
    ]
    status, out, err = run(capsys, "stages", "bilatreal")
    assert (status, out, err) == (2, "", "jaxisp: no stage named 'bilatreal'; is it bilateral?\n")


def test_recipes(capsys):
    listed = {r["name"]: r for r in json.loads(run(capsys, "recipes", "--json")[1])}
    assert listed["phone"]["draws"]["shot_read_noise.read"].startswith("uniform")
    assert "phone-no-post" in run(capsys, "recipes")[1]


def test_recipes_are_listed_by_name_or_word(capsys):
    def names(*words):
        status, out, _ = run(capsys, "recipes", *words, "--json")
        assert status == 0
        return [recipe["name"] for recipe in json.loads(out)]

    assert names("phone") == ["phone"] and names("awgn", "phone") == ["awgn", "phone"]
    assert names("phone-no") == ["phone-no-post", "phone-no-denoise", "phone-no-demosaic"]
    status, out, err = run(capsys, "recipes", "fone")
    assert status == 2 and not out and "is it phone?" in err


def test_folders_of_outputs_are_made_before_the_work(capsys, tmp_path):
    raw, new = dng(tmp_path / "a.dng"), tmp_path / "new"
    assert run(capsys, "develop", raw, "-o", new / "b" / "a.png")[0] == 0 and (new / "b" / "a.png").is_file()
    for command in (
        ("develop", tmp_path / "none.dng", "-o", tmp_path / "other" / "a.png"),
        ("recipe", tmp_path / "none.toml", "-o", tmp_path / "other" / "b.toml"),
        ("degrade", tmp_path, "-o", new / "b" / "a.png", "--recipe", "awgn"),
    ):
        status, out, err = run(capsys, *command)
        assert status == 2 and not out and err.count("\n") == 1
        assert not (tmp_path / "other").exists()


def test_degrade_writes_a_data_set_whose_images_can_be_made_again(capsys, photographs, tmp_path):
    out, two = tmp_path / "out", [photographs / "p0.png", photographs / "p1.png"]
    status, text, _ = run(
        capsys, "degrade", *two, "-o", out, "--recipe", "phone", "--count", 2, "--seed", 3, "--json"
    )
    result = json.loads(text)
    assert status == 0 and result["images"] == 4 and result["failed"] == []
    assert {"images", "images_per_second", "seconds"} <= set(result)
    dataset = open_dataset(out)
    assert dataset.kind == "clean+noisy" and len(dataset.pairs) == 4 and not dataset.problems
    again = tmp_path / "again"
    status, _, _ = run(
        capsys, "degrade", photographs / "p1.png", "-o", again, "--recipe", out / "p1_001.toml",
        "--seed", 3, "--start", 3,
    )  # fmt: skip
    assert status == 0
    first, second = (
        np.asarray(Image.open(p)) for p in (out / "p1_001.noisy.png", again / "p1_000.noisy.png")
    )
    np.testing.assert_array_equal(first, second)


@pytest.mark.parametrize(
    ("recipe", "message"),
    [
        ('stages = [{ stage = "rounding", options = { bits = "eight" } }]', "bits must be int, got 'eight'"),
        ('stages = [{ stage = "rounding", options = { bits = 0 } }]', "option bits must be from 1 to 16"),
        ('stages = [{ stage = "gaussian_noise", name = 5 }]', "name must be text"),
        ('stages = [{ stage = "spline_curve" }]\nparams.spline_curve.offsets = [0.1]', "spline_curve"),
        (
            'stages = [{ stage = "gaussian_noise" }]\nparams.gaussian_noise.std.normal = [0.1, 0, 0, 0.2]',
            "std must be positive",
        ),
    ],
)
def test_a_recipe_that_cannot_run_is_one_line_and_status_2(capsys, photographs, tmp_path, recipe, message):
    (tmp_path / "r.toml").write_text(recipe)
    arguments = ("degrade", photographs, "-o", tmp_path / "out", "--recipe", tmp_path / "r.toml")
    status, out, err = run(capsys, *arguments)
    assert status == 2 and not out and err.count("\n") == 1 and message in err
    assert not (tmp_path / "out").exists()


def test_degrade_is_what_the_recipe_does(capsys, photographs, tmp_path):
    assert run(capsys, "degrade", photographs / "p2.png", "-o", tmp_path / "o", "--recipe", "awgn")[0] == 0
    clean = np.asarray(Image.open(photographs / "p2.png"), np.float32) / 255
    noisy = RECIPES["awgn"]().degrade(jax.random.key(0), clean[None])[0][0]
    written = np.asarray(Image.open(tmp_path / "o" / "p2_000.noisy.png"))
    np.testing.assert_array_equal(written, np.round(np.asarray(noisy) * 255))


def test_degrade_goes_on_past_bad_files_and_lists_them(capsys, photographs, tmp_path):
    (photographs / "broken.png").write_bytes(b"\x89PNG\r\n\x1a\nnot a picture")
    Image.fromarray(np.zeros((8, 8), np.uint8)).save(photographs / "gray.jpg")
    np.save(photographs / "nan.npy", np.full((8, 8, 3), np.nan, np.float32))
    status, text, err = run(
        capsys, "degrade", photographs, "-o", tmp_path / "o", "--recipe", "awgn", "--json"
    )
    assert status == 2 and json.loads(text)["images"] == 3
    assert len(json.loads(text)["failed"]) == 3
    lines = err.strip().splitlines()
    assert len(lines) == 3
    for name in ("broken.png", "gray.jpg", "nan.npy"):
        assert sum(name in line for line in lines) == 1


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("degrade", "EMPTY", "-o", "OUT", "--recipe", "awgn"), "empty"),
        (("degrade", "MISSING", "-o", "OUT", "--recipe", "awgn"), "missing"),
        (("degrade", "PHOTOS", "-o", "OUT", "--recipe", "nonsense"), "no recipe named 'nonsense'"),
        (("degrade", "PHOTOS", "-o", "FILE", "--recipe", "awgn"), "file"),
        (("develop", "PHOTOS/p0.png", "-o", "OUT.png"), "p0.png"),
        (("develop", "MISSING.dng", "-o", "OUT.png"), "missing"),
        (("develop", "MISSING.dng", "-o", "OUT.jpg"), "only png is written"),
        (
            ("develop", "MISSING.dng", "-o", "OUT.png", "--camera", "MISSING.toml"),
            "missing.toml: cannot be read: no such file or directory\n",
        ),
        (("fit", "PHOTOS", "-o", "OUT.toml"), "photos"),
    ],
)
def test_unusable_input_is_one_line_and_status_2(capsys, photographs, tmp_path, arguments, message):
    (tmp_path / "empty").mkdir()
    (tmp_path / "file").write_text("x")
    places = {
        "EMPTY": tmp_path / "empty", "MISSING": tmp_path / "missing", "OUT": tmp_path / "out",
        "FILE": tmp_path / "file", "PHOTOS": photographs,
    }  # fmt: skip
    swapped = []
    for a in arguments:
        head, dot, suffix = a.partition(".") if a.partition("/")[0] != "PHOTOS" else a.partition("/")
        swapped.append(f"{places[head]}{dot}{suffix}" if head in places else a)
    status, out, err = run(capsys, *swapped)
    assert status == 2 and not out
    assert err.count("\n") == 1 and message in err.lower()
    assert not (tmp_path / "out").exists() or not list((tmp_path / "out").iterdir())


@pytest.mark.parametrize(
    ("arguments", "line"),
    [
        ("", "jaxisp: the following arguments are required: COMMAND; see jaxisp --help"),
        ("fit x", "jaxisp fit: the following arguments are required: -o/--out; see jaxisp fit --help"),
        ("fit x -o y --steps 0", "jaxisp fit: argument --steps: 0 is not positive; see jaxisp fit --help"),
        (
            "develop x -o y --camra z",
            "jaxisp develop: unknown: --camra (is it --camera?); see jaxisp develop --help",
        ),
        ("effects --bogus", "jaxisp effects: unknown: --bogus; see jaxisp effects --help"),
        ("develop a b -o c.png", "jaxisp develop: unknown: b; see jaxisp develop --help"),
        (
            "demo --seed -1",
            "jaxisp demo: argument --seed: -1 is not from 0 to 4294967295; see jaxisp demo --help",
        ),
        ("data list --jsn", "jaxisp data list: unknown: --jsn (is it --json?); see jaxisp data list --help"),
        (
            "stages --json=1 --qqq",
            "jaxisp stages: argument --json: ignored explicit argument '1'; see jaxisp stages --help",
        ),
    ],
)
def test_a_mistaken_call_is_one_line_and_status_2(capsys, arguments, line):
    with pytest.raises(SystemExit) as caught:
        main(arguments.split())
    assert caught.value.code == 2
    assert capsys.readouterr() == ("", line + "\n")


def test_a_full_disk_is_one_line(capsys, photographs, tmp_path, monkeypatch):
    import jaxisp.io.files as files

    def no_space(*_):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(files.os, "fsync", no_space)
    status, _, err = run(capsys, "degrade", photographs, "-o", tmp_path / "o", "--recipe", "awgn")
    assert status == 2 and "no space left" in err and err.count("\n") == 1
    assert not list((tmp_path / "o").glob("*"))


def test_a_fit_of_nothing_leaves_no_folder(capsys, tmp_path):
    out = tmp_path / "new" / "camera.toml"
    extra = ["--recipe", str(tmp_path / "other" / "prior.toml"), "--report", str(tmp_path / "new" / "report")]
    assert main(["fit", str(tmp_path / "missing"), "-o", str(out), *extra]) == 2
    assert "missing: no such" in capsys.readouterr().err
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    "arguments",
    [
        ("degrade", "PHOTOS", "-o", "RO/degraded", "--recipe", "awgn"),
        ("degrade", "PHOTOS", "-o", "RO/shards", "--recipe", "awgn", "--shards", "2"),
        ("train", "--clean", "PHOTOS", "--recipe", "awgn", "-o", "RO/run"),
        ("fit", "PHOTOS", "-o", "RO/camera.toml"),
        ("fit", "PHOTOS", "-o", "OUT/camera.toml", "--recipe", "RO/prior.toml"),
        ("fit", "PHOTOS", "-o", "OUT/camera.toml", "--report", "RO/report"),
        ("diagnose", "PHOTOS", "-o", "RO/diagnosis"),
        ("demo", "--out", "RO/demo"),
    ],
)
def test_a_read_only_folder_is_one_line_before_any_work(capsys, photographs, tmp_path, arguments):
    (tmp_path / "real").mkdir()
    with mounted(tmp_path / "Δ read only", "--bind", "-o", "ro", str(tmp_path / "real")) as folder:
        places = {"PHOTOS": photographs, "RO": folder, "OUT": tmp_path / "out"}
        heads = [a.partition("/") for a in arguments]
        status, out, err = run(
            capsys, *(f"{places.get(head, head)}{dash}{tail}" for head, dash, tail in heads)
        )
    assert status == 2 and not out
    assert err.count("\n") == 1 and "cannot be written: read-only file system" in err and "Δ read only" in err


def test_it_runs_as_a_module():
    done = subprocess.run([sys.executable, "-m", "jaxisp", "--version"], capture_output=True, text=True)
    assert done.returncode == 0 and done.stdout.startswith("jaxisp ")


def test_progress_off_a_terminal_is_a_line_a_phase(capsys, monkeypatch):
    monkeypatch.setattr(common, "QUIET", 0.0)
    with common.progress("fitting") as tick:
        for i in range(3):
            tick(i, 9, f"first 0.12{i}")
        tick(4, 9, "last 1 0.1")
        tick(5, 9, "last 2 0.09")
        tick(9, 9, "")
    out, err = capsys.readouterr()
    lines = err.splitlines()
    assert out == "" and len(lines) == 2
    assert lines[0].startswith("jaxisp: fitting: first") and lines[1].startswith("jaxisp: fitting: last")


def test_a_quick_command_is_silent_and_a_long_phase_is_told(capsys, monkeypatch):
    with common.progress("fitting") as tick:
        tick(0, 9, "first")
    assert capsys.readouterr().err == ""
    monkeypatch.setattr(common, "QUIET", 0.05)
    with common.progress("demo") as tick:
        tick(0, 7, "taking pictures")  # before it, and no tick after it
        time.sleep(0.3)
    assert capsys.readouterr().err == "jaxisp: demo: taking pictures\n"


@pytest.mark.parametrize(
    ("rest", "status", "told"),
    [
        ("<&- >&- 2>&-", 0, ""),
        ("> /dev/full", 2, "standard output: cannot be written: no space left"),
        ("| true", 0, ""),
    ],
)
def test_standard_streams_that_are_closed_full_or_left(rest, status, told):
    words = f"{sys.executable} -m jaxisp recipes --json {rest}"
    done = subprocess.run(["sh", "-c", words], capture_output=True, text=True)
    assert done.returncode == status and told in done.stderr and done.stderr.count("\n") == bool(told)


@pytest.mark.parametrize(
    "taken, told",
    [
        (lambda: jax.block_until_ready(jnp.zeros((1 << 20, 1 << 20))), "Out of memory allocating"),
        (lambda: np.empty(1 << 50, np.uint8), "Unable to allocate 1.00 PiB"),
    ],
    ids=["jax", "numpy"],
)
def test_memory_that_is_not_there_is_one_line_and_status_1(capsys, monkeypatch, taken, told):
    command = argparse.ArgumentParser()
    command.set_defaults(run=lambda _: taken())
    monkeypatch.setattr("jaxisp.cli.parser", lambda: command)
    status, out, err = run(capsys)
    assert (status, out, err.count("\n")) == (1, "", 1) and f"not enough memory: {told}" in err


def test_options_are_shown_where_they_do_something():
    """All commands take a seed, as scripts may give it to each."""
    (group,) = (a for a in parser()._actions if isinstance(a, argparse._SubParsersAction))
    drawing = {name for name, command in group.choices.items() if "--seed" in command.format_help()}
    assert drawing == {"demo", "develop", "degrade", "train", "diagnose"}
    for name in ("compare a b", "stages", "fit a -o b", "evaluate a"):
        assert parser().parse_args([*name.split(), "--seed", "3"]).seed == 3
    for name, command in group.choices.items():
        for action in command._actions:
            assert action.help or action.choices, f"{name}: {action.dest} says nothing of itself"


def test_a_folder_of_another_run_is_told_in_a_line_and_stays(capsys, photographs, tmp_path):
    out = tmp_path / "out"
    assert run(capsys, "degrade", photographs, "-o", out, "--recipe", "awgn")[0] == 0
    before = {path.name: path.read_bytes() for path in out.iterdir()}
    for other in (("amwgn",), ("awgn", "--seed", 1), ("amwgn", "--resume"), ("awgn=0.5,clean=0.5",)):
        status, said, err = run(capsys, "degrade", photographs, "-o", out, "--recipe", *other)
        assert status == 2 and not said and err.count("\n") == 1
        assert "recipe 'awgn'" in err and "choose another folder, or empty this one" in err
    assert {path.name: path.read_bytes() for path in out.iterdir()} == before
    assert run(capsys, "degrade", photographs, "-o", out, "--recipe", "awgn", "--resume")[0] == 0
    assert run(capsys, "degrade", photographs, "-o", out, "--recipe", "awgn")[0] == 0
    assert {path.name: path.read_bytes() for path in out.iterdir()} == before


def test_where_nothing_can_be_used_nothing_is_said_to_be_done(capsys, tmp_path, monkeypatch):
    monkeypatch.setattr("jaxisp.cli.denoise.find_denoiser", lambda _: (None, "none"))  # no picture to denoise
    (tmp_path / "in").mkdir()
    (tmp_path / "in" / "a.png").write_bytes(b"no picture")
    for command in (("degrade", "--recipe", "awgn"), ("denoise",)):
        name, *more = command
        status, out, err = run(capsys, name, tmp_path / "in", "-o", tmp_path / "new", *more)
        assert status == 2 and not out and err.count("\n") == 1 and "a.png" in err
        assert not (tmp_path / "new").exists()


def test_a_table_that_is_piped_is_whole(capsys):
    print_table(("a", "b"), [("x" * 300, "y" * 300), ("x", "y")])
    lines = capsys.readouterr().out.splitlines()
    assert len(lines) == 3 and lines[1] == f"{'x' * 300}  {'y' * 300}" and lines[2].endswith("y")
