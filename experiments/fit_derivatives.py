"""Forward differences, as the fit takes them, against `jax.jacfwd`: time and accuracy.

    python -m experiments.fit_derivatives FOLDER CAMERA.toml ...

For each data set of RAW+JPEG pairs and the camera that was fitted to it (`jaxisp fit`): the Jacobian of the
four tiles of one call to all parameters, at the camera. What is right is a central difference in float64;
`step` is how far the Gauss-Newton step is off that of the right Jacobian. Times are CPU seconds; with
`JAX_ENABLE_COMPILATION_CACHE=0` the first call compiles.
"""

import sys
import time
from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from jaxisp.fit.dataset import _Lazy
from jaxisp.fit.journal import Journal
from jaxisp.fit.model import Design, demosaicker_of
from jaxisp.fit.problem import Given, Problem
from jaxisp.fit.program import _robust, _Steps, rendered
from jaxisp.fit.search import Options, Search
from jaxisp.fit.solve import Fit
from jaxisp.fit.state import State
from jaxisp.fit.tiles import Chunk, prepare
from jaxisp.io import open_dataset
from jaxisp.recipe import Recipe

STEP64 = 1e-5
CALLS = 3


def fit_of(folder: str, camera: Recipe) -> tuple[Fit, State]:
    """The problem of the first pair at the design of a fitted camera, and its parameters on the real line."""
    shot = prepare(_Lazy(open_dataset(folder).pairs[0], None)())
    names = [s.fn.__name__ for s in camera.chain.stages()]
    size = next(
        (str(s.options["footprint"]) for s in camera.chain.stages() if s.fn.__name__ == "median"), None
    )
    demosaic = next(demosaicker_of(s) for s in camera.chain.stages() if s.fn.__name__.startswith("demosaic_"))
    options = Options(1, demosaic, size or "none", "camera", ())
    search = Search([shot], options, Journal.open(None, ""), lambda *_: None)
    lens, sampling = "geometric_distortion" in names, "chroma_subsampling" in names
    design = Design(demosaic, 0, size, "camera", lens, sampling)
    params = search.start | {n: v for n, v in camera.prior.items() if n in search.start}
    state = search._origin(params)
    return Fit(search.problem, params, search.views(design), state, design), state


def residual(problem: Problem, given: Given, vector: jax.Array, chunk: Chunk) -> jax.Array:
    """(N,) of the four tiles, before the encoder."""
    steps = _Steps(problem, given, chunk)
    at = steps.at(vector)
    return steps.finish(at, steps.denoise(at, steps.warp(at)), jnp.ones((), vector.dtype)).residual


def forward_differences(problem: Problem, given: Given, vector: jax.Array, chunk: Chunk) -> jax.Array:
    return rendered(problem, given, vector, chunk).jacobian


def jacfwd(problem: Problem, given: Given, vector: jax.Array, chunk: Chunk) -> jax.Array:
    return jax.jacfwd(lambda v: residual(problem, given, v, chunk))(vector).T


def jacfwd_shared(problem: Problem, given: Given, vector: jax.Array, chunk: Chunk) -> jax.Array:
    """What comes after denoising is differentiated from what that gave, as the differences do it."""
    early = np.asarray(problem.before[1])
    late = np.setdiff1d(np.arange(len(vector)), early)
    steps = _Steps(problem, given, chunk)
    here = steps.at(vector)
    denoised = steps.denoise(here, steps.warp(here))

    def through_all(part: jax.Array) -> jax.Array:
        return residual(problem, given, vector.at[early].set(part), chunk)

    def from_there(part: jax.Array) -> jax.Array:
        at = steps.at(vector.at[late].set(part))
        return steps.finish(at, denoised, jnp.ones((), vector.dtype)).residual

    rows = [jax.jacfwd(f)(vector[which]).T for f, which in ((through_all, early), (from_there, late))]
    return jnp.concatenate(rows)[np.argsort(np.concatenate([early, late]))]


def central(problem: Problem, given: Given, vector: np.ndarray, chunk: Chunk) -> np.ndarray:
    with jax.enable_x64(True):
        given, chunk = jax.tree.map(_double, (given, chunk))
        of = jax.jit(lambda v: residual(problem, given, v, chunk))
        at, ends = np.asarray(vector, float), STEP64 * np.eye(len(vector))
        assert of(at).dtype == np.float64
        return np.stack([np.asarray(of(at + e) - of(at - e)) / (2 * STEP64) for e in ends])


def _double(leaf: Any) -> np.ndarray:
    array = np.asarray(leaf)
    return array.astype(float) if array.dtype == np.float32 else array


def timed(call: Callable[..., Any], *arguments: Any) -> tuple[np.ndarray, float]:
    """What it gives, and the CPU seconds that it takes."""
    begun = time.process_time()
    found = np.asarray(call(*arguments), float)
    return found, time.process_time() - begun


def gauss_newton(jacobian: np.ndarray, left: np.ndarray, damping: float = 1e-4) -> np.ndarray:
    weight = np.asarray(_robust(left)[1], float)
    matrix = (jacobian * weight) @ jacobian.T / weight.sum()
    return np.linalg.solve(
        matrix + damping * np.diag(matrix.diagonal() + 1e-2), jacobian @ (weight * left) / weight.sum()
    )


def main() -> None:
    print("| data | method | first call | further calls | error of columns: median | largest | of | step |")
    print("| --- | --- | --- | --- | --- | --- | --- | --- |")
    for folder, file in zip(sys.argv[1::2], sys.argv[2::2]):
        fit, state = fit_of(folder, Recipe.load(file))
        problem, given, chunk = fit.problem, fit.given(0), fit.views[0].chunks[0]
        vector = fit.vector(state, 0)
        right = central(problem, given, vector, chunk) * given.moving[:, None]
        left = np.asarray(residual(problem, given, jnp.asarray(vector), chunk), float)
        size, step = np.linalg.norm(right, axis=1), gauss_newton(right, left)
        seen = size > 1e-6 * size.max()
        for method in (forward_differences, jacfwd, jacfwd_shared):
            jitted = jax.jit(method, static_argnums=0)
            found, first = timed(jitted, problem, given, vector, chunk)
            further = np.mean([timed(jitted, problem, given, vector, chunk)[1] for _ in range(CALLS)])
            own = found * given.moving[:, None]
            off = np.linalg.norm(own - right, axis=1)[seen] / size[seen]
            worst = ".".join([c for c, s in zip(problem.columns, seen) if s][int(off.argmax())])
            moved = np.linalg.norm(gauss_newton(own, left) - step) / np.linalg.norm(step)
            print(
                f"| {folder} | {method.__name__} | {first:.1f} s | {further:.2f} s | {np.median(off):.1e} | "
                f"{off.max():.1e} | {worst} | {moved:.1e} |",
                flush=True,
            )


if __name__ == "__main__":
    main()
