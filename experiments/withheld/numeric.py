"""Small helpers on (H, W, 3) or (H, W) float64 arrays that the bodies and effects share."""

import zlib

import cv2
import numpy as np
from scipy import ndimage


def srgb_encode(x: np.ndarray) -> np.ndarray:
    x = np.clip(x, 0.0, None)
    return np.where(x <= 0.0031308, 12.92 * x, 1.055 * np.power(np.maximum(x, 1e-9), 1 / 2.4) - 0.055)


def srgb_decode(y: np.ndarray) -> np.ndarray:
    y = np.clip(y, 0.0, None)
    return np.where(y <= 0.04045, y / 12.92, np.power((y + 0.055) / 1.055, 2.4))


def seed_of(*words: object) -> list[int]:
    """Turn names and numbers into a seed that does not change between runs."""
    return [zlib.crc32(str(word).encode()) for word in words]


def luma(rgb: np.ndarray) -> np.ndarray:
    return rgb @ np.array([0.2126, 0.7152, 0.0722])


def to_ycc(rgb: np.ndarray) -> np.ndarray:
    """Luma and two colour differences, by OpenCV (Y, Cr, Cb)."""
    return cv2.cvtColor(rgb.astype(np.float32), cv2.COLOR_RGB2YCrCb).astype(float)


def from_ycc(ycc: np.ndarray) -> np.ndarray:
    return cv2.cvtColor(ycc.astype(np.float32), cv2.COLOR_YCrCb2RGB).astype(float)


def with_luma(rgb: np.ndarray, y: np.ndarray) -> np.ndarray:
    """The picture with another luma and its own colour differences."""
    return rgb + (y - to_ycc(rgb)[..., 0])[..., None]


def blur(x: np.ndarray, sigma: float) -> np.ndarray:
    """Gaussian over rows and columns, edges held."""
    width = (sigma, sigma, 0)[: x.ndim]
    return ndimage.gaussian_filter(x, width, mode="nearest")


def radius(shape: tuple[int, ...]) -> np.ndarray:
    """Distance from the centre, one at the corners."""
    y, x = centred(shape)
    return np.hypot(y, x) / np.hypot(shape[0] / 2, shape[1] / 2)


def centred(shape: tuple[int, ...]) -> tuple[np.ndarray, np.ndarray]:
    y, x = np.mgrid[: shape[0], : shape[1]].astype(float)
    return y - (shape[0] - 1) / 2, x - (shape[1] - 1) / 2


def warp(x: np.ndarray, dy: np.ndarray, dx: np.ndarray) -> np.ndarray:
    """Fetch every pixel from (dy, dx) away, by OpenCV's Lanczos."""
    y0, x0 = np.mgrid[: x.shape[0], : x.shape[1]].astype(np.float32)
    fetched = cv2.remap(
        x.astype(np.float32),
        x0 + dx.astype(np.float32),
        y0 + dy.astype(np.float32),
        cv2.INTER_LANCZOS4,
        borderMode=cv2.BORDER_REFLECT_101,
    )
    return fetched.astype(float)


def radial_shift(shape: tuple[int, ...], corner: float, power: int) -> tuple[np.ndarray, np.ndarray]:
    """Displacement outwards that is `corner` pixels at the corners and grows as radius ** power."""
    y, x = centred(shape)
    gain = corner * radius(shape) ** (power - 1) / np.hypot(shape[0] / 2, shape[1] / 2)
    return y * gain, x * gain


def rms(a: np.ndarray, b: np.ndarray) -> float:
    return float(np.sqrt(np.mean((a.astype(float) - b.astype(float)) ** 2)))
