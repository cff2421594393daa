"""Scenes in linear light, cut from photographs that are shrunk until their noise and compression are gone."""

from pathlib import Path

import cv2
import numpy as np

from .chance import half_of, order

_SHRUNK = 4.0
"""Least factor: a photograph's own mosaic, noise and 8x8 blocks average out."""
_SHRUNK_FILM = 2.0
"""Likewise for scans, which have no mosaic."""
_CUTS = 2
Place = tuple[Path, int]


def places(data: Path, half: str) -> list[Place]:
    """(file, cut) of all scenes of a half; all cuts of a photograph are in one half."""
    files = sorted(p for f in ("photos", "kodak") for p in (data / "clean" / f).iterdir())
    own = [path for path in files if half_of(path.stem) == half]
    return [(path, cut) for path in own for cut in range(_CUTS if path.parent.name == "photos" else 1)]


def chosen(data: Path, half: str, camera: str, count: int) -> list[Place]:
    """The scenes that a camera sees: as many photographs as there are, before second cuts of any."""
    shuffled = sorted(places(data, half), key=lambda place: order(camera, place[0].stem))
    return sorted(shuffled, key=lambda place: place[1])[:count]


def light(place: Place, size: int) -> np.ndarray:
    """(size, size, 3) linear sRGB in [0, 1], the brightest hundredth near white."""
    path, cut = place
    picture = cv2.imread(str(path), cv2.IMREAD_COLOR)
    if picture is None:
        raise ValueError(f"{path}: not a picture that OpenCV reads")
    encoded = picture[..., ::-1].astype(np.float32) / 255
    linear = np.where(encoded <= 0.04045, encoded / 12.92, ((encoded + 0.055) / 1.055) ** 2.4)
    least = _SHRUNK if path.parent.name == "photos" else _SHRUNK_FILM
    shrunk = cv2.resize(linear, None, fx=1 / least, fy=1 / least, interpolation=cv2.INTER_AREA)
    height, width = shrunk.shape[:2]
    top, left = (height - size) // 2, round((cut + 0.5) / _CUTS * width - size / 2)
    left = int(np.clip(left, 0, width - size))
    cut_out = shrunk[top : top + size, left : left + size]
    return np.clip(0.92 * cut_out / np.quantile(cut_out, 0.995), 0, 1)
