"""Whole pipelines: a chain of nine stages beside other libraries' calls, recipes, and developing."""

import tempfile
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from functools import cache
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from benchmarks.case import Case, Peer
from benchmarks.torch_peer import left, tensor
from jaxisp.camera import develop, standard_camera
from jaxisp.io import read_raw
from jaxisp.io.dng import write_dng
from jaxisp.metrics import psnr
from jaxisp.pipeline import Chain, run, run_batch, run_in_strips, stage
from jaxisp.recipe import Recipe
from jaxisp.recipes import RECIPES
from jaxisp.samples import PHONES, scene
from jaxisp.stages.balance import Saturation
from jaxisp.stages.denoise.bilateral import Bilateral
from jaxisp.stages.detail import UnsharpMask
from jaxisp.stages.jpeg import Jpeg
from jaxisp.stages.noise import GaussianNoise

NOISE, SIGMA_SPACE, SIGMA_RANGE, GAMMA, SATURATION, QUALITY = 0.02, 1.5, 0.1, 2.2, 1.2, 75
AMOUNT, BLUR, BLUR_RADIUS = 0.5, 1.0, 3
NODES = (
    stage("mosaic"),
    stage("gaussian_noise"),
    stage("clip"),
    stage("demosaic_hibbard"),
    stage("bilateral", radius=2, chroma_radius=2),
    stage("median", footprint="3x3"),
    stage("srgb_oetf"),
    stage("saturation"),
    stage("unsharp_mask", radius=BLUR_RADIUS),
    stage("jpeg"),
)
PARAMS = {
    "gaussian_noise": GaussianNoise(std=NOISE),
    "bilateral": Bilateral(
        luma_sigma_space=SIGMA_SPACE, luma_sigma_range=SIGMA_RANGE, chroma_sigma_space=SIGMA_SPACE
    ),
    "saturation": Saturation(amount=SATURATION),
    "unsharp_mask": UnsharpMask(amount=AMOUNT, sigma=BLUR),
    "jpeg": Jpeg(quality=QUALITY),
}
LUMA = np.float32([0.299, 0.587, 0.114])
PAPERS_CODE = "the paper's own code: 46 images/s on two cores (a stated figure)"
KEY = jax.random.key(0)


def cases() -> Iterator[Case]:
    yield from chains()
    yield from recipes()
    yield developing()
    yield large_chain()


