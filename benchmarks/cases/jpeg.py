"""JPEG, coded and decoded: Pillow and OpenCV through their files in memory, kornia's differentiable one."""

import io
from collections.abc import Callable, Iterator
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from PIL import Image

from benchmarks.case import Case, Peer
from benchmarks.torch_peer import left, tensor
from jaxisp.pipeline import run_batch, stage
from jaxisp.samples import scene
from jaxisp.stages.jpeg import Jpeg

QUALITY = 75
GOALS = {"batch": {"Pillow": 1.5, "kornia": 3.0}, "1 MP": {"Pillow": 0.5, "kornia": 8.0}}
# colour both ways, chroma sampling, four one-dimensional transforms and the quantiser of 1.5 samples
FLOPS_PER_PIXEL = 30 + 10 + 1.5 * (4 * 40 / 8 + 6)


def cases() -> Iterator[Case]:
    for size, pictures in (("batch", patches()), ("1 MP", photograph(1000, 1000)[None])):
        yield case(size, pictures)


def patches() -> np.ndarray:
    """(32, 80, 80, 3) of 8 bits."""
    whole = photograph(1000, 1000)
    return np.stack([whole[y : y + 80, x : x + 80] for y in range(0, 320, 80) for x in range(0, 640, 80)])


def photograph(rows: int, columns: int) -> np.ndarray:
    """(H, W, 3) of 8 bits, a photograph's piece repeated; the tile is no multiple of a block."""
    tile = np.round(255 * np.clip(scene("astronaut", (397, 499)), 0, 1) ** (1 / 2.2)).astype(np.uint8)
    return np.tile(tile, (-(-rows // 397), -(-columns // 499), 1))[:rows, :columns]


def case(size: str, pictures: np.ndarray) -> Case:
    """A quality for each picture, as a recipe draws it."""
    node, images = stage("jpeg"), jnp.asarray(pictures / 255, jnp.float32)
    params = {"jpeg": Jpeg(quality=jnp.full(len(pictures), QUALITY, jnp.float32))}
    weights = jax.random.normal(jax.random.key(0), images.shape)
    gradient = jax.jit(jax.grad(lambda p, x: jnp.sum(run_batch(node, p, x) * weights), argnums=(0, 1)))
    calls = {"Pillow": pillow, "OpenCV": opencv, "kornia": kornia}
    ready = {name: call for name, make in calls.items() if (call := make(pictures)) is not None}
    peers = (Peer(name, call, GOALS[size].get(name), agreement) for name, call in ready.items())
    return Case(
        "JPEG 4:2:0",
        size,
        lambda: run_batch(node, params, images),
        tuple(peers),
        lambda: gradient(params, images),
        bytes_moved=2 * images.nbytes,
        flops=FLOPS_PER_PIXEL * images.size / 3,
    )


def agreement(ours: Any, theirs: Any) -> str:
    off = np.abs(255 * np.asarray(ours, np.float64) - theirs)
    if off.max() < 1e-3:
        return "identical"
    return f"PSNR {20 * np.log10(255 / np.sqrt(np.mean(off**2))):.1f} dB, {np.mean(off > 0.5):.1%} differ"


def pillow(pictures: np.ndarray) -> Callable[[], np.ndarray]:
    def one(picture: np.ndarray) -> np.ndarray:
        with io.BytesIO() as file:
            Image.fromarray(picture).save(file, "JPEG", quality=QUALITY)
            return np.asarray(Image.open(file).convert("RGB"))

    return lambda: np.stack([one(p) for p in pictures])


def opencv(pictures: np.ndarray) -> Callable[[], np.ndarray] | None:
    """With the pictures blue first, as OpenCV holds them; turning them is not timed."""
    try:
        import cv2
    except ImportError:
        return None
    turned = np.ascontiguousarray(pictures[..., ::-1])
    quality = [cv2.IMWRITE_JPEG_QUALITY, QUALITY]

    def run() -> np.ndarray:
        coded = (cv2.imencode(".jpg", p, quality)[1] for p in turned)
        return np.stack([np.asarray(cv2.imdecode(c, cv2.IMREAD_COLOR)) for c in coded])[..., ::-1]

    return run


def kornia(pictures: np.ndarray) -> Callable[[], Any] | None:
    try:
        import torch
        from kornia.enhance import jpeg_codec_differentiable
    except ImportError:
        return None
    images = tensor(np.moveaxis(pictures / np.float32(255), -1, 1))
    quality = tensor(np.full(len(images), QUALITY, np.float32))

    def run() -> Any:
        with torch.no_grad():
            return left(255 * jpeg_codec_differentiable(images, quality).permute(0, 2, 3, 1))

    return run
