"""What real cameras are like, for `jaxisp.fit.usual`: derives the numbers that stand there.

`python -m experiments.usual_cameras CALIBRATION PROFILES`. CALIBRATION is a folder with libcamera's tuning
files (`libcamera/*.json`: measured matrices from balanced camera RGB to linear sRGB, at several colour
temperatures) and with the database of response functions (`crf/dorfCurvesInv.mat`, Grossberg and Nayar 2004).
PROFILES is a folder of DNG camera profiles (`*.dcp`), of which the ColorMatrix of each illuminant is read:
those of RawTherapee 5.9, on Debian in /usr/share/rawtherapee/dcpprofiles. `--check CAMERAS` measures the
matrices' Gaussian on others: those that rawspeed's cameras.xml has for D65, on Debian in
/usr/share/darktable/rawspeed.
"""

import argparse
import io
import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np
import scipy.io
import tifffile

from jaxisp.fit.usual import LOOK
from jaxisp.io import tags as tag
from jaxisp.io.calibration import camera_to_srgb, camera_to_srgb_d65, neutral_of, usable
from jaxisp.io.dng_color import calibration

ZONES = 8
DIRECTIONS = 3
STEEPEST = 1e-2  # smallest slope that is told from none
OFF_DIAGONAL = ~np.eye(3, dtype=bool)
WHITES = {17: (0.44757, 0.40745), 21: (0.31271, 0.32902), 23: (0.34567, 0.35850)}
"""Chromaticities x, y of the illuminants of profiles: standard light A, D65, D50 (CIE 015)."""


def main() -> None:
    parser = argparse.ArgumentParser(description="Derive the numbers of jaxisp.fit.usual.")
    parser.add_argument("calibration", type=Path)
    parser.add_argument("profiles", type=Path)
    parser.add_argument("--check", type=Path, metavar="CAMERAS")
    parsed = parser.parse_args()
    folder = parsed.calibration
    np.set_printoptions(precision=4, suppress=True, floatmode="fixed")
    few = list(libcamera(folder / "libcamera"))
    sensors = [*few, *profiles(parsed.profiles)]
    print(f"# {len(sensors)} sensors, {len(np.concatenate(sensors))} matrices")
    found = matrices(sensors) | curves(folder / "crf" / "dorfCurvesInv.mat")
    for name, value in found.items():
        print(f"{name} =\n{np.array2string(np.asarray(value), separator=', ')}")
    if parsed.check:
        others = d65(parsed.check)
        print(f"# mean log density of {len(others)} other matrices: {density(others, sensors):.2f}, ", end="")
        print(f"by libcamera's {len(few)} sensors {density(others, few):.2f}")
        print(f"# without one camera the means move by at most {influence(sensors):.3f} standard deviations")


def moments(sensors: list[np.ndarray]) -> tuple[np.ndarray, np.ndarray]:
    """Mean and covariance that one more sensor has, its look included."""
    found, count = matrices(sensors), len(sensors)
    wider = (count + 1) / (count - 1)
    return found["MATRIX_MEAN"], wider * found["MATRIX_COVARIANCE"] + LOOK**2 * np.eye(6)


def density(matrices: np.ndarray, sensors: list[np.ndarray]) -> float:
    """Mean log density of (n, 6) matrices, constant left out."""
    mean, covariance = moments(sensors)
    off = matrices - mean
    squared = np.einsum("ni,ij,nj->n", off, np.linalg.inv(covariance), off)
    return float(-(squared.mean() + np.linalg.slogdet(covariance)[1]) / 2)


def influence(sensors: list[np.ndarray]) -> float:
    mean, covariance = moments(sensors)
    means = [matrices(sensors[:i] + sensors[i + 1 :])["MATRIX_MEAN"] for i in range(len(sensors))]
    return float((np.abs(np.asarray(means) - mean) / np.sqrt(np.diag(covariance))).max())


def d65(path: Path) -> np.ndarray:
    """(n, 6) of cameras that differ."""
    rows = [
        [list(map(int, (row.text or "").split())) for row in stated.iter("ColorMatrixRow")]
        for stated in ElementTree.parse(path).iter("ColorMatrix")
        if stated.get("planes") == "3"
    ]
    found = [camera_to_srgb_d65(m)[OFF_DIAGONAL] for m in np.asarray(rows) / 1e4 if usable(m)]
    return np.unique(np.round(found, 3), axis=0)


def matrices(sensors: list[np.ndarray]) -> dict[str, np.ndarray]:
    """Mean and covariance of the entries off the diagonal, rows summing to 1; each sensor weighs the same.

    sensors: (n, 6) each, one row a light.
    """
    weights = np.concatenate([np.full(len(own), 1 / len(own) / len(sensors)) for own in sensors])
    every = np.concatenate(sensors)
    return {
        "MATRIX_MEAN": weights @ every,
        "MATRIX_COVARIANCE": np.cov(every.T, aweights=weights, ddof=0),
    }


def libcamera(folder: Path) -> Iterator[np.ndarray]:
    for path in sorted(folder.glob("*.json")):
        if found := list(_found(json.loads(path.read_text()), "ccm")):
            yield np.reshape(found, (-1, 3, 3))[:, OFF_DIAGONAL]


def profiles(folder: Path) -> Iterator[np.ndarray]:
    """Of each profile its ColorMatrix at each illuminant; a TIFF file but for its magic number."""
    for path in sorted(folder.glob("*.dcp")):
        data = path.read_bytes()
        with tag.quiet_tifffile(), tifffile.TiffFile(io.BytesIO(data[:2] + b"*\0" + data[4:])) as file:
            stated = {t.code: t.value for t in file.pages[0].tags}
        wanted = {
            code: np.asarray(stated[code][::2], float) / stated[code][1::2]
            for code in tag.COLOR_MATRICES if code in stated
        } | {code: stated[code] for code in tag.ILLUMINANTS if code in stated}  # fmt: skip
        known = calibration(tag.DngTags(wanted, {}), lambda text: None)
        if known is None:
            continue
        lights = [WHITES[light] for light in known.illuminants if isinstance(light, int) and light in WHITES]
        if lights:
            neutrals = [neutral_of(known, np.asarray(xy)) for xy in lights]
            yield np.stack([camera_to_srgb(known, own)[OFF_DIAGONAL] for own in neutrals])


def curves(path: Path) -> dict[str, Any]:
    """Log slopes between equal steps of the sRGB encoding: mean, main directions, variance of the rest."""
    stored = scipy.io.loadmat(path)
    encoded = np.arange(ZONES + 1) / ZONES
    light = np.where(encoded <= 0.04045, encoded / 12.92, ((encoded + 0.055) / 1.055) ** 2.4)
    levels = np.stack([np.interp(light, x, y) for x, y in zip(stored["invI"], stored["invB"])])
    slopes = np.log(np.maximum(np.diff(levels, axis=1) * ZONES, STEEPEST))
    values, vectors = np.linalg.eigh(np.cov(slopes.T))
    kept = slice(-1, -DIRECTIONS - 1, -1)
    return {
        "CURVE_MEAN": slopes.mean(0),
        "CURVE_DIRECTIONS": (vectors * np.sqrt(values)).T[kept],
        "CURVE_REST": values[:-DIRECTIONS].mean(),
    }


def _found(tree: Any, key: str) -> Iterator[Any]:
    """All values of a key."""
    for name, value in tree.items() if isinstance(tree, dict) else enumerate(tree):
        if name == key:
            yield value
        elif isinstance(value, dict | list):
            yield from _found(value, key)


if __name__ == "__main__":
    main()