@cache
def linear(rows: int, columns: int) -> np.ndarray:
    """(H, W, 3) linear light, a photograph repeated."""
    tile = np.clip(scene("astronaut", (400, 500)), 0, 1).astype(np.float32)
    return np.tile(tile, (-(-rows // 400), -(-columns // 500), 1))[:rows, :columns]


def batch() -> np.ndarray:
    """(32, 80, 80, 3) linear light."""
    grid = linear(320, 640)
    return np.stack([grid[y : y + 80, x : x + 80] for y in range(0, 320, 80) for x in range(0, 640, 80)])


def chains() -> Iterator[Case]:
    chain = Chain(NODES, "chain")
    for size, images in (("batch", batch()), ("1 MP", linear(1000, 1000)[None])):
        yield chain_case(chain, size, images)


def chain_case(chain: Chain, size: str, images: np.ndarray) -> Case:
    def each(value: Any) -> jax.Array:
        """A value for each image, as in training."""
        return jnp.full((len(images), *np.shape(value)), value, jnp.float32)

    params, on_device = jax.tree.map(each, chain.init() | PARAMS), jnp.asarray(images)
    return Case(
        "chain of nine stages",
        size,
        lambda: run_batch(chain, params, on_device, KEY),
        tuple(chain_peers(images)),
        gradient_of(chain, params, on_device),
        bytes_moved=2 * images.nbytes,
        notes="mosaic, noise, Hibbard, bilateral r2, median 3x3, gamma, saturation, unsharp mask, JPEG; "
        "peers: their nearest calls, so that outputs differ by algorithm and by noise",
        gradient_goal=5.0,
    )


def gradient_of(chain: Chain, params: Any, images: jax.Array) -> Callable[[], Any]:
    """The gradient to all parameters and to the images."""
    weights = jax.random.normal(jax.random.key(1), images.shape)
    fn = jax.jit(jax.grad(lambda p, x: jnp.sum(run_batch(chain, p, x, KEY) * weights), argnums=(0, 1)))
    return lambda: fn(params, images)


def chain_peers(images: np.ndarray) -> Iterator[Peer]:
    serial = len(images) == 1
    yield Peer("OpenCV, serial", lambda: opencv_batch(images), 1 / 0.65, agreement, threads=1)
    two = (lambda: opencv_batch(images)) if serial else (lambda: opencv_batch(images, workers=2))
    how = "its own threads" if serial else "two images at a time"
    yield Peer(f"OpenCV, {how}", two, 1.0, agreement, threads=2 if serial else 1)
    try:
        import kornia  # noqa: F401
    except ImportError:
        return
    yield Peer("kornia", kornia_chain(images), 20.0, agreement)


def agreement(ours: Any, theirs: Any) -> str:
    """By the local means: noise and algorithms are each library's own."""

    def smooth(x: Any) -> jax.Array:
        x = jnp.asarray(x).reshape(-1, *np.shape(x)[-3:])
        x = x[:, : x.shape[1] // 8 * 8, : x.shape[2] // 8 * 8]
        means = x.reshape(len(x), x.shape[1] // 8, 8, x.shape[2] // 8, 8, 3).mean((2, 4))
        return means.reshape(-1, means.shape[2], 3)

    return f"PSNR {float(psnr(smooth(ours), smooth(theirs))):.1f} dB of 8x8 means"


def opencv_batch(images: np.ndarray, workers: int = 1) -> np.ndarray:
    if workers == 1:
        return np.stack([opencv_chain(x) for x in images])
    with ThreadPoolExecutor(workers) as pool:
        return np.stack(list(pool.map(opencv_chain, images)))


def opencv_chain(image: np.ndarray) -> np.ndarray:
    """The chain by OpenCV's calls, on one image."""
    import cv2

    mosaic = np.empty(image.shape[:2], np.float32)
    for y, x, c in ((0, 0, 0), (0, 1, 1), (1, 0, 1), (1, 1, 2)):
        mosaic[y::2, x::2] = image[y::2, x::2, c]
    sharp = opencv_photograph(cv2.add(mosaic, cv2.randn(np.empty_like(mosaic), 0, NOISE)))
    levels = np.clip(sharp * 255 + 0.5, 0, 255).astype(np.uint8)
    _, file = cv2.imencode(".jpg", levels[..., ::-1], (cv2.IMWRITE_JPEG_QUALITY, QUALITY))
    return cv2.imdecode(file, cv2.IMREAD_COLOR)[..., ::-1].astype(np.float32) / 255


def opencv_photograph(mosaic: np.ndarray) -> np.ndarray:
    """From the mosaic to what goes to the encoder. Its demosaicking takes integers."""
    import cv2

    counts = np.clip(mosaic * 65535, 0, 65535).astype(np.uint16)
    rgb = cv2.cvtColor(counts, cv2.COLOR_BayerRGGB2RGB_EA).astype(np.float32) * np.float32(1 / 65535)
    rgb = cv2.bilateralFilter(rgb, 5, SIGMA_RANGE, SIGMA_SPACE)
    rgb = cv2.medianBlur(rgb, 3)
    rgb = cv2.pow(rgb, 1 / GAMMA)
    rgb = cv2.transform(rgb, SATURATION * np.eye(3, dtype=np.float32) + (1 - SATURATION) * LUMA[None])
    blurred = cv2.GaussianBlur(rgb, (2 * BLUR_RADIUS + 1,) * 2, BLUR)
    return cv2.addWeighted(rgb, 1 + AMOUNT, blurred, -AMOUNT, 0)


def kornia_chain(images: np.ndarray) -> Callable[[], Any]:
    """The chain by kornia's calls, on the whole batch; its demosaicking is bilinear, its JPEG inexact."""
    import kornia
    import torch

    x = tensor(images.transpose(0, 3, 1, 2))
    rows, columns = (np.arange(n) % 2 for n in x.shape[2:])
    colour = rows[:, None] + columns  # red, green, green, blue
    masks = tensor(np.float32([colour == c for c in range(3)]))
    mix = tensor(SATURATION * np.eye(3, dtype=np.float32) + np.float32(1 - SATURATION) * LUMA)
    quality = tensor(np.float32([QUALITY]))

    def call() -> Any:
        with torch.inference_mode():
            mosaic = (x * masks).sum(1, keepdim=True)
            noisy = (mosaic + NOISE * torch.randn_like(mosaic)).clamp(0, 1)
            rgb = kornia.color.raw_to_rgb(noisy, kornia.color.CFA.BG)
            rgb = kornia.filters.bilateral_blur(rgb, (5, 5), SIGMA_RANGE, (SIGMA_SPACE, SIGMA_SPACE))
            rgb = kornia.filters.median_blur(rgb, (3, 3))
            rgb = kornia.enhance.adjust_gamma(rgb, 1 / GAMMA)
            rgb = torch.einsum("ij,njhw->nihw", mix, rgb)
            blurred = kornia.filters.gaussian_blur2d(rgb, (2 * BLUR_RADIUS + 1,) * 2, (BLUR, BLUR))
            sharp = (rgb + AMOUNT * (rgb - blurred)).clamp(0, 1)
            coded = kornia.enhance.jpeg_codec_differentiable(sharp, quality)
            return left(coded.permute(0, 2, 3, 1))

    return call


def recipes() -> Iterator[Case]:
    images = jnp.asarray(np.power(batch(), 1 / 2.2))
    for name in ("phone", "phone-ahd", "awgn"):
        recipe = RECIPES[name]()
        yield Case(
            f"recipe {name}",
            "batch",
            lambda r=recipe: r.degrade(KEY, images),
            gradient=recipe_gradient(recipe, images),
            bytes_moved=2 * images.nbytes,
            notes=f"new parameters per image; 32 / time = images/s; {PAPERS_CODE if name == 'phone' else ''}",
            gradient_goal=4.0,
        )


def recipe_gradient(recipe: Recipe, images: jax.Array) -> Callable[[], Any]:
    """The gradient to all drawn parameters."""
    params = recipe.degrade(KEY, images)[2]
    weights = jax.random.normal(jax.random.key(1), images.shape)
    fn = jax.jit(jax.grad(lambda p: jnp.sum(recipe.repeat(KEY, p, images) * weights)))
    return lambda: fn(params)


def developing() -> Case:
    """A 12-megapixel DNG beside LibRaw; reading and unpacking the file is not timed."""
    path = Path(tempfile.mkdtemp()) / "twelve.dng"
    phone = PHONES["a"]
    counts = np.rint(phone.black + 0.9 * mosaicked(linear(3024, 4032)) * (phone.white - phone.black))
    neutral = tuple(1 / phone.gains)
    matrix = np.array(phone.xyz_to_camera)
    write_dng(
        path, counts.astype(np.uint16), cfa="RGGB", black=(phone.black,), white=phone.white,
        color_matrix=matrix, as_shot_neutral=neutral,
    )  # fmt: skip
    raw, camera = read_raw(path), standard_camera()
    return Case(
        "develop, AHD",
        "12 MP",
        lambda: develop(raw, camera),
        tuple(libraw(path)),
        bytes_moved=raw.mosaic.nbytes * 4,
        notes="white balance, AHD, exposure, colour matrix, sRGB, in float32; rawpy's to 8 bits",
    )


def mosaicked(image: np.ndarray) -> np.ndarray:
    return np.asarray(run(stage("mosaic"), {}, image))


def libraw(path: Path) -> Iterator[Peer]:
    import rawpy

    def postprocess() -> np.ndarray:
        # LibRaw can process an unpacked file again
        return file.postprocess(demosaic_algorithm=rawpy.DemosaicAlgorithm.AHD, use_camera_wb=True)

    file = rawpy.imread(str(path))
    yield Peer("rawpy postprocess, AHD", postprocess, 1.0)


def large_chain() -> Case:
    """The chain without noise, which would be drawn for the whole frame, and without the encoder."""
    chain = Chain(tuple(n for n in NODES if n.name not in ("mosaic", "gaussian_noise", "jpeg")), "chain")
    mosaic = mosaicked(linear(3024, 4032))
    on_device = jnp.asarray(mosaic)
    params = chain.init() | {n: p for n, p in PARAMS.items() if n in chain.init()}
    return Case(
        "chain of six stages in strips",
        "12 MP",
        lambda: run_in_strips(chain, params, on_device),
        (Peer("OpenCV, its own threads", lambda: opencv_photograph(mosaic), 1 / 0.75, agreement),),
        bytes_moved=4 * mosaic.nbytes,
        notes="Hibbard, bilateral r2, median 3x3, gamma, saturation, unsharp mask",
    )
