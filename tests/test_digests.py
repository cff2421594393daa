"""Digests of what is resumed: single bits, files that were cut, emptied, swapped or lost."""

import json
import os
import shutil

import numpy as np
import pytest

from experiments.abuse.flips import accepted, cases
from jaxisp.data import ShardSource, degrade_shards
from jaxisp.data.shard_source import MANIFEST, SCHEMA, shard_name
from jaxisp.data.work import Work
from jaxisp.errors import InputError
from jaxisp.generate import degrade_files
from jaxisp.io import write_png
from jaxisp.io.digests import changed_files, check_seal, is_sealed, own_folder, sealed_json, sealed_toml
from jaxisp.recipes import RECIPES
from jaxisp.testing import smooth_image


@pytest.fixture
def photos(tmp_path):
    (tmp_path / "in").mkdir()
    for name in "abc":
        write_png(tmp_path / "in" / f"{name}.png", smooth_image((24, 30, 3), ord(name)))
    return tmp_path / "in"


def test_no_flipped_bit_is_accepted(tmp_path):
    """`python -m experiments.abuse.flips` flips 1000 of each."""
    pytest.importorskip("array_record")
    rng, names = np.random.default_rng(0), []
    for case in cases(tmp_path):
        assert accepted(case, 40, rng) == 0, case[0]
        names.append(case[0])
    assert len(names) == 7


def contents(folder):
    return {p.name: p.read_bytes() for p in folder.iterdir()}


def test_what_is_no_longer_what_was_written_is_written_again(photos, tmp_path):
    out, recipe = tmp_path / "out", RECIPES["awgn"]()
    degrade_files([photos], out, recipe)
    whole = contents(out)

    def again():
        return degrade_files([photos], out, recipe, resume=True).kept

    assert again() == 3
    for name in ("a_000.clean.png", "b_000.noisy.png", "c_000.toml"):
        for data in (whole[name][:-1], b"", whole[name] + b"\n", None):
            (out / name).unlink()
            if data is not None:
                (out / name).write_bytes(data)
            assert again() == 2 and contents(out) == whole, name
    for end in ("clean.png", "noisy.png", "toml"):  # swapped
        for one, other in ("ab", "ba"):
            (out / f"{one}_000.{end}").write_bytes(whole[f"{other}_000.{end}"])
        assert again() == 1 and contents(out) == whole
    shutil.copyfile(photos / "b.png", photos / "a.png")  # another photograph of the same name and size
    assert again() == 2 and contents(out) != whole


def test_shards_of_other_photographs_or_other_bytes_are_not_kept(photos, tmp_path):
    pytest.importorskip("array_record")
    out, recipe = tmp_path / "out", RECIPES["awgn"]()
    degrade_shards(Work([photos], recipe), out, 3)
    paths = [out / f"{shard_name(s, 3)}.array_record" for s in range(3)]
    swapped = bytearray(paths[0].read_bytes())
    swapped[1000] ^= 1
    paths[0].write_bytes(swapped)  # as long as before
    assert degrade_shards(Work([photos], recipe), out, 3).kept == 2
    (out / f"{shard_name(1, 3)}.json").write_text("[" * 100_000)
    assert degrade_shards(Work([photos], recipe), out, 3).kept == 2 and not ShardSource(out).verify()
    data = bytearray((photos / "a.png").read_bytes())
    data[-5] ^= 1
    (photos / "a.png").write_bytes(data)
    with pytest.raises(InputError, match="holds shards of other inputs"):
        degrade_shards(Work([photos], recipe), out, 3)


@pytest.mark.parametrize(
    "text",
    [
        '{"schema": 2, "shards": 1000000000000000}',
        "{}",
        "[]",
        "",
        "\xff",
        "[" * 100_000,
        '{"schema": 1}',
        "\0",
    ],
)
def test_a_damaged_manifest_is_one_line_at_once(tmp_path, text):
    (tmp_path / "manifest.json").write_text(text, encoding="latin-1")
    with pytest.raises(InputError, match=r"manifest\.json: "):
        ShardSource(tmp_path)
    (tmp_path / "manifest.json").write_text(sealed_json(text) if text.startswith('{"') else text)
    with pytest.raises(InputError, match=r"manifest\.json: "):
        ShardSource(tmp_path)


def test_seals():
    toml, table = sealed_toml('a = "' + "0" * 64 + '"\n'), sealed_json('{\n "a": 1\n}')
    for text in (toml, table):
        assert is_sealed(text)
        assert (
            not is_sealed(text.replace("a", "b", 1))
            and not is_sealed(text + " ")
            and not is_sealed(text[:-1])
        )
    assert not is_sealed('a = 1\n# digest = "' + "0" * 64 + '"\n')


