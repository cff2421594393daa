"""One bad file never ends a batch, and no name does anything to a terminal."""

import os
import re
from pathlib import Path

import pytest

import jaxisp.cli
from jaxisp.cli import common, main
from jaxisp.errors import printable
from jaxisp.io import write_png
from jaxisp.testing import smooth_image
from jaxisp.train.logs import STEP_FIELDS, Log, read_rows
from tests.io.test_files import as_nobody, open_to_all, special_inputs

EVIL = "\x1b]0;owned\x07[red]a[bold]\u202egnp\x9b2J"


@pytest.fixture
def folder(tmp_path):
    open_to_all(tmp_path)
    (tmp_path / "in").mkdir()
    for i, name in enumerate(("fine.png", "n" * 251 + ".png", f"{EVIL}.png")):
        write_png(tmp_path / "in" / name, smooth_image((24, 30, 3), i))
    (tmp_path / "in" / f"{EVIL}2.png").write_bytes(b"no picture")
    os.mkfifo(tmp_path / "in" / "FIFO.png")
    return tmp_path


def run(capsys, *arguments):
    status = main([str(a) for a in arguments])
    return status, *capsys.readouterr()


def test_degrade_goes_on(folder, capsys):
    (folder / "others").mkdir()
    bad = special_inputs(folder / "others")
    command = ("degrade", folder / "in" / "fine.png", "-o", folder / "before", "--recipe", "awgn")
    assert run(capsys, *command)[0] == 0  # imports what nobody may not be able to
    with as_nobody():
        status, out, err = run(
            capsys, "degrade", *bad, folder / "in", "-o", folder / "out", "--recipe", "awgn"
        )
    told = err.splitlines()
    assert status == 2 and out.startswith("2 images") and len(told) == len(bad) + 3
    assert all(printable(line) == line and line.startswith("jaxisp: ") for line in told)
    assert {p.name for p in (folder / "out").glob("*.toml")} == {
        "fine_000.toml",
        f"{EVIL}_000.toml",
        "dataset.toml",
    }
    assert [line for line in told if "its name is too long for those of its results" in line]


LINKED = (  # {} is a link to itself, then one to nothing
    "develop {}.dng -o a.png", "develop {}.npy -o a.png", "develop a.dng -o {}.png",
    "develop a.dng -o {}/a.png", "develop a.dng -o a.png --camera {}.toml", "fit {} -o c.toml",
    "fit in -o {}.toml", "fit in -o {}/c.toml", "fit in -o c.toml --report {}",
    "fit in -o c.toml --recipe {}.toml", "calibrate {} {} -o n.toml", "calibrate a.dng a.dng -o {}.toml",
    "adapt {} -o a.toml", "adapt in -o {}.toml",
    "adapt in -o {}/a.toml", "adapt in -o a.toml --clean {}", "adapt in -o a.toml --recipe {}.toml",
    "recipe {}.toml -o b.toml", "recipe phone -o {}.toml", "recipe phone -o b.toml --noise {}.toml",
    "degrade {} -o out --recipe awgn", "degrade {}.png -o out --recipe awgn",
    "degrade in -o {} --recipe awgn", "degrade in -o {}/out --recipe awgn",
    "degrade in -o out --recipe {}.toml", "degrade in -o {} --recipe awgn --shards 1",
    "train --clean {} -o run --recipe awgn", "train --clean in -o {} --recipe awgn",
    "train --clean in -o run --recipe {}.toml", "train -o {} --resume", "denoise --run {} in -o out",
    "evaluate --run {} in", "evaluate --methods gaussian {}", "diagnose {} -o d", "diagnose in -o {}",
    "diagnose in -o d --camera {}.toml", "compare {} {}", "compare {}.json {}.json", "demo --out {}",
)  # fmt: skip


@pytest.mark.parametrize("name", ["loop", "lost"])
def test_links_to_themselves_and_to_nothing(tmp_path, capsys, monkeypatch, name):
    monkeypatch.chdir(tmp_path)
    Path("in").mkdir()
    write_png("in/fine.png", smooth_image((24, 30, 3)))
    for end in ("", ".dng", ".npy", ".png", ".toml", ".json"):
        Path(f"{name}{end}").symlink_to(f"{name}{end}" if name == "loop" else "nothing")
    before = sorted(tmp_path.rglob("*"))
    for command in LINKED:
        status, out, err = run(capsys, *command.format(name, name).split())
        assert (status, out, err.count("\n")) == (2, "", 1), (command, err)
        assert f"{name}" in err or "jaxisp: a.dng: " in err or "jaxisp: in: holds no " in err, (command, err)
        assert sorted(tmp_path.rglob("*")) == before, command


