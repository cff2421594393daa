"""What a network gains from knowing its camera: adapted to noisy pictures alone, and trained on real pairs.

For each camera three networks, all begun with the weights that come with the package:

- general: as it is.
- adapted: `jaxisp adapt` on the camera's noisy pictures and nothing else, and the training that it does.
- real pairs: trained as long on real pairs of the camera, without the scenes that it is measured on.

PGap is what synthetic training loses: the PSNR of the last less that of one of the others.

python -m experiments.denoisers.one_camera DATA --work RUNS
"""

import argparse
import pickle
import shutil
from pathlib import Path
from typing import Any

import jax
import numpy as np
from flax import nnx

from benchmarks.machine import machine
from experiments.denoisers.pairs import aligned
from experiments.denoisers.report import save, tables
from jaxisp.adapt import adapt
from jaxisp.cli.devices import use_cores
from jaxisp.data.procedural import DRAWN
from jaxisp.io import open_dataset
from jaxisp.models import read_network
from jaxisp.models.apply import Denoiser
from jaxisp.process.cache import keep_compiled
from jaxisp.train import AlignedPair, TrainConfig, evaluate_pairs, load_denoiser
from jaxisp.train.finetune import beginning, clean_from, fine_tune
from jaxisp.train.optimizer import make_optimizer
from jaxisp.train.pool import PairPool
from jaxisp.train.step import init_state, make_step, split_model, weights

CAMERAS = {
    "Canon 5D II": ("polyu", "Canon5D2"),
    "Sony A7 II": ("polyu", "SonyA7II"),
    "phones, RAW": ("sidd", ""),
    "iPhone 8": ("iphone8", ""),
}
"""Set of pairs, and how the names of the camera's pairs begin."""
MEASURED = {"polyu": 248, "sidd": 248, "iphone8": None}
LEARNED = {"polyu": 1024, "sidd": None, "iphone8": None}
"""Sides of the middles that are measured and that real pairs are learned from [px]."""
FOLDS = 3
STEPS, SEED = 300, 0
KEY = "one_camera"


def pairs(data: Path, work: Path, name: str, side: int | None) -> list[AlignedPair]:
    """The aligned pairs of a set; kept on disk, as whole frames take minutes."""
    file = work / "aligned" / f"{name}-{side}.pickle"
    if not file.exists():
        made = aligned(data / name, side)
        file.parent.mkdir(parents=True, exist_ok=True)
        file.write_bytes(pickle.dumps(made))
    return pickle.loads(file.read_bytes())


def adapted(data: Path, work: Path, camera: str, steps: int, draws: int) -> tuple[Denoiser, dict[str, Any]]:
    """The network after `jaxisp adapt` on the camera's noisy pictures, and what it found."""
    name, begins = CAMERAS[camera]
    run = work / f"adapted-{_slug(camera)}"
    found = run / "found.pickle"
    if not found.exists():
        folder = run / "noisy"
        folder.mkdir(parents=True, exist_ok=True)
        for pair in open_dataset(data / name, kind="clean+noisy").pairs:
            if pair.name.startswith(begins):
                shutil.copy(pair.output, folder)
        result = adapt(folder, draws=draws, seed=SEED, tick=_tick)
        found.write_bytes(pickle.dumps(result))
    result = pickle.loads(found.read_bytes())
    clean = clean_from(run / "noisy", run / "run" / "clean")
    fine_tune(
        result.recipe, clean, run / "run", downsample=1, drawn=DRAWN, steps=steps, seed=SEED, tick=_tick
    )
    kept = {"effects": result.effects, "strange": result.strange, "crops": result.crops}
    return load_denoiser(run / "run", "last")[0], kept


