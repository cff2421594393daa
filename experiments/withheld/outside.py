"""Effects outside the vocabulary: a diagnosis should say that it does not know them."""

import cv2
import numpy as np
from scipy import ndimage

from .camera import DISTRIBUTIONS, KINDS, PAIRED, Effect, Shot
from .numeric import blur, centred, to_ycc, warp, with_luma


def flicker(x: np.ndarray, amount: float, shot: Shot) -> np.ndarray:
    """Light that pulses while the rows are read: a sinusoid down the rows, its phase by frame."""
    phase = shot.chance("flicker").uniform(0, 2 * np.pi)
    rows = np.arange(x.shape[0])[:, None] / 21.0
    return x * (1 + amount * np.sin(2 * np.pi * rows + phase))[..., None]


def skew(x: np.ndarray, pixels: float, shot: Shot) -> np.ndarray:
    """Rows slide sideways by up to `pixels` from the middle, one way or the other by scene."""
    y, _ = centred(x.shape)
    slide = 2 * pixels * y / x.shape[0] * shot.per_scene("skew").choice([-1.0, 1.0])
    return warp(x, np.zeros_like(slide), slide)


def date_stamp(encoded: np.ndarray, share: float, shot: Shot) -> np.ndarray:
    """Digits in orange in a corner, more or less opaque."""
    ink = np.zeros(encoded.shape[:2], np.uint8)
    height, width = ink.shape
    scale = width / 500
    place = (int(width * 0.52), int(height * 0.93))
    cv2.putText(ink, "21.11.2026", place, cv2.FONT_HERSHEY_DUPLEX, scale, 255, 1, cv2.LINE_AA)
    cover = share * ink[..., None] / 255
    return (1 - cover) * encoded + cover * np.array([1.0, 0.55, 0.1])


def posterise(encoded: np.ndarray, levels: float, shot: Shot) -> np.ndarray:
    return np.rint(encoded * levels) / levels


def dust(x: np.ndarray, depth: float, shot: Shot) -> np.ndarray:
    """A dozen soft dark spots at fixed places."""
    rng = shot.fixed("dust")
    height, width = x.shape[:2]
    shade = np.zeros((height, width))
    y, across = np.mgrid[:height, :width]
    for _ in range(12):
        r = np.hypot(y - rng.uniform(0, height), across - rng.uniform(0, width))
        size = rng.uniform(4, 10)
        shade = np.maximum(shade, rng.uniform(0.5, 1) / (1 + np.exp((r - size) * 0.8)))
    return x * (1 - depth * shade)[..., None]


def dark_outlines(encoded: np.ndarray, amount: float, shot: Shot) -> np.ndarray:
    """Edges drawn in dark on their darker side alone, clamped to the local range on the bright side."""
    y = to_ycc(encoded)[..., 0]
    over = y - blur(y, 1.5)
    floor = ndimage.minimum_filter(y, 3)
    return with_luma(encoded, y + amount * np.minimum(over + 0.02, 0) * (1 + (y - floor < 0.02)))


def diagonal_filter(encoded: np.ndarray, share: float, shot: Shot) -> np.ndarray:
    """Fine detail along one diagonal alone is taken out, as a moire filter does."""
    taps = np.diag([1.0, 4.0, 6.0, 4.0, 1.0]) / 16
    smooth = cv2.filter2D(encoded, -1, taps, borderType=cv2.BORDER_REFLECT_101)
    return (1 - share) * encoded + share * smooth


def gamut(encoded: np.ndarray, limit: float, shot: Shot) -> np.ndarray:
    """Colours beyond a chroma limit are cut to it."""
    ycc = to_ycc(encoded)
    chroma = np.hypot(ycc[..., 1] - 0.5, ycc[..., 2] - 0.5)[..., None]
    ratio = np.minimum(1, limit / np.maximum(chroma, 1e-6))
    grey = ycc[..., :1]
    return grey + (encoded - grey) * ratio


def dither(encoded: np.ndarray, levels: float, shot: Shot) -> np.ndarray:
    """Few levels, hidden by an ordered pattern of 4x4."""
    order = np.array([[0, 8, 2, 10], [12, 4, 14, 6], [3, 11, 1, 9], [15, 7, 13, 5]]) / 16 - 0.47
    height, width = encoded.shape[:2]
    pattern = np.tile(order, (-(-height // 4), -(-width // 4)))[:height, :width, None]
    return np.rint(encoded * levels + pattern) / levels


def ghost(x: np.ndarray, share: float, shot: Shot) -> np.ndarray:
    """The picture turned by half a circle, faintly over itself, as a reflection between lens surfaces."""
    return x + share * blur(x[::-1, ::-1], 3.0)


def _both(name: str, what: str, strengths: tuple[float, ...], place: str, act, scene: str = "") -> Effect:
    places = {kind: {place: act} for kind in KINDS}
    if scene:
        places = {PAIRED: {place: act}, DISTRIBUTIONS: {scene: act}}
    return Effect(name, what, strengths, places)


OUTSIDE = (
    _both("flicker", "share", (0.01, 0.02, 0.04, 0.07, 0.12), "rgb", flicker, "light"),
    _both("rolling_shutter_skew", "px at the edges", (0.5, 1.0, 2.0, 3.5, 6.0), "linear", skew, "light"),
    _both("date_stamp", "opacity", (0.1, 0.2, 0.4, 0.7, 1.0), "encoded", date_stamp),
    _both("posterisation", "levels", (80.0, 50.0, 32.0, 20.0, 12.0), "encoded", posterise),
    _both("dust_spots", "depth", (0.03, 0.06, 0.1, 0.2, 0.35), "rgb", dust, "light"),
    _both("dark_outlines", "amount", (0.15, 0.3, 0.5, 0.9, 1.5), "encoded", dark_outlines),
    _both("diagonal_filter", "share", (0.1, 0.2, 0.35, 0.6, 1.0), "encoded", diagonal_filter),
    _both("gamut_clipping", "chroma's limit", (0.3, 0.25, 0.2, 0.15, 0.1), "encoded", gamut),
    _both("dithering", "levels", (64.0, 40.0, 24.0, 14.0, 8.0), "encoded", dither),
    _both("lens_ghost", "share", (0.005, 0.01, 0.02, 0.04, 0.08), "rgb", ghost, "light"),
)

AXES = {
    "flicker": {"row"},
    "rolling_shutter_skew": {"edge", "orientation"},
    "date_stamp": {"fixed_pattern"},
    "posterisation": {"intensity"},
    "dust_spots": {"fixed_pattern"},
    "dark_outlines": {"edge"},
    "diagonal_filter": {"orientation", "lag"},
    "gamut_clipping": {"saturation"},
    "dithering": {"cfa_phase", "block_phase"},
    "lens_ghost": {"neighbourhood"},
}
"""What each is a matter of: a diagnosis that does not know the effect should still name one of these."""
