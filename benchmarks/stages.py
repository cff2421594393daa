"""Time every stage on one batch: compile, forward, and gradient to parameters and image.

    make bench                                 # everything
    python -m benchmarks.stages jpeg median    # some stages; the others' results are kept
    python -m benchmarks.stages --slice 1/4    # a quarter of the stages, likewise
    python -m benchmarks.stages --switches     # what a stage costs that is switched off
    python -m benchmarks.stages --chains       # a chain beside the sum of its stages
    python -m benchmarks.stages --render       # only remake the page from the results

Calls take turns, so that a busy moment hits all alike; medians are reported with the interquartile
range. Machine and versions are in the JSON.
"""

import argparse
import json
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
    "resampling", "saturation", "srgb_oetf", "unsharp_mask", "wavelet_coring",
)  # fmt: skip


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("stages", nargs="*", help="default: all")
    parser.add_argument("--slice", help="i/n: every n-th stage from the i-th on")
    parser.add_argument("--switches", action="store_true", help="stages switched on and off")
    parser.add_argument("--chains", action="store_true", help="a chain beside the sum of its stages")
    parser.add_argument("--seconds", type=float, default=30.0, help="for the rounds of each of the three")
    parser.add_argument("--render", action="store_true", help="time nothing, write the page")
    parser.add_argument("--out", type=Path, default=RESULTS)
    parser.add_argument("--report", type=Path, default=PAGE)
    arguments = parser.parse_args()
    some = arguments.stages or arguments.slice or arguments.switches or arguments.chains
    busy = load()
    found: dict[str, Any] = {}
    if not arguments.render:
        if not some or arguments.stages or arguments.slice:
            names = arguments.stages or chosen(arguments.slice or "1/1")
            found["stages"] = measure_stages(names, arguments.seconds)
        if not some or arguments.switches:
            found["switches"] = measure_switches(arguments.seconds)
        if not some or arguments.chains:
            found["chains"] = measure_chains(arguments.seconds)
        store(arguments.out, found, {"machine": machine(), "load": [busy, load()]})
    write_stages(arguments.report, arguments.out)


def chosen(which: str) -> list[str]:
    first, of = map(int, which.split("/"))
    return sorted(STAGES)[first - 1 :: of]


def store(path: Path, found: dict[str, Any], about: dict[str, Any]) -> None:
    """Put what was measured in place of what the file has of it; the machine is that of the last run."""
    path.parent.mkdir(parents=True, exist_ok=True)
    kept = json.loads(path.read_text()) if path.exists() else {}
    stages = kept.get("stages", {}) | found.get("stages", {})
    merged = kept | found | about | {"stages": {n: stages[n] for n in sorted(stages) if n in STAGES}}
    path.write_text(json.dumps(merged, indent=1) + "\n")


def measure_stages(names: list[str], budget: float) -> dict[str, Any]:
    calls = {
        f"{name} {what}": prepare(stage(name), what) for name in names for what in ("forward", "gradient")
    }
    timed = time_calls(calls, budget)
    return {name: {what: timed[f"{name} {what}"] for what in ("forward", "gradient")} for name in names}


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


def measure_switches(budget: float) -> dict[str, Any]:
    """A stage that is switched on and off without a new compilation, one switch for the batch."""
    calls: dict[str, Callable[[], Any]] = {}
    for name in SWITCHED:
        gate = Gate(stage(name))
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