def on_real_pairs(learned: list[AlignedPair], folder: Path, steps: int) -> Denoiser:
    """The network trained further on patches of real pairs, in the noisy picture's tone."""
    with beginning() as (start, about):
        model, _ = read_network(start)
    config = TrainConfig(clean=(), recipe="awgn", batch=16, patch=64, steps=steps, lr=3e-4, loss="log_rms")
    rng = np.random.default_rng(SEED)

    def make(indices: range) -> tuple[Any, Any]:
        return tuple(map(np.stack, zip(*[_patch(learned, rng, config.patch) for _ in indices])))

    of, count = ", ".join(pair.name for pair in learned), min(8192, config.batch * steps)
    pool = PairPool(folder / "pool", of, config.patch, count, make, batch=config.batch)
    optimizer = make_optimizer(config, max(1, len(pool) // config.batch))
    # its batches are pairs already, so the recipe degrades nothing
    step = make_step(
        model, config.recipe, optimizer, key=jax.random.key(SEED), loss=config.loss, ema=config.ema
    )
    state = init_state(model, optimizer, ema=config.ema)
    for done in range(steps):
        noisy, target = np.moveaxis(pool.batch(range(done * config.batch, (done + 1) * config.batch)), 1, 0)
        state, metrics = step(state, (noisy, target), done * config.batch)
        if (done + 1) % 100 == 0:
            _tick(done + 1, steps, f"real pairs, loss {float(metrics['loss']):.4f}")
    graph, _, _ = split_model(model, train=False)
    return Denoiser(nnx.merge(graph, *weights(state)), about["light"])


def _patch(learned: list[AlignedPair], rng: np.random.Generator, side: int) -> tuple[np.ndarray, np.ndarray]:
    pair = learned[int(rng.integers(len(learned)))]
    noisy = pair.noisy[pair.area]
    y, x = (int(rng.integers(n - side + 1)) for n in noisy.shape[:2])
    return noisy[y : y + side, x : x + side], pair.toned[y : y + side, x : x + side]


def rows(data: Path, work: Path, camera: str, steps: int, draws: int) -> list[dict[str, Any]]:
    """Figures of the three networks on the camera's pairs."""
    name, begins = CAMERAS[camera]
    own = [pair for pair in pairs(data, work, name, MEASURED[name]) if pair.name.startswith(begins)]
    with beginning() as (start, about):
        general = Denoiser(read_network(start)[0], about["light"])
    made = [_row("general", camera, evaluate_pairs(general, own))]
    network, found = adapted(data, work, camera, steps, draws)
    made.append({**_row("adapted", camera, evaluate_pairs(network, own)), **found})
    learned = [pair for pair in pairs(data, work, name, LEARNED[name]) if pair.name.startswith(begins)]
    each: list[dict[str, Any]] = []
    for fold in range(FOLDS):
        held = {pair.name for pair in own[fold::FOLDS]}
        others = [pair for pair in learned if pair.name not in held]
        folder = work / f"real-{_slug(camera)}-{fold}"
        network = on_real_pairs(others, folder, steps)
        each += evaluate_pairs(network, [pair for pair in own if pair.name in held])["pairs"]
    mean = {key: float(np.mean([row[key] for row in each])) for key in made[0]["mean"]}
    made.append(_row("real pairs", camera, {"mean": mean, "pairs": each}))
    for row in made:
        print(camera, row["denoiser"], {k: round(v, 3) for k, v in row["mean"].items()}, flush=True)
    return made


def _row(denoiser: str, camera: str, result: dict[str, Any]) -> dict[str, Any]:
    return {
        "denoiser": denoiser, "set": camera, "seed": None, "mean": result["mean"], "pairs": result["pairs"]
    }  # fmt: skip


def _slug(camera: str) -> str:
    return camera.lower().replace(",", "").replace(" ", "-")


def _tick(done: int, total: int, text: str) -> None:
    if done % 500 == 0 or done == total or "loss" in text:
        print(done, total, text, flush=True)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("data", type=Path)
    parser.add_argument("--work", type=Path, required=True, help="pairs and runs are kept here")
    parser.add_argument("--cameras", nargs="+", choices=CAMERAS, default=list(CAMERAS))
    parser.add_argument("--steps", type=int, default=STEPS)
    parser.add_argument("--draws", type=int, default=2048)
    parser.add_argument("--out", type=Path, default=Path("docs/results"))
    options = parser.parse_args()
    use_cores()
    keep_compiled()
    made = [
        row
        for camera in options.cameras
        for row in rows(options.data, options.work, camera, options.steps, options.draws)
    ]
    kept = tables(options.out).get(KEY, {}).get("rows", [])
    save(options.out, KEY, {
        "title": "One camera: adapted to its noisy pictures, and trained on its real pairs",
        "command": "python -m experiments.denoisers.one_camera DATA --work RUNS",
        "steps": options.steps, "draws": options.draws, "machine": machine(),
        "rows": [row for row in kept if row["set"] not in options.cameras] + made,
    })  # fmt: skip


if __name__ == "__main__":
    main()
