"""Demosaicking: colour-demosaicing, OpenCV, kornia, and LibRaw on twelve megapixels."""

import tempfile
from collections.abc import Callable, Iterator
from functools import cache
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from benchmarks.case import Case, Peer
from benchmarks.torch_peer import left, tensor
from jaxisp.cfa import masks, select
from jaxisp.io.dng import write_dng
from jaxisp.pipeline import run_batch, run_in_strips, stage
from jaxisp.samples import scene

KEY = jax.random.key(0)
MATRIX = np.eye(3)
# operations a pixel, counted from the formulas
STAGES: dict[str, tuple[str, dict[str, Any], float]] = {
    "bilinear": ("demosaic_bilinear", {}, 12),
    "Malvar": ("demosaic_malvar", {}, 35),
    "Hibbard": ("demosaic_hibbard", {}, 25),
    "Menon": ("demosaic_menon", {}, 90),
    "AHD": ("demosaic_ahd", {}, 400),
    "AHD, LibRaw's variant": ("demosaic_ahd", {"delta": 1, "variant": "libraw"}, 250),
    "AHD, 3 medians": ("demosaic_ahd", {"median_passes": 3}, 800),
}


def cases() -> Iterator[Case]:
    for name in STAGES:
        for size, mosaics in (("batch", batch()), ("1 MP", frame(1000, 1000)[None])):
            yield case(name, size, mosaics)
    yield large("AHD", passes=0, goal=1 / 0.8)
    yield large("AHD, 3 medians", passes=3, goal=1 / 0.12)


