"""Nothing that stood there before a command changes, but the outputs that it names."""

import hashlib
import os
import shutil
import stat
from importlib import resources

import numpy as np
import pytest

from jaxisp.camera import standard_camera
from jaxisp.cli import main
from jaxisp.data import shards
from jaxisp.data.catalogue import SETS, SUMS, RemoteFile
from jaxisp.io import write_png
from jaxisp.io.locks import locked
from jaxisp.recipes import RECIPES
from jaxisp.samples import PHONES, scenes, write_pairs
from jaxisp.testing import smooth_image
from tests.calibrate import sensor
from tests.data.test_catalogue import SHA, public, server  # noqa: F401
from tests.io.test_files import special_files

TRAIN = (
    "--recipe awgn --model fast --steps 1 --batch 1 --patch 12 --downsample 1 --validation 1 --cpu-devices 1"
)
FIT = "--steps 1 --demosaic demosaic_bilinear --median none"
COMMANDS = {
    "demo": ("demo --out out", ()),
    "develop": ("develop pairs/scene0.dng -o out/a.png", ("out/a.png",)),
    "fit": (
        f"fit pairs -o out/camera.toml --recipe out/prior.toml --report out {FIT}",
        ("out/camera.toml", "out/prior.toml", "out/report.html"),
    ),
    "recipe": ("recipe cameras/a.toml -o out/b.toml", ("out/b.toml",)),
    "degrade": (
        "degrade clean -o out --recipe awgn",
        ("out/p_000.clean.png", "out/p_000.noisy.png", "out/p_000.toml"),
    ),
    "degrade resumed": (
        "degrade clean -o out --recipe awgn --resume",
        ("out/p_000.clean.png", "out/p_000.noisy.png", "out/p_000.toml"),
    ),
    "shards": (
        "degrade clean -o out --recipe awgn --shards 1",
        ("out/shard-00000-of-00001.array_record", "out/shard-00000-of-00001.json"),
    ),
    "train": (f"train --clean clean -o out {TRAIN}", ()),
    "adapt": ("adapt photos -o out/a.toml --recipe awgn --downsample 1 --draws 64", ("out/a.toml",)),
    "denoise": ("denoise --run run clean -o out", ("out/p.png",)),
    "evaluate": ("evaluate --run run cn", ()),
    "diagnose": ("diagnose pairs -o out", ("out/report.json", "out/report.html")),
    "diagnose clean+noisy": ("diagnose cn -o out", ("out/simulator.toml",)),
    "downstream": ("diagnose pairs -o out --downstream", ()),
    "calibrate": (
        "calibrate flats darks -o out/noise.toml --report out",
        ("out/noise.toml", "out/report.html"),
    ),
}
ALWAYS_OURS = {  # what is not named by a call is not to be replaced: refused, or left as it is
    "demo": ("run/notes.txt", "pairs/mine.jpg", "camera.toml", "report.html", "demo.json"),
    "degrade": ("dataset.toml", ".lock"),
    "shards": ("recipe.toml", "manifest.json", ".lock"),
    "downstream": ("downstream.json",),
    "train": ("recipe.toml", "MODEL_CARD.md", "log.csv", "checkpoints/last/model.ckpt", ".lock"),
}
WHOLE = (
    "develop",
    "fit",
    "degrade",
    "degrade resumed",
    "shards",
    "train",
    "adapt",
    "denoise",
    "evaluate",
    "diagnose",
    "calibrate",
)
SLOW = ("fit", "diagnose")


@pytest.fixture(scope="module")
def inputs(tmp_path_factory):
    """What the commands read; it is looked at, too."""
    folder = tmp_path_factory.mktemp("work")
    for name in ("clean", "photos", "pairs", "cameras", "cn"):
        (folder / name).mkdir()
    write_png(folder / "clean" / "p.png", smooth_image((24, 30, 3)))
    write_png(folder / "photos" / "p.png", smooth_image((136, 144, 3)))
    write_pairs(folder / "pairs", PHONES["a"], list(scenes((96, 128)))[:2])
    flats, darks = sensor.frames(size=(128, 128))
    sensor.write(folder, "flats", flats[:10])
    sensor.write(folder, "darks", darks[:4])
    before = os.getcwd()
    os.chdir(folder)
    try:
        assert main(["degrade", "clean", "-o", "cn", "--recipe", "awgn"]) == 0
        assert main(f"train --clean clean -o run {TRAIN}".split()) == 0
        standard_camera("demosaic_bilinear").save(folder / "cameras" / "a.toml")
        yield folder
    finally:
        os.chdir(before)


def everything(folder):
    """All that is below a folder: what each name is, and what it holds."""
    found = {}
    for base, folders, files in os.walk(folder):
        for name in (*folders, *files):
            path = os.path.join(base, name)
            status = os.lstat(path)
            what = [stat.S_IFMT(status.st_mode), status.st_rdev]
            if stat.S_ISLNK(status.st_mode):
                what.append(os.readlink(path))
            elif stat.S_ISREG(status.st_mode):
                with open(path, "rb") as file:
                    what.append(hashlib.sha256(file.read()).hexdigest())
            found[os.path.relpath(path, folder)] = what
    return found


