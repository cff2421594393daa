"""The cases that the score is fitted to: which run again, in which order, and what is kept of them."""

import json
from pathlib import Path

import pytest

from experiments.score.cases import again, collected, planned
from experiments.score.compare import judged, of_names, of_questions
from experiments.third_party.cases import sample
from jaxisp.gap.search import score

KEPT = json.loads(Path("docs/results/score-cases.json").read_text())["cases"]
OWN = {"name": "raw+jpeg deleted two alder optical_blur=5 less optical_blur", "group": "deleted",
       "camera": "alder", "kind": "raw+jpeg", "truth": [], "beyond": True, "effects": [["optical_blur", 5]],
       "signs": {}, "closed": {}, "found": []}  # fmt: skip
OTHER = {"name": "fo_eeh", "group": "third party", "camera": "fast-openISP", "kind": "raw+jpeg",
         "truth": ["sharpening"], "also": [], "beyond": True, "signs": {}}  # fmt: skip


def test_each_kept_case_has_its_own_name_and_the_version_that_diagnosed_it():
    assert len({record["name"] for record in KEPT}) == len(KEPT) > 100
    assert all(len(record["version"]) >= 7 for record in KEPT)


def test_a_case_of_an_own_camera_is_written_again_from_its_name():
    """As it was planned: scenes, and the effect that is left out of those tried."""
    plan = {row["name"]: row for row in planned("raw+jpeg")}
    left_out = next(row for row in plan.values() if row["exclude"] and row["scenes"] == "two")
    for row in (left_out, next(row for row in plan.values() if row["group"] == "pair")):
        record = {name: row[name] for name in row if name not in ("scenes", "exclude")}
        (found,) = again([record], [])
        assert {name: found[name] for name in row} == row


def test_cases_of_converters_are_looked_for_in_folders(tmp_path):
    with pytest.raises(FileNotFoundError, match="no folder holds fo_eeh"):
        again([OWN, OTHER], [tmp_path])
    plain = next(case for case in sample("develop") if not case.level)
    for name in ("fo_eeh", plain.name, "libraw-imx219-black-1"):
        (tmp_path / name).mkdir()
    found = {row["name"]: row for row in again([OWN, OTHER], [tmp_path])}
    assert set(found) == {OWN["name"], "fo_eeh", plain.name}  # plain pictures are added, switches are not
    assert found["fo_eeh"]["folder"] == tmp_path / "fo_eeh" and "folder" not in found[OWN["name"]]
    assert found[plain.name]["truth"] == [] and found[plain.name]["camera"] == plain.converter


def test_a_part_of_a_run_is_a_sample_of_all():
    own = [record for record in KEPT if record["group"] != "third party"]
    rows = again(own, [])
    assert sorted(row["name"] for row in rows) == sorted(record["name"] for record in own)
    for group in ("single", "null", "beside"):
        whole = sum(row["group"] == group for row in rows)
        part = sum(row["group"] == group for row in rows[: len(rows) // 3])
        assert abs(part - whole / 3) < 2, group


def test_the_last_record_of_a_case_counts_and_keeps_what_the_rules_said(tmp_path, capsys):
    before = tmp_path / "before.json"
    first = OWN | {"version": "1111111", "rules": ["sharpening"], "rules_verdict": "effect", "closed": {}}
    before.write_text(json.dumps({"schema": 1, "cases": [first, OTHER | {"version": "1111111"}]}))
    folder = tmp_path / "again"
    folder.mkdir()
    (folder / "a.json").write_text(json.dumps(OWN | {"version": "2222222"}))
    (folder / "b.json").write_text(json.dumps(OTHER | {"version": "2222222", "failed": "ValueError()"}))
    found = {record["name"]: record for record in collected([before, folder])}
    assert found[OWN["name"]] == OWN | {
        "version": "2222222",
        "rules": ["sharpening"],
        "rules_verdict": "effect",
    }
    assert (
        found["fo_eeh"]["version"] == "1111111" and "failed: fo_eeh: ValueError()" in capsys.readouterr().out
    )
    assert [r["name"] for r in judged(collected([before]), list(found.values()))] == [OWN["name"]]


def test_figures_of_names_and_questions_on_cases_of_known_answers():
    sure = {"intercept": 0.0, "signs": {"closed": [0.0, 1.0, 10.0]}}
    scored = {"c": {question: sure | {"signs": {}} for question in (score.GRAIN, score.OTHER, score.NONE)}}
    scored["c"][score.EFFECT] = sure

    def case(name, truth, **closed):
        signs = {effect: {"closed": share, "form": 1.0} for effect, share in closed.items()}
        return {"name": name, "camera": "c", "kind": "raw+jpeg", "group": "single", "truth": truth,
                "beyond": False, "gap": {"before": 9.0, "floor": 4.0}, "signs": signs, "closed": closed,
                "found": list(closed)}  # fmt: skip

    cases = [case("right", ["vignetting"], vignetting=1.0), case("wrong", ["crosstalk"], vignetting=1.0),
             case("second", ["crosstalk"], vignetting=1.0, crosstalk=0.1), case("none", [], prnu=-1.0),
             case("false", [], prnu=1.0)]  # fmt: skip
    assert of_names(cases, scored) == {
        "right first": "1/3", "right named": "2/3", "a wrong one named": "2/3",
        "nothing to name, and one is": "1/2", "a wrong one above .9": "3/5",
    }  # fmt: skip
    rows, true, *_ = of_questions(cases, scored)[score.EFFECT]
    assert (rows, true) == ("6", "2")
