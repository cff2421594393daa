"""Write the cases of a half: a data set in each folder, with what is true of it in truth.json."""

import json
import os
import re
import shutil
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from .cameras import frames
from .cases import CONVERTERS, Case, cases
from .pictures import apart, to_png

_COUNT = 6


def make(data: Path, out: Path, half: str, size: int, match: str, levels: Sequence[int]) -> None:
    """Write every case of these strengths whose name matches and that does not stand yet."""
    for case in cases(half):
        if not case.level or (case.level in levels and re.search(match, case.name)):
            folder = out / case.name
            if not stands(folder, case):
                try:
                    truth = write(data, out, case, size)
                except (RuntimeError, OSError, ValueError) as error:  # told, and the others are made
                    print(f"{case.name}: {error}", flush=True)
                    shutil.rmtree(folder, ignore_errors=True)
                    continue
                print(case.name, truth["truth"], truth["apart"], flush=True)


def stands(folder: Path, case: Case) -> bool:
    """Whether a folder holds a case as it is written today: with these settings, and of its plain's size.

    A version before 4100fad enlarged what RawTherapee resizes by what its border cuts off, and wrote no
    distance to the plain picture.
    """
    if not (folder / "truth.json").exists():
        return False
    truth = json.loads((folder / "truth.json").read_text())
    return truth["settings"] == _said(case) and truth["apart"] is not None


def _said(case: Case) -> dict[str, str]:
    return {name: str(value) for name, value in case.settings.items()}


def write(data: Path, out: Path, case: Case, size: int) -> dict[str, Any]:
    """One case; returns what is written to truth.json.

    Raises:
        ValueError: a picture has not the size of its plain one; no switch changes the size.
    """
    raws = _raws(data, out, case, size)
    folder = out / case.name
    folder.mkdir(parents=True, exist_ok=True)
    for raw in raws:
        (folder / raw.name).unlink(missing_ok=True)
        os.link(raw, folder / raw.name)
    pictures = CONVERTERS[case.converter].develop(raws, case.camera, case.settings, folder)
    if "lossless" in case.settings:
        pictures = [to_png(path) for path in pictures]
    before = out / case.plain.name
    far = [apart(before / path.name, path) for path in pictures] if case.level else [0.0]
    truth = {
        "case": case.name,
        "converter": case.converter,
        "camera": case.camera,
        "switch": case.switch,
        "level": case.level,
        "half": case.half,
        "truth": case.what.truth,
        "also": list(case.what.also),
        "plain": case.plain.name,
        "settings": _said(case),
        "apart": round(float(np.sqrt(np.mean(np.square(far)))), 3),
    }
    (folder / "dataset.toml").write_text(f'camera = "{case.converter} {case.camera}"\n')
    (folder / "truth.json").write_text(json.dumps(truth, indent=1) + "\n")
    return truth


def _raws(data: Path, out: Path, case: Case, size: int) -> list[Path]:
    """The RAW files of a camera, written once; the folders of its cases have links to them."""
    kept = out / ".raw" / case.camera
    paths = [kept / f"s{i}.dng" for i in range(_COUNT)]
    if not all(path.exists() for path in paths):
        kept.mkdir(parents=True, exist_ok=True)
        for path, frame in zip(paths, frames(data, case.camera, case.half, _COUNT, size), strict=True):
            frame.save(path)
    return paths
