"""What first calls take: CPU seconds of tracing, lowering and compiling, by stage and by recipe.

    python -m experiments.first_calls jpeg_file bilateral phone
    python -m experiments.first_calls phone --gradient --no-compile
    python -m experiments.first_calls bilateral --later 50

A stage gets one picture of 80 x 80 px, a recipe 32. The gradient is that of the sum of squares to all
parameters. To compare two versions run them in turns: a busy machine changes CPU seconds too.
"""

import argparse
import statistics
import time
from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from jaxisp.pipeline import over_batch, stage
from jaxisp.process.selfcheck import check_backend
from jaxisp.recipes import RECIPES
from jaxisp.stages import STAGES

SIDE, PICTURES = 80, 32


def of_stage(name: str) -> tuple[Callable[[Any], jax.Array], Any]:
    """A function of the parameters, and parameters."""
    node, key = stage(name), jax.random.key(0)
    shape = (SIDE, SIDE) if node.domain_in.channels == 1 else (SIDE, SIDE, 3)
    image = np.random.default_rng(0).uniform(0.02, 0.98, shape).astype(np.float32)
    return (lambda params: node(params, jnp.asarray(image), key=key)), node.init()


def of_recipe(name: str) -> tuple[Callable[[Any], jax.Array], Any]:
    """A function of the parameters, and parameters of each picture."""
    recipe, keys = RECIPES[name](), jax.random.split(jax.random.key(0), PICTURES)
    images = np.random.default_rng(0).uniform(size=(PICTURES, SIDE, SIDE, 3)).astype(np.float32)
    params = jax.tree.map(lambda v: jnp.asarray(v, jnp.float32), jax.vmap(recipe.draw)(keys))
    return (lambda params: over_batch(recipe.chain, params, jnp.asarray(images), keys)), params


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("names", nargs="+", choices=[*sorted(STAGES), *RECIPES], metavar="NAME")
    parser.add_argument("--gradient", action="store_true")
    parser.add_argument("--no-compile", action="store_true")
    parser.add_argument("--later", type=int, default=0, help="also the median CPU time of so many calls [ms]")
    arguments = parser.parse_args()
    check_backend()
    for name in arguments.names:
        fn, params = of_recipe(name) if name in RECIPES else of_stage(name)
        squared = jax.grad(lambda p, fn=fn: jnp.sum(fn(p) ** 2))
        start = time.process_time()
        traced = jax.jit(squared if arguments.gradient else fn).trace(params)
        times = [start, time.process_time()]
        lowered = traced.lower()
        times.append(time.process_time())
        if not arguments.no_compile:
            program = lowered.compile()
            times.append(time.process_time())
        told = [f"{step} {s:.2f}" for step, s in zip(("trace", "lower", "compile"), np.diff(times))]
        if arguments.later and not arguments.no_compile:
            later = statistics.median(_cpu(program, params) for _ in range(arguments.later))
            told.append(f"later {1e3 * later:.2f} ms")
        print(name, ", ".join(told), flush=True)


def _cpu(program: Callable[[Any], Any], params: Any) -> float:
    start = time.process_time()
    jax.block_until_ready(program(params))
    return time.process_time() - start


if __name__ == "__main__":
    main()
