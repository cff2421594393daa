"""Time a first and a second start of the `phone` recipe, and the memory that developing a frame takes.

    python -m benchmarks.start

Writes benchmarks/results/start.json and remakes the page of `benchmarks.peers`, which shows it. Each is a
process of its own: one with an empty compilation cache, which it fills, one with that cache, and one that
develops twelve megapixels.
"""

import argparse
import json
import os
import resource
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

from benchmarks.machine import load
from benchmarks.report import write_performance

RESULTS = Path("benchmarks/results/start.json")
PAGE = Path("docs/results/performance.md")
CACHE = "JAX_COMPILATION_CACHE_DIR"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--only", choices=sorted(CHILDREN), help="in this process, for a parent")
    parser.add_argument("--out", type=Path, default=RESULTS)
    parser.add_argument(
        "--report", type=Path, default=PAGE, help="page to remake, from peers.json beside --out"
    )
    arguments = parser.parse_args()
    if arguments.only:
        print(json.dumps(CHILDREN[arguments.only]()))
        return
    measure(arguments.out)
    print(arguments.out.read_text())
    write_performance(arguments.report, peers=arguments.out.with_name("peers.json"))


def measure(out: Path = RESULTS) -> None:
    """Run the processes and write what they found."""
    busy = load()
    with tempfile.TemporaryDirectory() as cache:
        found = {
            "first": child("phone", cache),
            "second": child("phone", cache),
            "develop": child("develop", None),
        }
    out.parent.mkdir(parents=True, exist_ok=True)
    out.write_text(json.dumps(found | {"load": [busy, load()]}, indent=1) + "\n")


def child(what: str, cache: str | None) -> dict[str, Any]:
    """What a new process found, and how long it took in all."""
    environment = {k: v for k, v in os.environ.items() if k != CACHE}
    if cache:
        environment |= {CACHE: cache, "JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS": "0.1"}
    clock = time.perf_counter()
    command = [sys.executable, "-m", "benchmarks.start", "--only", what]
    done = subprocess.run(command, env=environment, capture_output=True, text=True, check=True)
    spent = time.perf_counter() - clock
    return json.loads(done.stdout.splitlines()[-1]) | {"process_s": round(spent, 2)}


def phone() -> dict[str, Any]:
    """A batch through the recipe, then its gradient to all parameters."""
    clock = time.perf_counter()
    import jax
    import jax.numpy as jnp
    import numpy as np

    from jaxisp.recipes import RECIPES

    imported = time.perf_counter()
    recipe, key = RECIPES["phone"](), jax.random.key(0)
    images = jnp.asarray(np.random.default_rng(0).random((32, 80, 80, 3), np.float32))
    params = jax.block_until_ready(recipe.degrade(key, images))[2]
    degraded = time.perf_counter()
    jax.block_until_ready(jax.jit(jax.grad(lambda p: jnp.mean(recipe.repeat(key, p, images) ** 2)))(params))
    return {
        "import_s": round(imported - clock, 2),
        "degrade_s": round(degraded - imported, 2),
        "gradient_s": round(time.perf_counter() - degraded, 2),
    }


def develop() -> dict[str, Any]:
    """Twelve megapixels by AHD, and the most memory that the process held."""
    import jax

    from benchmarks.cases.chain import developing

    case = developing()
    before = peak()
    jax.block_until_ready(case.ours())
    return {"before_mb": before, "peak_mb": peak()}


def peak() -> int:
    """MB that this process held at most. Linux's `ru_maxrss` would be its parent's, where that held more."""
    status = Path("/proc/self/status")
    if status.exists():
        return round(int(status.read_text().split("VmHWM:")[1].split()[0]) / 1024)
    return round(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024)


CHILDREN = {"phone": phone, "develop": develop}

if __name__ == "__main__":
    main()
