"""Effects of the processing between RAW and file, the same for both kinds of data."""

from dataclasses import replace

import cv2
import numpy as np
from scipy import ndimage

from .bodies import Body
from .camera import KINDS, Effect, Shot, compressed, decompressed
from .demosaic import demosaic, mosaicked
from .numeric import blur, from_ycc, luma, to_ycc, with_luma


def balance(linear: np.ndarray, amount: float, shot: Shot) -> np.ndarray:
    return linear * (1 + amount * shot.body.sign * np.array([1.0, 0.0, -0.8]))


def colour_matrix(rgb: np.ndarray, amount: float, shot: Shot) -> np.ndarray:
    mix = np.array([[-0.6, 0.8, -0.2], [0.3, -0.8, 0.5], [-0.1, 0.9, -0.8]])
    return rgb @ (np.eye(3) + amount * shot.body.sign * mix).T


def colour_table(encoded: np.ndarray, degrees: float, shot: Shot) -> np.ndarray:
    """Turn hues by an amount that changes sign three times round the circle; deepen some, dull others."""
    hsv = cv2.cvtColor(np.clip(encoded, 0, 1).astype(np.float32), cv2.COLOR_RGB2HSV).astype(float)
    turn = np.deg2rad(3 * hsv[..., 0] + 40)
    hsv[..., 0] = (hsv[..., 0] + degrees * np.sin(turn) * shot.body.sign * hsv[..., 1]) % 360
    hsv[..., 1] = np.clip(hsv[..., 1] * (1 + degrees / 60 * np.cos(turn) * hsv[..., 1]), 0, 1)
    return cv2.cvtColor(hsv.astype(np.float32), cv2.COLOR_HSV2RGB).astype(float)


def curve(encoded: np.ndarray, amount: float, shot: Shot) -> np.ndarray:
    """More contrast about a third, or less: a sine bump that no single power makes."""
    x = np.clip(encoded, 0, 1)
    return x - shot.body.sign * amount * np.sin(2 * np.pi * x ** (np.log(0.5) / np.log(0.35))) / 2


def local_tone(rgb: np.ndarray, power: float, shot: Shot) -> np.ndarray:
    """Dark surroundings are lifted, bright ones held down; the surround is even or edge-aware by body."""
    y = np.clip(luma(rgb), 1e-3, None)
    if shot.body.sign > 0:
        surround = blur(y, rgb.shape[0] / 14)
    else:
        log = np.log2(y).astype(np.float32)
        surround = np.exp2(cv2.bilateralFilter(log, -1, 1.5, rgb.shape[0] / 24).astype(float))
    return rgb * ((surround / np.exp(np.mean(np.log(y)))) ** -power)[..., None]


def chroma_gain(encoded: np.ndarray, amount: float, shot: Shot) -> np.ndarray:
    ycc = to_ycc(encoded)
    ycc[..., 1:] = 0.5 + (ycc[..., 1:] - 0.5) * (1 + amount * shot.body.sign)
    return from_ycc(ycc)


def smooth_luma(encoded: np.ndarray, reach: float, shot: Shot) -> np.ndarray:
    """Bilateral, non-local means or guided filter, by body; `reach` is the step in luma that survives."""
    y = np.clip(to_ycc(encoded)[..., 0], 0, 1)
    way = ord(shot.body.name[0]) % 3
    if way == 0:
        packed = np.rint(y * 65535).astype(np.uint16)
        height = [float(reach * 65535 * 0.8)]
        smooth = cv2.fastNlMeansDenoising(packed, height, None, 3, 13, cv2.NORM_L1) / 65535.0
    elif way == 1:
        mean = ndimage.uniform_filter(y, 5)
        variance = np.maximum(ndimage.uniform_filter(y * y, 5) - mean**2, 0)
        slope = variance / (variance + reach**2)
        smooth = ndimage.uniform_filter(slope, 5) * y + ndimage.uniform_filter((1 - slope) * mean, 5)
    else:
        smooth = cv2.bilateralFilter(y.astype(np.float32), 9, 2 * reach, 2.0).astype(float)
    return with_luma(encoded, smooth)


def smooth_chroma(encoded: np.ndarray, reach: float, shot: Shot) -> np.ndarray:
    """Gaussian, or a median followed by a Gaussian, over the colour differences."""
    ycc = to_ycc(encoded)
    if shot.body.sign < 0:
        window = 2 * int(np.ceil(reach)) + 1
        for c in (1, 2):
            ycc[..., c] = (ndimage.median_filter(ycc[..., c], window) + blur(ycc[..., c], reach)) / 2
    else:
        ycc[..., 1:] = blur(ycc[..., 1:], reach)
    return from_ycc(ycc)


def sharpen(encoded: np.ndarray, amount: float, shot: Shot) -> np.ndarray:
    y = to_ycc(encoded)[..., 0]
    width = {"alder": 0.8, "cedar": 1.6, "dogwood": 1.0, "elder": 2.0, "elm": 2.0}.get(shot.body.name, 1.2)
    return with_luma(encoded, y + amount * (y - blur(y, width)))


def other_demosaicking(demosaicked: np.ndarray, share: float, shot: Shot) -> np.ndarray:
    """Go towards the body's other algorithm, all the way at the highest strength."""
    mosaic = mosaicked(demosaicked, shot.body.cfa)
    other = demosaic(mosaic, shot.body.cfa, shot.body.other_demosaicker, shot.body.border)
    return (1 - share) * demosaicked + share * other


