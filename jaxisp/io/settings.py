"""dataset.toml: what it states of a folder's pairs, for all and by stem."""

import os
import re
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from jaxisp.errors import InputError, short
from jaxisp.io.description import RawDescription, describe
from jaxisp.io.files import read_toml

_FRAME = re.compile(r"(.+)\.f(\d{2,})")


def scene_and_frame(stem: str) -> tuple[str, int | None]:
    """A stem without its frame, and the frame."""
    frame = _FRAME.fullmatch(stem)
    return (frame[1], int(frame[2])) if frame else (stem, None)


@dataclass(frozen=True)
class Settings:
    """What dataset.toml states for a pair.

    Args:
        camera: its name.
        iso: for files that do not state it.
        clean_encoding: "srgb" or "linear".
        raw: for a mosaic without a header; overrides a header.
        cropped: the picture is a decoded crop of the camera's JPEG: its 8x8 grid may start anywhere.
    """

    camera: str = ""
    iso: float | None = None
    clean_encoding: str = "srgb"
    raw: RawDescription | None = None
    cropped: bool = False


class SettingsFile:
    """The dataset.toml of a folder, checked; all defaults where there is none."""

    def __init__(self, folder: Path):
        path = folder / "dataset.toml"
        self.source = str(path)
        table = read_toml(path) if os.path.lexists(path) else {}
        self._common = {key: value for key, value in table.items() if key in _CHECKS}
        self._overrides: dict[str, dict[str, Any]] = {}
        for key, value in table.items():
            if key not in _CHECKS and not isinstance(value, dict):
                raise InputError(
                    f"{path}: unknown key {key!r}, expected {', '.join(_CHECKS)} or a table named as a pair"
                )
            if key not in _CHECKS:
                self._overrides.update(_stems(key, value))
        self.common = self.of()

    def check_stems(self, stems: Iterable[str]) -> None:
        """Raise InputError where a table is the name of no file."""
        every = [name for stem in stems for name in (stem, re.sub(r"\.[ab]$", "", stem))]
        known = {name for stem in every for name in (stem, scene_and_frame(stem)[0])}
        for stem in self._overrides:
            if stem not in known:
                raise InputError(f"{self.source}: [{stem}] names no files of this folder")

    def of(self, stem: str = "") -> Settings:
        """The settings for all, overridden by those of the stem's scene, and these by its own."""
        merged: dict[str, Any] = {}
        stems = dict.fromkeys((scene_and_frame(stem)[0], stem))
        for where, table in (("", self._common), *((f"[{s}] ", self._overrides.get(s, {})) for s in stems)):
            _check(table, f"{self.source}: {where}")
            for key, value in table.items():
                merged[key] = {**merged.get(key, {}), **value} if isinstance(value, dict) else value
        raw, jpeg = merged.pop("raw", None), merged.pop("jpeg", {})
        return Settings(
            **merged,
            raw=None if raw is None else describe(raw, self.source),
            cropped=jpeg.get("cropped", False),
        )


def _is_positive(value: Any) -> bool:
    return isinstance(value, (int, float)) and not isinstance(value, bool) and 0 < value < 1e8


def _is_jpeg_table(value: Any) -> bool:
    return isinstance(value, dict) and all(k == "cropped" and isinstance(v, bool) for k, v in value.items())


_CHECKS: dict[str, tuple[Callable[[Any], bool], str]] = {
    "camera": (lambda v: isinstance(v, str), "text"),
    "iso": (_is_positive, "a positive number"),
    "clean_encoding": (lambda v: v in ("srgb", "linear"), '"srgb" or "linear"'),
    "raw": (lambda v: isinstance(v, dict), "a table"),
    "jpeg": (_is_jpeg_table, "a table with cropped = true or false"),
}


def _check(table: dict[str, Any], where: str) -> None:
    for key, value in table.items():
        if key not in _CHECKS:
            raise InputError(f"{where}unknown key {key!r}, expected {', '.join(_CHECKS)}")
        fine, wanted = _CHECKS[key]
        if not fine(value):
            raise InputError(f"{where}{key} = {short(value)}, expected {wanted}")


def _stems(key: str, table: dict[str, Any]) -> dict[str, dict[str, Any]]:
    """`[a.f00]` without quotes is a table within a table: join the names again."""
    own = {k: v for k, v in table.items() if k in _CHECKS or not isinstance(v, dict)}
    out = {key: own} if own or not table else {}
    for name, value in table.items():
        if name not in own:
            out.update(_stems(f"{key}.{name}", value))
    return out
