"""RAW files: photographs seen through published sensors, and tiles of real RAW frames."""

import dataclasses
import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from jaxisp.io import read_raw
from jaxisp.io.dng import write_dng

from . import scenes
from .chance import HALVES, order

_TO_XYZ = np.array(
    [[0.4124564, 0.3575761, 0.1804375], [0.2126729, 0.7151522, 0.0721750], [0.0193339, 0.1191920, 0.9503041]]
)
"""Linear sRGB to XYZ (D65)."""
_WHITE = 4095


@dataclasses.dataclass(frozen=True)
class Sensor:
    """A simulated camera.

    Attributes:
        tuning: file of `calibration/libcamera`, which has colour matrices and gains by colour temperature.
        kelvin: of the light.
        cfa: Bayer pattern.
        noise: entry of `calibration/noise_tables/phone_dng_noise_models.json`.
        iso: of that.
        black: level of 12 bits.
        exposure: share of the range that white takes.
    """

    tuning: str
    kelvin: float
    cfa: str
    noise: str
    iso: int
    black: int = 256
    exposure: float = 1.0


SENSORS = {
    "imx219": Sensor("imx219", 4600, "BGGR", "IMX586 binned-average", 200),
    "imx296": Sensor("imx296", 5600, "RGGB", "IMX481 (phone ultrawide)", 100, 240, 0.9),
    "imx378": Sensor("imx378", 5600, "GRBG", "IMX586 binned-average", 100),
    "imx477": Sensor("imx477", 3700, "GBRG", "IMX481 (phone ultrawide)", 200, 256, 0.95),
    "ov5647": Sensor("ov5647", 5699, "RGGB", "IMX586 48MP", 50, 64),
}
REAL = ("checker", "indoor", "kissx4", "outdoor")
CAMERAS = (*SENSORS, *REAL)


@dataclasses.dataclass(frozen=True)
class Frame:
    """A mosaic with what a DNG states of it: (H, W) uint16, and the arguments of `write_dng`."""

    mosaic: np.ndarray
    about: dict[str, Any]

    def save(self, path: Path) -> None:
        write_dng(path, self.mosaic, **self.about)


def frames(data: Path, camera: str, half: str, count: int, size: int) -> Iterator[Frame]:
    """The RAW frames of a camera; the halves share no photograph and no tile."""
    if camera in SENSORS:
        for place in scenes.chosen(data, half, camera, count):
            light, scene = scenes.light(place, size), f"{place[0].stem} {place[1]}"
            yield exposed(data, camera, SENSORS[camera], light, scene)
        return
    whole = _REAL[camera](data)
    for top, left in _tiles(whole, half, count, size):
        yield dataclasses.replace(whole, mosaic=whole.mosaic[top : top + size, left : left + size])


def exposed(
    data: Path, camera: str, sensor: Sensor, light: np.ndarray, scene: str, *, noisy: bool = True
) -> Frame:
    """Photons counted by a sensor: the published matrix undone, a mosaic, shot and read noise, 12 bits."""
    matrix, gains = tuning(data, sensor)
    seen = np.clip(light @ np.linalg.inv(matrix).T / gains, 0, None)
    y, x = np.mgrid[: light.shape[0], : light.shape[1]]
    channel = np.array(["RGB".index(c) for c in sensor.cfa]).reshape(2, 2)[y % 2, x % 2]
    mosaic = sensor.exposure * np.take_along_axis(seen, channel[..., None], 2)[..., 0]
    if noisy:
        shot, read = noise(data, sensor)
        rng = np.random.default_rng(order(camera, scene))
        mosaic = mosaic + np.sqrt(shot * mosaic + read) * rng.standard_normal(mosaic.shape)
    codes = np.rint(sensor.black + mosaic * (_WHITE - sensor.black))
    about = _about(camera, sensor.cfa, sensor.black, matrix, gains) | {"iso": sensor.iso}
    return Frame(np.clip(codes, 0, _WHITE).astype(np.uint16), about)


def _about(camera: str, cfa: str, black: int, matrix: np.ndarray, gains: np.ndarray) -> dict[str, Any]:
    return {
        "cfa": cfa,
        "black": [black],
        "white": _WHITE,
        "model": camera,
        "make": "third party",
        "color_matrix": np.linalg.inv(_TO_XYZ @ matrix @ np.diag(gains)),
        "as_shot_neutral": 1 / gains,
    }


