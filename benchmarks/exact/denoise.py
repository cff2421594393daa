"""Denoising and deconvolution against OpenCV, SciPy, PyWavelets and scikit-image, and loops in float64."""

from collections.abc import Iterator
from importlib.metadata import version

import cv2
import jax
import numpy as np
import pywt
import scipy
from scipy import ndimage
from skimage.restoration import richardson_lucy

from benchmarks.exact.row import Row, largest
from jaxisp.stages.denoise.bilateral import bilateral_plane
from jaxisp.stages.denoise.median import median_plane
from jaxisp.stages.denoise.wavelet import core_plane
from jaxisp.stages.detail import deconvolved
from jaxisp.testing import smooth_image
from tests.stages.test_denoise_bilateral import naive
from tests.stages.test_denoise_median import FOOTPRINTS

BILATERALS = [
    (radius, space, range_)
    for radius, space in ((1, 0.5), (2, 1.0), (3, 2.0), (5, 1.5), (5, 8.0))
    for range_ in (0.02, 0.1, 0.5)
]
PRINTED = "radii 1 to 5, spatial widths 0.5 to 8 px, range widths 0.02 to 0.5"


def rows() -> Iterator[Row]:
    yield bilateral_opencv()
    yield bilateral_loop()
    for footprint in FOOTPRINTS:
        yield median(footprint)
    for method in ("bayes", "visu", "fixed"):
        yield wavelet(method)
    yield deconvolution()


def noisy(shape: tuple[int, int], std: float = 0.05) -> np.ndarray:
    return (smooth_image(shape) + std * np.random.default_rng(0).standard_normal(shape)).astype(np.float32)


bilateral = jax.jit(bilateral_plane, static_argnums=4)


def bilateral_opencv() -> Row:
    worst = []
    for radius, space, range_ in BILATERALS:
        for plane in (smooth_image((37, 52)).astype(np.float32), noisy((61, 48))):
            border = cv2.BORDER_REFLECT_101
            want = cv2.bilateralFilter(plane, 2 * radius + 1, range_, space, borderType=border)
            worst.append(largest(bilateral(plane, plane, space, range_, radius), want))
    ran = f"{PRINTED}, waves with and without noise, borders too"
    return Row("bilateral", f"OpenCV {cv2.__version__}, float32", ran, max(worst), 1e-4)


def bilateral_loop() -> Row:
    """Joint: the guide is another picture; values below 0 and above 1."""
    rng, worst = np.random.default_rng(0), []
    for radius, space, range_ in BILATERALS:
        plane, guide = rng.uniform(-0.5, 1.5, (2, 29, 34)).astype(np.float32)
        want = naive((plane.astype(float),), guide.astype(float), space, range_, radius)[0]
        worst.append(largest(bilateral(plane, guide, space, range_, radius), want))
    reference = "its definition in double precision"
    return Row("bilateral", reference, f"{PRINTED}, joint, random", max(worst), 1e-4)


filtered = jax.jit(median_plane, static_argnums=1)


def median(footprint: str) -> Row:
    rng, worst = np.random.default_rng(0), []
    shapes = ((21, 34), (64, 65), (5, 4), (2, 3), (1, 7))
    for shape in shapes:
        for plane in (noisy(shape), rng.standard_normal(shape), rng.integers(0, 4, shape)):
            plane = plane.astype(np.float32)
            want = ndimage.median_filter(plane, footprint=FOOTPRINTS[footprint], mode="mirror")
            worst.append(largest(filtered(plane, footprint), want))
    ran = "a picture, normal numbers, and four levels (ties) at " + ", ".join(f"{h}x{w}" for h, w in shapes)
    return Row(f"median {footprint}", f"SciPy {scipy.__version__}", f"{ran}, borders too", max(worst), 0)


cored = jax.jit(core_plane, static_argnums=(3, 4, 5))


def wavelet(method: str) -> Row:
    worst = []
    for name in ("haar", "db2", "db4", "sym4"):
        for shape, levels in (((61, 48), 3), ((64, 65), 2), ((29, 34), 1)):
            for sigma, strength in ((0.02, 1.0), (0.1, 1.5)):
                plane = noisy(shape)
                want = shrunk(plane.astype(float), sigma, strength, name, levels, method)
                worst.append(largest(cored(plane, sigma, strength, name, levels, method), want))
    ran = "haar, db2, db4, sym4; 1 to 3 levels; sigma 0.02 and 0.1; 29x34 to 64x65, borders too"
    reference = f"PyWavelets {version('PyWavelets')} and the formula of the threshold"
    return Row(f"wavelet coring, {method}", reference, ran, max(worst), 1e-5)


iterated = jax.jit(deconvolved, static_argnums=(4, 5))


def deconvolution() -> Row:
    """From its start, which is flat; it pads with zeros, so that the inside is compared."""
    radius, worst = 5, []
    for iterations, sigma in ((1, 0.6), (3, 1.2), (5, 1.6)):
        taps = np.exp(-0.5 * (np.arange(-radius, radius + 1) / sigma) ** 2)
        psf = np.outer(taps, taps) / taps.sum() ** 2
        data = np.clip(noisy((134, 141), 0.02), 0.05, None)
        want = richardson_lucy(data.astype(float), psf, num_iter=iterations, clip=False)
        got = iterated(data, np.full_like(data, 0.5), sigma, 0.0, iterations, radius)
        edge = 2 * iterations * radius
        worst.append(largest(np.asarray(got)[edge:-edge, edge:-edge], want[edge:-edge, edge:-edge]))
    ran = "1 to 5 iterations, sigma 0.6 to 1.6 px, waves with noise, without borders"
    return Row("richardson_lucy", f"scikit-image {version('scikit-image')}", ran, max(worst), 1e-5)


def shrunk(
    plane: np.ndarray, sigma: float, strength: float, name: str, levels: int, method: str
) -> np.ndarray:
    """Soft thresholding of each sub-band by PyWavelets."""

    def by(band: np.ndarray) -> float:
        if method == "fixed":
            return sigma
        if method == "visu":
            return sigma * np.sqrt(2 * np.log(plane.size))
        return sigma**2 / np.sqrt(max(np.mean(band**2) - sigma**2, 1e-6 * sigma**2))

    low, shapes, pyramid = plane, [], []
    for _ in range(levels):
        shapes.append(low.shape)
        low, details = pywt.dwt2(low, name, mode="symmetric")
        pyramid.append(tuple(pywt.threshold(d, strength * by(d), "soft") for d in details))
    for (h, w), details in zip(reversed(shapes), reversed(pyramid)):
        low = pywt.idwt2((low, details), name, mode="symmetric")[:h, :w]
    return low
