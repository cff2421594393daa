"""How alike two images are: PSNR, SSIM, and the paper's normalisation before them.

Arrays are (H, W, 3) or (H, W), of the same shape, in [0, 1]; every function can be jitted and differentiated.
"""

from typing import Literal

import jax
import jax.numpy as jnp
import numpy as np

from jaxisp.arrays.safe_math import safe_divide, safe_sqrt
from jaxisp.arrays.stencils import filter_rows_columns

__all__ = ["match_moments", "psnr", "ssim", "ssim_map"]
__dir__ = __all__.copy  # what an editor completes

Window = Literal["gaussian", "uniform"]

SMALLEST_MSE = 1e-12
"""What `psnr` takes for none: 120 dB."""
_FLAT = 1e-5  # a standard deviation below it is rounding error
_C1, _C2 = 0.01**2, 0.03**2  # K1, K2 of Wang et al. 2004, for a data range of 1


def psnr(a: jax.Array, b: jax.Array, border: int = 0, mask: jax.Array | None = None) -> jax.Array:
    """Peak signal-to-noise ratio for a peak of 1: `-10 log10(mean((a - b)**2))` [dB].

    Args:
        a: (H, W, 3) or (H, W).
        b: like `a`.
        border: rows and columns that are left out on each side [px]; static.
        mask: (H, W), the weight of each pixel (or True where it counts); all of them if None.

    Returns:
        A scalar, at most 120 dB (equal images), NaN where no pixel counts.

    Raises:
        ValueError: the shapes differ or the border leaves nothing.

    Gradient: exact below 120 dB, 0 there.

    Example:
        >>> import numpy as np
        >>> zeros = np.zeros((16, 16, 3), np.float32)
        >>> round(float(psnr(zeros, zeros + 0.1)), 3)
        20.0
    """
    _check_shapes(a, b)
    h, w = a.shape[:2]
    if 2 * border >= min(h, w):
        raise ValueError(f"psnr: a border of {border} px leaves nothing of {h}x{w}")
    inner = (slice(border, h - border), slice(border, w - border))
    squared = (a[inner] - b[inner]) ** 2
    if mask is None:
        mse = squared.mean()
    else:
        weight = jnp.broadcast_to(_per_pixel(mask[inner], a.ndim), squared.shape).astype(squared.dtype)
        mse = jnp.where(weight > 0, weight * squared, 0).sum() / weight.sum()
    return -10 * jnp.log10(jnp.maximum(mse, SMALLEST_MSE))


def ssim(a: jax.Array, b: jax.Array, window: Window = "gaussian") -> jax.Array:
    """Mean structural similarity, over the pixels whose window lies inside the image.

    Args:
        a: (H, W, 3) or (H, W), at least as large as the window.
        b: like `a`.
        window: "gaussian" (11x11, sigma 1.5, population covariance: the original) or "uniform" (7x7,
            sample covariance: scikit-image's default). Their figures differ; say which was used.

    Returns:
        A scalar, the mean over channels.

    Raises:
        ValueError: the shapes differ, the image is smaller than the window, or no such window.

    Gradient: exact.

    Source: Wang, Bovik, Sheikh & Simoncelli 2004.

    Example:
        >>> import numpy as np
        >>> image = np.random.default_rng(0).random((16, 16), np.float32)
        >>> round(float(ssim(image, image)), 6)
        1.0
    """
    radius = len(_taps(window)) // 2
    values = ssim_map(a, b, window)
    return values[radius:-radius, radius:-radius].mean()


def ssim_map(a: jax.Array, b: jax.Array, window: Window = "gaussian") -> jax.Array:
    """Structural similarity of each pixel's neighbourhood, in the shape of `a`; see `ssim`.

    Within a window's radius of the border the image is mirrored, its edge pixel repeated.

    Example:
        >>> import numpy as np
        >>> image = np.random.default_rng(0).random((16, 20), np.float32)
        >>> ssim_map(image, 1 - image).shape
        (16, 20)
    """
    _check_shapes(a, b)
    taps = _taps(window)
    if min(a.shape[:2]) < len(taps):
        raise ValueError(f"ssim: the image {a.shape[:2]} is smaller than the window of {len(taps)} px")
    if a.ndim == 2:
        return _ssim_plane(a, b, window)
    return jnp.stack([_ssim_plane(a[..., c], b[..., c], window) for c in range(a.shape[-1])], axis=-1)


def match_moments(clean: jax.Array, output: jax.Array) -> jax.Array:
    """`clean` with each channel's mean and standard deviation made those of `output`.

    A pipeline that is compared with a clean photograph is not to blame for its exposure and contrast.

    Args:
        clean: (H, W, 3) or (H, W).
        output: like `clean`.

    Returns:
        Like `clean`, not clipped. A constant channel (standard deviation below 1e-5) becomes the mean of
        the output's.

    Gradient: exact, of what is returned.

    Source: Jaroensri et al. 2019, the normalisation of clean images before PSNR and SSIM.

    Example:
        >>> import numpy as np
        >>> image = np.random.default_rng(0).random((16, 16), np.float32)
        >>> bool(np.allclose(match_moments(image, 0.5 * image + 0.1), 0.5 * image + 0.1, atol=1e-5))
        True
    """
    _check_shapes(clean, output)

    def moments(image: jax.Array) -> tuple[jax.Array, jax.Array]:
        mean = image.mean(axis=(0, 1), keepdims=True)
        return mean, safe_sqrt(((image - mean) ** 2).mean(axis=(0, 1), keepdims=True))

    (mean, deviation), (new_mean, new_deviation) = moments(clean), moments(output)
    return (clean - mean) * safe_divide(new_deviation, deviation, _FLAT) + new_mean


def _taps(window: Window) -> np.ndarray:
    if window == "gaussian":
        weights = np.exp(-0.5 * (np.arange(-5, 6) / 1.5) ** 2)
        return weights / weights.sum()
    if window == "uniform":
        return np.full(7, 1 / 7)
    raise ValueError(f"ssim: window {window!r} is not 'gaussian' or 'uniform'")


def _ssim_plane(a: jax.Array, b: jax.Array, window: Window) -> jax.Array:
    taps = _taps(window)
    weights = [float(t) for t in taps]
    unbiased = len(taps) ** 2 / (len(taps) ** 2 - 1) if window == "uniform" else 1.0
    center = a.mean()  # the second moments lose fewer digits about it

    def blur(plane: jax.Array) -> jax.Array:
        return filter_rows_columns(plane, weights, weights, mode="symmetric")

    x, y = a - center, b - center
    mean_x, mean_y = blur(x), blur(y)
    var_x = unbiased * (blur(x * x) - mean_x**2)
    var_y = unbiased * (blur(y * y) - mean_y**2)
    covariance = unbiased * (blur(x * y) - mean_x * mean_y)
    mean_a, mean_b = mean_x + center, mean_y + center
    luminance = (2 * mean_a * mean_b + _C1) / (mean_a**2 + mean_b**2 + _C1)
    return luminance * (2 * covariance + _C2) / (var_x + var_y + _C2)


def _per_pixel(mask: jax.Array, ndim: int) -> jax.Array:
    return mask[..., None] if ndim == 3 else mask


def _check_shapes(a: jax.Array, b: jax.Array) -> None:
    if a.shape != b.shape or a.ndim not in (2, 3):
        raise ValueError(f"expected two (H, W, 3) or (H, W) images of one shape, got {a.shape} and {b.shape}")