def resize(encoded: np.ndarray, factor: float, shot: Shot) -> np.ndarray:
    """Shrunk by the factor and enlarged again."""
    height, width = encoded.shape[:2]
    small = (round(width / factor), round(height / factor))
    way = cv2.INTER_LANCZOS4 if factor < 1.2 else cv2.INTER_LINEAR
    picture = cv2.resize(encoded.astype(np.float32), small, interpolation=way)
    return cv2.resize(picture, (width, height), interpolation=cv2.INTER_CUBIC).astype(float)


def coarse_tables(pixels: np.ndarray, quality: float, shot: Shot) -> np.ndarray:
    """Compressed and decoded: the picture is then filed without a header that would tell."""
    return decompressed(compressed(pixels, int(quality), "4:4:4", "opencv"))


def subsample(pixels: np.ndarray, way: float, shot: Shot) -> np.ndarray:
    """Chroma kept at half the columns, or at half of columns and rows, before the encoder sees it."""
    ycc = to_ycc(pixels / 255.0)
    height, width = pixels.shape[:2]
    size = (width // 2, height // 2) if way >= 2 else (width // 2, height)
    down = cv2.INTER_NEAREST if way >= 4 else cv2.INTER_AREA
    up = cv2.INTER_LINEAR if way in (0, 1, 2) else cv2.INTER_NEAREST
    kept = cv2.resize(ycc[..., 1:].astype(np.float32), size, interpolation=down)
    chroma = cv2.resize(kept, (width, height), interpolation=up).astype(float)
    share = 0.5 if way == 0 else 1.0
    ycc[..., 1:] += share * (chroma - ycc[..., 1:])
    return np.rint(255 * np.clip(from_ycc(ycc), 0, 1)).astype(np.uint8)


def full_chroma(body: Body, way: float, shot: Shot) -> Body:
    return replace(body, sampling="4:4:4")


def compress_twice(pixels: np.ndarray, quality: float, shot: Shot) -> np.ndarray:
    """Compressed once before, on a grid that starts elsewhere."""
    down, across = shot.fixed("grid").integers(1, 8, 2)
    height, width = pixels.shape[:2]
    padded = np.pad(pixels, ((down, 0), (across, 0), (0, 0)), mode="edge")
    once = decompressed(compressed(padded, int(quality), "4:4:4"))
    return np.ascontiguousarray(once[down : down + height, across : across + width])


def grain(encoded: np.ndarray, amount: float, shot: Shot) -> np.ndarray:
    """Soft grains, strongest in the middle tones, the same in all channels but for a third."""
    rng = shot.chance("grain")
    height, width = encoded.shape[:2]
    common = blur(rng.standard_normal((height, width)), 0.6)[..., None]
    own = blur(rng.standard_normal((height, width, 3)), 0.6)
    field = common / common.std() * 0.8 + own / own.std() * 0.33
    y = np.clip(to_ycc(encoded)[..., :1], 0, 1)
    return encoded + amount * field * (0.3 + 2.8 * y * (1 - y))


def _both(name: str, what: str, strengths: tuple[float, ...], place: str, act) -> Effect:
    return Effect(name, what, strengths, {kind: {place: act} for kind in KINDS})


def _file(name: str, what: str, strengths: tuple[float, ...], act) -> Effect:
    return Effect(name, what, strengths, {k: {"pixels": act, "rendering": full_chroma} for k in KINDS})


RENDERING = (
    _both("white_balance", "red's gain", (0.015, 0.03, 0.05, 0.09, 0.16), "linear", balance),
    _both("color_matrix", "share mixed", (0.03, 0.06, 0.1, 0.18, 0.3), "rgb", colour_matrix),
    _both("color_lut", "hue's turn, degrees", (2.0, 4.0, 7.0, 12.0, 20.0), "encoded", colour_table),
    _both("tone_curve", "height of the bump", (0.015, 0.03, 0.05, 0.09, 0.15), "encoded", curve),
    _both("local_tone_mapping", "power", (0.03, 0.06, 0.1, 0.18, 0.3), "rgb", local_tone),
    _both("saturation", "chroma's gain", (0.05, 0.1, 0.17, 0.3, 0.5), "encoded", chroma_gain),
    _both("luma_denoising", "step in luma", (0.008, 0.014, 0.025, 0.045, 0.08), "encoded", smooth_luma),
    _both("chroma_denoising", "reach, px", (0.6, 0.9, 1.4, 2.2, 3.5), "encoded", smooth_chroma),
    _both("sharpening", "amount", (0.1, 0.2, 0.35, 0.6, 1.0), "encoded", sharpen),
    _both("demosaicking", "share of the other", (0.2, 0.4, 0.6, 0.8, 1.0), "demosaicked", other_demosaicking),
    _both("resampling", "factor", (1.08, 1.15, 1.3, 1.6, 2.0), "encoded", resize),
    _file("jpeg_quantization", "quality", (92.0, 85.0, 72.0, 50.0, 28.0), coarse_tables),
    _file("chroma_subsampling", "way", (0.0, 1.0, 2.0, 3.0, 4.0), subsample),
    _file("double_compression", "first quality", (92.0, 85.0, 72.0, 50.0, 28.0), compress_twice),
    _both("film_grain", "deviation in the middle tones", (0.005, 0.01, 0.018, 0.03, 0.05), "encoded", grain),
)  # fmt: skip
