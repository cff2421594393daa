"""The study of withheld effects: which cases it has, what it keeps of a diagnosis, what its tables count."""

import dataclasses
import json
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from experiments import null_drops
from experiments.evaluation.bodies import targets
from experiments.evaluation.kept import collect, located, slim
from experiments.withheld import effects
from experiments.withheld.camera import KINDS
from experiments.withheld.study import (
    _TOO_SMALL,
    Case,
    _plain,
    cases,
    chosen,
    counted,
    examine,
    kept,
    parse,
    run,
    true_closure,
)
from experiments.withheld.tables import markdown, wilson
from jaxisp.gap.criteria import CRITERIA, Criteria


def report(verdict: str, *causes: str) -> dict[str, object]:
    made = [{"effect": c, "alternatives": ["sharpening"], "closed": 0.7, "ci": [0.6, 0.9]} for c in causes]
    return {
        "verdict": verdict,
        "causes": made,
        "ranking": [{"effect": c, "status": "accepted"} for c in causes],
        "base": {"absorbed": {}},
        "gap": {"before": 3.0, "floor": 1.0, "unit": 1.0},
        "where": [],
        "unexplained": {"axes": []},
        "seconds": 1.0,
    }


def test_the_effects_of_pairs_come_alone_too() -> None:
    found = list(cases(KINDS[0], "alone", ["alder"], [3]))
    names = {name for pair in effects.PAIRS for name in pair}
    assert {case.effects[0][0] for case in found} == {n for n in names if effects.shows_in(n, KINDS[0])}
    assert len(found) == len(set(found))


def test_a_lost_header_leaves_its_compression_beside_each_effect(tmp_path: Path) -> None:
    found = list(cases(KINDS[0], "stripped", ["alder"], [4]))
    assert {case.effects[1:] for case in found} == {(effects.LOST_HEADER,)}
    shown = {name for name in effects.VOCABULARY if effects.shows_in(name, KINDS[0])}
    assert {case.effects[0][0] for case in found} == shown - {effects.LOST_HEADER[0]}
    files: list[str] = []

    def diagnosis(folder: Path, exclude: list[str]) -> dict[str, object]:
        files.extend(path.suffix for path in folder.iterdir())
        return report("effect", *(name for name, _ in found[0].effects))

    one = examine(found[0], diagnosis, size=64, count=2)
    assert ".jpg" not in files and "statistics" not in one
    text = markdown([one, one | {"case": "another", "causes": [], "verdict": "unknown"}])
    assert "## Headers lost, raw+jpeg" in text and "| compression named | 50% " in text


def test_cases_are_chosen_by_name() -> None:
    words = "--kind raw+jpeg --split sealed --bodies fig elm --strengths 4 --out f"
    names = [c.name for c in chosen(parse([*words.split(), "--match", "elm (prnu|sharp)"]))]
    assert sorted(names) == ["raw+jpeg nulls two elm nothing=1", "raw+jpeg sealed two elm sharpening=4"]


def test_what_lowers_the_gap_of_a_camera_that_lacks_nothing() -> None:
    ranking = [
        {"effect": "prnu", "closed": 4.0, "ci": [2.0, 5.0], "possible": True},
        {"effect": "sharpening", "closed": 9.0, "ci": [-9.0, 20.0], "possible": True},
        {"effect": "vignetting", "closed": 9.0, "ci": [8.0, 9.0], "possible": False},
        {"effect": "row_noise", "closed": 7.0},  # as predicted
    ]
    of = {"kind": "clean+noisy", "gap": {"before": 0.5, "floor": 0.5}, "ranking": ranking}
    found = null_drops.drops(of)  # shares are of 0.02 floors, and a unit is 1
    assert found["lowered"]["prnu"] == pytest.approx([0.04, 0.02]) and len(found["lowered"]) == 2
    assert null_drops.most(found)[0] == "prnu" and null_drops.most({"lowered": {}})[1:] == (0.0, 0.0)
    text = null_drops.page([{"case": "a", "kind": "clean+noisy"} | found], "--limit 1")
    assert "| clean+noisy | 1 | 0.04 | 0.04 | 0.02 | 0.02 | 0.7 |" in text and "| a | 0.00 | prnu | " in text


