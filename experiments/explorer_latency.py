"""From a slider that moves to the picture that follows, without a browser: milliseconds for every stage.

    python -m experiments.explorer_latency --out explorer.json

Sets each stage's first slider ten times, as the notebook's kernel does when the browser says that it moved:
the pipeline runs, the picture comes to the host and is compressed to PNG. What comes on top is the browser's
and the connection's.
"""

import argparse
import json
import time
from pathlib import Path
from typing import Any

import numpy as np

from jaxisp import STAGES, Chain, stage
from jaxisp.explore import Explorer
from jaxisp.process.cache import keep_compiled
from jaxisp.samples import scene
from jaxisp.stages.transfer import srgb_oetf

SIZES = ((160, 240), (384, 576))
CAMERA = (
    "mosaic", "shot_read_noise", "demosaic_malvar", "white_balance", "bilateral", "color_matrix", "srgb_oetf",
    "unsharp_mask", "jpeg",
)  # fmt: skip
MOVES = 10


def moves(explorer: Explorer) -> list[float]:
    """Milliseconds of each move of the first slider, the first one left out."""
    slider = next(iter(explorer.sliders.values()))
    low, high = slider.min, slider.max
    places = np.linspace(low, high, MOVES + 3)[1:-1]
    if type(slider).__name__ == "FloatLogSlider":
        places = 10.0**places
    elif type(slider).__name__ == "IntSlider":
        places = [int(p) for p in places]
    found = []
    for value in places:
        clock = time.perf_counter()
        slider.value = value
        found.append(1e3 * (time.perf_counter() - clock))
    return found[1:]


def measure(name: str, size: tuple[int, int]) -> dict[str, Any] | None:
    """Of a stage or of the camera at a size; None where it has no slider."""
    node = Chain(tuple(stage(n) for n in CAMERA)) if name == "camera" else stage(name)
    photograph = np.asarray(srgb_oetf(scene("coffee", size)), np.float32)
    clock = time.perf_counter()
    explorer = Explorer(node, photograph)
    first = time.perf_counter() - clock
    if not explorer.sliders:
        return None
    times = moves(explorer)
    return {"first_s": round(first, 2), "median_ms": round(float(np.median(times)), 1),
            "most_ms": round(max(times), 1)}  # fmt: skip


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--out", type=Path, help="JSON file")
    parser.add_argument("--only", nargs="*", help="these stages; `camera` is a chain of nine")
    arguments = parser.parse_args()
    keep_compiled()
    result: dict[str, Any] = {}
    for size in SIZES:
        found = {}
        for name in arguments.only or ["camera", *sorted(STAGES)]:
            row = measure(name, size)
            if row is not None:
                found[name] = row
        result[f"{size[1]}x{size[0]}"] = found
        slowest = sorted(found, key=lambda name: found[name]["median_ms"], reverse=True)[:8]
        median = np.median([row["median_ms"] for row in found.values()])
        print(f"{size[1]}x{size[0]}: {len(found)} with sliders, median {median:.1f} ms; slowest")
        print(*(f"  {name}: {found[name]}" for name in slowest), sep="\n", flush=True)
    if arguments.out:
        arguments.out.write_text(json.dumps(result, indent=1) + "\n")


if __name__ == "__main__":
    main()
