"""Single operators on 32 pictures of 256x256: AlbumentationsX, and kornia as it is and compiled by torch."""

from collections.abc import Callable, Iterator
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from benchmarks.case import Case, Peer
from benchmarks.cases.denoise import optional
from benchmarks.torch_peer import left, tensor
from jaxisp.pipeline import run_batch, stage
from jaxisp.samples import scene
from jaxisp.stages.balance import Saturation
from jaxisp.stages.blur import OpticalBlur
from jaxisp.stages.denoise.median import Median
from jaxisp.stages.detail import UnsharpMask
from jaxisp.stages.jpeg import Jpeg
from jaxisp.stages.noise import GaussianNoise
from jaxisp.stages.power import Gamma
from jaxisp.stages.resampling import Resampling

KEY = jax.random.key(0)
SIDE, COUNT = 256, 32
SIGMA, RADIUS, AMOUNT, STD, GAMMA, SATURATION, QUALITY = 1.5, 5, 0.5, 0.05, 1.5, 1.2, 75
WINDOW = 2 * RADIUS + 1

Kornia = Callable[[Any, Any, Any], Any]
"""(kornia, torch, images) to images."""


def cases() -> Iterator[Case]:
    pictures = data()
    yield case("Gaussian", pictures, "optical_blur", OpticalBlur(sigma=SIGMA), blurred, radius=RADIUS)
    yield case(
        "median 3x3", pictures, "median", Median(strength=1.0),
        lambda k, t, x: k.filters.median_blur(x, 3), footprint="3x3",
    )  # fmt: skip
    yield case(
        "unsharp mask", pictures, "unsharp_mask", UnsharpMask(amount=AMOUNT, sigma=SIGMA),
        lambda k, t, x: x + AMOUNT * (x - blurred(k, t, x)), radius=RADIUS,
    )  # fmt: skip
    yield case(
        "Gaussian noise", pictures, "gaussian_noise", GaussianNoise(std=STD),
        lambda k, t, x: x + STD * t.randn_like(x),
    )  # fmt: skip
    yield case("gamma", pictures, "gamma_compression", Gamma(gamma=GAMMA), power)
    yield case("saturation", pictures, "saturation", Saturation(amount=SATURATION), saturated)
    yield case("half the size and back", pictures, "resampling", Resampling(factor=2.0), there_and_back)
    yield case("JPEG", pictures, "jpeg", Jpeg(quality=QUALITY), compressed)


def data() -> np.ndarray:
    """(32, 256, 256, 3) float32, encoded."""
    whole = np.clip(scene("astronaut", (400, 500)), 0, 1).astype(np.float32) ** np.float32(1 / 2.2)
    corners = [(y, x) for y in range(0, 140, 36) for x in range(0, 240, 31)]
    return np.stack([whole[y : y + SIDE, x : x + SIDE] for y, x in corners[:COUNT]])


def case(row: str, pictures: np.ndarray, name: str, params: Any, with_kornia: Kornia, **static: Any) -> Case:
    """A stage with parameters of each picture, as a recipe draws them."""
    node, x = stage(name, **static), jnp.asarray(pictures)
    each = jax.tree.map(lambda v: jnp.full((COUNT, *np.shape(v)), v, jnp.float32), {name: params})
    return Case(
        row,
        f"{SIDE}x{SIDE}",
        lambda: run_batch(node, each, x, KEY),
        (*albumentations(row, pictures), *kornia_peers(with_kornia, pictures)),
        bytes_moved=2 * pictures.nbytes,
        images=COUNT,
    )


def albumentations(row: str, pictures: np.ndarray) -> Iterator[Peer]:
    """One picture after the other, as its transforms take them; OpenCV's threads are its own."""
    if (library := optional("albumentations")) is None:
        return
    blur = {"blur_range": (WINDOW, WINDOW), "sigma_range": (SIGMA, SIGMA)}
    area, linear = 3, 1  # OpenCV's
    transforms = {
        "Gaussian": (library.GaussianBlur, blur),
        "median 3x3": (library.MedianBlur, {"blur_range": (3, 3)}),
        "unsharp mask": (library.UnsharpMask, {**blur, "alpha_range": (AMOUNT, AMOUNT), "threshold": 0}),
        "Gaussian noise": (library.GaussNoise, {"std_range": (STD, STD), "per_channel": True}),
        "gamma": (library.RandomGamma, {"gamma_range": (100 / GAMMA, 100 / GAMMA)}),
        "saturation": (
            library.ColorJitter,
            {f"{name}_range": (1, 1) for name in ("brightness", "contrast")}
            | {"saturation_range": (SATURATION, SATURATION), "hue_range": (0, 0)},
        ),
        "half the size and back": (
            library.Downscale,
            {"scale_range": (0.5, 0.5), "interpolation_pair": {"downscale": area, "upscale": linear}},
        ),
        "JPEG": (library.ImageCompression, {"quality_range": (QUALITY, QUALITY)}),
    }
    make, options = transforms[row]
    transform = make(**options, p=1.0)

    def call() -> np.ndarray:
        return np.stack([transform(image=picture)["image"] for picture in pictures])

    yield Peer("AlbumentationsX", call, None, apart)


def kornia_peers(operator: Kornia, pictures: np.ndarray) -> Iterator[Peer]:
    torch, kornia = optional("torch"), optional("kornia")
    if torch is None or kornia is None:
        return
    x = tensor(np.moveaxis(pictures, -1, 1))
    ways = {"kornia": operator, "kornia, torch.compile": torch.compile(operator)}
    for name, way in ways.items():

        def call(way: Kornia = way) -> Any:
            with torch.inference_mode():
                return left(way(kornia, torch, x).permute(0, 2, 3, 1))

        yield Peer(name, call, None, apart)


def blurred(kornia: Any, torch: Any, x: Any) -> Any:
    return kornia.filters.gaussian_blur2d(x, (WINDOW, WINDOW), (SIGMA, SIGMA))


def power(kornia: Any, torch: Any, x: Any) -> Any:
    return kornia.enhance.adjust_gamma(x, 1 / GAMMA)


def saturated(kornia: Any, torch: Any, x: Any) -> Any:
    return kornia.enhance.adjust_saturation_with_gray_subtraction(x, SATURATION)


def there_and_back(kornia: Any, torch: Any, x: Any) -> Any:
    small = kornia.geometry.resize(x, (SIDE // 2, SIDE // 2), antialias=True)
    return kornia.geometry.resize(small, (SIDE, SIDE))


def compressed(kornia: Any, torch: Any, x: Any) -> Any:
    quality = torch.full((len(x),), float(QUALITY))
    return kornia.enhance.jpeg_codec_differentiable(x, quality)


def apart(ours: Any, theirs: Any) -> str:
    """Kernels, rounding and noise are each library's own."""
    off = np.asarray(ours, np.float64) - np.asarray(theirs, np.float64)
    return f"PSNR {-10 * np.log10(max(float(np.mean(off**2)), 1e-20)):.1f} dB"
