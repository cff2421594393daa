"""A network for all cameras: its clean pictures, its training, its file.

python -m experiments.denoisers.general clean DATA --work RUNS --photos FOLDER ...
python -m experiments.denoisers.general train --work RUNS
python -m experiments.denoisers.general export --work RUNS --out FILE

Each goes on where it was stopped. `train --start FILE` begins with the weights of a file, of another run: so
the network that comes with the package, `jaxisp/models/general.npz`, is trained further.
"""

import argparse
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from experiments.denoisers.training import TEST_PICTURES
from jaxisp.cli.devices import use_cores
from jaxisp.data import downsample_linear
from jaxisp.data.clean import SOFTNESS
from jaxisp.data.procedural import drawn
from jaxisp.errors import InputError
from jaxisp.io import read_image, write_png
from jaxisp.io.files import find_images
from jaxisp.mixture import Mixture
from jaxisp.models import save_network
from jaxisp.models.files import read_arrays
from jaxisp.pipeline import Chain, stage
from jaxisp.priors import Uniform
from jaxisp.process.cache import keep_compiled
from jaxisp.recipe import Recipe
from jaxisp.recipes import any_camera, mix
from jaxisp.stages.noise import GaussianNoise
from jaxisp.train import TrainConfig, load_denoiser, train
from jaxisp.train.checkpoints import Checkpoints
from jaxisp.train.folder import load_settings, settings_digest

FREE = ("photos", "kodak")
"""Folders of DATA/clean whose licences allow all uses; that of cbsd68 does not."""
FACTORS, LARGE = (2, 3), 1400
"""By which small photographs and those of at least so many px are made smaller: their own noise and
compression are to be below a step of 8 bits."""
SOFT = {"": SOFTNESS, "sharp_": 0.0}
"""Standard deviation of the blur after that [px], by what the files' names begin with: as soft as a lens and
a sensor make pictures, and as sharp as pictures that somebody made smaller. Without the second a network
takes the finest detail of such pictures for noise."""
SIDE = 256
"""Of the tiles that photographs are cut into [px]: small, so that most patches are of photographs."""
DRAWN = {"leaves": 100, "text": 18, "stripes": 14, "gradients": 24}
"""Pictures of 512 px."""

TRAINING: dict[str, Any] = {
    "model": "levelnet", "model_options": {"features": (64, 64, 96)}, "target": "camera", "patch": 64,
    "batch": 16, "downsample": 1, "per_image": 50, "held_out": 24, "validation": 128, "checkpoint_every": 500,
    "pool": 45_056, "steps": 10_000, "lr": 1e-3, "ema": 0.999, "loss": "log_rms",
    "warmup": 300, "log_every": 100,
}  # fmt: skip


def recipe() -> Mixture:
    """All cameras, and white noise of encoded values: that of `awgn` is of linear light."""
    white = Recipe(
        Chain((stage("gaussian_noise"), stage("clip"), stage("rounding")), "white-noise"),
        {"gaussian_noise": GaussianNoise(std=Uniform(0.0, 0.2))},
    )
    return mix({any_camera(): 0.8, white: 0.2})


def clean(data: Path, photos: list[Path], out: Path) -> None:
    """Write the clean pictures, in tiles."""
    out.mkdir(parents=True, exist_ok=True)
    if (out / "done").exists():
        return
    pixels = 0
    for name, picture in _pictures(data, photos):
        for i, tile in enumerate(_tiles(picture)):
            write_png(out / f"{name}_{i:03d}.png", tile)
            pixels += tile.shape[0] * tile.shape[1]
    print(f"photographs: {pixels / 1e6:.1f} Mpx")
    for kind, count in DRAWN.items():
        for seed in range(count):
            write_png(out / f"{kind}_{seed:03d}.png", drawn(kind, seed))
        print(f"{kind}: {count * 512**2 / 1e6:.1f} Mpx", flush=True)
    (out / "done").touch()


def _pictures(data: Path, photos: list[Path]) -> Iterator[tuple[str, np.ndarray]]:
    """Photographs, made smaller."""
    for path in find_images([data / "clean" / name for name in FREE] + photos, recursive=True):
        if path.stem in TEST_PICTURES:
            continue
        try:
            picture = read_image(path)
        except InputError as error:
            print(error)
            continue
        factor = FACTORS[min(picture.shape[:2]) >= LARGE]
        for begins, softness in SOFT.items():
            small = downsample_linear(picture, factor, softness)
            print(f"{begins}{path.name}: 1/{factor}, {small.shape[1]}x{small.shape[0]}", flush=True)
            yield begins + path.stem, small


def _tiles(picture: np.ndarray) -> Iterator[np.ndarray]:
    counts = [max(1, n // SIDE) for n in picture.shape[:2]]
    edges = [np.linspace(0, n, count + 1).astype(int) for n, count in zip(picture.shape, counts)]
    for top, bottom in zip(edges[0], edges[0][1:]):
        for left, right in zip(edges[1], edges[1][1:]):
            yield picture[top:bottom, left:right]


def configuration(work: Path, **changes: Any) -> TrainConfig:
    return TrainConfig(clean=(str(work / "clean"),), recipe=recipe().name, **{**TRAINING, **changes})


def export(run: Path, path: Path) -> None:
    """The averaged weights of a run's last checkpoint, and how many patches they have seen."""
    denoiser, config = load_denoiser(run, "last")
    before = read_arrays(config.start)[1].get("patches", 0) if config.start else 0
    kept = Checkpoints(run, settings_digest(*load_settings(run)), reading=True)
    steps = max(kept.steps())  # a run may be exported before its end
    kept.close()
    save_network(
        path, denoiser.model, config.model, config.model_options, light=config.light, recipe=config.recipe,
        patches=before + steps * config.batch,
    )  # fmt: skip


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("what", choices=("clean", "train", "export"))
    parser.add_argument("data", type=Path, nargs="?")
    parser.add_argument("--work", type=Path, required=True, help="clean pictures and runs are kept here")
    parser.add_argument("--photos", type=Path, nargs="*", default=[], help="further folders of photographs")
    parser.add_argument("--run", default="general")
    parser.add_argument("--steps", type=int)
    parser.add_argument("--start", default="", help="weights to begin with")
    parser.add_argument("--seed", type=int, default=0, help="of the pool: another where --start is given")
    parser.add_argument("--out", type=Path, default=Path("general.npz"))
    options = parser.parse_args()
    if options.what == "clean":
        clean(options.data, options.photos, options.work / "clean")
        return
    run = options.work / options.run
    if options.what == "export":
        export(run, options.out)
        return
    use_cores()
    keep_compiled()
    changes = {"steps": options.steps} if options.steps else {}
    config = configuration(options.work, start=options.start, seed=options.seed, **changes)
    result = train(
        config,
        run,
        recipe=recipe(),
        resume=True,
        tick=lambda done, total, text: print(done, total, text, flush=True),
    )
    print(result.as_dict())


if __name__ == "__main__":
    main()
