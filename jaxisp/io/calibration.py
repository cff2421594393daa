"""Colour calibration of a camera: from the matrices that a file states to linear sRGB."""

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


@dataclass(frozen=True)
class Calibration:
    """The matrices of a DNG: one or two of each, for as many illuminants.

    Args:
        illuminants: EXIF LightSource codes; 0 is unknown.
        color_matrices: (n, 3, 3) XYZ to camera (ColorMatrix).
        forward_matrices: (n, 3, 3) white-balanced camera to XYZ D50 (ForwardMatrix), or None.
        camera_calibrations: (n, 3, 3) this camera against its model (CameraCalibration).
        analog_balance: (3,) gains before the converter (AnalogBalance).
    """

    illuminants: tuple[int, ...]
    color_matrices: np.ndarray
    forward_matrices: np.ndarray | None
    camera_calibrations: np.ndarray
    analog_balance: np.ndarray

    def at(self, xy: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray | None]:
        """XYZ to camera, reference camera to this one, and forward matrix, in light of chromaticity `xy`."""
        weight = self._weight(xy)

        def mix(matrices: np.ndarray) -> np.ndarray:
            return weight * matrices[0] + (1 - weight) * matrices[-1]

        to_this = np.diag(self.analog_balance) @ mix(self.camera_calibrations)
        forward = None if self.forward_matrices is None else mix(self.forward_matrices)
        return to_this @ mix(self.color_matrices), to_this, forward

    def _weight(self, xy: np.ndarray) -> float:
        """Share of the first illuminant: linear in inverse temperature, held outside the two."""
        first, last = (_TEMPERATURES.get(i, 0) for i in (self.illuminants[0], self.illuminants[-1]))
        if first == last or not (first and last):
            return 1.0
        share = (1 / temperature(xy) - 1 / last) / (1 / first - 1 / last)
        return float(np.clip(share, 0, 1))


def temperature(xy: np.ndarray) -> float:
    """Correlated colour temperature [K] of a chromaticity. Source: McCamy 1992."""
    x, y = xy
    n = (x - 0.3320) / (0.1858 - y) if y != 0.1858 else 0.0
    return float(np.clip(((449 * n + 3525) * n + 6823.3) * n + 5520.33, 1000, 40000))


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
    """Whether it is a 3x3 matrix that can be inverted."""
    if matrix is None or matrix.shape != (3, 3) or not np.isfinite(matrix).all():
        return False
    return bool(np.linalg.cond(matrix) < 1e4)


def _unit_rows(matrix: np.ndarray) -> np.ndarray:
    return matrix / matrix.sum(1, keepdims=True)
