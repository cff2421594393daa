"""Compare AHD with LibRaw's on the same mosaic, and take the differences apart.

    python -m benchmarks.ahd_libraw                      # on scikit-image's photographs, as DNG
    python -m benchmarks.ahd_libraw picture.dng ...      # on RAW files

LibRaw is set to do nothing but subtract black, balance white, clip, and demosaick to 16 linear bits in
camera colours. Ours gets the samples that LibRaw demosaicked: black subtracted, balanced, clipped, cut to
16 bits. Eight pixels at each border are left out: LibRaw fills five of them by other means.
"""

import argparse
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any
from unittest.mock import patch

import jax
import jax.numpy as jnp
import numpy as np
import rawpy
import skimage.data

from jaxisp.cfa import masks, select
from jaxisp.color import SRGB_TO_XYZ
from jaxisp.io.dng import write_dng
from jaxisp.stages.demosaic import ahd, demosaic_ahd, homogeneity

BORDER = 8
FULL = 65535
OURS: dict[str, dict[str, Any]] = {
    "paper, delta 2 (default)": {},
    "paper, delta 1": {"delta": 1},
    '`variant="libraw"`, delta 1': {"delta": 1, "variant": "libraw"},
}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("files", nargs="*", type=Path, help="RAW files; default: scikit-image's photographs")
    files = parser.parse_args().files
    print("| mosaic | AHD | PSNR [dB] | off by more than 2/65535 | by more than 0.01 |")
    print("| --- | --- | --- | --- | --- |")
    with tempfile.TemporaryDirectory() as folder:
        for path in files or photographs(Path(folder)):
            for row in compare(path):
                print(f"| {path.stem} | {row} |")


def pictures(least: int = 0) -> Iterator[tuple[str, np.ndarray]]:
    """Names and linear light in [0, 0.9], continued by mirror images to so many rows and columns."""
    for name in ("astronaut", "coffee", "chelsea"):
        picture = 0.9 * (getattr(skimage.data, name)() / 255.0) ** 2.2
        more = [(0, max(0, least - n)) for n in picture.shape[:2]]
        yield name, np.pad(picture, [*more, (0, 0)], mode="reflect")


def photographs(folder: Path) -> Iterator[Path]:
    """DNGs of linear light whose camera colours are linear sRGB."""
    for name, picture in pictures():
        yield as_dng(folder / f"{name}.dng", picture, "RGGB")


def as_dng(path: Path, picture: np.ndarray, cfa: str) -> Path:
    """What a sensor sees of a picture, whose colours are the camera's and linear sRGB."""
    mosaic = select(masks(picture.shape[:2], cfa), *(jnp.asarray(p) for p in np.moveaxis(picture, -1, 0)))
    pixels = np.round(FULL * np.asarray(mosaic)).astype(np.uint16)
    matrix = np.linalg.inv(SRGB_TO_XYZ)
    return write_dng(path, pixels, cfa=cfa, black=[0], white=FULL, color_matrix=matrix)


def compare(path: Path) -> Iterator[str]:
    """Table rows for one file."""
    theirs, mosaic, cfa, camera_to_srgb = libraw(path)
    for name, static in OURS.items():
        yield f"{name} | {agreement(demosaic(mosaic, cfa, static), theirs)}"
    with patch.object(ahd, "_clipped", lambda planes: planes):
        found = agreement(demosaic(mosaic, cfa, static), theirs)
    yield f"... without clipping the candidates | {found}"
    with patch.object(homogeneity, "lab", lab_of(camera_to_srgb, whole=False)):
        found = agreement(demosaic(mosaic, cfa, static), theirs)
    yield f"... with Lab by the camera's matrix | {found}"
    with patch.object(homogeneity, "lab", lab_of(camera_to_srgb, whole=True)):
        found = agreement(demosaic(mosaic, cfa, static), theirs)
    yield f"... and with whole numbers: Lab in 1/64 | {found}"


def libraw(
    path: Path, algorithm: Any = rawpy.DemosaicAlgorithm.AHD
) -> tuple[np.ndarray, np.ndarray, str, np.ndarray]:
    """LibRaw's picture, the mosaic it was made of, its pattern, and the matrix from camera to linear sRGB."""
    with rawpy.imread(str(path)) as raw:
        gains = np.asarray(raw.daylight_whitebalance[:3])
        gains = gains / gains.min() if (gains > 0).all() else np.ones(3)
        picture = raw.postprocess(
            demosaic_algorithm=algorithm,
            gamma=(1, 1),
            no_auto_bright=True,
            adjust_maximum_thr=0.0,
            output_color=rawpy.ColorSpace.raw,
            output_bps=16,
            user_wb=[gains[0], gains[1], gains[2], gains[1]],
            user_flip=0,
        )
        site = np.minimum(raw.raw_colors_visible, 3)
        black = np.asarray(raw.black_level_per_channel)[site]
        scale = gains[[0, 1, 2, 1]][site] * FULL / (raw.white_level - black)
        mosaic = np.floor(np.clip((raw.raw_image_visible - black) * scale, 0, FULL)) / FULL
        cfa = "".join("RGBG"[i] for i in raw.raw_pattern.ravel())
        return picture / FULL, mosaic, cfa, raw.color_matrix[:, :3].copy()


def demosaic(mosaic: np.ndarray, cfa: str, static: dict[str, Any]) -> np.ndarray:
    fn = jax.jit(lambda m: demosaic_ahd(m, cfa=cfa, **static))
    return np.asarray(fn(jnp.asarray(mosaic, jnp.float32)), np.float64)


def agreement(ours: np.ndarray, theirs: np.ndarray) -> str:
    difference = (ours - theirs)[BORDER:-BORDER, BORDER:-BORDER]
    worst = np.abs(difference).max(axis=-1)
    psnr = -10 * np.log10(np.mean(difference**2))
    return f"{psnr:.1f} | {np.mean(worst > 2 / FULL):.1%} | {np.mean(worst > 0.01):.2%}"


def lab_of(camera_to_srgb: np.ndarray, whole: bool) -> Any:
    """A replacement of `homogeneity.lab`: by a camera's matrix, and as 16-bit LibRaw has it if `whole`."""
    matrix = (SRGB_TO_XYZ / SRGB_TO_XYZ.sum(axis=1, keepdims=True)) @ camera_to_srgb

    def lab(rgb: Any) -> Any:
        ratios = [sum(float(w) * c for w, c in zip(m, rgb)) for m in matrix]
        if whole:
            ratios = [jnp.floor(jnp.clip(FULL * r + 0.5, 0, FULL)) / FULL for r in ratios]
        x, y, z = (homogeneity._lab_curve(r) for r in ratios)
        out = (116 * y - 16, 500 * (x - y), 200 * (y - z))
        return tuple(jnp.trunc(64 * plane) for plane in out) if whole else out

    return lab


if __name__ == "__main__":
    main()
