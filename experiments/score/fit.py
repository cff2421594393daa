"""Fit the score to cases whose effects are known, and say how far it can be trusted.

    python -m experiments.score.fit docs/results/score-cases.json --study docs/results/diagnosis.json \
        -o jaxisp/gap/search/score.json --page docs/results/score.md

Logistic regressions with a ridge; the weight of each sign has the side that its meaning gives it, or is 0.
All figures are of cameras that were left out of the fit, one camera at a time.
"""

import argparse
import itertools
import json
import sys
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from scipy.optimize import minimize

from experiments.withheld.effects import ABSORBABLE, PAIRED
from experiments.withheld.tables import table, wilson
from jaxisp.gap.case import Gap
from jaxisp.gap.criteria import CRITERIA
from jaxisp.gap.search import score
from jaxisp.gap.search.signs import left_signs
from jaxisp.io.files import write_text

Record = Mapping[str, Any]
Row = tuple[Record, str, bool, Mapping[str, float]]
"""A case, an effect or a question, whether the answer is yes, and the signs."""
SIDES: dict[str, dict[str, int]] = {
    score.EFFECT: {"closed": 1, "ahead": 1, "gap": 1, "nearer": 1, "contrary": -1},
    score.GRAIN: {"closed": 1},
    score.OTHER: {"left": 1, "share_left": 1, "likeliest": -1},
    score.NONE: {"excess": -1},
}
"""By question, the signs that are used and the side of their weights."""
_RIDGE = 1.0  # observations by which each standardised weight is held to 0
_CHANCE = 0.2
_BINS = (0.0, 0.1, 0.3, 0.5, 0.7, 0.9, 1.0)


def is_true(effect: str, record: Record) -> bool:
    """Whether an effect is there, or one that the truth may be called as well."""
    return effect in record.get("also", ()) or any(effect in told.split("|") for told in record["truth"])


def effect_rows(records: Sequence[Record], grain: bool) -> list[Row]:
    """A row for each refitted effect; film grain beside a RAW has a question of its own."""
    return [
        (record, effect, is_true(effect, record), signs)
        for record in records
        for effect, signs in record["signs"].items()
        if ("form" not in signs) == grain
    ]


def fitted(rows: Sequence[Row], question: str) -> dict[str, Any]:
    """The row of `score.json` for a question."""
    sides = SIDES[question]
    values = np.array([[signs[name] for name in sides] for *_, signs in rows])
    answers = np.array([answer for _, _, answer, _ in rows], float)
    means, deviations = values.mean(0), np.maximum(values.std(0), 1e-3)
    design = np.column_stack([np.ones(len(rows)), (values - means) / deviations])
    towards = 2 * answers - 1

    def loss(weights: np.ndarray) -> tuple[float, np.ndarray]:
        margin = towards * (design @ weights)
        slope = -towards / (1 + np.exp(np.clip(margin, -500, 500)))
        held = np.r_[0.0, weights[1:]]
        return (
            float(np.logaddexp(0, -margin).sum() + _RIDGE * (held @ held) / 2),
            design.T @ slope + _RIDGE * held,
        )

    bounds = [(None, None), *((0, None) if side > 0 else (None, 0) for side in sides.values())]
    found = minimize(loss, np.zeros(design.shape[1]), jac=True, bounds=bounds, method="L-BFGS-B").x
    return {
        "intercept": round(float(found[0]), 4),
        "signs": {
            name: [round(float(v), 4) for v in (mean, deviation, weight)]
            for name, mean, deviation, weight in zip(sides, means, deviations, found[1:])
            if abs(weight) > 1e-3
        },
    }


def fit_all(records: Sequence[Record]) -> dict[str, Any]:
    """The whole of `score.json`; records of the study only tell whether nothing is missing."""
    own = [record for record in records if record["group"] != "study"]
    effects, grain = effect_rows(own, False), effect_rows(records, True)
    found = {score.EFFECT: fitted(effects, score.EFFECT), score.GRAIN: fitted(grain, score.GRAIN)}
    found |= {score.OTHER: fitted(left_rows(own, found, score.OTHER), score.OTHER)}
    return found | {score.NONE: fitted(left_rows(records, found, score.NONE), score.NONE)}


