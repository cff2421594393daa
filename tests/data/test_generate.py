"""Degrading files: resumed, killed, two at once, a full disk, odd names, folders that cannot be written."""

import fcntl

import jax
import numpy as np
import pytest

from jaxisp.data import work as samples
from jaxisp.data.work import Outcome, Work
from jaxisp.errors import InputError
from jaxisp.frames import MOST_FRAMES, Frames
from jaxisp.generate import degrade_files
from jaxisp.io import read_image, write_png
from jaxisp.pipeline import Chain, stage
from jaxisp.process import memory
from jaxisp.process.programs import compile_times
from jaxisp.recipe import Recipe
from jaxisp.recipes import RECIPES
from jaxisp.testing import smooth_image
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
    (out / ".mine.tmp").write_bytes(b"not ours")
    again = degrade_files([photos], out, recipe, count=2, seed=1, resume=True)
    assert (again.images, again.kept) == (3, 5) and contents(out) == contents(whole)
    assert [p.name for p in out.glob(".*.tmp")] == [".mine.tmp"]


def test_a_folder_holds_one_data_set(photos, tmp_path):
    """Nothing tells the samples of two runs apart once they stand in one folder."""
    awgn, out = RECIPES["awgn"](), tmp_path / "out"
    degrade_files([photos], out, awgn, count=2, seed=1)
    before = contents(out)
    quiet = awgn.override(gaussian_noise={"std": 0.01})
    for again, settings, what in (
        ("amwgn", {"seed": 1}, "holds a data set of the recipe 'awgn', and this run is of 'amwgn', seed 1"),
        (quiet, {"seed": 1}, "this run is of 'awgn-edited', seed 1"),
        (quiet.named("awgn"), {"seed": 1}, "holds samples of other numbers of the recipe 'awgn', seed 1"),
        (awgn, {"seed": 2}, "holds samples of the recipe 'awgn', seed 1, and this run is of 'awgn', seed 2"),
        (awgn, {"seed": 1, "count": 1}, "holds more than 1 versions of -dash"),
    ):
        for resume in (False, True):
            with pytest.raises(InputError, match=f"{what}.*; choose another folder, or empty this one"):
                degrade_files([photos], out, again, resume=resume, **{"count": 2, **settings})
    with pytest.raises(InputError, match="is an input too"):
        degrade_files([out], out, awgn, seed=1)
    assert contents(out) == before
    (out / "dataset.toml").unlink()  # as after a run that was killed
    (out / "-dash_000.toml").write_text("cut sho")
    with pytest.raises(InputError, match="holds samples of the recipe 'awgn'"):
        degrade_files([photos], out, "amwgn", count=2, seed=1)
    assert degrade_files([photos], out, awgn, count=2, seed=1).images == 8 and contents(out) == before
    assert degrade_files([photos], out, awgn, count=3, seed=1, start=5).images == 12


def test_where_nothing_can_be_used_no_folder_is_left(tmp_path):
    (tmp_path / "in").mkdir()
    (tmp_path / "in" / "a.jpg").write_bytes(b"\xff\xd8 not a picture")
    assert len(degrade_files([tmp_path / "in"], tmp_path / "new" / "out", "awgn").failed) == 1
    assert not (tmp_path / "new").exists()
    (tmp_path / "out").mkdir()
    degrade_files([tmp_path / "in"], tmp_path / "out", "awgn")
    assert (tmp_path / "out").is_dir() and not contents(tmp_path / "out")


def test_programs_that_are_forgotten_between_sizes_change_no_bit(tmp_path, monkeypatch):
    (tmp_path / "in").mkdir()
    for i in range(3):
        write_png(tmp_path / "in" / f"{i}.png", smooth_image((20 + i, 26, 3), i))
    recipe = Recipe(Chain((stage("gaussian_noise"), stage("rounding")), "grain"), {})
    whole, few, forgotten = tmp_path / "whole", tmp_path / "few", []
    degrade_files([tmp_path / "in"], whole, recipe, seed=1)
    monkeypatch.setattr(memory, "MOST_SIZES", 1)
    monkeypatch.setattr(memory, "FEW_SIZES", 0)
    monkeypatch.setattr(memory, "forget_compiled", lambda: forgotten.append(jax.clear_caches()))
    degrade_files([tmp_path / "in"], few, recipe, seed=1)
    assert len(forgotten) == 3 and contents(few) == contents(whole)


def test_pictures_of_many_sizes_do_not_pile_up(tmp_path, monkeypatch):
    (tmp_path / "in").mkdir()
    for i in range(6):
        write_png(tmp_path / "in" / f"{i}.png", smooth_image((20 + i % 3, 26, 3), i))
    recipe = Recipe(Chain((stage("gaussian_noise"), stage("rounding")), "grain"), {})
    whole, few = tmp_path / "whole", tmp_path / "few"
    assert degrade_files([tmp_path / "in"], whole, recipe, seed=1).images == 6
    monkeypatch.setattr(samples, "WAITING_PIXELS", 3 * 22 * 26)
    reads = []
    monkeypatch.setattr(samples, "read_image", lambda path: reads.append(path) or read_image(path))
    work, given = Work([tmp_path / "in"], recipe, seed=1), []
    for batch in work._batches(range(6), Outcome(), lambda sample: False):
        given += [sample.stem for sample, _ in batch]
        assert len(reads) - len(given) <= 3
    assert sorted(given) == [f"{i}_000" for i in range(6)]
    degrade_files([tmp_path / "in"], few, recipe, seed=1)
    assert contents(few) == contents(whole)