def tuning(data: Path, sensor: Sensor) -> tuple[np.ndarray, np.ndarray]:
    """(3, 3) from balanced sensor RGB to linear sRGB, and the gains (3,) of this light, green's 1."""
    found = json.loads((data / "calibration" / "libcamera" / f"{sensor.tuning}.json").read_text())
    parts = {name: value for own in found["algorithms"] for name, value in own.items()}
    near = min(parts["rpi.ccm"]["ccms"], key=lambda own: abs(own["ct"] - sensor.kelvin))
    curve = np.array(parts["rpi.awb"]["ct_curve"], float).reshape(-1, 3)
    red, blue = (np.interp(sensor.kelvin, curve[:, 0], curve[:, i]) for i in (1, 2))
    matrix = np.array(near["ccm"], float).reshape(3, 3)
    return matrix / matrix.sum(1, keepdims=True), np.array([1 / red, 1, 1 / blue])


def noise(data: Path, sensor: Sensor) -> tuple[float, float]:
    """Shot and read noise: the variance is `shot * x + read` for x in [0, 1]."""
    tables = json.loads((data / "calibration" / "noise_tables" / "phone_dng_noise_models.json").read_text())
    own = {name: float(np.mean(tables[sensor.noise][name])) for name in "ABCD"}
    shot = own["A"] * sensor.iso + own["B"]
    return max(shot, 1e-5), max(own["C"] * sensor.iso**2 + own["D"], 1e-8)


def _tiles(whole: Frame, half: str, count: int, size: int) -> list[tuple[int, int]]:
    """(top, left) of the tiles with most detail, every second of them: neighbours share no pixel."""
    height, width = (n // size for n in whole.mosaic.shape)
    black, white = float(np.mean(whole.about["black"])), float(whole.about["white"])
    found = []
    for row in range(height):
        for column in range(width):
            tile = whole.mosaic[row * size : (row + 1) * size, column * size : (column + 1) * size]
            value = np.sqrt(np.clip((tile[::2, ::2] - black) / (white - black), 0, 1))
            slope = np.abs(np.diff(cv2.GaussianBlur(value, (0, 0), 1.5), axis=0)).mean()
            found.append((slope if np.mean(tile >= 0.98 * white) < 0.05 else 0.0, row * size, column * size))
    best = sorted(found, reverse=True)[: 2 * count]
    return [(top, left) for _, top, left in best[HALVES.index(half) :: 2]]


def _checker(data: Path) -> Frame:
    mosaic = np.fromfile(data / "raw" / "ColorCheckerRAW_1920x1080_12bit_BGGR.raw", "<u2").reshape(1080, 1920)
    return _described(data, mosaic, "BGGR", 200, _WHITE, "checker")


def _kiss(data: Path) -> Frame:
    raw = read_raw(data / "raw" / "canon_kissx4_magiclantern_colorchart.dng")
    codes = np.rint(2056 + raw.mosaic * (15000 - 2056))
    mosaic = np.clip(codes, 0, 16383).astype(np.uint16)
    brightest = round(1.05 * float(np.quantile(mosaic, 0.999)))  # the frame is dim
    return _described(data, mosaic, raw.cfa, 2056, brightest, "kissx4")


def _infinite(data: Path, *names: str) -> Frame:
    """Frames of 8 bits beside each other, at the levels of 12 bits; the pattern goes on across the seam."""
    read = [
        cv2.imread(
            str(data / "raw" / "infinite_isp" / f"{name}_2592x1536_8bit_GRBG.png"), cv2.IMREAD_UNCHANGED
        )
        for name in names
    ]
    mosaic = np.concatenate([np.asarray(r, np.uint16) * 16 for r in read], 1)
    return _described(data, mosaic, "GRBG", 200, 255 * 16, names[0].lower()[:-1])


_REAL = {
    "checker": _checker,
    "kissx4": _kiss,
    "indoor": lambda data: _infinite(data, "Indoor1"),
    "outdoor": lambda data: _infinite(data, "Outdoor1", "Outdoor2"),
}


def _described(data: Path, mosaic: np.ndarray, cfa: str, black: int, white: int, camera: str) -> Frame:
    """A frame whose file says nothing of its colours: grey on average, a published sensor's matrix."""
    even = mosaic[: mosaic.shape[0] // 2 * 2, : mosaic.shape[1] // 2 * 2].astype(float) - black
    cell = [even[i // 2 :: 2, i % 2 :: 2].mean() for i in range(4)]
    means = np.array([np.mean([m for m, c in zip(cell, cfa) if c == color]) for color in "RGB"])
    gains = means[1] / means
    matrix, _ = tuning(data, SENSORS["imx477"])
    return Frame(mosaic, _about(camera, cfa, black, matrix, gains) | {"white": white})
