"""Classical denoisers of scikit-image, blind: the noise is estimated from the picture itself.

Their estimate takes noise to be white. That of a JPEG is not, so its estimate is too low: each is also
given a factor on it, chosen on the sets in `CHOSEN_ON`, never on the reported crops.
"""

from collections.abc import Callable, Mapping, Sequence

import numpy as np
from skimage.restoration import (
    denoise_nl_means,
    denoise_tv_chambolle,
    denoise_wavelet,
    estimate_sigma,
)

from jaxisp.train import AlignedPair, evaluate_pairs

CHOSEN_ON = ("polyu", "sidd")
FACTORS = (1.0, 2.0, 4.0)
Denoise = Callable[[np.ndarray], np.ndarray]


def noise_level(image: np.ndarray) -> float:
    """Standard deviation of white noise, by the finest wavelet coefficients."""
    return float(estimate_sigma(image, channel_axis=-1, average_sigmas=True))


def nl_means(image: np.ndarray, factor: float) -> np.ndarray:
    """Buades, Coll & Morel 2005, patches of 5 px within 13 px."""
    sigma = factor * noise_level(image)
    return denoise_nl_means(
        image,
        patch_size=5,
        patch_distance=6,
        h=0.8 * sigma,
        sigma=sigma,
        fast_mode=True,
        channel_axis=-1,
    )


def wavelet(image: np.ndarray, factor: float) -> np.ndarray:
    """BayesShrink (Chang, Yu & Vetterli 2000) in YCbCr."""
    sigma = factor * noise_level(image)
    return denoise_wavelet(image, sigma=sigma, convert2ycbcr=True, rescale_sigma=True, channel_axis=-1)


def total_variation(image: np.ndarray, factor: float) -> np.ndarray:
    """Chambolle 2004; the weight is the noise level."""
    return denoise_tv_chambolle(image, weight=factor * noise_level(image), channel_axis=-1)


METHODS: dict[str, Callable[[np.ndarray, float], np.ndarray]] = {
    "non-local means": nl_means,
    "wavelet": wavelet,
    "total variation": total_variation,
}


def chosen(sets: Mapping[str, Sequence[AlignedPair]]) -> dict[str, float]:
    """By method, the factor whose PSNR is the highest on the sets to choose on."""
    return {name: max(FACTORS, key=lambda factor: _score(name, factor, sets)) for name in METHODS}


def denoiser(name: str, factor: float) -> Denoise:
    """A method with its factor, cut to [0, 1]."""
    return lambda image: np.clip(METHODS[name](image, factor), 0, 1).astype(np.float32)


def _score(name: str, factor: float, sets: Mapping[str, Sequence[AlignedPair]]) -> float:
    results = [evaluate_pairs(denoiser(name, factor), sets[which]) for which in CHOSEN_ON]
    return float(np.mean([result["mean"]["psnr"] for result in results]))