@cache
def frame(rows: int, columns: int) -> np.ndarray:
    """(H, W) mosaic of a photograph, repeated."""
    tile = np.clip(scene("astronaut", (400, 500)), 0, 1)
    mosaic = np.asarray(
        select(masks((400, 500), "RGGB"), *(jnp.asarray(p) for p in np.moveaxis(tile, -1, 0)))
    )
    tiled = np.tile(mosaic.astype(np.float32), (-(-rows // 400), -(-columns // 500)))[:rows, :columns]
    return np.round(tiled * 65535).astype(np.float32) / 65535  # what a 16-bit peer gets


def batch() -> np.ndarray:
    """(32, 80, 80) mosaics."""
    whole = frame(320, 640)
    return np.stack([whole[y : y + 80, x : x + 80] for y in range(0, 320, 80) for x in range(0, 640, 80)])


def case(name: str, size: str, mosaics: np.ndarray) -> Case:
    fn, static, flops = STAGES[name]
    node, x = stage(fn, **static), jnp.asarray(mosaics)
    weights = jax.random.normal(KEY, (*mosaics.shape, 3))
    gradient = jax.jit(jax.grad(lambda m: jnp.sum(run_batch(node, {}, m, KEY) * weights)))
    return Case(
        name,
        size,
        lambda: run_batch(node, {}, x, KEY),
        tuple(peers(name, mosaics, one=size != "batch")),
        lambda: gradient(x),
        bytes_moved=4 * mosaics.nbytes,
        flops=flops * mosaics.size,
    )


def peers(name: str, mosaics: np.ndarray, one: bool) -> Iterator[Peer]:
    if name == "bilinear":
        yield from opencv("16 bits", "", np.uint16, mosaics, 1 / 1.3, inside(1))
        yield from colour_demosaicing("bilinear", mosaics, 24 if one else 14, inside(1))
        yield from kornia(mosaics)
    if name == "Malvar":
        yield from colour_demosaicing("Malvar2004", mosaics, 33 if one else 40, inside(2))
    if name == "Menon":
        yield from colour_demosaicing("Menon2007", mosaics, 20, inside(8))
    if name == "Hibbard":
        yield from opencv("edge-aware", "_EA", np.uint16, mosaics, 1.25 if one else 1.3, inside(4))
    if name.startswith("AHD"):
        yield from opencv("VNG, 8 bits", "_VNG", np.uint8, mosaics, None, inside(8))
        yield from colour_demosaicing("Menon2007", mosaics, None, inside(8))


def opencv(
    what: str, suffix: str, dtype: type, mosaics: np.ndarray, goal: float | None, agrees: Callable[..., str]
) -> Iterator[Peer]:
    try:
        import cv2
    except ImportError:
        return
    full = np.iinfo(dtype).max
    whole = np.round(mosaics * full).astype(dtype)
    code = getattr(cv2, f"COLOR_BayerRGGB2RGB{suffix}")

    def call() -> list[np.ndarray]:
        return [cv2.cvtColor(m, code) for m in whole]

    yield Peer(f"OpenCV, {what}", call, goal, lambda ours, theirs: agrees(ours, np.stack(theirs) / full))


def colour_demosaicing(
    name: str, mosaics: np.ndarray, goal: float | None, agrees: Callable[..., str]
) -> Iterator[Peer]:
    try:
        import colour_demosaicing as library
    except ImportError:
        return
    fn = getattr(library, f"demosaicing_CFA_Bayer_{name}")
    yield Peer(
        f"colour-demosaicing, {name}", lambda: np.stack([fn(m, "RGGB") for m in mosaics]), goal, agrees
    )


def kornia(mosaics: np.ndarray) -> Iterator[Peer]:
    try:
        import torch
        from kornia.color import CFA, raw_to_rgb
    except ImportError:
        return
    x = tensor(mosaics[:, None])

    def call() -> Any:
        with torch.no_grad():
            return left(raw_to_rgb(x, CFA.BG).permute(0, 2, 3, 1))

    yield Peer("kornia, raw_to_rgb", call, None, inside(2))


def inside(border: int) -> Callable[[Any, Any], str]:
    """How far two pictures are apart, that many pixels from their borders."""

    def agrees(ours: Any, theirs: Any) -> str:
        ours, theirs = (np.asarray(x, np.float64).reshape(-1, *np.shape(x)[-3:]) for x in (ours, theirs))
        difference = (ours - theirs)[:, border:-border, border:-border]
        psnr = -10 * np.log10(max(float(np.mean(difference**2)), 1e-20))
        return f"max {np.abs(difference).max():.1e}, PSNR {psnr:.1f} dB inside"

    return agrees


def large(name: str, passes: int, goal: float) -> Case:
    """Twelve megapixels in strips, beside LibRaw's whole reading of a file of them."""
    mosaic = frame(3000, 4000)
    node, x = stage("demosaic_ahd", median_passes=passes), jnp.asarray(mosaic)
    return Case(
        name,
        "12 MP",
        lambda: run_in_strips(node, {}, x),
        tuple(libraw(mosaic, passes, goal)),
        bytes_moved=4 * mosaic.nbytes,
        flops=STAGES[name][2] * mosaic.size,
        notes="in strips; LibRaw's time includes reading the file, scaling and writing 16 bits"
        + (", and its medians are another algorithm" if passes else ""),
    )


def libraw(mosaic: np.ndarray, passes: int, goal: float) -> Iterator[Peer]:
    import rawpy

    folder = tempfile.TemporaryDirectory()  # goes when the call that holds it goes
    pixels = np.round(mosaic * 65535).astype(np.uint16)
    path = write_dng(
        Path(folder.name) / "frame.dng", pixels, cfa="RGGB", black=[0], white=65535, color_matrix=MATRIX
    )

    def call(folder: Any = folder) -> np.ndarray:
        with rawpy.imread(str(path)) as raw:
            return raw.postprocess(
                demosaic_algorithm=rawpy.DemosaicAlgorithm.AHD,
                median_filter_passes=passes,
                gamma=(1, 1),
                no_auto_bright=True,
                adjust_maximum_thr=0.0,
                output_color=rawpy.ColorSpace.raw,
                output_bps=16,
                user_wb=[1, 1, 1, 1],
                user_flip=0,
            )

    def agrees(ours: Any, theirs: Any) -> str:
        return inside(8)(ours, np.asarray(theirs, np.float32) / 65535)

    yield Peer(f"LibRaw AHD, {passes} median passes" if passes else "LibRaw AHD", call, goal, agrees)
