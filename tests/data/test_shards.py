"""Shards: the pictures of plain degrading, by index, in any number of files, resumed, damaged, locked."""

import fcntl
import pickle
import time
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest

from jaxisp.data import ShardSource, degrade_shards
from jaxisp.data.shard_source import read_manifest, shard_name
from jaxisp.data.shards import parse_shards
from jaxisp.data.work import Work
from jaxisp.errors import InputError
from jaxisp.generate import degrade_files
from jaxisp.io import read_image, write_png
from jaxisp.recipe import Recipe
from jaxisp.recipes import RECIPES
from jaxisp.testing import smooth_image

pytest.importorskip("array_record")


@pytest.fixture(scope="module")
def photos(tmp_path_factory):
    folder = tmp_path_factory.mktemp("photos é 1")
    for i, shape in enumerate(((24, 30, 3), (17, 21, 3), (24, 30, 3))):
        write_png(folder / f"p{i}.png", smooth_image(shape, i))
    (folder / "q.png").write_bytes(b"\x89PNG\r\n\x1a\nbroken")
    return folder


def work(photos, recipe="amwgn", **options):
    return Work([photos], RECIPES[recipe](), **{"count": 3, "seed": 5, "start": 7, **options})


@pytest.fixture(scope="module")
def written(photos, tmp_path_factory):
    out = tmp_path_factory.mktemp("shards")
    return out, degrade_shards(work(photos), out, 4)


def test_every_sample_is_that_of_plain_degrading(photos, written, tmp_path):
    plain = degrade_files([photos], tmp_path, RECIPES["amwgn"](), count=3, seed=5, start=7)
    out, outcome = written
    assert outcome.images == plain.images == 9 and outcome.failed == plain.failed
    source = ShardSource(out)
    assert len(source) == 9 and source.indices.tolist() == list(range(7, 16))
    for i in range(len(source)):
        name = source.arrays(i)["name"].tobytes().decode()
        for part in ("clean", "noisy"):
            np.testing.assert_array_equal(source[i][part], read_image(tmp_path / f"{name}.{part}.png"))
        drawn = Recipe.load(tmp_path / f"{name}.toml")
        digests = drawn.meta.pop("sha256")  # of the pictures beside it
        assert set(digests) == {"clean", "noisy"}
        assert source.parameters(i) == drawn and drawn.meta["sample"]["index"] == source.indices[i]


@pytest.mark.parametrize("shards", [1, 7, 20])
def test_the_number_of_shards_and_their_order_change_nothing(photos, written, tmp_path, shards):
    for shard in reversed(range(shards)):
        degrade_shards(work(photos), tmp_path, shards, only=[shard])
    one, other = ShardSource(written[0]), ShardSource(tmp_path)
    assert repr(one) == repr(other)
    for i in range(len(one)):
        for name, value in one.arrays(i).items():
            np.testing.assert_array_equal(value, other.arrays(i)[name])


def test_a_run_goes_on_and_keeps_what_stands(photos, written, tmp_path):
    degrade_shards(work(photos), tmp_path, 4, only=[0, 2])
    with pytest.raises(InputError, match=r"2 of 4 shards are missing; write them with --shard 1,3"):
        ShardSource(tmp_path)
    broken = tmp_path / f"{shard_name(2, 4)}.array_record"
    broken.write_bytes(broken.read_bytes()[:-100])
    stood = (tmp_path / f"{shard_name(0, 4)}.array_record").stat().st_mtime_ns
    outcome = degrade_shards(work(photos), tmp_path, 4)
    assert outcome.kept == 3 and not list(tmp_path.glob(".*.tmp"))
    assert (tmp_path / f"{shard_name(0, 4)}.array_record").stat().st_mtime_ns == stood
    source = ShardSource(tmp_path)
    assert len(source) == 9 and not source.verify()


def test_shards_of_something_else_are_refused(photos, written):
    out, _ = written
    for other, words in (
        (work(photos, seed=6), "seed = 5, not 6"),
        (work(photos, "awgn"), "recipe = 'amwgn'"),
        (work(photos / "p0.png"), "samples = 12, not 3"),
        (Work([photos / "q.png", photos], RECIPES["amwgn"](), 3, 5, 7), "other inputs"),
    ):
        with pytest.raises(InputError, match=words):
            degrade_shards(other, out, 4)
    with pytest.raises(InputError, match="shards = 4, not 5"):
        degrade_shards(work(photos), out, 5)
    with pytest.raises(InputError, match=r"holds no manifest\.json"):
        ShardSource(photos)


def test_shards_of_other_places_and_sets_are_made_anew(photos, tmp_path):
    def parts(folder, shard):
        return [folder / f"{shard_name(shard, 3)}{end}" for end in (".array_record", ".json")]

    def put(folder, taken):
        """In the place of shards those of a folder."""
        held = {s: [path.read_bytes() for path in parts(folder, other)] for s, other in taken.items()}
        for shard, own in held.items():
            for path, data in zip(parts(tmp_path / "own", shard), own):
                path.write_bytes(data)

    own, other = tmp_path / "own", tmp_path / "other"
    degrade_shards(work(photos), own, 3)
    degrade_shards(work(photos, seed=6), other, 3)
    whole = [record["noisy"] for record in ShardSource(own)]
    for folder, taken in ((other, {1: 1}), (own, {0: 1, 1: 0}), (own, {2: 0})):
        put(folder, taken)
        with pytest.raises(InputError, match=f"{len(taken)} of 3 shards are missing"):
            ShardSource(own)
        degrade_shards(work(photos), own, 3)
        for record, noisy in zip(ShardSource(own), whole, strict=True):
            np.testing.assert_array_equal(record["noisy"], noisy)
    (own / "recipe.toml").write_text("another")
    with pytest.raises(InputError, match=r"recipe\.toml: stands there already"):
        degrade_shards(work(photos), own, 3)


