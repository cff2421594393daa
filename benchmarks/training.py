"""A training step against the same network in PyTorch, and how much of it is degrading.

    python -m benchmarks.training

Degrade, forward, backward and update of 32 patches of 80x80 by `phone` and the `fast` network. PyTorch has
the same layers and optimizer but takes a noisy batch that is there already. Rounds are interleaved.
"""

import argparse
import itertools
import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import optax

from benchmarks.machine import load, machine
from benchmarks.timing import interleaved, summary
from jaxisp.cli.devices import use_cores
from jaxisp.models import make_model
from jaxisp.recipes import find_recipe
from jaxisp.train import degrader, init_state, make_mesh, make_step, replicate

BATCH, SIDE, RECIPE, MODEL = 32, 80, "phone", "fast"
STEP, DEGRADE, TORCH = "step, degrading included", "degrading alone", "PyTorch, nothing degraded"
RESULTS, PAGE = Path("benchmarks/results/training.json"), Path("docs/results/training.md")
GOALS = {"share": 0.25, "ratio": 1.7}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--rounds", type=int, default=15)
    parser.add_argument("--seconds", type=float, default=50.0, help="no further round is begun after")
    parser.add_argument("--out", type=Path, default=RESULTS)
    parser.add_argument("--report", type=Path, default=PAGE)
    arguments = parser.parse_args()
    use_cores()
    busy = [load()]
    calls = {**jax_calls(), **torch_calls()}
    for call in calls.values():
        call()
    samples = interleaved(calls, arguments.rounds, arguments.seconds)
    results = {name: {**summary(times), "rounds": len(times)} for name, times in samples.items()}
    found = {"machine": machine(), "load": [*busy, load()], "milliseconds": results}
    written = {arguments.out: json.dumps(found, indent=1) + "\n", arguments.report: markdown(found)}
    for path, text in written.items():
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text)
    print(markdown(found))


def jax_calls() -> dict[str, Callable[[], Any]]:
    """A step as the trainer does it, and its degrading."""
    mesh, recipe, model, key = make_mesh(BATCH), find_recipe(RECIPE), make_model(MODEL), jax.random.key(0)
    optimizer = optax.chain(optax.clip_by_global_norm(1.0), optax.adam(1e-3))
    step = make_step(model, recipe, optimizer, key=key, ema=0.999, mesh=mesh)
    rows = jax.NamedSharding(mesh, jax.P("batch"))
    clean, indices = jax.device_put((images(), np.arange(BATCH)), rows)
    state = [replicate(mesh, init_state(model, optimizer, ema=0.999))]
    degrade = jax.jit(degrader(recipe, key, mesh))

    def train() -> Any:
        state[0], metrics = step(state[0], clean, 0)
        return metrics

    return {STEP: train, DEGRADE: lambda: degrade(clean, indices)}


def torch_calls() -> dict[str, Callable[[], Any]]:
    """The same network and update; none where PyTorch is not installed."""
    try:
        import torch
        from torch import nn
    except ImportError:
        return {}
    widths = [12, *[48] * 7]
    layers: list[Any] = [nn.PixelUnshuffle(2)]
    for a, b in itertools.pairwise(widths):
        layers += [nn.Conv2d(a, b, 3, padding=1), nn.ReLU(inplace=True)]
    body = nn.Sequential(*layers, nn.Conv2d(48, 12, 3, padding=1), nn.PixelShuffle(2))
    body = body.to(memory_format=torch.channels_last)
    counted = sum(p.numel() for p in body.parameters())
    expected = sum(x.size for x in jax.tree.leaves(jax.eval_shape(lambda: weights_of(MODEL))))
    assert counted == expected, (counted, expected)
    averaged = [p.detach().clone() for p in body.parameters()]
    optimizer = torch.optim.Adam(body.parameters(), 1e-3)
    clean = torch.from_numpy(images()).permute(0, 3, 1, 2)
    noisy = clean + 0.05 * torch.randn(clean.shape)

    def train() -> None:
        optimizer.zero_grad()
        (noisy - body(noisy) - clean).abs().mean().backward()
        nn.utils.clip_grad_norm_(body.parameters(), 1.0)
        optimizer.step()
        torch._foreach_lerp_(averaged, [p.detach() for p in body.parameters()], 1e-3)

    return {TORCH: train}


def weights_of(name: str) -> Any:
    """The weights of a network alone."""
    from flax import nnx

    return nnx.to_pure_dict(nnx.state(make_model(name), nnx.Param))


def images() -> np.ndarray:
    """A batch of smooth pictures."""
    corners = np.random.default_rng(0).random((BATCH, 10, 10, 3), np.float32)
    return np.array(jax.image.resize(jnp.asarray(corners), (BATCH, SIDE, SIDE, 3), "cubic").clip(0, 1))


def markdown(found: dict[str, Any]) -> str:
    """The page."""
    times = found["milliseconds"]
    step, degrade = times[STEP]["ms"], times[DEGRADE]["ms"]
    rows = [f"| {name} | {t['ms']:.0f} | {t['iqr']:.0f} | {t['rounds']} |" for name, t in times.items()]
    against = f"{step / times[TORCH]['ms']:.2f} times" if TORCH in times else "not measured against"
    info = found["machine"]
    return "\n".join(
        [
            "# A training step",
            "",
            f"{BATCH} patches of {SIDE}x{SIDE}, recipe `{RECIPE}`, network `{MODEL}`, Adam with averaging.",
            "",
            "| | median ms | interquartile range | rounds |",
            "| --- | --- | --- | --- |",
            *rows,
            "",
            f"Degrading takes {degrade / step:.0%} of a step (goal: at most {GOALS['share']:.0%}).",
            f"A step takes {against} that of the same network in PyTorch, which degrades nothing (goal: at",
            f"most {GOALS['ratio']}).",
            "",
            f"{info['processor']}, {info['cores']} cores; jax {info['versions']['jax']}, torch "
            f"{info['versions']['torch']}; load before and after {found['load'][0]}, {found['load'][1]}.",
            "`python -m benchmarks.training`",
            "",
        ]
    )


if __name__ == "__main__":
    main()
