"""A trained run as a denoiser of pictures and files."""

import time
from collections.abc import Callable, Container, Mapping, Sequence
from pathlib import Path
from typing import Any

import jax.numpy as jnp
import numpy as np
from flax import nnx

from jaxisp.errors import InputError
from jaxisp.io.files import check_output, find_images, output_folder, real_paths
from jaxisp.io.images import read_image, write_png
from jaxisp.models.inference import denoise
from jaxisp.stages.transfer import srgb_eotf, srgb_oetf
from jaxisp.train.checkpoints import FOLDERS, Checkpoints
from jaxisp.train.config import TrainConfig
from jaxisp.train.folder import load_settings
from jaxisp.train.optimizer import make_optimizer
from jaxisp.train.step import init_state, split_model, weights
from jaxisp.train.trainer import build_model


class Denoiser:
    """A network with the encoding that it works in.

    Args:
        model: the network.
        light: "encoded" or "linear": what it sees.
    """

    def __init__(self, model: nnx.Module, light: str = "encoded") -> None:
        self.model, self.light = model, light

    def __call__(self, image: np.ndarray, *, tile: int | None = None) -> np.ndarray:
        """Denoise (H, W, 3) encoded sRGB in [0, 1] of any size; the result is cut to [0, 1]."""
        if self.light == "encoded":
            return np.clip(denoise(self.model, image, tile=tile), 0, 1)
        linear = np.asarray(srgb_eotf(jnp.asarray(image, jnp.float32)))
        return np.asarray(srgb_oetf(jnp.clip(denoise(self.model, linear, tile=tile), 0, 1)))


def load_denoiser(run: str | Path, checkpoint: str = "best") -> tuple[Denoiser, TrainConfig]:
    """The network of a run, with its averaged weights, and what the run was told.

    Args:
        run: a folder that `train` wrote.
        checkpoint: "best", by its validation, or "last".

    Raises:
        InputError: no run, or no checkpoint.
    """
    if checkpoint not in FOLDERS:
        raise InputError(f"checkpoint {checkpoint!r}: expected one of {', '.join(FOLDERS)}")
    config, _ = load_settings(run)
    model = build_model(config)
    like = init_state(model, make_optimizer(config, 1), ema=config.ema)
    checkpoints = Checkpoints(Path(run), reading=True)
    found = checkpoint if checkpoints.steps(checkpoint) else "last"  # stopped before its first validation
    state = checkpoints.restore(like, found)
    checkpoints.close()
    graph, _, _ = split_model(model, train=False)
    return Denoiser(nnx.merge(graph, *weights(state)), config.light), config


def denoise_files(
    denoiser: Denoiser,
    inputs: Sequence[str | Path],
    out: str | Path,
    *,
    tile: int | None = None,
    tick: Callable[[int, int, str], Any] = lambda done, total, text: None,
) -> dict[str, Any]:
    """Write OUT/STEM.png for each picture.

    Returns:
        {"images", "seconds", "failed"}: failed has (file, reason) of what could not be used.

    Raises:
        InputError: no input, the folder cannot be written, or the tile is too small for the network.
    """
    paths, out = find_images(inputs), output_folder(out)
    given = real_paths(paths)
    clock, failed = time.perf_counter(), []
    done: dict[str, Path] = {}
    for path in paths:
        try:
            picture = _read(path, out, done, given)
        except InputError as error:
            failed.append((str(path), str(error)))
            continue
        denoised = denoiser(picture, tile=tile)  # a tile that is too small is so for all: not caught
        if np.isnan(denoised).any():
            failed.append((str(path), f"{path}: the network makes NaN of it"))
            continue
        write_png(out / f"{path.stem}.png", denoised)
        done[path.stem] = path
        tick(len(done), len(paths), path.name)
    return {"images": len(done), "seconds": round(time.perf_counter() - clock, 3), "failed": failed}


def _read(path: Path, out: Path, done: Mapping[str, Path], given: Container[str]) -> np.ndarray:
    """A picture; InputError where its result would replace an input, or that of one done before."""
    if path.stem in done:
        raise InputError(f"{path}: {done[path.stem]} has the same name, which outputs would share")
    try:
        check_output(out / f"{path.stem}.png", given)
    except InputError as error:
        raise InputError(f"{path}: has no place for its result: {error}") from error
    return read_image(path)