def test_damage_is_found(photos, tmp_path):
    degrade_shards(work(photos), tmp_path, 1)
    path = tmp_path / f"{shard_name(0, 1)}.array_record"
    data = bytearray(path.read_bytes())
    data[1000] ^= 255  # within the first record; the file's end is padding
    path.write_bytes(bytes(data))
    source = ShardSource(tmp_path)
    assert source.verify() == [path]
    with pytest.raises(InputError, match="damaged"):
        for i in range(len(source)):
            source.arrays(i)
    path.with_suffix(".json").write_text("{}")
    with pytest.raises(InputError, match="1 of 1 shards are missing"):
        ShardSource(tmp_path)
    (tmp_path / "manifest.json").write_text("{")
    with pytest.raises(InputError, match=r"manifest\.json: is damaged"):
        ShardSource(tmp_path)


def test_one_writer_a_shard_and_none_beside_plain_degrading(photos, tmp_path):
    (tmp_path / f".{shard_name(1, 2)}.lock").touch()
    with (tmp_path / f".{shard_name(1, 2)}.lock").open("w") as file:
        fcntl.flock(file, fcntl.LOCK_EX)
        with pytest.raises(InputError, match="another process is writing"):
            degrade_shards(work(photos), tmp_path, 2, only=[1])
        assert degrade_shards(work(photos), tmp_path, 2, only=[0]).images
    with (tmp_path / ".lock").open("w") as file:
        fcntl.flock(file, fcntl.LOCK_SH)  # as another job that writes shards does
        assert degrade_shards(work(photos), tmp_path, 2).images
        with pytest.raises(InputError, match="another process is writing"):
            degrade_files([photos], tmp_path, RECIPES["amwgn"]())


def test_of_two_that_start_at_once_with_different_recipes_one_is_refused(photos, tmp_path, monkeypatch):
    written = Recipe.save

    def slow(recipe, path):
        written(recipe, path)
        time.sleep(0.5)  # long enough for the other to find no manifest

    monkeypatch.setattr(Recipe, "save", slow)

    def ends(recipe):
        try:
            degrade_shards(work(photos, recipe), tmp_path, 1, only=[])
        except InputError as error:
            return str(error)
        return recipe

    with ThreadPoolExecutor() as pool:
        one, other = sorted(pool.map(ends, ("amwgn", "awgn")), key=len)
    assert "holds shards of recipe" in other
    assert read_manifest(tmp_path)["recipe"] == Recipe.load(tmp_path / "recipe.toml").name == one


def test_grain_reads_them_and_so_do_its_workers(written):
    grain = pytest.importorskip("grain")
    source = ShardSource(written[0])
    source[0]
    copy = pickle.loads(pickle.dumps(source))
    np.testing.assert_array_equal(copy[8]["noisy"], source[8]["noisy"])
    dataset = grain.MapDataset.source(source).seed(1).shuffle()
    assert sorted(dataset[i]["noisy"].tobytes() for i in range(9)) == sorted(
        source[i]["noisy"].tobytes() for i in range(9)
    )
    with pytest.raises(IndexError):
        source[9]


@pytest.mark.parametrize(("text", "numbers"), [("3", [3]), ("0-2", [0, 1, 2]), ("7, 0-1", [7, 0, 1])])
def test_shard_numbers(text, numbers):
    assert parse_shards(text, 8) == numbers


@pytest.mark.parametrize("text", ["8", "2-1", "-1", "a", "", "0-8", "1,,2", "99999999999999999999"])
def test_shard_numbers_that_are_none(text):
    with pytest.raises(InputError, match="from 0 to 7"):
        parse_shards(text, 8)


def test_from_the_command_line(photos, tmp_path, capsys):
    import json

    from jaxisp.cli import main

    command = ["degrade", str(photos / "p0.png"), "-o", str(tmp_path / "out"), "--recipe", "amwgn", "--json"]
    for shard, images, kept in (("1", 2, 0), ("0-1", 1, 2)):  # 3 samples: 1 in the first, 2 in the second
        assert main([*command, "--count", "3", "--shards", "2", "--shard", shard, "--seed", "4"]) == 0
        said = json.loads(capsys.readouterr().out)
        assert (said["images"], said["kept"]) == (images, kept)
    assert len(ShardSource(tmp_path / "out")) == 3
    assert main([*command, "--shard", "1"]) == 2 and "--shard needs --shards" in capsys.readouterr().err
    assert main([*command, "--shards", "2", "--shard", "2"]) == 2
    assert "expected numbers from 0 to 1" in capsys.readouterr().err


def test_an_error_of_computing_is_not_one_of_the_disk(tmp_path, monkeypatch):
    def broken(*_):
        raise RuntimeError("no device")

    write_png(tmp_path / "p.png", smooth_image((12, 14, 3)))
    work = Work([tmp_path / "p.png"], RECIPES["awgn"]())
    monkeypatch.setattr(type(work.recipe), "degrade", broken)
    with pytest.raises(RuntimeError, match="no device"):
        degrade_shards(work, tmp_path / "out", 1)
    assert not list((tmp_path / "out").glob("shard*"))
