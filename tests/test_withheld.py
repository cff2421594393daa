"""The cameras of the withheld-effect study: independent of the package, and each effect does something."""

import ast
import json
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from skimage.color import rgb2gray

from experiments.withheld import effects
from experiments.withheld.bodies import BODIES, Noise, _by_name
from experiments.withheld.camera import KINDS, Shot, before_body, develop, expose
from experiments.withheld.demosaic import DEMOSAICKERS, demosaic, mosaicked
from experiments.withheld.libraw import SWITCHES, developed
from experiments.withheld.outside import AXES as OUTSIDE_AXES
from experiments.withheld.scenes import GREY, SETS, clutter, scenes
from experiments.withheld.shoot import write
from experiments.withheld.study import (
    _TOO_SMALL,
    Case,
    _plain,
    cases,
    counted,
    examine,
    kept,
    parse,
    run,
    true_closure,
)
from experiments.withheld.tables import markdown, wilson
from experiments.withheld_targets import located, targets
from jaxisp.gap.effects import AXES
from jaxisp.gap.verdict import NULL_DROP

PACKAGE = Path(__file__).parent.parent / "experiments" / "withheld"
ALLOWED = {"numpy", "scipy", "cv2", "PIL", "skimage"}
MORE = {"study": {"jaxisp"}, "libraw": {"rawpy", "tifffile"}}