def test_pictures_of_many_sizes_share_programs(tmp_path, monkeypatch):
    (tmp_path / "in").mkdir()
    for i in range(24):
        write_png(tmp_path / "in" / f"{i:02d}.png", smooth_image((20 + i % 6, 26 + i // 2, 3), i))
    recipe = Recipe(Chain((stage("gaussian_noise"), stage("rounding")), "grain"), {})
    alone, shared = tmp_path / "alone", tmp_path / "shared"
    with compile_times() as programs:
        assert degrade_files([tmp_path / "in"], shared, recipe, count=2, seed=1).images == 48
    assert sum(program.name == "_degraded" for program in programs) <= MOST_FRAMES
    monkeypatch.setattr(samples, "shared_frames", lambda *_: Frames())
    degrade_files([tmp_path / "in"], alone, recipe, count=2, seed=1)
    assert contents(shared) == contents(alone)


def test_a_broken_file_does_not_take_a_name(tmp_path):
    (tmp_path / "a.jpg").write_bytes(b"\xff\xd8 not a picture")
    for name in ("a.png", "b.png", "b.tiff"):
        write_png(tmp_path / "b.png", smooth_image((20, 26, 3), 0))
        (tmp_path / name).write_bytes((tmp_path / "b.png").read_bytes())
    outcome = degrade_files([tmp_path], tmp_path / "out", RECIPES["awgn"]())
    assert outcome.images == 2 and (tmp_path / "out" / "a_000.toml").exists()
    reasons = dict((path.rpartition("/")[2], reason) for path, reason in outcome.failed)
    assert set(reasons) == {"a.jpg", "b.tiff"} and "b.png has the same name" in reasons["b.tiff"]


@pytest.mark.parametrize(
    ("name", "params"), [("motion_blur", "[params.motion_blur]\nlengths = [1.0]"), ("srgb_eotf", "")]
)
def test_a_recipe_that_cannot_run_is_refused_before_any_work(photos, tmp_path, name, params):
    recipe = Recipe.from_toml(f'name = "mine"\nstages = [{{stage = "{name}"}}]\n{params}')
    with pytest.raises(InputError, match="recipe 'mine'"):
        degrade_files([photos], tmp_path / "out", recipe)
    assert not (tmp_path / "out").exists()


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


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"seed": "1"}, "seed must be a whole number from 0 on, got '1'"),
        ({"seed": -1}, "seed must be a whole number from 0 on"),
        ({"seed": 2**32}, "seeds go from 0 to 4294967295"),
        ({"count": 0}, "count must be a whole number from 1 on, got 0"),
        ({"count": 1.5}, "count must be a whole number from 1 on"),
        ({"start": -1}, "start must be a whole number from 0 on"),
        ({"start": 2**31 - 2}, "sample indices go from 0 to 2147483646"),
    ],
    ids=str,
)
def test_settings_that_no_run_has(photos, tmp_path, settings, message):
    with pytest.raises(InputError, match=message):
        degrade_files(photos, tmp_path / "out", "awgn", **settings)
    assert not (tmp_path / "out").exists()


def test_a_folder_may_be_given_alone_and_is_no_output(photos):
    with pytest.raises(InputError, match="is an input too"):
        degrade_files(str(photos), photos, "awgn")


def test_shards_that_are_not(photos, tmp_path):
    pytest.importorskip("array_record")
    from jaxisp.data import degrade_shards

    for shards, only, message in (
        (0, None, "shards must be a whole number from 1 on"),
        ("2", None, "shards must be"),
        (2, [0, 5], r"only = \[5\]: shards are counted from 0 to 1"),
    ):
        with pytest.raises(InputError, match=message):
            degrade_shards(Work([photos], "awgn"), tmp_path / "out", shards, only=only)
    assert not (tmp_path / "out").exists()


def test_shards_of_an_edited_recipe_are_told_apart(photos, tmp_path):
    pytest.importorskip("array_record")
    from jaxisp.data import degrade_shards

    awgn = RECIPES["awgn"]()
    degrade_shards(Work([photos], awgn), tmp_path, 2, only=[])
    edited = awgn.override(gaussian_noise={"std": 0.01})
    for other, what in (
        (edited, "recipe = 'awgn', not 'awgn-edited'"),
        (edited.named("awgn"), "another recipe named 'awgn'"),
    ):
        with pytest.raises(InputError, match=f"holds shards of {what}; choose another folder"):
            degrade_shards(Work([photos], other), tmp_path, 2, only=[])
