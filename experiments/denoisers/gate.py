"""The gate before any real set: a network against classical denoisers on what its recipe makes of pictures
that it has not seen.

Each classical denoiser gets the strength that turns out best for each picture, and beside it the one that
`jaxisp evaluate` gives it, which knows the noisy picture alone, as the network does.

python -m experiments.denoisers.gate DATA --work RUNS --network FILE
"""

import argparse
import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from benchmarks.machine import machine
from jaxisp.cli.devices import use_cores
from jaxisp.data import downsample_linear
from jaxisp.io import read_image
from jaxisp.io.files import write_text
from jaxisp.models import read_network
from jaxisp.models.apply import Denoiser
from jaxisp.models.levels import measured_map
from jaxisp.process.cache import keep_compiled
from jaxisp.recipes import find_recipe
from jaxisp.train import Classical
from jaxisp.train.classical import METHODS
from jaxisp.train.target import pair_maker

SIDE = 112
SEED = 61  # of the gate alone
SEEN = slice(0, 26, 2)
"""Pictures of cbsd68 that were the gate before this one: methods were chosen while looking at them."""
ROUNDING = 12 * 255**2
"""1 / the mean square of rounding to 8 bits: a PSNR [58.9 dB] beyond which nothing is to be gained."""
NOISY = 48.1
"""PSNR [dB] below which a picture has noise of a step of 8 bits or more."""
BLURS = (0.4, 0.55, 0.75, 1.0, 1.4, 2.0)  # px
RATIOS = {"tv": (0.35, 0.5, 0.7, 1.0, 1.4, 2.0), "bm3d": (1.0, 1.5, 2.2), "ffdnet": (0.7, 1.0, 1.4, 2.0, 2.8)}
OTHER_RATIOS = (0.5, 0.7, 1.0, 1.4, 2.0)
"""Of the noise's true standard deviation."""


def pairs(data: Path, work: Path, recipe: str) -> list[tuple[np.ndarray, np.ndarray]]:
    """Noisy and target; kept on disk."""
    file = work / f"gate-{recipe}-{SEED}.npz"
    if not file.exists():
        made = jax.jit(pair_maker(find_recipe(recipe), jax.random.key(SEED), "camera"))
        both = [
            [np.asarray(part)[0] for part in made(clean[None], np.asarray([i], np.int32))]
            for i, clean in enumerate(_clean(data))
        ]
        np.savez(file, pairs=np.asarray(both))
    return [(noisy, target) for noisy, target in np.load(file)["pairs"]]


def _clean(data: Path) -> list[np.ndarray]:
    """Both ends of pictures that no network learned from and no earlier gate looked at."""
    paths = sorted((data / "clean" / "cbsd68").iterdir())
    del paths[SEEN]
    found = []
    for path in paths:
        small = downsample_linear(read_image(path), 2)
        for end in (slice(None, SIDE), slice(-SIDE, None)):
            long = small if small.shape[0] > small.shape[1] else small.swapaxes(0, 1)
            across = (long.shape[1] - SIDE) // 2
            found.append(np.ascontiguousarray(long[end, across : across + SIDE]))
    return found


def psnr(picture: np.ndarray, target: np.ndarray) -> float:
    """Of encoded pictures [dB], at most that of 8 bits."""
    error = float(((np.clip(picture, 0, 1) - target) ** 2).mean())
    return -10 * float(np.log10(max(error, 1 / ROUNDING)))


def best(method: str, noisy: np.ndarray, target: np.ndarray) -> float:
    """Of the strengths, and of leaving the picture as it is."""
    level = max(float((noisy - target).std()), 0.2 / 255)
    strengths = BLURS if METHODS[method].unit == "px" else RATIOS.get(method, OTHER_RATIOS)
    scale = 1.0 if METHODS[method].unit == "px" else level
    return max(psnr(noisy, target), *(psnr(Classical(method, s * scale)(noisy), target) for s in strengths))


def blind(method: str, noisy: np.ndarray, target: np.ndarray) -> float:
    """With the strength that `jaxisp evaluate` gives it, which knows the noisy picture alone."""
    return psnr(Classical(method)(noisy), target)


def with_true_map(model: Any, noisy: np.ndarray, target: np.ndarray) -> np.ndarray:
    """What a network with a noise map makes of a picture where it need not estimate that."""
    picture, wanted = jnp.asarray(noisy)[None], jnp.asarray(target)[None]
    return np.asarray(model(picture, measured_map(picture, wanted)))[0]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("data", type=Path)
    parser.add_argument("--work", type=Path, required=True, help="pairs and figures are kept here")
    parser.add_argument("--network", type=Path, help="a file of weights; none: classical denoisers alone")
    parser.add_argument("--recipe", default="any-camera")
    parser.add_argument("--out", type=Path, default=Path("docs/results"))
    options = parser.parse_args()
    use_cores()
    keep_compiled()
    both = pairs(options.data, options.work, options.recipe)
    rows: dict[str, list[float]] = {"noisy input": [psnr(picture, target) for picture, target in both]}
    kept = options.work / f"gate-{options.recipe}-{SEED}.json"
    rows |= json.loads(kept.read_text()) if kept.exists() else {}
    for method in METHODS:
        for name, measured in ((method, best), (f"{method}, blind", blind)):
            if name not in rows and not Classical(method).missing():
                rows[name] = [measured(method, *pair) for pair in both]
                write_text(kept, json.dumps(rows))
                print(name, round(float(np.mean(rows[name])), 2), flush=True)
    if options.network:
        model, about = read_network(options.network)
        network: Callable[[np.ndarray], np.ndarray] = Denoiser(model, about["light"])
        rows["network"] = [psnr(network(picture), target) for picture, target in both]
        rows["network, true map"] = [psnr(with_true_map(model, *pair), pair[1]) for pair in both]
    noisy = np.asarray(rows["noisy input"]) < NOISY
    result: dict[str, Any] = {
        "command": "python -m experiments.denoisers.gate DATA --work RUNS --network FILE",
        "machine": machine(), "recipe": options.recipe, "pictures": len(both), "side": SIDE,
        "strengths": "best of each picture in hindsight; blind: those of jaxisp.train.classical",
        "noisy_pictures": int(noisy.sum()),
        "psnr": {name: round(float(np.mean(values)), 3) for name, values in rows.items()},
        "psnr_noisy": {
            name: round(float(np.mean(np.asarray(values)[noisy])), 3) for name, values in rows.items()
        },
        "each": {name: [round(value, 3) for value in values] for name, values in rows.items()},
    }  # fmt: skip
    print(json.dumps({name: result[name] for name in ("noisy_pictures", "psnr", "psnr_noisy")}, indent=1))
    if options.network:
        write_text(options.out / "general-gate.json", json.dumps(result, indent=1) + "\n")


if __name__ == "__main__":
    main()
