"""Many large files: time and memory."""

import os
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image

from experiments.fit_phones.common import SEED, Cases, Run
from jaxisp.samples import PHONES, scene, write_pairs

MEASURE = """
import resource, sys
from jaxisp.fit import fit_dataset
found = fit_dataset(sys.argv[1])
peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
print(found.seconds, found.as_dict()["held_out"]["psnr"], peak)
"""


def runs(data: Path | None) -> dict[str, Run]:
    return {"ten": large}


def large(count: int = 10, size: tuple[int, int] = (3000, 4000)) -> dict[str, Any]:
    """One 12-megapixel pair under `count` names: what a fit of many large files takes."""
    picture = Image.fromarray(np.uint8(255 * scene("coffee", 400) ** (1 / 2.2))).resize(
        size[::-1], Image.Resampling.BICUBIC
    )
    light = (np.asarray(picture) / np.float32(255)) ** 2.2
    with tempfile.TemporaryDirectory() as temporary:
        folder = Path(temporary)
        write_pairs(folder, PHONES["a"], {"large0": light}, SEED)
        for i in range(1, count):
            for ending in ("dng", "jpg"):
                os.link(folder / f"large0.{ending}", folder / f"large{i}.{ending}")
        command = [sys.executable, "-c", MEASURE, str(folder)]
        printed = subprocess.run(command, check=True, capture_output=True, text=True).stdout.split()
    return dict(zip(("seconds", "held_out_psnr", "peak_kib"), map(float, printed))) | {"pairs": count}


def page(cases: Cases) -> list[str]:
    r = cases["ten"]
    return [
        "## Large files",
        "",
        f"{r['pairs']} pairs of 12 megapixels (one pair under {r['pairs']} names): {r['seconds']:.0f} s, "
        f"at most {r['peak_kib'] / 2**20:.1f} GiB, {r['held_out_psnr']:.2f} dB held out.",
    ]
