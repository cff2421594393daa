"""Effects of the sensor and its readout. In RAW+JPEG pairs they are what the camera does about them."""

from dataclasses import replace

import numpy as np
from scipy import ndimage

from .bodies import Noise
from .camera import DISTRIBUTIONS, PAIRED, Effect, Shot
from .demosaic import mosaicked


def offset(mosaic: np.ndarray, amount: float, shot: Shot) -> np.ndarray:
    return mosaic + amount * shot.body.sign


def louder(noise: Noise, factor: float, shot: Shot) -> Noise:
    """Noise of `factor` times the deviation; fewer electrons make the shot noise stronger too."""
    if shot.body.sign < 0:
        factor = 1 / factor
    return replace(noise, full_well=noise.full_well / factor**2, read=noise.read / factor)


def rows(mosaic: np.ndarray, amount: float, shot: Shot) -> np.ndarray:
    return mosaic + amount * shot.chance("rows").standard_normal((mosaic.shape[0], 1))


def columns(mosaic: np.ndarray, amount: float, shot: Shot) -> np.ndarray:
    return mosaic + amount * shot.fixed("columns").standard_normal((1, mosaic.shape[1]))


def pixel_gains(mosaic: np.ndarray, amount: float, shot: Shot) -> np.ndarray:
    return mosaic * np.maximum(1 + amount * shot.fixed("gains").standard_normal(mosaic.shape), 0)


def correlated(noise: Noise, reach: float, shot: Shot) -> Noise:
    return replace(noise, reach=reach)


def tails(noise: Noise, freedom: float, shot: Shot) -> Noise:
    return replace(noise, freedom=freedom)


def stuck(mosaic: np.ndarray, density: float, shot: Shot) -> np.ndarray:
    """Four in five stuck high, at levels of their own; the others read nothing."""
    rng = shot.fixed("stuck")
    where = rng.random(mosaic.shape) < density
    level = np.where(rng.random(mosaic.shape) < 0.8, rng.uniform(0.3, 0.9, mosaic.shape), 0.0)
    return np.where(where, np.maximum(level, mosaic * (level > 0)), mosaic)


def greens(mosaic: np.ndarray, amount: float, shot: Shot) -> np.ndarray:
    """The green beside red gets more, the one beside blue less."""
    out = mosaic.copy()
    cells = [shot.body.cfa[:2], shot.body.cfa[2:]]
    for row, pair in enumerate(cells):
        sign = 1 if "R" in pair else -1
        out[row::2, pair.index("G") :: 2] *= 1 + sign * amount * shot.body.sign / 2
    return out


def leak(mosaic: np.ndarray, amount: float, shot: Shot) -> np.ndarray:
    """A share of each photosite's light goes to its neighbours, more along the row than across."""
    along, across = 0.3 * amount, 0.2 * amount
    kernel = np.array([[0, across, 0], [along, 1 - amount, along], [0, across, 0]])
    return ndimage.convolve(mosaic, kernel, mode="mirror")


def unleak(mosaic: np.ndarray, amount: float, shot: Shot) -> np.ndarray:
    """The defect left alone by some bodies, its first-order correction by others."""
    return leak(mosaic, amount if shot.body.sign > 0 else -amount, shot)


def coarse(mosaic: np.ndarray, levels: float, shot: Shot) -> np.ndarray:
    return np.floor(mosaic * levels + 0.5) / levels


def clip_sites(mosaic: np.ndarray, level: float, shot: Shot) -> np.ndarray:
    """Saturates at `level` of what the scene's white gives in green, or at each site in its own colour."""
    body = shot.body
    top = np.full((*mosaic.shape, 3), level * body.exposure)
    return np.minimum(mosaic, mosaicked(top if body.sign > 0 else top / np.array(body.gains), body.cfa))


def _noise(name: str, what: str, strengths: tuple[float, ...], act) -> Effect:
    return Effect(name, what, strengths, {DISTRIBUTIONS: {"noise": act}})


def _readout(name: str, what: str, strengths: tuple[float, ...], act) -> Effect:
    return Effect(name, what, strengths, {DISTRIBUTIONS: {"readout": act}})


def _both(name: str, what: str, strengths: tuple[float, ...], act, place: str, paired=None) -> Effect:
    return Effect(name, what, strengths, {DISTRIBUTIONS: {place: act}, PAIRED: {"raw": paired or act}})


SENSOR = (
    _both("black_level_offset", "share of white", (0.0015, 0.003, 0.005, 0.009, 0.016), offset, "readout"),
    _noise("noise_level", "factor on the deviation", (1.12, 1.25, 1.45, 1.9, 2.8), louder),
    _readout("row_noise", "deviation, share of white", (0.0006, 0.0012, 0.0022, 0.004, 0.007), rows),
    _readout("column_noise", "deviation, share of white", (0.0006, 0.0012, 0.0022, 0.004, 0.007), columns),
    Effect("prnu", "deviation of the gain", (0.008, 0.015, 0.03, 0.05, 0.09),
           {DISTRIBUTIONS: {"sites": pixel_gains}}),
    _noise("correlated_noise", "reach, px", (0.3, 0.4, 0.55, 0.8, 1.3), correlated),
    _noise("heavy_tailed_noise", "degrees of freedom", (8.0, 5.0, 3.6, 2.8, 2.3), tails),
    _readout("hot_pixels", "share of pixels", (0.0002, 0.0005, 0.001, 0.002, 0.004), stuck),
    _both("green_imbalance", "difference of the gains", (0.01, 0.02, 0.035, 0.06, 0.1), greens, "sites"),
    _both("crosstalk", "share that leaks", (0.02, 0.04, 0.07, 0.12, 0.2), leak, "sites", unleak),
    _readout("adc_quantization", "levels to white", (160.0, 96.0, 56.0, 32.0, 20.0), coarse),
    _both("highlight_clipping", "level, share of the scene's white in green", (0.9, 0.8, 0.7, 0.55, 0.4),
          clip_sites, "sites"),
)  # fmt: skip
