"""Whole batches and a whole frame on the default device: images/s, and how far from its memory's floor.

    python -m benchmarks.accelerator                        # phone on 256 and 1024 patches, and 12 MP
    python -m benchmarks.accelerator --stages 1024          # each stage too, beside kornia on the same device
    python -m benchmarks.accelerator --recipes phone-ahd awgn --batches 32 --json

The floor is what a copy of the batch takes there, measured in the same run: no chain can be faster that reads
its pictures and writes them; a stage's is that of what it reads and writes. On a GPU, one call of this is
what there is to measure; it runs anywhere.
"""

import argparse
import json
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from rich.console import Console

from benchmarks.accelerator_report import write_accelerator
from benchmarks.case import Case, Peer
from benchmarks.cases import chain, demosaic, denoise, filters, jpeg
from benchmarks.kernels import kernels
from benchmarks.machine import load, machine
from benchmarks.peers import compare
from benchmarks.timing import finish, seconds, summary
from jaxisp.camera import standard_camera
from jaxisp.io.files import write_text
from jaxisp.pipeline import Chain, run_in_strips
from jaxisp.recipes import RECIPES

RESULTS = Path("benchmarks/results/accelerator.json")
LEAST_ROUNDS, IN_A_ROW = 5, 8
DEMOSAICKERS = ("bilinear", "Malvar", "Hibbard", "Menon", "AHD", "AHD, 3 medians")


class How(NamedTuple):
    """Seconds for the rounds of a row, and whether its kernels are listed."""

    budget: float
    kernels: bool


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--recipes", nargs="*", default=["phone"], help="of `jaxisp recipes`, or none")
    parser.add_argument("--batches", nargs="+", type=int, default=[256, 1024], help="of 80x80 at once")
    parser.add_argument("--no-frame", action="store_true", help="do not develop 12 megapixels")
    parser.add_argument("--stages", type=int, default=0, help="so many patches through each stage, too")
    parser.add_argument("--only", default="", help="the stages with this in their name")
    parser.add_argument("--kernels", action="store_true", help="the kernels of each row, too")
    parser.add_argument("--seconds", type=float, default=5.0, help="for the rounds of one row")
    parser.add_argument("--out", type=Path, default=RESULTS)
    parser.add_argument("--report", type=Path, help="write a page of the results here")
    parser.add_argument("--render", action="store_true", help="measure nothing, write the page")
    parser.add_argument("--json", action="store_true", help="print the results as JSON")
    arguments = parser.parse_args()
    unknown = set(arguments.recipes) - set(RECIPES)
    if unknown:
        parser.error(f"no recipe {', '.join(sorted(unknown))}; there are {', '.join(RECIPES)}")
    if arguments.render:
        if not arguments.report:
            parser.error("--render needs --report")
        write_accelerator(arguments.report, arguments.out)
        return
    console = Console(width=150, highlight=False, stderr=arguments.json)
    arguments.out.parent.mkdir(parents=True, exist_ok=True)
    results: dict[str, Any] = {"machine": machine(), "load": [load()], "rows": []}
    how = How(arguments.seconds, arguments.kernels)

    def keep(rows: Iterator[dict[str, Any]]) -> None:
        for row in rows:
            console.print(line(row))
            results["rows"].append(row)
            write_text(arguments.out, json.dumps(results, indent=1) + "\n")

    keep(recipe_rows(arguments.recipes, arguments.batches, how))
    if not arguments.no_frame:
        keep(frame_rows(how))
    if arguments.stages:
        keep(stage_rows(arguments.stages, arguments.only, how))
    results["machine"], results["load"] = machine(), [*results["load"], load()]
    write_text(arguments.out, json.dumps(results, indent=1) + "\n")
    if arguments.report:
        write_accelerator(arguments.report, arguments.out)
    if arguments.json:
        print(json.dumps(results))


def recipe_rows(recipes: list[str], batches: list[int], how: How) -> Iterator[dict[str, Any]]:
    patches = np.power(chain.batch(), 1 / 2.2)
    for name in recipes:
        recipe = RECIPES[name]()
        for count in batches:
            images = jnp.asarray(repeated(patches, count))
            about = {"what": name, "images": count}
            yield about | measure(lambda r=recipe, x=images: r.degrade(chain.KEY, x), 2 * images.nbytes, how)
            gradient = chain.recipe_gradient(recipe, images)
            yield about | {"what": f"{name}, gradient"} | measure(gradient, 2 * images.nbytes, how)


def frame_rows(how: How) -> Iterator[dict[str, Any]]:
    case = chain.developing()
    moved = 2 * case.ours().nbytes
    yield {"what": f"{case.stage}, {case.size}", "images": 1} | measure(case.ours, moved, how)
    yield {"what": "the same, from and to the device", "images": 1} | measure(on_device(), moved, how)


