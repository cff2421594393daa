"""Time every stage on one batch: compile, forward, and gradient to parameters and image.

    make bench                                 # everything
    python -m benchmarks.stages jpeg median    # some stages; the others' results are kept
    python -m benchmarks.stages --missing --within 50   # those without results, as many as begin in 50 s
    python -m benchmarks.stages --switches     # what a stage costs that is switched off
    python -m benchmarks.stages --chains       # a chain beside the sum of its stages
    python -m benchmarks.stages --render       # only remake the page from the results

Calls take turns, so that a busy moment hits all alike; medians are reported with the interquartile
range. Machine and versions are in the JSON.
"""

import argparse
import json
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from benchmarks.cases import chain
from benchmarks.machine import load, machine
from benchmarks.stages_report import write_stages
from benchmarks.timing import interleaved, seconds, summary
from jaxisp.pipeline import Chain, Gate, Node, Params, Stage, Switch, run_batch, stage
from jaxisp.stages import STAGES

BATCH, SIDE, ROUNDS = 32, 80, 15
RESULTS = Path("benchmarks/results/stages.json")
PAGE = Path("docs/results/stages.md")
KEY = jax.random.key(0)
SWITCHED = (
    "bilateral", "defocus", "geometric_distortion", "jpeg", "median", "motion_blur", "optical_blur",
    "resampling", "s_curve", "saturation", "unsharp_mask", "wavelet_coring",
)  # fmt: skip


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("stages", nargs="*", help="default: all")
    parser.add_argument("--missing", action="store_true", help="the stages that have no results yet")
    parser.add_argument("--within", type=float, help="seconds after which no further stage is begun")
    parser.add_argument("--switches", action="store_true", help="stages switched on and off")
    parser.add_argument("--chains", action="store_true", help="a chain beside the sum of its stages")
    parser.add_argument(
        "--seconds", type=float, default=3.0, help="for the rounds of a stage, or of the others"
    )
    parser.add_argument("--render", action="store_true", help="time nothing, write the page")
    parser.add_argument("--out", type=Path, default=RESULTS)
    parser.add_argument("--report", type=Path, default=PAGE)
    arguments = parser.parse_args()
    some = arguments.stages or arguments.missing or arguments.switches or arguments.chains
    busy = load()

    def keep(found: dict[str, Any]) -> None:
        store(arguments.out, found, {"machine": machine(), "load": [busy, load()]})

    if not arguments.render:
        if not some or arguments.stages or arguments.missing:
            names = arguments.stages or chosen(arguments.out if arguments.missing else None)
            measure_stages(names, arguments.seconds, arguments.within, keep)
        if not some or arguments.switches:
            keep({"switches": measure_switches(arguments.seconds)})
        if not some or arguments.chains:
            keep({"chains": measure_chains(arguments.seconds)})
    write_stages(arguments.report, arguments.out)


def chosen(results: Path | None) -> list[str]:
    """All stages, or those that the results lack."""
    known = json.loads(results.read_text()).get("stages", {}) if results and results.exists() else {}
    return [name for name in sorted(STAGES) if name not in known]


def store(path: Path, found: dict[str, Any], about: dict[str, Any]) -> None:
    """Put what was measured in place of what the file has of it; the machine is that of the last run."""
    path.parent.mkdir(parents=True, exist_ok=True)
    kept = json.loads(path.read_text()) if path.exists() else {}
    stages = kept.get("stages", {}) | found.get("stages", {})
    merged = kept | found | about | {"stages": {n: stages[n] for n in sorted(stages) if n in STAGES}}
    path.write_text(json.dumps(merged, indent=1) + "\n")


def measure_stages(
    names: list[str], budget: float, within: float | None, keep: Callable[[dict[str, Any]], None]
) -> None:
    """Forward and gradient of each stage in turns; kept one by one, as the compilations take a while."""
    clock = time.perf_counter()
    for name in names:
        if within is not None and time.perf_counter() - clock > within:
            break
        calls = {what: prepare(stage(name), what) for what in ("forward", "gradient")}
        keep({"stages": {name: time_calls(calls, budget)}})