def probabilities(record: Record, found: Mapping[str, Any]) -> dict[str, float]:
    """The probability of each refitted effect of a case."""
    return {
        effect: score.logistic(found[score.GRAIN if "form" not in signs else score.EFFECT], signs)
        for effect, signs in record["signs"].items()
    }


def left_rows(records: Sequence[Record], found: Mapping[str, Any], question: str) -> list[Row]:
    """A row for each case: does something else remain, is nothing missing?"""
    rows: list[Row] = []
    for record in records:
        criteria, gap = CRITERIA[record["kind"]], record["gap"]
        likely = probabilities(record, found)
        named = [e for e in record["found"] if likely.get(e, 0.0) >= criteria.named]
        whole = Gap(gap["before"], gap["floor"], criteria.least_unit)
        after = gap["before"] - whole.scale * sum(record["closed"][e] for e in named)
        signs = left_signs(whole, after, max(likely.values(), default=0.0), criteria.null_drop)
        missed = [t for t in record["truth"] if not set(t.split("|")) & set(named)]
        answer = record["beyond"] or bool(missed)
        if question == score.NONE:
            answer = not record["beyond"] and not record["truth"]
        rows.append((record, question, answer, signs))
    return rows


def of_study(found: Mapping[str, Any]) -> list[Record]:
    """Cases of the withheld study: how large is a gap without an effect, and what does film grain close?

    No other signs are known of them. Of film grain only those cases have signs in which it was named.
    """
    cases = {name: r for group in ("nulls", "main") for name, r in found[group]["cases"].items()}
    rows = []
    for name, r in cases.items():
        named = [effect for effect, _ in r["effects"]]
        if r["split"] not in ("nulls", "develop", "sealed", "outside", "pairs") or set(named) & set(
            ABSORBABLE
        ):
            continue
        if "gap" in r:
            # the floor of statistics was 1, which is what is harmless; chance is about a fifth of it
            floor = r["gap"]["floor"] if r["kind"] == PAIRED else _CHANCE
            row = {"name": name, "kind": r["kind"], "camera": r["body"], "group": "study", "signs": {}}
            row |= {"gap": {"before": r["gap"]["before"], "floor": floor}, "closed": {}, "found": []}
            if r["kind"] == PAIRED and "film_grain" in r.get("closed", {}):
                whole = Gap(r["gap"]["before"], floor, CRITERIA[PAIRED].least_unit)
                size = float(np.log2(1 + r["ci"]["film_grain"][0] * whole.scale / whole.unit))
                row["signs"] = {"film_grain": {"size": size, "closed": r["closed"]["film_grain"]}}
            truth = named if "film_grain" in named else []
            rows.append(row | {"truth": truth, "beyond": r["split"] != "nulls"})
    return rows


def left_out(records: Sequence[Record], fit: Callable[[Sequence[Record]], Any]) -> dict[str, Any]:
    """By camera, the score fitted to all other cameras."""
    cameras = sorted({record["camera"] for record in records})
    return {camera: fit([r for r in records if r["camera"] != camera]) for camera in cameras}


def answers(records: Sequence[Record], scores: Mapping[str, Any]) -> dict[str, list[tuple[float, bool]]]:
    """By question, probability and truth of each row, by the score that did not see the row's camera."""
    found: dict[str, list[tuple[float, bool]]] = {q: [] for q in SIDES}
    for record in records:
        own = scores[record["camera"]]
        for effect, p in probabilities(record, own).items():
            question = score.GRAIN if "form" not in record["signs"][effect] else score.EFFECT
            found[question].append((p, is_true(effect, record)))
        for question in (score.OTHER, score.NONE):
            if question == score.OTHER and record["group"] == "study":
                continue
            for _, _, answer, signs in left_rows([record], own, question):
                found[question].append((score.logistic(own[question], signs), answer))
    return found


