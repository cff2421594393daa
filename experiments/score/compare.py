"""Two sets of evidence for the score, on the same cases: is it better fitted to the second than to the first?

    git show COMMIT:docs/results/score-cases.json > BEFORE.json
    python -m experiments.score.compare BEFORE.json AFTER.json --study docs/results/diagnosis.json

Both fits are judged by the cases that another version diagnosed in the second file than in the first, each by
a fit that did not see the case's camera.
"""

import argparse
import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from experiments.score.fit import (
    SIDES,
    Record,
    answers,
    area,
    brier,
    calibration,
    fit_all,
    is_true,
    log_loss,
    named_by,
    of_study,
    probabilities,
)
from experiments.withheld.tables import table
from jaxisp.gap.criteria import CRITERIA


def judged(before: Sequence[Record], after: Sequence[Record]) -> list[Record]:
    """The cases of `after` that are new there, or of another version."""
    versions = {record["name"]: record.get("version") for record in before}
    return [r for r in after if r["name"] not in versions or versions[r["name"]] != r.get("version")]


def scores(evidence: Sequence[Record], cameras: Sequence[str]) -> dict[str, Any]:
    """By camera, the score fitted to all evidence but the camera's."""
    return {
        camera: fit_all([r for r in evidence if r["camera"] != camera]) for camera in sorted(set(cameras))
    }


def of_questions(cases: Sequence[Record], scored: Mapping[str, Any]) -> dict[str, list[str]]:
    """By question: rows, true ones, Brier score, log loss, area under ROC, calibration."""
    return {
        question: [str(len(own)), str(sum(answer for _, answer in own)),
                   *(f"{of(own):.3f}" for of in (brier, log_loss, area, calibration))]
        for question, own in answers(cases, scored).items()
        if own
    }  # fmt: skip


def of_names(cases: Sequence[Record], scored: Mapping[str, Any]) -> dict[str, str]:
    """How often what is named is right."""
    likely = {r["name"]: probabilities(r, scored[r["camera"]]) for r in cases}
    said = {r["name"]: named_by(r, likely[r["name"]], CRITERIA[r["kind"]].named) for r in cases}
    with_effect, without = ([r for r in cases if bool(r["truth"]) == there] for there in (True, False))

    def share(cases: Sequence[Record], counted: Sequence[bool]) -> str:
        return f"{sum(counted)}/{len(cases)}"

    def wrong(cases: Sequence[Record]) -> str:
        return share(cases, [any(not is_true(e, r) for e in said[r["name"]]) for r in cases])

    right = [[is_true(e, r) for e in said[r["name"]]] for r in with_effect]
    return {
        "right first": share(with_effect, [any(own[:1]) for own in right]),
        "right named": share(with_effect, [any(own) for own in right]),
        "a wrong one named": wrong(with_effect),
        "nothing to name, and one is": wrong(without),
        "a wrong one above .9": share(
            cases, [any(p > 0.9 and not is_true(e, r) for e, p in likely[r["name"]].items()) for r in cases]
        ),
    }


def tables(before: Sequence[Record], after: Sequence[Record], study: Sequence[Record]) -> str:
    """Markdown."""
    cases = judged(before, after)
    cameras = [record["camera"] for record in cases]
    fits = {"first": scores([*before, *study], cameras), "second": scores([*after, *study], cameras)}
    questions = {name: of_questions(cases, fit) for name, fit in fits.items()}
    names = {name: of_names(cases, fit) for name, fit in fits.items()}
    head = ["question", "fitted to", "rows", "true", "Brier score", "log loss", "area under ROC",
            "mean gap of probability and frequency"]  # fmt: skip
    rows = [[q, name, *questions[name][q]] for q in SIDES for name in fits if q in questions[name]]
    lines = [f"{len(cases)} cases of {len(set(cameras))} cameras.", "", table(head, rows)]
    said = [[what, *(names[name][what] for name in fits)] for what in names["first"]]
    return "\n".join([*lines, table(["cases", *fits], said)])


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("before", type=Path)
    parser.add_argument("after", type=Path)
    parser.add_argument("--study", type=Path, required=True, help="results of the withheld study")
    asked = parser.parse_args()
    before, after = (json.loads(path.read_text())["cases"] for path in (asked.before, asked.after))
    print(tables(before, after, of_study(json.loads(asked.study.read_text()))))


if __name__ == "__main__":
    main()
