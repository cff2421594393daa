"""Whole batches and a whole frame on the default device: images/s, and how far from its memory's floor.

    python -m benchmarks.accelerator                        # phone on 256 and 1024 patches, and 12 MP
    python -m benchmarks.accelerator --recipes phone-ahd awgn --batches 32 --json

The floor is what a copy of the batch takes there, measured in the same run: no chain can be faster that reads
its pictures and writes them. On a GPU, one call of this is what there is to measure; it runs anywhere.
"""

import argparse
import json
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
from rich.console import Console

from benchmarks.cases import chain
from benchmarks.machine import load, machine
from benchmarks.timing import seconds, summary
from jaxisp.camera import standard_camera
from jaxisp.recipes import RECIPES
from jaxisp.strips import run_in_strips

RESULTS = Path("benchmarks/results/accelerator.json")
LEAST_ROUNDS, IN_A_ROW = 5, 8


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--recipes", nargs="*", default=["phone"], help="of `jaxisp recipes`, or none")
    parser.add_argument("--batches", nargs="+", type=int, default=[256, 1024], help="of 80x80 at once")
    parser.add_argument("--no-frame", action="store_true", help="do not develop 12 megapixels")
    parser.add_argument("--seconds", type=float, default=5.0, help="for the rounds of one row")
    parser.add_argument("--out", type=Path, default=RESULTS)
    parser.add_argument("--json", action="store_true", help="print the results as JSON")
    arguments = parser.parse_args()
    unknown = set(arguments.recipes) - set(RECIPES)
    if unknown:
        parser.error(f"no recipe {', '.join(sorted(unknown))}; there are {', '.join(RECIPES)}")
    console = Console(width=150, highlight=False, stderr=arguments.json)
    results: dict[str, Any] = {"machine": machine(), "load": [load()], "rows": []}
    for row in rows(arguments.recipes, arguments.batches, not arguments.no_frame, arguments.seconds):
        console.print(line(row))
        results["rows"].append(row)
    results["load"].append(load())
    arguments.out.parent.mkdir(parents=True, exist_ok=True)
    arguments.out.write_text(json.dumps(results, indent=1) + "\n")
    if arguments.json:
        print(json.dumps(results))


def rows(recipes: list[str], batches: list[int], frame: bool, budget: float) -> Iterator[dict[str, Any]]:
    patches = jnp.power(chain.batch(), 1 / 2.2)
    for name in recipes:
        recipe = RECIPES[name]()
        for count in batches:
            images = jax.device_put(jnp.resize(patches, (count, *patches.shape[1:])))
            about = {"what": name, "images": count}
            yield about | measure(lambda r=recipe, x=images: r.degrade(chain.KEY, x), images, budget)
            gradient = chain.recipe_gradient(recipe, images)
            yield about | {"what": f"{name}, gradient"} | measure(gradient, images, budget)
    if frame:
        case = chain.developing()
        picture = jax.device_put(case.ours())
        yield {"what": f"{case.stage}, {case.size}", "images": 1} | measure(case.ours, picture, budget)
        yield {"what": "the same, from and to the device", "images": 1} | measure(
            on_device(), picture, budget
        )


def on_device() -> Callable[[], jax.Array]:
    """Render twelve megapixels that are on the device already, and leave them there."""
    camera, mosaic = standard_camera(), jax.device_put(chain.mosaicked(chain.linear(3024, 4032)))
    return lambda: run_in_strips(camera.chain, camera.prior, mosaic)


def measure(call: Callable[[], Any], pictures: jax.Array, budget: float) -> dict[str, Any]:
    """Medians in ms: of calls in a row, as a training loop makes them, and of one that is waited for.

    Beside them a copy of the pictures, in a row too.
    """
    first, row, alone, clock = seconds(call), [], [], time.perf_counter()
    while len(row) < LEAST_ROUNDS or time.perf_counter() - clock < budget:
        row.append(in_a_row(call))
        alone.append(seconds(call))
    copy = jax.jit(lambda x: 2 * x)
    seconds(lambda: copy(pictures))
    floor = 1e3 * min(in_a_row(lambda: copy(pictures)) for _ in range(LEAST_ROUNDS))
    timed = summary(row)
    return {
        "first_call_s": round(first, 2),
        **timed,
        "alone_ms": summary(alone)["ms"],
        "rounds": len(row),
        "floor_ms": round(floor, 4),
        "times_floor": round(timed["ms"] / floor, 1),
    }


def in_a_row(call: Callable[[], Any]) -> float:
    """Seconds of one of some calls, of which only the last is waited for."""
    clock = time.perf_counter()
    for _ in range(IN_A_ROW - 1):
        call()
    jax.block_until_ready(call())
    return (time.perf_counter() - clock) / IN_A_ROW


def line(row: dict[str, Any]) -> str:
    speed = 1e3 * row["images"] / row["ms"]
    return (
        f"{row['what']}, {row['images']} at once: {row['ms']:.2f} ms ({row['iqr']:.2f}), "
        f"{speed:,.1f} images/s, {row['times_floor']} x the floor; waited for {row['alone_ms']:.2f} ms; "
        f"first call {row['first_call_s']} s"
    )


if __name__ == "__main__":
    main()
