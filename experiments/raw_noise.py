"""Noise measured in one RAW, against the noise between frames and against noise that is known.

    python -m experiments.raw_noise DATA

DATA has imx296/static.f*.dng, frames of one scene that does not move, and iphone7/.
"""

import argparse
import json
from pathlib import Path
from typing import Any

import numpy as np
from scipy import ndimage

from jaxisp.fit import estimate_raw_noise
from jaxisp.io import open_dataset, read_raw

LEVELS = (0.02, 0.1, 0.5)
SHOT, READ, TIMES = 4e-4, 2e-3, 30


def between_frames(folder: Path) -> list[dict[str, Any]]:
    """Shot noise of each colour from the variance over frames by level, and from the first frame alone."""
    frames = [read_raw(path) for path in sorted(folder.glob("static.f*.dng"))]
    cfa, stack = frames[0].cfa, np.stack([frame.mosaic for frame in frames]).astype(np.float64)
    alone = estimate_raw_noise(frames[0].mosaic, cfa)
    assert alone is not None
    rows = []
    for i, colour in enumerate("RGB"):
        planes = [
            stack[:, k // 2 :: 2, k % 2 :: 2].reshape(len(stack), -1) for k in range(4) if cfa[k] == colour
        ]
        values = np.concatenate(planes, axis=1)
        mean, variance = values.mean(0), values.var(0, ddof=1)
        parts = np.array_split(np.argsort(mean), 40)
        x, y = (np.asarray([a[part].mean() for part in parts]) for a in (mean, variance))
        line = np.linalg.lstsq(np.stack([x, np.ones_like(x)], 1) / y[:, None], np.ones_like(x), rcond=None)[0]
        rows.append({"colour": colour, "frames": float(line[0]), "alone": float(alone[i, 0])})
    return rows


def simulated() -> list[dict[str, Any]]:
    """Standard deviation of known noise as it is found, over its own: mean and spread."""
    found = []
    for seed in range(TIMES):
        rng = np.random.default_rng(seed)
        smooth = ndimage.gaussian_filter(rng.standard_normal((512, 640)), 40)
        light = 0.002 + 0.65 * ((smooth - smooth.min()) / np.ptp(smooth)) ** 3
        mosaic = rng.poisson(light / SHOT) * SHOT + READ * rng.standard_normal(light.shape)
        line = estimate_raw_noise(mosaic, "RGGB")
        assert line is not None
        found.append([[np.sqrt(s * x + r * r) for x in LEVELS] for s, r in line])
    ratio = np.asarray(found) / [np.sqrt(SHOT * x + READ**2) for x in LEVELS]
    return [
        {
            "colour": c,
            "level": x,
            "mean": float(ratio[:, i, j].mean()),
            "spread": float(ratio[:, i, j].std(ddof=1)),
        }
        for i, c in enumerate("RGB")
        for j, x in enumerate(LEVELS)
    ]


def gains(folder: Path) -> list[float]:
    """A file's white balance before it was written: by how much red and blue are noisier than green."""
    raw = next(iter(open_dataset(folder).pairs)).load().raw
    assert raw is not None
    line = estimate_raw_noise(raw.mosaic, raw.cfa)
    assert line is not None
    return [float(v) for v in line[:, 0] / line[1, 0]]


def markdown(results: dict[str, Any]) -> str:
    lines = ["# Noise measured in one RAW", "", "`python -m experiments.raw_noise DATA`", ""]
    lines += ["IMX296, shot noise (variance per unit of light), from five frames and from one:", ""]
    lines += ["| colour | five frames | one frame |", "| --- | --- | --- |"]
    lines += [f"| {r['colour']} | {r['frames']:.3g} | {r['alone']:.3g} |" for r in results["imx296"]]
    lines += [
        "",
        f"Noise that is known, 512x640, {TIMES} pictures: standard deviation found over the true one.",
        "",
    ]
    lines += ["| colour | level | mean | spread |", "| --- | --- | --- | --- |"]
    lines += [
        f"| {r['colour']} | {r['level']} | {r['mean']:.3f} | {r['spread']:.3f} |"
        for r in results["simulated"]
    ]
    red, _, blue = results["iphone7"]
    lines += [
        "",
        f"iPhone 7, balanced before it was written by 2.49 and 1.74: found {red:.2f} and {blue:.2f}.",
        "",
    ]
    return "\n".join(lines)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("data", type=Path)
    parser.add_argument("--out", type=Path, default=Path("docs/results"))
    arguments = parser.parse_args()
    results = {
        "imx296": between_frames(arguments.data / "imx296"),
        "simulated": simulated(),
        "iphone7": gains(arguments.data / "iphone7"),
    }
    (arguments.out / "raw-noise.json").write_text(json.dumps(results, indent=1) + "\n")
    (arguments.out / "raw-noise.md").write_text(markdown(results))


if __name__ == "__main__":
    main()
