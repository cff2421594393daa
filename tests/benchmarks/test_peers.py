"""The harness: what it measures, how it judges, and that pages follow from the results alone."""

import itertools
import json
import time

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from benchmarks import musts, peers, report, stages, timing
from benchmarks.case import Case, Peer

LIMITS = {"copy_gb_per_s": {"batch": 10.0, "1 MP": 5.0}, "peak_gflop_per_s": 100.0}
ENTRY = {"ms": 2.0, "iqr": 0.1}


def sleeper(seconds, value=0.0):
    def call():
        time.sleep(seconds)
        return np.float64(value)

    return call


def broken():
    raise RuntimeError("no such codec\nand more")


@pytest.fixture(scope="module")
def row():
    others = (
        Peer("slower", sleeper(0.03, 2.0), goal=2, agrees=lambda ours, theirs: f"{theirs - ours:.0f} apart"),
        Peer("faster", sleeper(0.001), goal=0.05, threads=1),
        Peer("broken", broken),
    )
    case = Case("nap", "batch", sleeper(0.006), others, sleeper(0.018), bytes_moved=2e7, flops=1e8)
    return peers.measure(case, 5, 0.0, LIMITS)


def test_times_and_ratios(row):
    slower, faster, _ = row["peers"]
    assert 6 <= row["ms"] < 9 and row["rounds"] == 5
    assert 3 < slower["ratio"] < 6 and faster["ratio"] < 0.4
    assert 2 < row["gradient"]["ratio"] < 4 and row["gradient"]["goal"] == 6
    assert report.verdict(slower) == "won, goal met"
    assert report.verdict(faster) == "lost, goal met"


def test_outputs_are_compared_and_failures_are_kept(row):
    slower, faster, failed = row["peers"]
    assert slower["outputs"] == "2 apart" and "outputs" not in faster
    assert failed["error"] == "RuntimeError: no such codec" and "ms" not in failed
    assert list(peers.errors({"rows": [row]})) == [failed["error"]]


def test_floor_is_the_longer_of_bytes_and_flops(row):
    assert row["floor_ms"] == 2.0 and row["floor_by"] == "bytes"
    by_flops = peers.floor(Case("x", "1 MP", broken, bytes_moved=5e6, flops=1e9), 30.0, LIMITS)
    assert by_flops == {"floor_ms": 10.0, "floor_by": "flops", "times_floor": 3.0}
    assert peers.floor(Case("x", "12 MP", broken), 30.0, LIMITS) == {}


def test_a_case_that_breaks_is_a_row():
    row = peers.measure(Case("bad", "batch", broken), 5, 0.0, LIMITS)
    assert row["error"] == "RuntimeError: no such codec"
    assert row["error"] in report.family("f", result(row))


def test_scratch_memory_is_that_of_the_program():
    known = peers.executables()
    program = jax.jit(lambda x: jnp.sort(x @ x, 0) @ x)
    program(jnp.ones((512, 512)))
    assert peers.temporaries(known) >= 512 * 512 * 4 / 1e6 - 0.1
    assert peers.temporaries(peers.executables()) is None


def test_rounds_take_turns_and_stop_at_the_budget():
    order = []
    calls = {name: lambda name=name: (time.sleep(0.005), order.append(name)) for name in "ab"}
    samples = timing.interleaved(calls, rounds=100, budget=0.0)
    assert {k: len(v) for k, v in samples.items()} == {"a": timing.LEAST_ROUNDS, "b": timing.LEAST_ROUNDS}
    assert [name for name, _ in itertools.groupby(order)] == list("ab") * (1 + timing.LEAST_ROUNDS)


def test_a_call_is_warm_before_it_is_sampled():
    took = iter([0.05] + [0.002] * 100)
    assert timing.sample(lambda: time.sleep(next(took)), 0.002, None) < 0.02
    took = iter([0.05])
    assert timing.sample(lambda: time.sleep(next(took)), timing.LONG, None) >= 0.05


@pytest.mark.parametrize(
    "ratio, goal, word", [(1.0, 1, "won, goal met"), (0.9, 1, "lost, goal missed"), (1.1, None, "won")]
)
def test_verdicts(ratio, goal, word):
    assert report.verdict({"ratio": ratio, "goal": goal}) == word


def result(*rows):
    machine = {"processor": "P", "cores": 2, "backend": "cpu", "python": "3", "threads": {"opencv": 2}}
    machine["versions"] = {"jax": "1", "kornia": "not installed"}
    return {"machine": machine, "load": [0.1, 1.2], "limits": LIMITS, "rows": list(rows)}


def test_families_are_kept_and_the_page_follows_from_the_file(tmp_path, row):
    out, page = tmp_path / "peers.json", tmp_path / "performance.md"
    peers.store(out, "second", result(row))
    peers.store(out, "first", result(row, row))
    peers.store(out, "first", result(row))
    assert [len(f["rows"]) for f in json.loads(out.read_text())["families"].values()] == [1, 1]
    report.write_performance(page, peers=out)
    text = page.read_text()
    assert "4 comparisons 2 are won and 2 lost; 4 goals are met and 0 missed" in text
    assert "jax 1." in text and "left out: kornia." in text and "did not run: RuntimeError" in text
    assert text.index("## first") < text.index("## second")
    report.write_performance(page, peers=out)
    assert page.read_text() == text


def test_every_family_gives_cases():
    """They import; their pictures and peers are made only when asked for."""
    for name in peers.families():
        module = __import__(f"benchmarks.cases.{name}", fromlist=["cases"])
        assert callable(module.cases)


def test_every_stage_that_is_switched_can_be():
    assert set(stages.gates()) == set(stages.SWITCHED)


def test_what_was_asked_for_is_judged_by_its_own_measure(tmp_path):
    peer = ENTRY | {"name": "OpenCV, 16 bits", "ratio": 0.59, "goal": None}
    bilinear = ENTRY | {"stage": "bilinear", "size": "batch", "peers": [peer]}
    slope = ENTRY | {"ratio": 4.0, "goal": 4}
    phone = ENTRY | {"stage": "recipe phone", "size": "batch", "ms": 20.0, "peers": [], "gradient": slope}
    results = {"demosaic": result(bilinear), "chain": result(phone)}
    start = {
        "first": {"degrade_s": 20.1}, "second": {"import_s": 1.0, "degrade_s": 2.0},
        "develop": {"peak_mb": 2048},
    }  # fmt: skip
    rows = [(row[0], *row[3:]) for row in musts.rows(results, start)]
    assert ("bilinear", "0.6 x", "0.59 x", "**missed**") in rows
    assert ("recipe phone", "1500 images/s", "1600 images/s", "met") in rows
    assert ("recipe phone, gradient to all parameters", "at most 4 x", "4.00 x", "met") in rows
    assert ("recipe phone, first call", "below 20 s", "20.1 s", "**missed**") in rows
    assert [row[-1] for row in rows[-2:]] == ["met", "met"] and len(rows) == 7


def test_every_must_names_a_row_of_the_results():
    results = json.loads(peers.RESULTS.read_text())["families"]
    sizes = sum(len(of_size) for *_, of_size in musts.AGAINST_PEERS)
    assert len(list(musts.rows(results, None))) == sizes + len(musts.AGAINST_STATED) + 3


def test_images_a_second_of_those_that_ran():
    timed = [{"name": "kornia", "ms": 64.0}, {"name": "AlbumentationsX", "error": "broke"}]
    row = {"stage": "blur", "images": 32, "ms": 4.0, "peers": timed}
    assert report.rate_cells(row) == ["blur", "8,000", "", "500", ""]
