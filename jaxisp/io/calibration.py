"""Colour calibration of a camera: from the matrices that a file states to linear sRGB."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from jaxisp.color import SRGB_TO_XYZ, XYZ_TO_SRGB

_BRADFORD = np.array([[0.8951, 0.2664, -0.1614], [-0.7502, 1.7135, 0.0367], [0.0389, -0.0685, 1.0296]])
_D50 = np.array([0.9642, 1.0, 0.8249])  # the connection space of DNG and ICC
_D65 = SRGB_TO_XYZ.sum(1)  # so that white goes to exactly 1, 1, 1

# Correlated colour temperatures of EXIF LightSource codes [K]; ranges stand for their middle.
_TEMPERATURES = {
    1: 5500, 2: 4150, 3: 2850, 4: 5500, 9: 5500, 10: 6500, 11: 7500, 12: 6400, 13: 5050, 14: 4150,
    15: 3525, 16: 2925, 17: 2850, 18: 5500, 19: 6500, 20: 5500, 21: 6500, 22: 7500, 23: 5000, 24: 3200,
}  # fmt: skip


_DAYLIGHTS, _DAYLIGHT_TINT = (20, 21, 22, 23), 0.0032  # D55, D65, D75, D50 lie above the Planckian locus

Light = int | tuple[float, float]
"""An illuminant: an EXIF LightSource code, or a chromaticity x, y."""


@dataclass(frozen=True)
class Calibration:
    """The matrices of a DNG: one to three of each, for as many illuminants.

    Args:
        illuminants: of each ColorMatrix; code 0 is unknown.
        color_matrices: (n, 3, 3) XYZ to camera (ColorMatrix).
        forward_matrices: n of (3, 3) white-balanced camera to XYZ D50 (ForwardMatrix), None where one is
            missing; or None.
        camera_calibrations: (n, 3, 3) this camera against its model (CameraCalibration).
        analog_balance: (3,) gains before the converter (AnalogBalance).
    """

    illuminants: tuple[Light, ...]
    color_matrices: np.ndarray
    forward_matrices: Sequence[np.ndarray | None] | None
    camera_calibrations: np.ndarray
    analog_balance: np.ndarray

    def at(self, xy: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray | None]:
        """XYZ to camera, reference camera to this one, and forward matrix, in light of chromaticity `xy`."""
        weights = mixing_weights(self.illuminants, xy)
        color = np.tensordot(weights, self.color_matrices, 1)
        to_this = np.diag(self.analog_balance) @ np.tensordot(weights, self.camera_calibrations, 1)
        return to_this @ color, to_this, self._forward(weights)

    def _forward(self, weights: np.ndarray) -> np.ndarray | None:
        """The mix of those that there are: the only one whatever the light."""
        stated = () if self.forward_matrices is None else self.forward_matrices
        there = [(w, m) for w, m in zip(weights, stated) if m is not None]
        if not there:
            return None
        own, matrices = np.array([w for w, _ in there]), np.stack([m for _, m in there])
        own = own / own.sum() if own.sum() > 0 else np.full(len(there), 1 / len(there))
        return np.tensordot(own, matrices, 1)


def mixing_weights(illuminants: Sequence[Light], xy: np.ndarray) -> np.ndarray:
    """(n,) share of each illuminant's matrices in light of chromaticity `xy`; they sum to 1.

    Between two it is linear in inverse temperature, and held outside them. Of three each counts by its
    distance in inverse temperature and tint. Unknown illuminants do not count; the first counts alone where
    fewer than two are known.

    Source: Digital Negative specification 1.7.1, chapter 6, and Adobe's DNG SDK 1.7 for three.
    """
    out = np.zeros(len(illuminants))
    known = [i for i, light in enumerate(illuminants) if is_known(light)]
    used = known if len(known) > 1 else [0]
    out[used] = _weights([_temperature_and_tint(illuminants[i]) for i in used], xy)
    return out


def is_known(light: Light) -> bool:
    """Whether an illuminant has a temperature."""
    return isinstance(light, tuple) or light in _TEMPERATURES


def _weights(lights: list[tuple[float, float]], xy: np.ndarray) -> np.ndarray:
    first = np.eye(len(lights))[0]
    if len(lights) == 1:
        return first
    kelvin, tint = temperature_and_tint(xy)
    if len(lights) == 2:
        (warm, _), (cold, _) = lights
        if warm == cold:
            return first
        share = float(np.clip((1 / kelvin - 1 / cold) / (1 / warm - 1 / cold), 0, 1))
        return np.array([share, 1 - share])
    places = np.array([(15 * t, min(1500 / k, 1)) for k, t in [*lights, (kelvin, tint)]])
    near = 1 / (np.square(places[:-1] - places[-1]).sum(1) + 1e-8)
    near = near / near.sum()
    smooth = np.clip((near * near * (3 - 2 * near) - 0.02) / 0.98, 0, 1)
    return smooth / smooth.sum()


def _temperature_and_tint(light: Light) -> tuple[float, float]:
    """0 K where the illuminant is unknown."""
    if isinstance(light, tuple):
        return temperature_and_tint(np.array(light))
    return float(_TEMPERATURES.get(light, 0)), _DAYLIGHT_TINT if light in _DAYLIGHTS else 0.0


def temperature_and_tint(xy: np.ndarray) -> tuple[float, float]:
    """Correlated colour temperature [K, 1000 to 40000] of a chromaticity, and how far it is from the
    Planckian locus in the CIE 1960 diagram (greenish is above 0).

    Source: the locus by Krystek 1985, "An algorithm to calculate correlated colour temperature".
    """
    x, y = xy
    u, v = np.array([4 * x, 6 * y]) / (-2 * x + 12 * y + 3)
    mired = np.arange(25.0, 1001.0)
    locus_u, locus_v = _planckian(1e6 / mired)
    squared = (locus_u - u) ** 2 + (locus_v - v) ** 2
    at = int(np.clip(np.argmin(squared), 1, mired.size - 2))
    before, here, after = squared[at - 1 : at + 2]
    bend = before - 2 * here + after
    shift = 0.5 * (before - after) / bend if bend > 0 else 0.0
    kelvin = 1e6 / float(np.clip(mired[at] + shift, 25, 1000))
    on_u, on_v = _planckian(np.asarray(kelvin))
    return kelvin, float(np.copysign(np.hypot(u - on_u, v - on_v), v - on_v))


def _planckian(kelvin: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """u and v of the Planckian locus."""
    u = (0.860117757 + 1.54118254e-4 * kelvin + 1.28641212e-7 * kelvin**2) / (
        1 + 8.42420235e-4 * kelvin + 7.08145163e-7 * kelvin**2
    )
    v = (0.317398726 + 4.22806245e-5 * kelvin + 4.20481691e-8 * kelvin**2) / (
        1 - 2.89741816e-5 * kelvin + 1.61456053e-7 * kelvin**2
    )
    return u, v


def white_xy(calibration: Calibration, neutral: np.ndarray) -> np.ndarray:
    """Chromaticity of the light in which grey looks like `neutral` to the camera.

    Source: Digital Negative specification 1.4, "Translating Camera Neutral Coordinates to White
    Balance xy Coordinates".
    """
    xy = _D50[:2] / _D50.sum()
    for _ in range(30):
        xyz = np.linalg.solve(calibration.at(xy)[0], neutral)
        if not (np.isfinite(xyz).all() and xyz.sum() > 0):
            break
        last, xy = xy, xyz[:2] / xyz.sum()
        if np.abs(xy - last).sum() < 1e-7:
            break
    return xy


def neutral_of(calibration: Calibration, xy: np.ndarray) -> np.ndarray:
    """What the camera sees of grey in a light of chromaticity `xy`; green is 1."""
    seen = calibration.at(xy)[0] @ np.array([xy[0] / xy[1], 1.0, (1 - xy[0] - xy[1]) / xy[1]])
    return seen / seen[1]


def adaptation(white: np.ndarray, to: np.ndarray) -> np.ndarray:
    """The linear Bradford transform that takes one white (XYZ) to another."""
    gains = (_BRADFORD @ to) / (_BRADFORD @ white)
    return np.linalg.inv(_BRADFORD) @ np.diag(gains) @ _BRADFORD


def camera_to_srgb(calibration: Calibration, neutral: np.ndarray) -> np.ndarray:
    """White-balanced camera RGB to linear sRGB, for the light in which grey is `neutral`; rows sum to 1.

    Source: Digital Negative specification 1.4, chapter 6, then Bradford from D50 to D65.
    """
    color, to_this, forward = calibration.at(white_xy(calibration, neutral))
    if forward is None:
        balanced_to_xyz = np.linalg.solve(color, np.diag(neutral))
        white = balanced_to_xyz.sum(1)
        return _unit_rows(XYZ_TO_SRGB @ adaptation(white / white[1], _D65) @ balanced_to_xyz / white[1])
    forward = forward * (_D50 / forward.sum(1))[:, None]
    reference = np.linalg.solve(to_this, neutral)
    balanced_to_reference = np.diag(1 / reference) @ np.linalg.solve(to_this, np.diag(neutral))
    return _unit_rows(XYZ_TO_SRGB @ adaptation(_D50, _D65) @ forward @ balanced_to_reference)


def camera_to_srgb_d65(xyz_to_camera: np.ndarray) -> np.ndarray:
    """The same from one D65 matrix alone: sRGB to camera with rows scaled to sum to 1, inverted.

    Source: dcraw (Coffin), cam_xyz_coeff.
    """
    srgb_to_camera = xyz_to_camera @ SRGB_TO_XYZ
    return _unit_rows(np.linalg.inv(_unit_rows(srgb_to_camera)))


def usable(matrix: np.ndarray | None) -> bool:
    """Whether it is a 3x3 matrix that can be inverted; those of cameras have numbers near 1."""
    if matrix is None or matrix.shape != (3, 3) or not np.isfinite(matrix).all():
        return False
    return bool(1e-3 < np.abs(matrix).max() < 1e3 and np.linalg.cond(matrix) < 1e4)


def _unit_rows(matrix: np.ndarray) -> np.ndarray:
    return matrix / matrix.sum(1, keepdims=True)
