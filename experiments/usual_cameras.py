"""What real cameras are like, for `jaxisp.fit.usual`: derives the numbers that stand there.

`python -m experiments.usual_cameras CALIBRATION`, a folder with libcamera's tuning files (`libcamera/*.json`:
measured matrices from balanced camera RGB to linear sRGB, at several colour temperatures) and with the
database of response functions (`crf/dorfCurvesInv.mat`, Grossberg and Nayar 2004).
"""

import argparse
import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import scipy.io

ZONES = 8
DIRECTIONS = 3
STEEPEST = 1e-2  # smallest slope that is told from none


def main() -> None:
    parser = argparse.ArgumentParser(description="Derive the numbers of jaxisp.fit.usual.")
    parser.add_argument("calibration", type=Path)
    folder = parser.parse_args().calibration
    np.set_printoptions(precision=4, suppress=True, floatmode="fixed")
    found = matrices(folder / "libcamera") | curves(folder / "crf" / "dorfCurvesInv.mat")
    for name, value in found.items():
        print(f"{name} =\n{np.array2string(np.asarray(value), separator=', ')}")


def matrices(folder: Path) -> dict[str, np.ndarray]:
    """Mean and covariance of the entries off the diagonal, rows summing to 1; each sensor weighs the same."""
    sensors = [list(_found(json.loads(path.read_text()), "ccm")) for path in sorted(folder.glob("*.json"))]
    entries = [np.reshape(found, (-1, 3, 3))[:, ~np.eye(3, dtype=bool)] for found in sensors if found]
    weights = np.concatenate([np.full(len(own), 1 / len(own) / len(entries)) for own in entries])
    every = np.concatenate(entries)
    return {
        "MATRIX_MEAN": weights @ every,
        "MATRIX_COVARIANCE": np.cov(every.T, aweights=weights, ddof=0),
    }


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