def brier(rows: Sequence[tuple[float, bool]]) -> float:
    return float(np.mean([(p - answer) ** 2 for p, answer in rows]))


def log_loss(rows: Sequence[tuple[float, bool]]) -> float:
    """Mean -log of the probability that the right answer was given [nats]."""
    return float(np.mean([-np.log(max(p if answer else 1 - p, 1e-12)) for p, answer in rows]))


def area(rows: Sequence[tuple[float, bool]]) -> float:
    """Area under the ROC curve: how often a right answer has the higher probability."""
    yes, no = (np.array([p for p, answer in rows if answer == side]) for side in (True, False))
    if not len(yes) or not len(no):
        return float("nan")
    return float(((yes[:, None] > no) + 0.5 * (yes[:, None] == no)).mean())


def reliability(rows: Sequence[tuple[float, bool]]) -> list[tuple[str, int, float, int]]:
    """By range of the probability: how many rows, their mean probability, how many are true."""
    found = []
    for low, high in itertools.pairwise(_BINS):
        own = [(p, answer) for p, answer in rows if low <= p < high or (high == 1.0 and p == 1.0)]
        if own:
            mean = float(np.mean([p for p, _ in own]))
            found.append((f"{low:g} to {high:g}", len(own), mean, sum(answer for _, answer in own)))
    return found


def calibration(rows: Sequence[tuple[float, bool]]) -> float:
    """The mean gap between probability and frequency over the ranges of `reliability`, by their rows."""
    return sum(abs(mean * n - true) for _, n, mean, true in reliability(rows)) / len(rows)


def named_by(record: Record, likely: Mapping[str, float], bar: float) -> list[str]:
    """The effects that the search found and that are probable, likeliest first."""
    return sorted((e for e in record["found"] if likely.get(e, 0.0) >= bar), key=lambda e: -likely[e])


def comparison(records: Sequence[Record], scores: Mapping[str, Any]) -> str:
    """Rules and score on the same cases, by group."""
    rows = []
    groups = dict.fromkeys((r["kind"], r["group"]) for r in records if r["group"] != "study")
    for kind, group in sorted(groups):
        own = [r for r in records if (r["kind"], r["group"]) == (kind, group)]
        likely = {r["name"]: probabilities(r, scores[r["camera"]]) for r in own}
        cells: list[Any] = [kind, group, len(own)]
        by_rules = {r["name"]: r["rules"] for r in own if "rules" in r}
        by_score = {r["name"]: named_by(r, likely[r["name"]], CRITERIA[kind].named) for r in own}
        for said in (by_rules, by_score):
            told = [r for r in own if r["name"] in said]
            known = [r for r in told if r["truth"]]
            first = sum(any(is_true(e, r) for e in said[r["name"]][:1]) for r in known)
            any_of = sum(any(is_true(e, r) for e in said[r["name"]]) for r in known)
            wrong = sum(any(not is_true(e, r) for e in said[r["name"]]) for r in told)
            cells += [f"{n}/{len(known)}" if known else "" for n in (first, any_of)]
            cells.append(f"{wrong}/{len(told)}")
        sure = sum(any(p > 0.9 and not is_true(e, r) for e, p in likely[r["name"]].items()) for r in own)
        rows.append([*cells, sure])
    head = [
        "pairs", "group", "cases", "rules: right first", "rules: right named", "rules: a wrong one named",
        "score: right first", "score: right named", "score: a wrong one named", "score: a wrong one above .9",
    ]  # fmt: skip
    return table(head, rows)