def imported(path: Path) -> set[str]:
    """Top-level names of all that a module imports, at any depth; what lies beside it is left out."""
    found = set()
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.Import):
            found |= {alias.name.split(".")[0] for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            assert node.level <= 1, f"{path}: reaches outside its folder"
            found |= {node.module.split(".")[0]} if node.level == 0 and node.module else set()
        elif isinstance(node, ast.Call) and isinstance(node.func, ast.Name):
            assert node.func.id not in ("__import__", "exec", "eval"), path
    return found


@pytest.mark.parametrize("path", sorted(PACKAGE.glob("*.py")), ids=lambda p: p.stem)
def test_imports_nothing_of_the_package(path: Path) -> None:
    extra = imported(path) - set(sys.stdlib_module_names) - ALLOWED
    assert extra == MORE.get(path.stem, set())
    assert "importlib" not in imported(path)
    assert path.stem == "scenes" or "skimage" not in imported(path)


def test_study_names_the_package_once() -> None:
    assert (PACKAGE / "study.py").read_text().count("jaxisp") == 1


def test_vocabulary_is_the_contract() -> None:
    assert len(effects.VOCABULARY) == 34
    assert set(effects.DEVELOP) | set(effects.SEALED) == set(effects.VOCABULARY)
    assert not set(effects.DEVELOP) & set(effects.SEALED)
    assert all(len(effect.strengths) == 5 for effect in effects.EVERYTHING.values())
    assert sum(1 for _ in cases(KINDS[0], "nulls", list(BODIES), [1])) >= 100
    assert set(OUTSIDE_AXES) == set(effects.OUTSIDE)
    assert set().union(*OUTSIDE_AXES.values()) <= set(AXES)


def picture(size: int = 64) -> np.ndarray:
    rng = np.random.default_rng(3)
    field = np.stack([clutter(size, rng, 1.1) for _ in range(3)], axis=-1)
    found = np.clip(0.15 + 0.85 * field.mean(-1, keepdims=True) + 0.5 * (field - 0.5), 0.01, 1)
    found[8:16, 8:24], found[40:48, 30:40], found[30:36, 4:20] = (0.9, 0.02, 0.02), 1.0, (0.02, 0.05, 0.8)
    return found


def shoot(body: str, kind: str, active: dict[str, int], scene: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """RAW and picture of a body that has next to no noise of its own."""
    chosen = tuple((effects.EVERYTHING[name], level) for name, level in active.items())
    still = replace(BODIES[body], bright=Noise(1e10, 1.0), dim=Noise(1e10, 1.0))
    shot = Shot(still, kind, chosen, "test")
    raw = expose(before_body(scene, still), shot)
    return raw, develop(raw, shot)


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("body", ["alder", "birch"])
def test_effects_grow_and_leave_the_raw_alone(body: str, kind: str) -> None:
    scene = picture()
    raw, plain = shoot(body, kind, {}, scene)
    for name in (*effects.VOCABULARY, *effects.OUTSIDE):
        if not effects.shows_in(name, kind) or "noise" in effects.EVERYTHING[name].acts[kind]:
            continue
        change = []
        for level in (1, 5):
            other, pixels = shoot(body, kind, {name: level}, scene)
            change.append(np.sqrt(np.mean((pixels.astype(float) - plain) ** 2)))
            if kind == "raw+jpeg":
                np.testing.assert_array_equal(other, raw, err_msg=name)
        assert 0.02 < change[0] < change[1], (name, change)


def flat_noise(name: str, level: int) -> np.ndarray:
    """Noise in the RAW of a dark card, without the mean of each place in the CFA."""
    shot = Shot(BODIES["alder"], "clean+noisy", ((effects.EVERYTHING[name], level),), "card")
    cells = expose(np.full((256, 256, 3), 0.004), shot).reshape(128, 2, 128, 2).astype(float)
    return (cells - cells.mean((0, 2), keepdims=True)).reshape(256, 256)


@pytest.mark.parametrize(
    ("name", "measure"),
    [
        ("noise_level", np.std),
        ("correlated_noise", lambda x: np.mean(x[:, 1:] * x[:, :-1]) / x.var()),
        ("heavy_tailed_noise", lambda x: np.mean(x**4) / x.var() ** 2),
        ("row_noise", lambda x: x.mean(axis=1).std()),
        ("column_noise", lambda x: x.mean(axis=0).std()),
    ],
)
def test_noise_effects_grow(name, measure) -> None:
    weak, strong = (measure(flat_noise(name, level)) for level in (1, 5))
    assert strong > 1.3 * weak


@pytest.mark.parametrize("cfa", ["RGGB", "BGGR", "GRBG", "GBRG"])
@pytest.mark.parametrize("name", sorted(DEMOSAICKERS))
def test_demosaickers_keep_colours_of_all_mosaics(name: str, cfa: str) -> None:
    y, x = np.mgrid[:32, :40] / 40
    smooth = np.stack([0.2 + 0.5 * x, 0.3 + 0.4 * y, 0.7 - 0.4 * x], axis=-1)
    for border in ("reflect", "cells"):
        found = demosaic(mosaicked(smooth, cfa), cfa, name, border)
        assert np.abs(found - smooth)[4:-4, 4:-4].max() < 0.01


def test_write_is_repeatable_and_as_the_contract_says(tmp_path: Path) -> None:
    chosen = {"first": picture(48)}
    for folder in ("a", "b"):
        write(tmp_path / folder, "dogwood", {"vignetting": 3, "sharpening": 2}, "raw+jpeg", chosen)
    write(tmp_path / "c", "alder", {"jpeg_quantization": 4}, "clean+noisy", chosen, frames=2)
    files = {p.name: p.read_bytes() for p in (tmp_path / "a").iterdir()}
    assert set(files) == {"first.raw.npy", "first.jpg", "dataset.toml"}
    assert files == {p.name: p.read_bytes() for p in (tmp_path / "b").iterdir()}
    found = {p.name for p in (tmp_path / "c").iterdir()}
    assert found == {"first.clean.png", "first.f00.noisy.png", "first.f01.noisy.png", "dataset.toml"}
    assert Image.open(tmp_path / "a" / "first.jpg").size == (48, 48)
    with pytest.raises(ValueError, match="does not show"):
        write(tmp_path / "d", "alder", {"hot_pixels": 1}, "raw+jpeg", chosen)


@pytest.mark.parametrize("name", sorted(BODIES))
def test_libraw_develops_what_a_body_took(name: str) -> None:
    """Its bilinear demosaicking is the study's, with BT.709's curve after the body's gains and matrix."""
    body = BODIES[name]
    raw, _ = shoot(name, "raw+jpeg", {}, picture(96))
    mosaic = np.maximum((raw.astype(float) - body.black) / (body.white - body.black), 0)
    gains = mosaicked(np.ones((96, 96, 3)) * body.gains, body.cfa)
    linear = demosaic(np.minimum(mosaic * gains, 1), body.cfa, "bilinear", "reflect") @ body.matrix.T
    linear = np.clip(linear, 0, 1)
    curve = np.where(linear < 0.018054, 4.5 * linear, 1.0993 * linear**0.45 - 0.0993)
    error = developed(raw, name, SWITCHES["linear"].settings) - 255 * curve
    assert np.sqrt(np.mean(error[4:-4, 4:-4] ** 2)) < 1
    assert np.abs(developed(raw, name, {}) - 255 * curve).mean() > 1, "AHD is another"


def test_the_effects_of_pairs_come_alone_too() -> None:
    found = list(cases(KINDS[0], "alone", ["alder"], [3]))
    names = {name for pair in effects.PAIRS for name in pair}
    assert {case.effects[0][0] for case in found} == {n for n in names if effects.shows_in(n, KINDS[0])}
    assert len(found) == len(set(found))


def test_deleting_hides_the_true_effect_alone() -> None:
    tried = []
    case = next(cases(KINDS[0], "deleted", ["alder"], [3]))

    def diagnosis(folder: Path, exclude: list[str]) -> dict[str, object]:
        tried.append((len(list(folder.iterdir())), exclude))
        return report("unknown")

    found = examine(case, diagnosis, size=64, count=2)
    assert tried == [(5, [case.effects[0][0]])] and found["verdict"] == "unknown"
    assert "statistics" not in found  # nothing is compared with these


def test_scenes_may_have_several_frames(capsys: pytest.CaptureFixture[str]) -> None:
    found: list[str] = []

    def diagnosis(folder: Path, exclude: list[str]) -> dict[str, object]:
        found.extend(sorted(path.name for path in folder.glob("*.jpg")))
        return report("none")

    case = next(cases("clean+noisy", "sealed", ["alder"], [1]))
    assert "failed" not in examine(case, diagnosis, size=64, count=2, frames=2)
    scenes = [name.partition(".")[0] for name in found[::2]]
    assert found == [f"{scene}.f{frame:02d}.jpg" for scene in scenes for frame in (0, 1)] and len(found) == 4
    with pytest.raises(SystemExit):
        parse(["--split", "nulls", "libraw", "--frames", "2", "--out", "x.json"])
    assert "one frame of each scene" in capsys.readouterr().err


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize(("more", "excluded"), [(-0.01, [34]), (0.0, [34, 0])])
def test_nulls_whose_gap_is_too_small_are_not_searched(kind: str, more: float, excluded: list[int]) -> None:
    """A diagnosis looks for no effect there, so that the verdict is the same."""
    assert _TOO_SMALL[kind] < 1 + NULL_DROP[kind] < _TOO_SMALL[kind] + 0.15
    tried = []

    def diagnosis(folder: Path, exclude: list[str]) -> dict[str, object]:
        tried.append(len(exclude))
        return report("none") | {"gap": {"before": _TOO_SMALL[kind] + more, "floor": 1.0}}

    examine(next(cases(kind, "nulls", ["alder"], [1])), diagnosis, size=64, count=2)
    assert tried == excluded


def test_scene_sets_are_disjoint() -> None:
    names = [set(scenes(name, 64)) for name in SETS]
    assert all(len(found) == 8 for found in names)
    pictures = [p for name in SETS for p in scenes(name, 64).values()]
    assert all(p.shape == (64, 64, 3) and p.min() >= 0 and p.max() <= 1 for p in pictures)
    assert all(np.abs(a - b).max() > 0.1 for i, a in enumerate(pictures) for b in pictures[:i])


def test_grey_scenes_are_a_set_s_without_its_colours() -> None:
    coloured, grey = scenes("two", 64, 3), scenes(GREY, 64, 3)
    assert list(coloured) == list(grey)
    for own, plain in zip(coloured.values(), grey.values()):
        assert np.ptp(plain, axis=-1).max() == 0 and np.ptp(own, axis=-1).max() > 0.05
        np.testing.assert_allclose(plain[..., 0], rgb2gray(own), atol=0.01)


@pytest.mark.parametrize("split", ["sealed", "nulls"])
def test_nothing_is_tried_where_axes_are_asked_for_alone(split: str) -> None:
    hidden = []

    def diagnosis(folder: Path, exclude: list[str]) -> dict[str, object]:
        hidden.append(exclude)
        return report("unknown") | {"where": [{"axis": "edge"}], "gap": {"before": 9.0, "floor": 1.0}}

    case = next(cases("raw+jpeg", split, ["alder"], [4]))
    found = examine(case, diagnosis, size=64, count=2, untried=True)
    assert found["where"] == ["edge"] and found["gap"]["before"] == 9.0 and "ranking" not in found
    assert hidden == [sorted(effects.VOCABULARY)]


def report(verdict: str, *causes: str) -> dict[str, object]:
    made = [{"effect": c, "alternatives": ["sharpening"], "closed": 0.7, "ci": [0.6, 0.9]} for c in causes]
    return {
        "verdict": verdict,
        "causes": made,
        "ranking": [{"effect": c, "status": "accepted"} for c in causes],
        "base": {"absorbed": {}},
        "gap": {"before": 3.0, "floor": 1.0},
        "where": [],
        "unexplained": {"axes": []},
        "seconds": 1.0,
    }


def test_tables_count_what_was_said() -> None:
    def record(name: str, said: dict[str, object], split: str = "develop") -> dict[str, object]:
        case = {"case": name + split + str(len(said["causes"])), "kind": "raw+jpeg", "split": split}
        case |= {"body": "alder", "effects": [[name, 3]], "scenes": "one", "standing": [], "seconds": 2.0}
        return case | kept(said)

    right = record("vignetting", report("effect", "vignetting"))
    group = record("sharpening", report("effect", "prnu"))
    clear = record("nothing", report("none"), "nulls")
    alarm = record("cropped", report("effect", "prnu"), "nulls")
    text = markdown([right, group, clear, alarm])
    assert "| right effect first | 50% " in text
    assert "| its group first | 100% " in text
    assert "| **all** | 50% " in text
    assert "| 2.0 to 4.0 | 50% [9%, 91%] (1/2) | 1 | 0 | 0 |" in text, "both gaps are 3 floors"
    assert "| 4.0 and more | – (0) | 0 | 0 | 0 |" in text
    assert true_closure(right, clear | {"gap": {"before": 1.5, "floor": 1.0}}) == 0.75
    counting = {"statistics": [[2.0, 1.5], [0.0, 0.5]]}  # the first counts three times as much; the gap is 3
    assert true_closure(right | counting, clear | {"statistics": []}) == 0.0
    assert true_closure(right | counting, clear | {"statistics": [[1.0, 1.0], [1.0, 1.0]]}) == 1.0
    without = clear | {"statistics": [[2**0.5, 1.0], [1.0, 1.0]]}
    assert true_closure(right | counting, without) == pytest.approx((3 - 1.75) / 2)
    said = report("none")
    said["gap"]["statistics"] = {"b": [0.0, 0.5], "a": [2.00001, 1.5]}
    assert counted(said) == counting["statistics"] and "statistics" not in kept(said)["gap"]
    deleted = [record(n, report("effect", "sharpening"), "deleted") for n in ("optical_blur", "prnu")]
    deleted += [record("vignetting", report("unknown"), "deleted")]
    switched = [record(n, report("none"), "libraw") for n in ("plain", "vng", "medians")]
    switched += [record("ppg", report("unknown"), "libraw")]
    text = markdown([*deleted, *switched])
    for said in ("unknown", "another of its group", "a stranger"):
        assert f"| {said} | 33% " in text
    assert "| vng | demosaicking or none | (none) 1 | 100% " in text
    assert "| ppg | demosaicking or none | (unknown) 1 | 0% " in text
    assert "| medians | chroma_denoising | (none) 1 | 0% " in text
    strangers = [record(n, report("unknown"), "outside") for n in ("flicker", "dark_outlines")]
    strangers[0]["where"] = ["row", "lag", "edge"]
    strangers[1]["where"] = ["row", "lag", "hue"]
    text = markdown(strangers)
    assert "| unknown | 100% " in text and "| right axis among the first three | 50% " in text
    both = record("vignetting", report("effect", "vignetting", "sharpening"), "pairs")
    both["effects"] = [["vignetting", 3], ["sharpening", 3]]
    one = both | {"case": "another", "causes": ["vignetting"], "effects": [["vignetting", 3], ["prnu", 3]]}
    names = ("vignetting", "sharpening", "prnu")
    alone = [record(n, report("unknown"), "alone") | {"case": f"{n} alone"} for n in names]
    text = markdown([both, one, *alone[:2]])
    assert (
        "| both found | 50% " in text and text.count("(1/1) |") == 2
    )  # the other's effect is not known alone
    assert "| both found | 50% [9%, 91%] (1/2) | 50% " in markdown([both, one, *alone])
    near = {"effects": ["luma_denoising"], "closed": 0.5, "axes": ["lag"]}
    unknown = record("prnu", report("unknown") | {"unexplained": {"axes": [], "nearest": near}})
    text = markdown([unknown, record("vignetting", report("effect", "prnu"))])
    assert "| luma_denoising would close 0.50 and leave 2 on lag |" in text and "| prnu closes " in text
    low, high = wilson(2, 100)
    assert abs(low - 0.0055) < 1e-3 and abs(high - 0.0700) < 1e-3


def test_what_must_be_reached_stands_beside_what_was() -> None:
    def record(split: str, *names: str, said: str = "effect", kind: str = "raw+jpeg", **more: object) -> dict:
        case = {"case": f"{kind} {split} {names} {more}", "kind": kind, "split": split, "body": "alder"}
        case |= {"effects": [[n, 4] for n in names], "scenes": "one", "standing": [], "seconds": 2.0}
        return case | kept(report(said, *(names if said == "effect" else ()))) | more

    sealed = [
        record("sealed", "prnu", true_closure=0.8),  # closes 0.7 [0.6, 0.9]
        record("sealed", "sharpening", true_closure=1.0),
        record("sealed", "vignetting", said="unknown", true_closure=1.0),
        record("sealed", "prnu", said="none", gap={"before": 1.9, "floor": 1.0}),  # near the floor
        record("sealed", "tone_curve", said="none"),  # the base's own
    ]
    pairs = [record("pairs", "prnu", "sharpening"), record("pairs", "prnu", "row_noise", kind="clean+noisy")]
    alone = [record("alone", name) for name in ("prnu", "sharpening")]
    nulls = [record("nulls", "nothing", said="none"), record("nulls", "cropped", said="none")]
    strangers = [record("outside", "flicker", said="unknown", where=["row"])]
    lines = targets([*sealed, *pairs, *alone, *nulls, *strangers]).splitlines()
    found = {line.split(" | ")[0][2:]: line.split(" | ")[1:-1] for line in lines[2:]}
    assert "RAW+JPEG, sealed" in lines[0] and "clean+noisy, develop" in lines[0]
    first, _, other, _ = found["right effect first"]
    assert first == "67% [21%, 94%] (2/3)" and other == "– (0)"
    assert found["closed, of what the effect made, median"][0] == "0.79 (2)"
    assert found["how far off the refit is, median"][0] == "0.20 (2)"
    assert found["what the effect made is in the 90 % interval"][0].endswith(" (1/2)")
    assert found['what a base takes up: absorbed or "none"'][0].endswith(" (1/1)")
    assert found['outside the vocabulary: "unknown"'][0].endswith(" (1/1)")
    assert found["named where nothing is missing"][0].endswith(" (0/2)")
    both = found["two effects, either alone twice the floor: both found"]
    assert both[0].endswith(" (1/1)") and both[2] == "– (0)", "nobody looked at either alone"


def test_axes_of_a_later_version_replace_those_of_their_cases_alone() -> None:
    records = [{"case": name, "where": ["lag"], "verdict": "unknown"} for name in "abc"]
    again = [
        {"case": "a", "where": ["edge"], "verdict": "none"},
        {"case": "b", "failed": "no"},
        {"case": "d", "where": []},
    ]
    found = located(records, again)
    assert [r["where"] for r in found] == [["edge"], ["lag"], ["lag"]]
    assert {r["verdict"] for r in found} == {"unknown"} and records[0]["where"] == ["lag"]


def test_a_case_that_fails_says_where_without_a_path() -> None:
    def diagnosis(folder: Path, exclude: list[str]) -> dict[str, object]:
        raise ValueError("no")

    found = examine(next(cases("raw+jpeg", "sealed", ["alder"], [1])), diagnosis, size=64, count=2)
    assert found["failed"] == "ValueError('no')"
    assert found["trace"][-1].startswith("test_withheld.py:") and found["trace"][-1].endswith(" diagnosis")
    assert "/" not in "".join(found["trace"])


def test_a_case_is_compared_with_one_in_a_file_like_its_own() -> None:
    names = {"jpeg_quantization": "lossless", "prnu": "nothing"}
    for name, plain in names.items():
        compared = _plain({"kind": "clean+noisy", "body": "elm", "scenes": "two", "effects": [[name, 3]]})
        assert compared == Case("clean+noisy", "nulls", "elm", ((plain, 1),), "two")


@pytest.mark.parametrize("untried", [False, True])
def test_results_keep_the_commands_that_asked_for_them(tmp_path: Path, untried: bool) -> None:
    out = tmp_path / "results.json"
    first = list(cases("raw+jpeg", "nulls", ["alder"], [1], "two"))

    def diagnosis(folder, **options):
        return report("none")

    for command, todo in (("--limit 1", first[:1]), ("--limit 1", first[:1]), ("--limit 2", first[:2])):
        run(todo, diagnosis, out, 1, {"size": 64, "count": 2, "untried": untried}, command)
    found = json.loads(out.read_text())
    assert found["commands"] == ["--limit 1", "--limit 2"] and len(found["cases"]) == 2
    assert all("statistics" in case for case in found["cases"].values())


def test_no_two_bodies_have_one_name() -> None:
    with pytest.raises(ValueError, match="one name"):
        _by_name([BODIES["alder"], BODIES["alder"]])
    assert BODIES["elder"].cfa != BODIES["elm"].cfa  # the one was once run under the other's