def unchanged(before, folder, named=()):
    after = everything(folder)
    return {
        path: after.get(path)
        for path, what in before.items()
        if path not in named and what != after.get(path)
    }


def clear(folder):
    shutil.rmtree(folder / "out", ignore_errors=True)
    (folder / "out").mkdir()


@pytest.mark.parametrize(
    "name", [n if n not in SLOW else pytest.param(n, marks=pytest.mark.slow) for n in WHOLE]
)
def test_what_stands_beside_the_outputs(inputs, name, capsys):
    clear(inputs)
    command, named = COMMANDS[name]
    (inputs / "out" / "others").mkdir()
    special_files(inputs / "out" / "others")
    for path in named:  # as temporary names may have been called
        for other in (f"{path}.tmp", f"{path}~"):
            (inputs / other).write_bytes(b"mine")
        os.link(
            inputs / f"{path}.tmp",
            os.path.join(inputs, os.path.dirname(path), f".{os.path.basename(path)}.tmp"),
        )
        (inputs / path).write_text("of a run before")
        os.link(inputs / path, inputs / f"{path}.other name")
    before = everything(inputs)
    assert main(command.split()) == 0, capsys.readouterr().err
    assert unchanged(before, inputs, named) == {}
    assert all((inputs / path).read_bytes() != b"of a run before" for path in named)
    assert not [p for p in everything(inputs).keys() - before.keys() if p.endswith(("tmp", "lock"))]
    shutil.rmtree(inputs / "out")


@pytest.mark.parametrize("name", [n for n in COMMANDS if COMMANDS[n][1]])
def test_an_output_that_is_a_link_or_a_device_is_refused_at_once(inputs, name, capsys):
    command, named = COMMANDS[name]
    for path in named:
        clear(inputs)
        for special in special_files(inputs / "out"):
            os.rename(inputs / "out" / special, inputs / path)
            before = everything(inputs)
            assert main(command.split()) == 2
            assert unchanged(before, inputs, {p for p in named if p != path}) == {}
            assert capsys.readouterr().err.count("\n") == 1
            os.unlink(inputs / path)


@pytest.mark.parametrize(("name", "path"), [(n, p) for n in ALWAYS_OURS for p in ALWAYS_OURS[n]])
def test_what_is_not_named_by_the_call_is_never_replaced(inputs, name, path, capsys):
    command, named = COMMANDS[name]
    clear(inputs)
    place = inputs / "out" / path
    place.parent.mkdir(parents=True, exist_ok=True)
    place.write_text('mine = "and not a run\'s"\n')
    before = everything(inputs)
    status, told = main(command.split()), capsys.readouterr().err
    assert unchanged(before, inputs, named) == {}
    assert status == 2 and told.count("\n") == 1 and path in told


def test_no_result_replaces_an_input(inputs, capsys):
    clear(inputs)
    pictures = inputs / "out"
    for name in ("a.png", "b.png", "a_000.clean.png"):
        write_png(pictures / name, smooth_image((24, 30, 3), len(name)))
    np.save(pictures / "b.npy", smooth_image((24, 30, 3), 9).astype(np.float32))
    (pictures / "b_000.toml").write_text(RECIPES["awgn"]().to_toml())
    before = everything(inputs)
    for command in (
        "denoise --run run out -o out", "degrade out -o out --recipe awgn",
        "degrade out/b.png -o out --recipe out/b_000.toml",
        "degrade out/b.png -o out --recipe out/b_000.toml=0.5,clean=0.5",
    ):  # fmt: skip
        assert main(command.split()) == 2
        assert "is an input" in capsys.readouterr().err
        assert unchanged(before, inputs) == {}
    (inputs / "noisy").mkdir()
    write_png(inputs / "noisy" / "a.png", smooth_image((24, 30, 3)))
    shutil.copy(resources.files("jaxisp.models") / "general.npz", inputs / "weights.npz")
    for command in ("recipe cameras/a.toml -o cameras/../cameras/a.toml", "fit pairs -o pairs/dataset.toml",
        "fit pairs -o pairs/scene0.dng", "fit pairs -o new.toml --recipe pairs/scene0.jpg",
        "develop pairs/scene0.dng -o camera.png --camera camera.png",
        "adapt noisy -o weights.npz --start weights.npz --run tuned",
    ):  # fmt: skip
        (inputs / "pairs" / "dataset.toml").write_text('camera = "a"\n')
        before = everything(inputs)
        assert main(command.split()) == 2
        assert unchanged(before, inputs) == {} and "is an input" in capsys.readouterr().err
        (inputs / "pairs" / "dataset.toml").unlink()