def of_questions(records: Sequence[Record], found: Mapping[str, Any], scores: Mapping[str, Any]) -> str:
    """How well probabilities of cameras left out are told, by question and kind of pairs."""
    kinds = sorted({record["kind"] for record in records})
    seen = {record["camera"]: found for record in records}
    rows = []
    for question in SIDES:
        for kind in ("all", *kinds):
            which = [r for r in records if kind in ("all", r["kind"])]
            own, fitted_to = (answers(which, by)[question] for by in (scores, seen))
            if own:
                figures = (
                    brier(own),
                    _alone(own),
                    log_loss(own),
                    area(own),
                    calibration(own),
                    calibration(fitted_to),
                )
                true = sum(answer for _, answer in own)
                rows.append([question, kind, len(own), true, *(f"{v:.3f}" for v in figures)])
    head = [
        "question", "pairs", "rows", "true", "Brier score", "of the frequency alone", "log loss",
        "area under ROC", "mean gap of probability and frequency", "of the score fitted to all",
    ]  # fmt: skip
    return table(head, rows)


def page(records: Sequence[Record], found: Mapping[str, Any], scores: Mapping[str, Any], command: str) -> str:
    """The results as Markdown."""
    own = [record for record in records if record["group"] != "study"]
    versions = Counter(record["version"] for record in own).most_common()
    said = answers(records, scores)
    lines = [
        "# The score of the diagnosis", "",
        f"```sh\npython -m experiments.score.fit {command}\n```", "",
        f"{len(own)} cases of {len({r['camera'] for r in own})} cameras, and for the question whether "
        f"nothing is missing {len(records) - len(own)} of the withheld study. Every figure is of the "
        "score that was fitted without the case's camera; a converter of third parties counts as one camera. "
        "The signs, and the sides of their weights, were chosen on these cases, by the log loss of cameras "
        "left out.", "",
        "A case keeps the version that diagnosed it: " + ", ".join(f"{v} {n}" for v, n in versions) + ".", "",
        "## Rules and score", "",
        "*Rules* are those that the score replaces, as they answered when cases were collected. A wrong "
        "name is an effect that is not in the truth; of third-party cameras it may still be there.", "",
        comparison(records, scores),
        "## Questions", "",
        of_questions(records, found, scores),
        "The share of cases without an effect differs from camera to camera of the study, so that a score "
        "that has not seen one expects another share of it: most of the gap of *none*. The last column has "
        "no such gap, and says nothing of other cameras.", "",
        "## Reliability", "",
        "95 % intervals (Wilson).", "",
    ]  # fmt: skip
    for question, own in said.items():
        rows = []
        for name, count, mean, true in reliability(own):
            low, high = wilson(true, count)
            rows.append([name, count, f"{mean:.2f}", f"{true / count:.2f} [{low:.2f}, {high:.2f}]"])
        head = ["probability", "rows", "mean", "frequency"]
        lines += [f"### {question}", "", table(head, rows)]
    lines += ["## Weights", "", "Of standardised signs, all cameras.", ""]
    for question in SIDES:
        weights = sorted(found[question]["signs"].items(), key=lambda kv: -abs(kv[1][2]))
        lines += [
            f"### {question}", "",
            table(
                ["sign", "mean", "deviation", "weight"],
                [["intercept", "", "", f"{found[question]['intercept']:.2f}"],
                 *([n, *(f"{v:.2f}" for v in values)] for n, values in weights)],
            ),
        ]  # fmt: skip
    return "\n".join(lines)


def _alone(rows: Sequence[tuple[float, bool]]) -> float:
    share = float(np.mean([answer for _, answer in rows]))
    return share * (1 - share)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("cases", type=Path)
    parser.add_argument("--study", type=Path, required=True, help="results of the withheld study")
    parser.add_argument("-o", "--out", type=Path, required=True)
    parser.add_argument("--page", type=Path, required=True)
    asked = parser.parse_args()
    records = json.loads(asked.cases.read_text())["cases"] + of_study(json.loads(asked.study.read_text()))
    found = fit_all(records)
    write_text(asked.out, json.dumps(found, indent=1) + "\n")
    write_text(asked.page, page(records, found, left_out(records, fit_all), " ".join(sys.argv[1:])))


if __name__ == "__main__":
    main()
