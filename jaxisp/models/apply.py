"""Networks as denoisers of pictures and files, and the one that comes with the package."""

import contextlib
import time
from collections.abc import Callable, Container, Hashable, Mapping, Sequence
from importlib import resources
from pathlib import Path
from typing import Any

import jax.numpy as jnp
import numpy as np
from flax import nnx

from jaxisp.errors import InputError
from jaxisp.io.files import check_output, find_images, output_folder, real_paths
from jaxisp.io.images import read_as_stored, write_png
from jaxisp.io.locks import locked
from jaxisp.models import read_network
from jaxisp.models.inference import denoise
from jaxisp.process.memory import forget_beyond
from jaxisp.stages.transfer import srgb_eotf, srgb_oetf

SHIPPED = "general.npz"


class Denoiser:
    """A network with the encoding that it works in.

    Args:
        model: the network.
        light: "encoded" or "linear": what it sees.
    """

    def __init__(self, model: nnx.Module, light: str = "encoded") -> None:
        self.model, self.light = model, light

    def __call__(self, image: np.ndarray, *, tile: int | None = None, strength: float = 1.0) -> np.ndarray:
        """Denoise (H, W, 3) encoded sRGB in [0, 1] of any size; the result is cut to [0, 1].

        `tile` and `strength` are those of `jaxisp.models.denoise`.
        """
        options: dict[str, Any] = {"tile": tile, "strength": strength}
        if self.light == "encoded":
            return np.clip(denoise(self.model, image, **options), 0, 1)
        linear = np.asarray(srgb_eotf(jnp.asarray(image, jnp.float32)))
        return np.asarray(srgb_oetf(jnp.clip(denoise(self.model, linear, **options), 0, 1)))


def shipped_denoiser() -> tuple[Denoiser, dict[str, Any]]:
    """The denoiser that comes with the package, and what is kept with its weights.

    Raises:
        InputError: this package comes without one.
    """
    if not (resources.files("jaxisp.models") / SHIPPED).is_file():
        raise InputError("no network comes with this jaxisp: train one with jaxisp train, and give --run RUN")
    with resources.as_file(resources.files("jaxisp.models") / SHIPPED) as path:
        model, about = read_network(path)
    return Denoiser(model, about["light"]), about


def denoise_files(
    denoiser: Denoiser,
    inputs: Sequence[str | Path],
    out: str | Path,
    *,
    tile: int | None = None,
    strength: float = 1.0,
    tick: Callable[[int, int, str], Any] = lambda done, total, text: None,
) -> dict[str, Any]:
    """Write OUT/STEM.png for each picture, or one picture as OUT where that ends in `.png`.

    JPEGs and PNGs are denoised in their own colour space and as they lie; their EXIF and their colour profile
    go with them. Others are written upright in sRGB. After some sizes the programs of all are forgotten,
    those of others in the process too: see `forget_compiled`.

    Args:
        denoiser: of encoded pictures.
        inputs: pictures, and folders of them.
        out: a folder, made where it is missing; or the file of a single picture.
        tile: side of the tiles [px]; the network's unless given.
        strength: see `jaxisp.models.denoise`.
        tick: called with (done, total, text).

    Returns:
        {"images", "seconds", "failed"}: failed has (file, reason) of what could not be used.

    Raises:
        InputError: no input, the folder cannot be written, or another process writes into it; the tile is too
            small for the network; a file is given for more pictures than one.
    """
    paths, out, name = find_images(inputs), Path(out), None
    if out.suffix.lower() == ".png" and not out.is_dir():
        if len(paths) > 1:
            raise InputError(f"{out}: is one file, and there are {len(paths)} pictures; give a folder")
        out, name = out.parent, out.name
    out, given, clock = output_folder(out), real_paths(paths), time.perf_counter()
    done: dict[str, Path] = {}
    failed: list[tuple[str, str]] = []
    sizes: set[Hashable] = set()
    # a single file is written at once: nobody else's can come between
    with contextlib.nullcontext() if name else locked(out):
        for path in paths:
            target = out / (name or f"{path.stem}.png")
            try:
                picture, kept = _read(path, target, done, given)
            except InputError as error:
                failed.append((str(path), str(error)))
                continue
            forget_beyond(sizes, picture.shape)
            # a tile that is too small is so for all: not caught
            denoised = denoiser(picture, tile=tile, strength=strength)
            if np.isnan(denoised).any():
                failed.append((str(path), f"{path}: the network makes NaN of it"))
                continue
            write_png(target, denoised, **kept)
            done[path.stem] = path
            tick(len(done), len(paths), path.name)
    return {"images": len(done), "seconds": round(time.perf_counter() - clock, 3), "failed": failed}


def _read(
    path: Path, target: Path, done: Mapping[str, Path], given: Container[str]
) -> tuple[np.ndarray, dict[str, Any]]:
    """A picture and what is kept of its file; InputError where its result would replace an input, or that of
    one done before."""
    if path.stem in done:
        raise InputError(f"{path}: {done[path.stem]} has the same name, which outputs would share")
    try:
        check_output(target, given)
    except InputError as error:
        raise InputError(f"{path}: has no place for its result: {error}") from error
    return read_as_stored(path)