def on_device() -> Callable[[], jax.Array]:
    """Render twelve megapixels that are on the device already, and leave them there."""
    camera, mosaic = standard_camera(), jax.device_put(chain.mosaicked(chain.linear(3024, 4032)))
    return lambda: run_in_strips(camera.chain, camera.prior, mosaic)


def stage_rows(count: int, only: str, how: How) -> Iterator[dict[str, Any]]:
    """Each stage on that many patches, and kornia where it has the like."""
    for make in stage_cases(count):
        case = make()
        if only in case.stage:
            row = {"what": case.stage, "images": count} | measure(case.ours, case.bytes_moved, how)
            beside = [against(case, peer, row["ms"], how) for peer in case.peers if "kornia" in peer.name]
            yield row | {"peers": beside}


def stage_cases(count: int) -> Iterator[Callable[[], Case]]:
    """What makes the cases of the benchmarks, one by one, with more patches."""
    mosaics, planes = repeated(demosaic.batch(), count), repeated(denoise.data()["batch"], 3 * count)
    pictures = repeated(filters.batch(), count)
    for name in DEMOSAICKERS:
        yield lambda name=name: demosaic.case(name, "batch", mosaics)
    for radius in (2, 5):
        yield lambda r=radius: denoise.bilateral_case("batch", planes, jnp.asarray(planes), r)
    for side in (3, 5):
        yield lambda side=side: denoise.median_case("batch", planes, jnp.asarray(planes), side)
    yield lambda: denoise.wavelet_case("batch", planes, jnp.asarray(planes))
    yield lambda: denoise.grid_case("batch", jnp.asarray(planes))
    for make in (filters.gaussian, filters.unsharp, filters.chromatic_aberration):
        yield lambda make=make: make("batch", pictures)
    yield lambda: jpeg.case("batch", repeated(jpeg.patches(), count))
    yield lambda: chain.chain_case(Chain(chain.NODES, "chain"), "batch", repeated(chain.batch(), count))


def repeated(images: np.ndarray, count: int) -> np.ndarray:
    return np.resize(images, (count, *images.shape[1:]))


def against(case: Case, peer: Peer, ours_ms: float, how: How) -> dict[str, Any]:
    """A peer's outputs beside ours, then its times; or what went wrong, as one line."""
    entry = compare(case, peer)
    if "error" not in entry:
        entry |= timed(peer.call, how.budget)
        entry["ratio"] = round(entry["ms"] / ours_ms, 2)
    return entry


def measure(call: Callable[[], Any], moved: float, how: How) -> dict[str, Any]:
    """The times of a call beside the floor, a copy that reads and writes as many bytes as are given."""
    first = seconds(call)
    row = {"first_call_s": round(first, 2)} | timed(call, how.budget)
    numbers = jnp.ones(int(moved / 8), jnp.float32)
    copy = jax.jit(lambda x: 2 * x)
    seconds(lambda: copy(numbers))
    floor = 1e3 * min(in_a_row(lambda: copy(numbers)) for _ in range(LEAST_ROUNDS))
    row |= {"floor_ms": round(floor, 4), "times_floor": round(row["ms"] / floor, 1)}
    if how.kernels:
        found = kernels(call)
        row["kernels_ms"], row["kernels"] = round(sum(k["ms"] for k in found), 3), found
    return row


def timed(call: Callable[[], Any], budget: float) -> dict[str, Any]:
    """Medians in ms: of calls in a row, as a training loop makes them, and of one that is waited for."""
    row, alone, clock = [], [], time.perf_counter()
    while len(row) < LEAST_ROUNDS or time.perf_counter() - clock < budget:
        row.append(in_a_row(call))
        alone.append(in_a_row(call, 1))
    return {**summary(row), "alone_ms": summary(alone)["ms"], "rounds": len(row)}


def in_a_row(call: Callable[[], Any], calls: int = IN_A_ROW) -> float:
    """Seconds of one of some calls, of which only the last is waited for."""
    clock = time.perf_counter()
    for _ in range(calls - 1):
        call()
    finish(call)
    return (time.perf_counter() - clock) / calls


def line(row: dict[str, Any]) -> str:
    speed = 1e3 * row["images"] / row["ms"]
    text = (
        f"{row['what']}, {row['images']} at once: {row['ms']:.2f} ms ({row['iqr']:.2f}), "
        f"{speed:,.1f} images/s, {row['times_floor']} x the floor; waited for {row['alone_ms']:.2f} ms; "
        f"first call {row['first_call_s']} s"
    )
    if "kernels" in row:
        text += f"; {row['kernels_ms']} ms in {sum(k['times'] for k in row['kernels']):.0f} kernels"
    for entry in row.get("peers", ()):
        said = entry.get("error") or f"{entry['ms']:.2f} ms, {entry['ratio']:.2f} x ours"
        text += f"\n    {entry['name']}: {said} ({entry.get('outputs', 'not compared')})"
    return text


if __name__ == "__main__":
    main()
