"""Separable filters, optics, noise and change of size: OpenCV, SciPy, kornia, NumPy."""

from collections.abc import Callable, Iterator
from functools import cache
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from benchmarks.case import Case, Peer
from benchmarks.torch_peer import left, tensor
from jaxisp.pipeline import run_batch, stage
from jaxisp.samples import scene
from jaxisp.stages.blur import OpticalBlur
from jaxisp.stages.detail import UnsharpMask
from jaxisp.stages.noise import GaussianNoise, PoissonNoise, ShotReadNoise
from jaxisp.stages.optics import GeometricDistortion, LateralChromaticAberration
from jaxisp.stages.resampling import Resampling

KEY = jax.random.key(0)
BLUR_SIGMA, BLUR_RADIUS = 1.5, 6
UNSHARP_SIGMA, UNSHARP_RADIUS, AMOUNT = 1.0, 3, 0.5
RED, BLUE = 1.004, 0.997
K1, K2 = 0.05, -0.01
SHOT, READ, GAIN = 0.001, 0.01, 0.001


def cases() -> Iterator[Case]:
    for size, images in (("batch", batch()), ("1 MP", frame(1000, 1000)[None])):
        yield gaussian(size, images)
        yield unsharp(size, images)
        yield chromatic_aberration(size, images)
        yield distortion(size, images)
        yield resampled(size, images)
        yield from noises(size, np.ascontiguousarray(images[..., 1]))


