"""What any report.json must be, whatever it says."""

import json
from itertools import pairwise

import pytest

from jaxisp.gap import EFFECTS
from jaxisp.gap.criteria import CRITERIA
from jaxisp.gap.simulator.effects import AXES, BOTH, JPEG_JPEG, SITES

STATUSES = {"accepted", "rejected", "absorbed", "not_identifiable"}


def keeps_the_schema(report):
    json.dumps(report, allow_nan=False)
    gap, causes = report["gap"], report["causes"]
    assert report["schema"] == 1 and report["kind"] in (*BOTH, JPEG_JPEG) and report["seconds"] > 0
    assert {"stages", "fitted", "absorbed"} <= set(report["base"])
    fit, held_out = (report["pairs"][half] for half in ("fit", "held_out"))
    assert fit and held_out and not set(fit) & set(held_out)
    assert gap["floor"] <= gap["before"] and gap["metric"]
    assert gap["ci"][0] <= gap["after"] <= gap["ci"][1], "the interval is of what is left"
    _causes(report["verdict"], causes, gap)
    _ranking(report["ranking"], causes)
    _where(report["verdict"], report["where"], gap)
    left = report["unexplained"]
    assert 0 <= left["share"] <= 1 and set(left["axes"]) <= set(AXES) and left["description"]
    if report["verdict"] != "none":
        best, explained = gap["reducible"]["best"], gap["reducible"]["explained"]
        criteria = CRITERIA[report["kind"]]
        little = gap["before"] - best <= criteria.null_drop * max(gap["floor"], criteria.least_unit)
        assert best <= gap["after"] and (explained is None if little else explained <= 1)


def _causes(verdict, causes, gap):
    assert verdict in {"effect", "none", "unknown"} and (verdict == "effect") == bool(causes)
    points = [gap["before"], *(c["gap_after"] for c in causes)]
    assert [c["gap_before"] for c in causes] == pytest.approx(points[:-1]) and points[-1] == gap["after"]
    for cause in causes:
        share = (cause["gap_before"] - cause["gap_after"]) / (gap["before"] - gap["floor"])
        assert cause["closed"] == pytest.approx(share, rel=0.02)
        assert 0.05 < cause["ci"][0] <= cause["ci"][1] and 0 <= cause["p_value"] <= 1
        assert cause["site"] in SITES and cause["effect"] in EFFECTS and cause["params"]
        assert set(cause["alternatives"]) <= set(EFFECTS) - {cause["effect"]}
        assert cause["next_measurement"] is None or cause["alternatives"]
    assert all(a["closed"] >= b["closed"] for a, b in pairwise(causes))


def _ranking(ranking, causes):
    assert {row["status"] for row in ranking} <= STATUSES
    assert len({row["effect"] for row in ranking} & set(EFFECTS)) == len(ranking)
    accepted = [row["effect"] for row in ranking if row["status"] == "accepted"]
    assert sorted(accepted) == sorted(cause["effect"] for cause in causes)
    assert [row["effect"] for row in ranking[: len(causes)]] == accepted, "best first"
    rest = [row["closed"] for row in ranking[len(causes) :]]
    assert rest == sorted(rest, reverse=True)


def _where(verdict, where, gap):
    assert (verdict == "none") == (not where)
    assert [row["share"] for row in where] == sorted((row["share"] for row in where), reverse=True)
    for row in where:
        assert row["axis"] in AXES and len(row["bins"]) == len(row["profile"])
        assert 0 <= row["ci"][0] <= row["share"] <= row["ci"][1] <= 1 and 0 <= row["p_value"] <= 1
        assert row["size"] == gap["axes"][row["axis"]]