def time_calls(calls: dict[str, Callable[[], Any]], budget: float) -> dict[str, Any]:
    """Seconds of the first call, then medians in ms."""
    first = {name: round(seconds(call), 2) for name, call in calls.items()}
    samples = interleaved(calls, ROUNDS, budget)
    return {name: {"first_call_s": first[name]} | summary(samples[name]) for name in calls}


def prepare(case: Stage, what: str) -> Callable[[], Any]:
    """A call without arguments that runs the stage on the batch."""
    params, images = jax.device_put(case.init()), batch(case)
    if what == "forward":
        return lambda: run_batch(case, params, images, KEY)
    gradient = jax.jit(jax.grad(lambda p, x: jnp.sum(run_batch(case, p, x, KEY) ** 2), argnums=(0, 1)))
    return lambda: gradient(params, images)


def batch(case: Node) -> jax.Array:
    shape = (BATCH, SIDE, SIDE) if case.domain_in.channels == 1 else (BATCH, SIDE, SIDE, 3)
    return jax.device_put(np.random.default_rng(0).uniform(0.02, 0.98, shape).astype(np.float32))


def gates() -> dict[str, Gate]:
    return {name: Gate(stage(name)) for name in SWITCHED}


def measure_switches(budget: float) -> dict[str, Any]:
    """A stage that is switched on and off without a new compilation, one switch for the batch."""
    calls: dict[str, Callable[[], Any]] = {}
    for name, gate in gates().items():
        images = batch(gate)
        for word, on in (("on", 1.0), ("off", 0.0)):
            params = jax.device_put(gate.init() | {gate.name: Switch(on=jnp.float32(on))})
            calls[f"{name} {word}"] = lambda g=gate, p=params, x=images: run_batch(g, p, x, KEY)
    copy, images = jax.jit(lambda x: x + 1), batch(stage("saturation"))
    timed = time_calls(calls | {"copy": lambda: copy(images)}, budget)
    rows = {name: {word: timed[f"{name} {word}"] for word in ("on", "off")} for name in SWITCHED}
    return {"copy": timed["copy"], "stages": rows}


def measure_chains(budget: float) -> list[dict[str, Any]]:
    """The first stages of the chain in one program, and the sum of each alone on what it gets there."""
    return [row for size in ("batch", "1 MP") for row in chain_rows(size, budget / 2)]


def chain_rows(size: str, budget: float) -> list[dict[str, Any]]:
    images = chain.batch() if size == "batch" else chain.linear(1000, 1000)[None]
    whole = Chain(chain.NODES, "chain")
    params: Params = jax.tree.map(
        lambda v: jnp.full((len(images), *np.shape(v)), v, jnp.float32), whole.init() | chain.PARAMS
    )
    start = now = jnp.asarray(images)
    calls: dict[str, Callable[[], Any]] = {}
    for i, node in enumerate(chain.NODES):
        part = Chain(chain.NODES[: i + 1], "chain")
        calls[f"up to {node.name}"] = runner(part, params, start)
        calls[node.name] = runner(node, params, now)
        now = calls[node.name]()
    timed, total, rows = time_calls(calls, budget), 0.0, []
    for node in chain.NODES:
        total += timed[node.name]["ms"]
        together = timed[f"up to {node.name}"]
        alone = {"alone_ms": timed[node.name]["ms"], "sum_ms": round(total, 4)}
        rows.append({"size": size, "stage": node.name} | together | alone)
    return rows


def runner(node: Node, params: Params, images: jax.Array) -> Callable[[], jax.Array]:
    own = {name: params[name] for name in node.init()}
    return lambda: run_batch(node, own, images, KEY)


if __name__ == "__main__":
    main()