def test_a_text_that_was_changed_by_hand_says_how_to_use_it(tmp_path):
    path = tmp_path / "config.toml"
    for text in ("a = 1\n", sealed_toml("a = 1")):
        path.write_text(text)
        check_seal(path)
    path.write_text(sealed_toml("a = 1").replace("1", "2", 1))
    with pytest.raises(InputError, match="Delete that line to use it as it is"):
        check_seal(path)


def test_a_folder_of_ones_own(tmp_path):
    def write(**files):
        with own_folder(tmp_path / "out", "list.json") as folder:
            for name, text in files.items():
                (folder / "deep").mkdir(exist_ok=True)
                (folder / "deep" / name).write_text(text)

    write(a="one", b="two")
    write(a="three")
    assert sorted(p.name for p in (tmp_path / "out").rglob("*")) == ["a", "deep", "list.json"]
    (tmp_path / "out" / "mine" / "deep").mkdir(parents=True)  # of the user's own, and empty
    with own_folder(tmp_path / "new", "list.json") as folder:
        (folder / "two" / "deep").mkdir(parents=True)
        (folder / "two" / "deep" / "a").write_text("a")
    with own_folder(tmp_path / "new", "list.json") as folder:
        assert not (folder / "two").exists()
    write(a="four")
    assert (tmp_path / "out" / "mine" / "deep").is_dir()
    (tmp_path / "elsewhere").mkdir()
    (tmp_path / "out" / "link").symlink_to("../elsewhere")
    with pytest.raises(InputError, match="out: holds link, which is none of the files"):
        write(c="five")
    (tmp_path / "out" / "link").unlink()
    for name in ("deep/mine", "deep/a"):
        (tmp_path / "out" / name).write_text("mine")
        with pytest.raises(InputError, match=f"out: holds {name}, which is none of the files written here"):
            write(c="four")
        assert (tmp_path / "out" / name).read_text() == "mine" and not (
            tmp_path / "out" / "deep" / "c"
        ).exists()
        (tmp_path / "out" / "deep" / "mine").unlink(missing_ok=True)


@pytest.mark.parametrize("kind", ["text", "link", "FIFO"])
def test_a_list_that_is_none_of_ours_is_left_alone(tmp_path, kind):
    with own_folder(tmp_path / "other", "list.json") as folder:
        (folder / "a").write_text("a")
    place = tmp_path / "out" / "list.json"
    place.parent.mkdir()
    if kind == "text":
        place.write_text("mine")
    if kind == "link":
        place.symlink_to(tmp_path / "other" / "list.json")
    if kind == "FIFO":
        os.mkfifo(place)
    with (
        pytest.raises(InputError, match=r"out: holds list\.json, which is none"),
        own_folder(place.parent, "list.json"),
    ):
        raise AssertionError
    assert os.listdir(place.parent) == ["list.json"]


@pytest.mark.parametrize("files", [5, None, ["a"], {"a": 5}, {"a": None}, {"a": ["0" * 64]}])
def test_digests_that_are_no_text_are_one_error(tmp_path, files):
    (tmp_path / "a").write_bytes(b"a")
    (tmp_path / "notes.json").write_text(sealed_json(json.dumps({"files": files})))
    with pytest.raises(InputError, match=r"notes\.json: holds no digests of files"):
        changed_files(tmp_path, "notes.json")
    with (
        pytest.raises(InputError, match="holds a, which is none of the files"),
        own_folder(tmp_path, "notes.json"),
    ):
        raise AssertionError


@pytest.mark.parametrize("inputs", [5, None, ["a"], [["a", 5]], [["a"]], [[["a"], "b"]], {"a": "b"}])
def test_a_manifest_whose_inputs_are_no_text_is_one_error(photos, tmp_path, inputs):
    pytest.importorskip("array_record")
    plan = {
        "schema": SCHEMA,
        "shards": 1,
        "recipe": "awgn",
        "recipe_sha256": "0",
        "seed": 0,
        "inputs": inputs,
    }
    (tmp_path / "out").mkdir()
    (tmp_path / "out" / MANIFEST).write_text(sealed_json(json.dumps(plan)))
    for use in (ShardSource, lambda out: degrade_shards(Work([photos], RECIPES["awgn"]()), out, 1)):
        with pytest.raises(InputError, match=r"manifest\.json: its inputs are no names with digests"):
            use(tmp_path / "out")
