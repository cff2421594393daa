"""Degrading files: resumed, killed, two at once, a full disk, odd names, folders that cannot be written."""

import fcntl

import numpy as np
import pytest

from jaxisp.errors import InputError
from jaxisp.generate import degrade_files
from jaxisp.io import read_image, write_png
from jaxisp.recipes import RECIPES
from tests.conftest import smooth_image
from tests.mounts import mounted


@pytest.fixture(scope="module")
def photos(tmp_path_factory):
    folder = tmp_path_factory.mktemp("in") / "a folder, ünïcode 写真"
    folder.mkdir()
    for name in ("with space.png", "ñandú.png", "-dash.png", "[b]*?.png"):
        write_png(folder / name, smooth_image((20, 26, 3), len(name)))
    return folder


def contents(folder):
    return {p.name: p.read_bytes() for p in folder.iterdir() if p.name[0] != "."}


def test_resumed_is_undisturbed(photos, tmp_path):
    recipe, whole, out = RECIPES["awgn"](), tmp_path / "whole", tmp_path / "out put"
    assert degrade_files([photos], whole, recipe, count=2, seed=1).images == 8
    degrade_files([photos], out, recipe, count=2, seed=1)
    (out / "ñandú_001.toml").unlink()
    (out / "with space_000.noisy.png").unlink()
    (out / "-dash_000.toml").write_text("cut sho")
    (out / ".-dash_000.noisy.png.tmp").write_bytes(b"killed here")
    (out / ".mine.tmp").write_bytes(b"not ours")
    again = degrade_files([photos], out, recipe, count=2, seed=1, resume=True)
    assert (again.images, again.kept) == (3, 5) and contents(out) == contents(whole)
    assert [p.name for p in out.glob(".*.tmp")] == [".mine.tmp"]
    assert degrade_files([photos], out, recipe, count=2, seed=2, resume=True).kept == 0
    assert contents(out) != contents(whole)


def test_two_runs_into_one_folder_are_refused(photos, tmp_path):
    with (tmp_path / ".lock").open("w") as file:
        fcntl.flock(file, fcntl.LOCK_EX)
        with pytest.raises(InputError, match="another process is writing into this folder"):
            degrade_files([photos], tmp_path, RECIPES["awgn"]())
    assert degrade_files([photos], tmp_path, RECIPES["awgn"]()).images == 4


def test_a_full_disk_is_one_line_and_leaves_whole_files(photos, tmp_path):
    with mounted(tmp_path / "small", "-t", "tmpfs", "-o", "size=24k", "tmpfs") as out:
        with pytest.raises(InputError, match="cannot be written: no space left on device"):
            degrade_files([photos], out, RECIPES["awgn"](), count=4)
        pictures = list(out.glob("*.png"))
        assert pictures and all(read_image(p).shape == (20, 26, 3) for p in pictures)
        assert not list(out.glob(".*.tmp"))


def test_shards_on_a_full_disk(photos, tmp_path):
    pytest.importorskip("array_record")
    from jaxisp.data import degrade_shards
    from jaxisp.data.shard_source import shard_name
    from jaxisp.generate import Work

    with mounted(tmp_path / "small", "-t", "tmpfs", "-o", "size=48k", "tmpfs") as out:
        with pytest.raises(InputError, match=r"array_record: cannot be written"):
            degrade_shards(Work([photos], RECIPES["awgn"](), count=8), out, 2)
        assert not (out / f"{shard_name(0, 2)}.json").exists() and not list(out.glob(".*.tmp"))


def test_a_read_only_folder_is_one_line(photos, tmp_path):
    (tmp_path / "real").mkdir()
    with mounted(tmp_path / "there", "--bind", "-o", "ro", str(tmp_path / "real")) as out:
        with pytest.raises(InputError, match="cannot be written: read-only file system"):
            degrade_files([photos], out, RECIPES["awgn"]())
        with pytest.raises(InputError, match="cannot be written"):
            write_png(out / "a.png", np.zeros((2, 2, 3)))