@pytest.fixture
def fetching(inputs, server, monkeypatch):  # noqa: F811
    """A set of one file on a server of this machine, and the folder of all sets."""
    clear(inputs)
    monkeypatch.setenv("JAXISP_DATA", "out")
    monkeypatch.setitem(SETS, "kodak", public(RemoteFile(f"{server}/a.bin", "a.bin")))
    return inputs


def test_what_stands_beside_a_set_that_is_fetched(fetching, capsys):
    out = fetching / "out"
    (out / "others").mkdir()
    special_files(out / "others")
    (out / "small").mkdir()  # empty, where the set comes to be
    for name in ("polyu.zip", f"{SUMS}.tmp", f".{SUMS}.tmp", "others/a.bin"):
        (out / name).write_bytes(b"mine")
    (out / SUMS).write_text(f'{{"https://example.org/other": "{SHA}"}}')
    before = everything(fetching)
    assert main(["data", "fetch", "kodak"]) == 0, capsys.readouterr().err
    assert unchanged(before, fetching, (f"out/{SUMS}",)) == {} and SHA in (out / SUMS).read_text()
    new = everything(fetching).keys() - before.keys()
    assert new == {"out/small/a.bin", "out/small/SOURCE.json"}
    before = everything(fetching)
    assert main(["data", "fetch", "kodak"]) == 0 and everything(fetching) == before


PART = ".small.partial"
FETCHED = ["small", SUMS, ".small.lock", PART, f".{SUMS}.lock"]
FETCHED += [f"{PART}/{name}" for name in (".a.bin.part", ".a.bin.etag", "a.bin", "SOURCE.json", "of/another")]


@pytest.mark.parametrize("name", FETCHED)
def test_no_link_or_device_is_followed_or_replaced_by_fetching(fetching, capsys, name):
    (fetching / "mine").mkdir(exist_ok=True)
    (fetching / "out" / name).parent.mkdir(parents=True, exist_ok=True)
    for special in (*special_files(fetching / "out"), "to a folder", "hard link"):
        if special == "to a folder":
            (fetching / "out" / name).symlink_to(fetching / "mine")
        elif special == "hard link":
            os.link(fetching / "out" / "target", fetching / "out" / name)
        else:
            os.rename(fetching / "out" / special, fetching / "out" / name)
        before = everything(fetching)
        assert main(["data", "fetch", "kodak"]) == 2
        told = capsys.readouterr().err.splitlines()
        assert name in told[-1] and "Traceback" not in told[-1] and len(told) == 3
        now = everything(fetching)
        assert unchanged(before, fetching) == {}
        assert all(
            path.startswith(("out/.small.partial", "out/.small.lock")) for path in now.keys() - before.keys()
        )
        (fetching / "out" / name).unlink()


TAKEN = {  # the lock of each command in its output folder
    "demo": ".lock",
    "fit": ".camera.toml.partial.lock",
    "fit's report": ".report.lock",
    "degrade": ".lock",
    "shards": ".shard-00000-of-00001.lock",
    "train": ".lock",
    "denoise": ".lock",
    "diagnose": ".lock",
}


@pytest.mark.parametrize("name", TAKEN)
def test_of_two_that_write_into_one_folder_the_second_is_refused(inputs, name, capsys):
    clear(inputs)
    with locked("out", name=TAKEN[name]):
        before = everything(inputs)
        status = main(COMMANDS[name.removesuffix("'s report")][0].split())
        told = capsys.readouterr().err
        assert (status, told.count("\n")) == (2, 1) and "out: another process is " in told
        new = everything(inputs).keys() - before.keys()
        assert unchanged(before, inputs) == {} and new <= {"out/manifest.json", "out/recipe.toml"}


@pytest.mark.parametrize("how", ["gone", "anew", "a file"])
@pytest.mark.parametrize("name", ["degrade", "shards", "denoise"])
def test_a_folder_that_is_removed_while_it_is_written_is_one_error(inputs, name, how, capsys, monkeypatch):
    clear(inputs)

    def remove(path, *arguments, written=write_png, **options):
        written(path, *arguments, **options)
        disturb()

    def disturb():
        shutil.rmtree(inputs / "out")
        if how == "anew":
            (inputs / "out").mkdir()
        elif how == "a file":
            (inputs / "out").write_bytes(b"mine")

    for module in ("jaxisp.generate", "jaxisp.models.apply"):
        monkeypatch.setattr(f"{module}.write_png", remove)
    encoded = shards.encode_record
    monkeypatch.setattr(shards, "encode_record", lambda made: (disturb(), encoded(made))[1])
    status = main(COMMANDS[name][0].split())
    told = capsys.readouterr().err
    assert (status, told.count("\n")) == (2, 1) and "jaxisp: out" in told
    if how == "a file":
        assert (inputs / "out").read_bytes() == b"mine"
        (inputs / "out").unlink()