def test_nulls_are_searched_for_one_cause_though_their_gap_is_small(monkeypatch: pytest.MonkeyPatch) -> None:
    def diagnosis(folder: str, criteria: Criteria) -> SimpleNamespace:
        assert len(list(Path(folder).glob("*.jpg"))) == 8
        assert criteria == dataclasses.replace(
            CRITERIA[KINDS[1]], null_drop=-np.inf, null_excess=0.0, most_causes=1
        )
        gap = {"before": 1.5, "floor": 1.0}
        return SimpleNamespace(report={"kind": KINDS[1], "gap": gap, "ranking": []})

    monkeypatch.setattr(null_drops, "diagnose", diagnosis)
    case = next(cases(KINDS[1], "nulls", ["alder"], [1]))
    assert null_drops.looked_at(case) == {"case": case.name, "kind": KINDS[1], "above": 0.5, "lowered": {}}


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
    assert _TOO_SMALL[kind] < CRITERIA[kind].null_drop < _TOO_SMALL[kind] + 0.15
    tried = []

    def diagnosis(folder: Path, exclude: list[str]) -> dict[str, object]:
        tried.append(len(exclude))
        return report("none") | {"gap": {"before": 1 + _TOO_SMALL[kind] + more, "floor": 1.0, "unit": 1.0}}

    examine(next(cases(kind, "nulls", ["alder"], [1])), diagnosis, size=64, count=2)
    assert tried == excluded


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
    for said in ("unknown", "another of its group", "an effect of another group"):
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
    nulls = [record("nulls", "nothing", said="none"), record("nulls", "cropped", said="unknown")]
    strangers = [record("outside", "flicker", said="unknown", where=["row"])]
    lines = targets([*sealed, *pairs, *alone, *nulls, *strangers]).splitlines()
    found = {line.split(" | ")[0][2:]: line.split(" | ")[1:-1] for line in lines[2:]}
    assert "RAW+JPEG, sealed" in lines[0] and "clean+noisy, develop" in lines[0]
    first, _, other, _ = found["right effect first"]
    assert first == "67% [21%, 94%] (2/3)" and other == "– (0)"
    assert found["closed over the true share, median"][0] == "0.79 (2)"
    assert found["error of the refitted share, median"][0] == "0.20 (2)"
    assert found["true share inside the 90 % interval"][0].endswith(" (1/2)")
    assert found['effects a base absorbs: absorbed or "none"'][0].endswith(" (1/1)")
    assert found['out of the library: "unknown"'][0].endswith(" (1/1)")
    assert found["nulls: an effect named"][0].endswith(" (0/2)")
    assert found['nulls: an effect named, or "unknown"'][0].endswith(" (1/2)")
    both = found["two effects, each alone twice the floor: both found"]
    assert both[0].endswith(" (1/1)") and both[2] == "– (0)", "nobody looked at either alone"
    every = [*sealed, *pairs, *alone, *nulls, *strangers]
    assert targets(list(map(slim, every))).splitlines() == lines, "what is kept is what the tables need"


def test_collected_results_take_the_last_of_a_case(tmp_path: Path) -> None:
    def file(name: str, **record: object) -> Path:
        path = tmp_path / name
        case = {"case": "a", "kind": "raw+jpeg", "split": "nulls", "body": "elm", "effects": [["nothing", 1]]}
        case |= {"scenes": "one", "standing": [], "seconds": 1.0, **kept(report("none")), **record}
        path.write_text(json.dumps({"commands": [name], "cases": {"a": case}}))
        return path

    old, new, axes = file("old", seconds=2.0), file("new", seconds=3.0), file("axes", where=["edge"])
    sizes = file("nulls", gap={"before": 1.0, "floor": 1.0, "axes": {"row": 0.123456789}})
    for name in ("one", "two"):
        (tmp_path / name).write_text(json.dumps({name: {"kind": "raw+jpeg"}}))
    drops = [tmp_path / "one", tmp_path / "two"]
    collect({"main": [old, new], "nulls": [sizes], "drops": drops}, [axes], tmp_path / "out.json")
    found = json.loads((tmp_path / "out.json").read_text())
    case = found["main"]["cases"]["a"]
    assert case["seconds"] == 3.0 and case["where"] == ["edge"]
    assert found["main"]["commands"] == ["old", "new", "axes"] and found["grey"]["cases"] == {}
    assert found["drops"] == {name: {"kind": "raw+jpeg"} for name in ("one", "two")} and found["fresh"] == {}
    assert found["nulls"]["cases"]["a"]["gap"]["axes"] == {"row": 0.123456789}, (
        "the null bank is made from it"
    )


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
    assert found["trace"][-1].startswith("test_withheld_study.py:") and found["trace"][-1].endswith(
        " diagnosis"
    )
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
