"""Effects of lens and light. In RAW+JPEG pairs they are what the camera does about them after the RAW."""

import cv2
import numpy as np

from .camera import DISTRIBUTIONS, PAIRED, Effect, Shot
from .numeric import blur, radial_shift, radius, warp


def vignette(light: np.ndarray, fall: float, shot: Shot) -> np.ndarray:
    """Light falls by `fall` at the corners, as a cosine to the fourth does."""
    tangent = (1 - fall) ** -0.5 - 1
    return light / (1 + tangent * radius(light.shape) ** 2)[..., None] ** 2


def shading_correction(linear: np.ndarray, fall: float, shot: Shot) -> np.ndarray:
    r = radius(linear.shape)
    return linear * (1 + fall * (0.8 * r**2 + 0.2 * r**4))[..., None]


def colour_shade(linear: np.ndarray, amount: float, shot: Shot) -> np.ndarray:
    r2 = radius(linear.shape) ** 2
    tints = np.array([1.0, 0.0, -0.7]) * shot.body.sign
    return linear * (1 + amount * r2[..., None] * tints)


def lateral_colour(rgb: np.ndarray, corner: float, shot: Shot) -> np.ndarray:
    out = rgb.copy()
    for channel, share in ((0, 1.0), (2, -0.7)):
        shift = radial_shift(rgb.shape, corner * share * shot.body.sign, 1)
        out[..., channel] = warp(rgb[..., channel], *shift)
    return out


def soften(rgb: np.ndarray, sigma: float, shot: Shot) -> np.ndarray:
    """A Gaussian by some bodies, a disc of the same spread by others."""
    if shot.body.sign > 0:
        return blur(rgb, sigma)
    y, x = (np.mgrid[:224, :224] - 111.5) / 32  # 32 steps to a pixel, whose own spread counts
    disc = (
        (np.hypot(y, x) <= 2 * np.sqrt(sigma**2 - 1 / 12))
        .reshape(7, 32, 7, 32)
        .sum(axis=(1, 3))
        .astype(float)
    )
    return cv2.filter2D(rgb, -1, disc / disc.sum(), borderType=cv2.BORDER_REFLECT)


def motion(light: np.ndarray, length: float, shot: Shot) -> np.ndarray:
    """A straight path of `length` pixels, in one direction for the whole body."""
    angle = shot.fixed("motion").uniform(0, np.pi)
    steps = np.linspace(-0.5, 0.5, 4 * int(np.ceil(length)) + 1) * length
    flat = np.ones(light.shape[:2])
    return np.mean([warp(light, flat * s * np.sin(angle), flat * s * np.cos(angle)) for s in steps], axis=0)


def distort(rgb: np.ndarray, corner: float, shot: Shot) -> np.ndarray:
    return warp(rgb, *radial_shift(rgb.shape, corner * shot.body.sign, 3))


def glare(light: np.ndarray, share: float, shot: Shot) -> np.ndarray:
    """Half of the spread light is even, half stays within a third of the frame."""
    wide = np.stack([blur(light[..., c], light.shape[0] / 6) for c in range(3)], axis=-1)
    return (1 - share) * light + share * 0.5 * (wide + light.mean(axis=(0, 1)))


def _both(
    name: str, what: str, strengths: tuple[float, ...], act, place: str = "linear", paired=None
) -> Effect:
    return Effect(name, what, strengths, {DISTRIBUTIONS: {"light": act}, PAIRED: {place: paired or act}})


OPTICS = (
    _both(
        "vignetting", "share of light lost (r+j: added) at the corners", (0.04, 0.08, 0.14, 0.24, 0.4),
        vignette, paired=shading_correction,
    ),
    _both("color_shading", "red's gain at the corners", (0.02, 0.04, 0.07, 0.12, 0.2), colour_shade),
    _both("lateral_chromatic_aberration", "red's shift at the corners, px", (0.25, 0.5, 0.9, 1.5, 2.5),
          lateral_colour),
    _both("optical_blur", "sigma, px", (0.4, 0.55, 0.75, 1.0, 1.4), soften),
    Effect("motion_blur", "length, px", (1.4, 2.0, 3.0, 4.5, 7.0), {DISTRIBUTIONS: {"light": motion}}),
    _both("geometric_distortion", "shift at the corners, px", (0.4, 0.8, 1.5, 2.5, 4.0), distort),
    _both("veiling_glare", "share of light spread", (0.008, 0.016, 0.03, 0.06, 0.1), glare, place="rgb"),
)  # fmt: skip