def test_a_folder_of_links_is_a_batch(tmp_path, capsys):
    (tmp_path / "in" / "sub").mkdir(parents=True)
    write_png(tmp_path / "in" / "fine.png", smooth_image((24, 30, 3)))
    for name, target in (
        ("loop.png", "loop.png"),
        ("a.png", "b.png"),
        ("b.png", "a.png"),
        ("lost.png", "nothing"),
        ("loop", "loop"),
        ("here", "."),
        ("sub/up", ".."),
    ):
        (tmp_path / "in" / name).symlink_to(target)
    status, out, err = run(
        capsys, "degrade", tmp_path / "in", "-o", tmp_path / "out", "--recipe", "awgn", "--json"
    )
    assert status == 2 and '"images": 1' in out and len(err.splitlines()) == 4
    assert all(f"/{name}.png: cannot be read: " in err for name in ("a", "b", "loop", "lost"))


def test_a_pair_that_is_no_file_does_not_end_an_evaluation(tmp_path):
    from jaxisp.train.evaluate import evaluate_dataset

    for name in ("a", "b"):
        for part in ("clean", "noisy"):
            write_png(tmp_path / f"{name}.{part}.png", smooth_image((24, 30, 3)))
    (tmp_path / "b.noisy.png").unlink()
    os.mkfifo(tmp_path / "b.noisy.png")
    Path(os.fsdecode(os.fsencode(tmp_path) + b"/\xff.noisy.png")).symlink_to(tmp_path / "a.noisy.png")
    Path(os.fsdecode(os.fsencode(tmp_path) + b"/\xff.clean.png")).symlink_to(tmp_path / "a.clean.png")
    result = evaluate_dataset(lambda image: image, tmp_path)
    assert [pair["name"] for pair in result["pairs"]] == ["a"]
    assert sorted("FIFO" in reason or "not UTF-8" in reason for _, reason in result["failed"]) == [True, True]


def test_printable():
    assert printable("a b é 写 [x]") == "a b é 写 [x]"
    assert printable("a\nb\tc\u00a0d\r") == "a b c d "
    assert printable("\x1b[2J\x07\x9b\u202e\udcff\x7f") == r"\x1b[2J\x07\x9b\u202e\udcff\x7f"


def test_all_that_is_printed_for_people_is_printable(capsys):
    common.say(EVIL)
    common.warn(EVIL)
    common.print_table(("a",), [(EVIL,)])
    with pytest.raises(SystemExit):
        main(["develop", f"--{EVIL}"])
    out, err = capsys.readouterr()
    for line in (out + err).splitlines():
        assert printable(line) == line
    assert out.count("[red]a[bold]") == 2 and out.count("owned") == 2
    for path in Path(jaxisp.cli.__file__).parent.glob("*.py"):
        if path.name != "common.py":
            assert not re.findall(r"(?<![\w.])print\(", path.read_text()), path


def test_progress_shows_names_as_they_are(monkeypatch, capsys):
    monkeypatch.setattr("sys.stderr.isatty", lambda: True)
    monkeypatch.setenv("FORCE_COLOR", "1")
    with common.progress("working") as tick:
        tick(1, 2, EVIL)
    said = capsys.readouterr().err
    assert "[red]a[bold]" in said and "\x1b]0;" not in said and "\u202e" not in said


@pytest.mark.parametrize(
    "damage",
    [
        b"\x00" * 64,
        b"\xff\xfe\n",
        b'"' + b"x" * 200_000,
        b"9" * 5000 + b",1,1,1,1,1\n",
        b"1,2\n",
        "²,1,1,1,1,1\n".encode(),
    ],
)
def test_a_damaged_log_loses_its_damaged_lines_alone(tmp_path, damage):
    row = dict.fromkeys(STEP_FIELDS, 1.0)
    log = Log(tmp_path, 0)
    log.steps([{**row, "step": 1}, {**row, "step": 2}])
    log.close()
    path = tmp_path / "log.csv"
    lines = path.read_bytes().splitlines(keepends=True)
    path.write_bytes(b"".join([*lines[:2], damage + b"\n", lines[2], b"3,1,"]))
    Log(tmp_path, 5).close()
    assert [r["step"] for r in read_rows(path)] == ["1", "2"]
    assert path.read_bytes().splitlines() == [line.rstrip() for line in lines]


def test_a_log_that_is_no_file_is_one_line(tmp_path):
    os.mkfifo(tmp_path / "log.csv")
    with pytest.raises(jaxisp.InputError, match=r"log\.csv: is a FIFO"):
        Log(tmp_path, 0)


def test_what_the_system_says_of_a_file_is_one_line(capsys, monkeypatch):
    def broken(arguments):
        raise PermissionError(13, "Permission denied", "somewhere")

    monkeypatch.setattr("jaxisp.cli.listings.run_recipes", broken)
    assert run(capsys, "recipes") == (2, "", "jaxisp: somewhere: cannot be used: permission denied\n")
