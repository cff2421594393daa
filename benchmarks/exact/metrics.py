"""PSNR and SSIM against scikit-image."""

import functools
from collections.abc import Callable, Iterator
from importlib.metadata import version
from typing import Any

import jax
import numpy as np
from skimage.metrics import peak_signal_noise_ratio, structural_similarity

from benchmarks.exact.row import Row, largest
from jaxisp.metrics import psnr, ssim
from jaxisp.testing import smooth_image
from tests.test_metrics import SKIMAGE

REFERENCE = f"scikit-image {version('scikit-image')}"
RAN = "colour and grey, 33x18 to 129x193, noise of 0.01 and 0.05, bright and dark"


def rows() -> Iterator[Row]:
    for window, options in SKIMAGE.items():
        for dtype in (np.float32, np.float64):
            got = jax.jit(functools.partial(ssim, window=window))
            pairs = results(got, functools.partial(reference_ssim, options), dtype)
            worst = max(largest(g, w) for g, w in pairs)
            yield Row(f"SSIM, {window} window", REFERENCE, f"{RAN}, {precision(dtype)}", worst, 1e-6)
    for dtype in (np.float32, np.float64):
        pairs = results(jax.jit(psnr), lambda a, b: peak_signal_noise_ratio(a, b, data_range=1), dtype)
        worst = max(largest(np.float64(g) / w, 1) for g, w in pairs)
        yield Row("PSNR", REFERENCE, f"{RAN}, {precision(dtype)}, relative", worst, 1e-6)


def reference_ssim(options: dict[str, Any], a: np.ndarray, b: np.ndarray) -> float:
    channel = 2 if a.ndim == 3 else None
    return structural_similarity(a, b, data_range=1, channel_axis=channel, **options)


def precision(dtype: Any) -> str:
    return "single precision" if dtype == np.float32 else "double precision"


def results(got: Callable[..., Any], want: Callable[..., float], dtype: Any) -> Iterator[tuple[Any, float]]:
    """Ours and theirs on the same numbers; theirs in double precision."""
    for shape in ((21, 34, 3), (33, 18), (129, 193, 3)):
        for gain in (1.0, 0.05):
            for noise in (0.05, 0.01):
                a = gain * smooth_image(shape)
                b = np.clip(a + noise * np.random.default_rng(1).standard_normal(shape), 0, 1)
                a, b = a.astype(dtype), b.astype(dtype)
                with jax.enable_x64(dtype == np.float64):
                    yield got(a, b), want(a.astype(np.float64), b.astype(np.float64))
