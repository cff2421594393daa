"""Picture files: a colour table of our own, decoding, and how far two pictures are apart."""

from pathlib import Path

import cv2
import numpy as np

_LEVEL = 8
"""Of the table: 64 values a channel, in a picture of 512x512."""


def write_hald(path: Path) -> Path:
    """A film's look as a HaldCLUT: greens turned to teal, reds warmed, blues muted, greys left alone."""
    side = _LEVEL**2
    blue, green, red = np.meshgrid(*[np.linspace(0, 1, side)] * 3, indexing="ij")
    rgb = np.stack([red, green, blue], -1)
    luma = rgb @ np.array([0.299, 0.587, 0.114])
    chroma = rgb - luma[..., None]
    hue = np.arctan2(
        np.sqrt(3) * (chroma[..., 1] - chroma[..., 2]), 2 * chroma[..., 0] - chroma[..., 1] - chroma[..., 2]
    )
    turn = 0.35 * np.exp(-(((hue - 2.1) / 0.8) ** 2)) - 0.2 * np.exp(-((hue / 0.6) ** 2))
    scale = 1 - 0.45 * np.exp(-(((hue + 2.1) / 0.8) ** 2)) + 0.25 * np.exp(-((hue / 0.6) ** 2))
    first, second = np.array([1, -0.5, -0.5]), np.array([0, 1, -1]) * np.sqrt(3) / 2
    size = np.linalg.norm(chroma, axis=-1) * scale
    angle = np.arctan2(chroma @ second, chroma @ first) + turn
    unit = (np.cos(angle)[..., None] * first + np.sin(angle)[..., None] * second) / np.sqrt(1.5)
    looked = np.clip(luma[..., None] + size[..., None] * unit, 0, 1)
    picture = np.rint(65535 * looked.reshape(_LEVEL**3, _LEVEL**3, 3)).astype(np.uint16)
    cv2.imwrite(str(path), picture[..., ::-1])
    return path


def to_png(path: Path) -> Path:
    """The pixels of a picture file in a PNG of 8 bits beside it, which replaces it."""
    found = path.with_suffix(".png")
    cv2.imwrite(str(found), decoded(path))
    path.unlink()
    return found


def decoded(path: Path) -> np.ndarray:
    """(H, W, 3) uint8 in OpenCV's order."""
    picture = cv2.imread(str(path), cv2.IMREAD_COLOR)
    if picture is None:
        raise ValueError(f"{path}: not a picture that OpenCV reads")
    return picture


def apart(one: Path, other: Path) -> float:
    """Root mean square difference in Y'CbCr over the three channels [8-bit steps].

    Raises:
        ValueError: the pictures have two sizes.
    """
    both = [cv2.cvtColor(decoded(path), cv2.COLOR_BGR2YCrCb).astype(float) for path in (one, other)]
    if both[0].shape != both[1].shape:
        sizes = " and ".join("x".join(map(str, picture.shape[1::-1])) for picture in both)
        raise ValueError(f"{one} and {other}: {sizes} px, must have one size")
    return float(np.sqrt(((both[0] - both[1]) ** 2).sum(-1).mean()))
