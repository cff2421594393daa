"""The readers that are given damaged files, and what may come of one."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from experiments.abuse import kept
from jaxisp.calibrate.noise import Calibrated
from jaxisp.data.catalogue import read_sums
from jaxisp.errors import InputError
from jaxisp.io import read_image, read_jpeg, read_raw
from jaxisp.io.description import RawDescription
from jaxisp.io.icc import by_tables, profile_space
from jaxisp.io.libraw import embedded_jpeg
from jaxisp.io.opcodes import GainMap, parse_opcodes, shading_gain
from jaxisp.io.settings import SettingsFile
from jaxisp.models.files import read_arrays
from jaxisp.recipe import Recipe
from jaxisp.recipes import find_degradation
from jaxisp.report.compare import compare, comparison_page
from jaxisp.train import TrainConfig


def _raw(path: Path) -> None:
    raw = read_raw(path)
    _finite(raw.mosaic, raw.black, raw.white_balance, raw.white)
    if raw.shading is not None:
        _finite(raw.shading)
    embedded_jpeg(path)


def _opcodes(path: Path) -> None:
    found = parse_opcodes(path.read_bytes(), str(path))
    shading_gain([opcode for opcode in found if isinstance(opcode, GainMap)], (26, 38))


def _jpeg(path: Path) -> None:
    jpeg = read_jpeg(path)
    _finite(jpeg.upright, jpeg.quality)


def _settings(path: Path) -> None:
    file = SettingsFile(path.parent)
    file.of("a.f01")


def _recipe(path: Path) -> None:
    recipe = Recipe.load(path)
    assert Recipe.from_toml(recipe.to_toml()) == recipe, "does not read back equal"


def _profile(path: Path) -> None:
    data = path.read_bytes()
    if profile_space(data, str(path)) is None:
        by_tables(np.zeros((2, 2, 3), np.uint8), data, str(path))


def _noise(path: Path) -> None:
    found = Calibrated.load(path)
    assert Calibrated.from_toml(found.to_toml()) == found, "does not read back equal"


def _finite(*values: Any) -> None:
    for value in values:
        assert np.isfinite(value).all(), "holds NaN or infinity"


READERS: dict[str, Callable[[Path], Any]] = {
    "raw": _raw,
    "mosaic": lambda path: _finite(read_raw(path, RawDescription(cfa="RGGB")).mosaic),
    "opcodes": _opcodes,
    "jpeg": _jpeg,
    "picture": lambda path: _finite(read_image(path)),
    "settings": _settings,
    "recipe": _recipe,
    "config": TrainConfig.load,
    "mixture": lambda path: find_degradation(str(path)),
    "noise": _noise,
    "profile": _profile,
    "network": read_arrays,
    "journal": kept.journal,
    "sample": kept.sample,
    "manifest": kept.manifest,
    "note": kept.note,
    "record": kept.record,
    "checkpoint": kept.checkpoint,
    "log": kept.log,
    "archive": kept.archive,
    "sums": lambda path: read_sums(path.parent),
    "report": lambda path: comparison_page(compare(path, path)),
}


def outcome(kind: str, path: Path) -> str:
    """Read a file: "accepted", "refused", or how the reader broke its promise of one clean error."""
    try:
        READERS[kind](path)
    except InputError as error:
        text = str(error)
        if "\n" in text or str(path) not in text:
            return f"unclear: {text[:300]!r}"
        return "refused" if len(text) < 2500 else f"long: {len(text)} characters, {text[:200]!r}"
    except BaseException as error:
        return f"{type(error).__name__}: {str(error)[:200]!r} at {_place(error)}"
    return "accepted"


def _place(error: BaseException) -> str:
    """The innermost line of the package that an error came through."""
    place, trace = "?", error.__traceback__
    while trace is not None:
        code = trace.tb_frame.f_code
        if "jaxisp" in code.co_filename:
            place = f"{Path(code.co_filename).name}:{trace.tb_lineno}"
        trace = trace.tb_next
    return place
