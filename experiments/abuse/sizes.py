"""Pictures of many sizes in one run of `degrade`: how large the process becomes.

    JAXISP_CACHE=off python -m experiments.abuse.sizes --recipe awgn --count 1000

Each size from 32 x 32 to 96 x 96 px comes once, in random order. A line after every tenth picture: the
pictures, the process's memory, the programs that were compiled, of the recipe and in all, seconds of the
processor.
"""

import argparse
import tempfile
import time
from pathlib import Path

import numpy as np

from jaxisp.process.programs import compile_times

SMALLEST, LARGEST = 32, 96


def held() -> float:
    """Memory of this process [MB]."""
    return int(Path("/proc/self/statm").read_text().split()[1]) * 4096 / 1e6


def main() -> None:
    from jaxisp.generate import degrade_files
    from jaxisp.io import write_png
    from jaxisp.recipes import RECIPES

    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--recipe", default="awgn", choices=RECIPES)
    parser.add_argument("--count", type=int, default=1000)
    arguments = parser.parse_args()
    rng, sides = np.random.default_rng(0), range(SMALLEST, LARGEST + 1)
    shapes = [(h, w, 3) for h in sides for w in sides]
    with tempfile.TemporaryDirectory() as folder, compile_times() as programs:
        inputs = Path(folder, "in")
        inputs.mkdir()
        for i, k in enumerate(rng.permutation(len(shapes))[: arguments.count]):
            write_png(inputs / f"{i:04d}.png", rng.uniform(size=shapes[k]))

        def tick(done: int, total: int) -> None:
            if done in (8, total) or done % 10 == 0:
                cpu = time.process_time()
                own = sum(program.name == "_degraded" for program in programs)
                print(f"{done} {held():.0f} MB {own} of {len(programs)} programs {cpu:.0f} s", flush=True)

        degrade_files([inputs], Path(folder, "out"), RECIPES[arguments.recipe](), tick=tick)


if __name__ == "__main__":
    main()