@cache
def frame(rows: int, columns: int) -> np.ndarray:
    """(H, W, 3) linear light, a photograph repeated."""
    tile = np.clip(scene("astronaut", (400, 500)), 0, 1).astype(np.float32)
    return np.tile(tile, (-(-rows // 400), -(-columns // 500), 1))[:rows, :columns]


def batch() -> np.ndarray:
    """(32, 80, 80, 3) linear light."""
    whole = frame(320, 640)
    return np.stack([whole[y : y + 80, x : x + 80] for y in range(0, 320, 80) for x in range(0, 640, 80)])


def case(
    row: str,
    name: str,
    params: Any,
    size: str,
    images: np.ndarray,
    peers: Iterator[Peer],
    flops: float,
    notes: str = "",
    **static: Any,
) -> Case:
    """A stage with parameters of each image, and its gradient to them and to the images."""
    node, x = stage(name, **static), jnp.asarray(images)
    each = {name: jax.tree.map(lambda v: jnp.full((len(images), *np.shape(v)), v, jnp.float32), params)}
    weights = jax.random.normal(KEY, images.shape)
    gradient = jax.jit(jax.grad(lambda p, v: jnp.sum(run_batch(node, p, v, KEY) * weights), argnums=(0, 1)))
    return Case(
        row,
        size,
        lambda: run_batch(node, each, x, KEY),
        tuple(peers),
        lambda: gradient(each, x),
        bytes_moved=2 * images.nbytes,
        flops=flops * images.size,
        notes=notes,
    )


def gaussian(size: str, images: np.ndarray) -> Case:
    peers = gaussian_peers(images)
    what = f"sigma {BLUR_SIGMA}, radius {BLUR_RADIUS}"
    flops = 4 * (2 * BLUR_RADIUS + 1)
    params = OpticalBlur(sigma=BLUR_SIGMA)
    return case("Gaussian", "optical_blur", params, size, images, peers, flops, what, radius=BLUR_RADIUS)


def gaussian_peers(images: np.ndarray) -> Iterator[Peer]:
    side = 2 * BLUR_RADIUS + 1
    cv2 = opencv()
    if cv2:
        border = cv2.BORDER_REFLECT_101
        blur = lambda: [cv2.GaussianBlur(v, (side, side), BLUR_SIGMA, borderType=border) for v in images]  # noqa: E731
        yield Peer("OpenCV", blur, 0.7, equal)
    import scipy.ndimage as ndi

    sigma, radius = (0, BLUR_SIGMA, BLUR_SIGMA, 0), (0, BLUR_RADIUS, BLUR_RADIUS, 0)
    call = lambda: ndi.gaussian_filter(images, sigma, mode="mirror", radius=radius)  # noqa: E731
    yield Peer("SciPy", call, None, equal)
    yield from kornia_peer(
        images, lambda k, x: k.gaussian_blur2d(x, (side, side), (BLUR_SIGMA, BLUR_SIGMA)), goal=5.0
    )


def unsharp(size: str, images: np.ndarray) -> Case:
    what = f"sigma {UNSHARP_SIGMA}, radius {UNSHARP_RADIUS}, no threshold"
    flops = 4 * (2 * UNSHARP_RADIUS + 1) + 4
    params = UnsharpMask(amount=AMOUNT, sigma=UNSHARP_SIGMA)
    peers = unsharp_peers(images)
    return case(
        "unsharp mask", "unsharp_mask", params, size, images, peers, flops, what, radius=UNSHARP_RADIUS
    )


def unsharp_peers(images: np.ndarray) -> Iterator[Peer]:
    side = 2 * UNSHARP_RADIUS + 1
    cv2 = opencv()
    if cv2:

        def sharpen() -> list[np.ndarray]:
            border = cv2.BORDER_REFLECT_101
            blurs = (cv2.GaussianBlur(v, (side, side), UNSHARP_SIGMA, borderType=border) for v in images)
            return [cv2.addWeighted(v, 1 + AMOUNT, b, -AMOUNT, 0) for v, b in zip(images, blurs)]

        yield Peer("OpenCV", sharpen, 0.7, equal)

    def with_kornia(filters: Any, x: Any) -> Any:
        blurred = filters.gaussian_blur2d(x, (side, side), (UNSHARP_SIGMA, UNSHARP_SIGMA))
        return x + AMOUNT * (x - blurred)

    yield from kornia_peer(images, with_kornia, goal=5.0)


def chromatic_aberration(size: str, images: np.ndarray) -> Case:
    params = LateralChromaticAberration(red_scale=RED, blue_scale=BLUE)
    peers = remap_peers(images, [1 / RED, None, 1 / BLUE], 1.0 if size == "batch" else 0.8)
    return case("chromatic aberration", "lateral_chromatic_aberration", params, size, images, peers, 12)


def distortion(size: str, images: np.ndarray) -> Case:
    y, x = centred(images.shape[1:3])
    r2 = (y * y + x * x) / (y[0, 0] ** 2 + x[0, 0] ** 2)
    factor = 1 + K1 * r2 + K2 * r2 * r2
    peers = remap_peers(images, [factor], None)
    params = GeometricDistortion(k1=K1, k2=K2)
    return case("geometric distortion", "geometric_distortion", params, size, images, peers, 12)


def centred(shape: tuple[int, ...]) -> tuple[np.ndarray, np.ndarray]:
    y, x = np.mgrid[: shape[0], : shape[1]]
    return y - (shape[0] - 1) / 2, x - (shape[1] - 1) / 2


def remap_peers(images: np.ndarray, factors: list[Any], goal: float | None) -> Iterator[Peer]:
    """Bilinear samples at a factor times the place from the centre: one factor, or one a channel."""
    y, x = centred(images.shape[1:3])
    centre = [(n - 1) / 2 for n in images.shape[1:3]]
    places = [f if f is None else (f * y + centre[0], f * x + centre[1]) for f in factors]
    cv2 = opencv()
    if cv2:
        maps = [p if p is None else (p[1].astype(np.float32), p[0].astype(np.float32)) for p in places]
        how = {"interpolation": cv2.INTER_LINEAR, "borderMode": cv2.BORDER_REPLICATE}

        def one(image: np.ndarray) -> np.ndarray:
            if len(maps) == 1:
                return cv2.remap(image, *maps[0], **how)
            planes = zip(cv2.split(image), maps)
            return cv2.merge([v if m is None else cv2.remap(v, *m, **how) for v, m in planes])

        yield Peer("OpenCV, remap", lambda: [one(v) for v in images], goal, equal)
    import scipy.ndimage as ndi

    def sampled(image: np.ndarray) -> np.ndarray:
        each = [
            image[..., c] if p is None else ndi.map_coordinates(image[..., c], p, order=1, mode="nearest")
            for c, p in enumerate(places * (3 // len(places)))
        ]
        return np.stack(each, -1)

    yield Peer("SciPy, map_coordinates", lambda: np.stack([sampled(v) for v in images]), None, equal)


def resampled(size: str, images: np.ndarray) -> Case:
    return case("resampling", "resampling", Resampling(factor=2.0), size, images, resample_peers(images), 12)


def resample_peers(images: np.ndarray) -> Iterator[Peer]:
    """Pillow's antialiased bilinear, halved and back, a channel at a time: it has no RGB floats."""
    from PIL import Image

    height, width = images.shape[1:3]
    linear = Image.Resampling.BILINEAR

    def there_and_back(plane: np.ndarray) -> np.ndarray:
        small = Image.fromarray(plane).resize((width // 2, height // 2), linear)
        return np.asarray(small.resize((width, height), linear))

    def call() -> np.ndarray:
        return np.stack([np.stack([there_and_back(v[..., c]) for c in range(3)], -1) for v in images])

    yield Peer("Pillow", call, None, equal)


def noises(size: str, mosaics: np.ndarray) -> Iterator[Case]:
    rng = np.random.default_rng(0)

    def normal() -> np.ndarray:
        return rng.standard_normal(mosaics.shape, np.float32)

    def gaussian_noise() -> np.ndarray:
        return mosaics + np.float32(READ) * normal()

    def shot_read() -> np.ndarray:
        return mosaics + np.sqrt(np.float32(SHOT) * mosaics + np.float32(READ**2)) * normal()

    def poisson() -> np.ndarray:
        return np.float32(GAIN) * rng.poisson(mosaics / GAIN) + np.float32(READ) * normal()

    rows: list[tuple[str, str, Any, Callable[[], np.ndarray], float | None]] = [
        ("Gaussian noise, mosaic", "gaussian_noise", GaussianNoise(std=READ), gaussian_noise, 1.4),
        (
            "shot and read noise, mosaic",
            "shot_read_noise",
            ShotReadNoise(shot=SHOT, read=READ),
            shot_read,
            None,
        ),
        ("Poisson noise, mosaic", "poisson_noise", PoissonNoise(gain=GAIN, read=READ), poisson, None),
    ]
    for row, name, params, call, goal in rows:
        peer = Peer("NumPy", call, goal, lambda ours, theirs: strength(ours - mosaics, theirs - mosaics))
        yield case(row, name, params, size, mosaics, iter([peer]), 60)


def opencv() -> Any:
    try:
        import cv2
    except ImportError:
        return None
    return cv2


def kornia_peer(images: np.ndarray, call: Callable[[Any, Any], Any], goal: float) -> Iterator[Peer]:
    try:
        import torch
        from kornia import filters
    except ImportError:
        return
    x = tensor(np.moveaxis(images, -1, 1))

    def run() -> Any:
        with torch.inference_mode():
            return left(call(filters, x).permute(0, 2, 3, 1))

    yield Peer("kornia", run, goal, equal)


def equal(ours: Any, theirs: Any) -> str:
    """The largest difference."""
    return f"max difference {np.abs(np.asarray(ours, np.float64) - np.asarray(theirs)).max():.1e}"


def strength(ours: Any, theirs: Any) -> str:
    return f"standard deviations {np.std(ours):.5f} and {np.std(theirs):.5f}"
