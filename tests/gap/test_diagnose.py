"""The whole diagnosis, on cameras that share no code with the package and whose effect it is not told.

In `make test` a camera that lacks nothing and one that lacks something are diagnosed, here and beside clean
pictures in `test_clean_noisy`; `test_verdict` and `test_stepwise` hold how a verdict comes, "unknown" too.
"""

import functools
import io
import json
from contextlib import redirect_stderr, redirect_stdout
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter

from experiments.null_bank import beyond
from experiments.withheld.scenes import scenes
from experiments.withheld.shoot import write
from jaxisp.camera import develop
from jaxisp.cli import main
from jaxisp.errors import InputError
from jaxisp.gap import diagnose
from jaxisp.gap.axes.null_bank import bank
from jaxisp.gap.report.record import HIDDEN, NO_COLOURS
from jaxisp.io import open_dataset
from jaxisp.recipe import Recipe
from tests.gap.schema import keeps_the_schema

pytestmark = pytest.mark.optimised

BODY, LONE = "birch", "lone.jpg"


CASES = {"nothing": 1, "scene_gain": 1, "vignetting": 4, "chroma_denoising": 3, "color_lut": 4,
         "local_tone_mapping": 4, "optical_blur": 3, "green_imbalance": 4, "film_grain": 4,
         "diagonal_filter": 5}  # fmt: skip
"""What the camera does, and how strongly."""


@pytest.fixture(scope="module")
def pairs(tmp_path_factory):
    """The pairs of a case; all are of one body and size, to share programs."""

    @functools.cache
    def folder(name: str) -> Path:
        made = tmp_path_factory.mktemp(name)
        write(made, BODY, {name: CASES[name]}, size=128, count=6)
        return made

    return folder


@pytest.fixture(scope="module")
def commanded(pairs, tmp_path_factory):
    """What `jaxisp diagnose` prints of vignetting beside a file that has no pair, and its output folder."""
    folder, out = pairs("vignetting"), tmp_path_factory.mktemp("written")
    (folder / LONE).write_bytes(b"")
    with redirect_stdout(io.StringIO()) as said, redirect_stderr(io.StringIO()) as warned:
        status = main(["diagnose", str(folder), "-o", str(out), "--json"])
    return SimpleNamespace(
        folder=folder, out=out, status=status, report=json.loads(said.getvalue()), warned=warned.getvalue()
    )


@pytest.fixture(scope="module")
def diagnosed(pairs, request):
    """The report of a case, made when it is asked for."""

    @functools.cache
    def report(name: str):
        whole = name == "vignetting"
        found = request.getfixturevalue("commanded").report if whole else diagnose(pairs(name)).report
        keeps_the_schema(found)
        assert found["kind"] == "raw+jpeg"
        return found

    return report


def named(report) -> set[str]:
    """The first cause and what it cannot be told from."""
    first = report["causes"][0] if report["causes"] else {"effect": None, "alternatives": []}
    return {first["effect"], *first["alternatives"]}


@pytest.mark.parametrize("harmless", ["nothing", pytest.param("scene_gain", marks=pytest.mark.slow)])
def test_no_effect_is_named_where_none_is_missing(diagnosed, harmless):
    report = diagnosed(harmless)
    assert report["verdict"] == "none" and report["causes"] == [] and report["where"] == []
    assert not beyond(bank()["raw+jpeg"], report["gap"]["axes"])


@pytest.mark.parametrize(
    "effect",
    [
        "vignetting",
        *(
            pytest.param(name, marks=pytest.mark.slow)
            for name in (
                "color_lut",
                "film_grain",
                "chroma_denoising",
                "local_tone_mapping",
                "optical_blur",
                "green_imbalance",
            )
        ),
    ],
)
def test_the_effect_that_is_missing_is_named(diagnosed, effect):
    report = diagnosed(effect)
    assert report["verdict"] == "effect"
    assert effect in named(report), [(r["effect"], round(r["closed"], 2)) for r in report["ranking"][:4]]
    assert report["where"], "a gap is somewhere"


@pytest.mark.slow
def test_what_is_outside_the_vocabulary_is_unknown(diagnosed):
    report = diagnosed("diagonal_filter")
    assert report["verdict"] == "unknown" and report["causes"] == []
    assert "orientation" in [row["axis"] for row in report["where"][:3]]
    assert "edge" in report["unexplained"]["next_measurement"]


@pytest.mark.slow
def test_grey_scenes_are_said_to_show_no_colour(diagnosed, tmp_path):
    smooth = {name: gaussian_filter(s.mean(-1), 4) for name, s in scenes("one", 128, 6).items()}
    grey = {name: np.repeat(s[..., None], 3, -1) for name, s in smooth.items()}  # detail has false colours
    write(tmp_path, BODY, {"vignetting": 4}, scenes=grey)
    found, coloured = diagnose(tmp_path).report, diagnosed("vignetting")
    colour = {"saturation", "color_lut"}
    assert _not_identifiable(found) >= {*colour, "color_matrix"}
    assert not _not_identifiable(coloured) & colour


def _not_identifiable(report) -> set[str]:
    """Effects that the pairs cannot show or say nothing of."""
    return {r["effect"] for r in report["ranking"] if r.get("reason") in (HIDDEN, NO_COLOURS)}


def test_with_the_cause_raw_files_are_developed_as_by_the_camera(commanded):
    simulator = commanded.out / "simulator.toml"
    assert Recipe.load(simulator).meta["causes"] == ["vignetting"]

    def left(camera):
        pairs = [pair.load() for pair in open_dataset(commanded.folder).pairs]
        return np.mean([(255 * (develop(p.raw, camera) - p.picture)) ** 2 for p in pairs])

    assert left(simulator) < 0.4 * left(Recipe.load(simulator).without("vignetting"))


def test_the_command_writes_both_files(commanded):
    printed, out = commanded.report, commanded.out
    assert commanded.status == 2
    assert f"jaxisp: {commanded.folder / LONE}: has no RAW file beside it" in commanded.warned, (
        "the rest is diagnosed all the same"
    )
    assert [f["file"] for f in printed["pairs"]["failed"]] == [LONE]
    assert {row["done"] for row in printed["pairs"]["aligned"]} == {"nothing"}
    assert json.loads((out / "report.json").read_text())["verdict"] == printed["verdict"]
    assert "<html" in (out / "report.html").read_text()


@pytest.mark.slow
def test_what_is_excluded_is_not_named(tmp_path):
    write(tmp_path, BODY, {"vignetting": 4}, size=128, count=4)
    report = diagnose(tmp_path, exclude=["vignetting"]).report
    assert "vignetting" not in {r["effect"] for r in report["ranking"]}
    with pytest.raises(InputError, match="no effect named 'nonsense'"):
        diagnose(tmp_path, exclude=["nonsense"])
