"""Data sets on disk: which files belong together, what dataset.toml says of them, and reading a pair."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from jaxisp.cfa import is_xtrans
from jaxisp.errors import InputError
from jaxisp.io.files import PathLike, list_folder
from jaxisp.io.images import read_image, read_with_header
from jaxisp.io.jpeg import Jpeg, decode_jpeg, read_jpeg
from jaxisp.io.libraw import embedded_jpeg
from jaxisp.io.orientation import orient, unorient
from jaxisp.io.raw import RAW_SUFFIXES, Raw, read_raw
from jaxisp.io.settings import Settings, SettingsFile, scene_and_frame
from jaxisp.shown import brief

RAW_JPEG, CLEAN_NOISY, JPEG_JPEG = "raw+jpeg", "clean+noisy", "jpeg+jpeg"
_JPEG_SUFFIXES = (".jpg", ".jpeg")
_CLEAN_SUFFIXES = (".png", ".jpg", ".jpeg", ".tif", ".tiff", ".npy")
_NOISY_SUFFIXES = (".png", ".npy", ".jpg", ".jpeg")


@dataclass(frozen=True, repr=False)
class Loaded:
    """A pair in memory.

    Args:
        picture: (H, W, 3) float32 encoded, the camera's output; beside a RAW, turned as the RAW is stored.
        jpeg: the file it came from with its tables, pixels as stored; None for PNG and NPY.
        raw: the mosaic, or None.
        clean: (H, W, 3) float32 in the encoding of `settings`, upright, or None; of two JPEGs the first.
        embedded: whether the JPEG is the one inside the RAW.
        iso: from the RAW, the JPEG or dataset.toml, in that order.
        clean_file: the file that the clean picture came from with its tables, where it is a JPEG that is
            encoded as a picture is; else None.
    """

    __repr__ = brief

    name: str
    picture: np.ndarray
    jpeg: Jpeg | None
    raw: Raw | None
    clean: np.ndarray | None
    settings: Settings
    embedded: bool
    iso: float | None
    clean_file: Jpeg | None = None


@dataclass(frozen=True)
class Pair:
    """Two files that belong together, read by `load`.

    Args:
        name: the stem, with the frame where there is one.
        scene: the stem without the frame.
        frame: number of a repeated frame, or None.
        output: the camera's picture; the RAW itself where it embeds it.
        raw, clean: the other half.
    """

    name: str
    scene: str
    frame: int | None
    output: Path
    raw: Path | None
    clean: Path | None
    settings: Settings

    def load(self) -> Loaded:
        """Read both files; InputError names the one that is bad."""
        raw = read_raw(self.raw, self.settings.raw) if self.raw else None
        if raw is not None and is_xtrans(raw.cfa):
            raise InputError(
                f"{self.raw}: is an X-Trans RAW; pairs need a Bayer mosaic (jaxisp develop renders both)"
            )
        linear = self.settings.clean_encoding == "linear"
        clean, file = read_with_header(self.clean, linear=linear) if self.clean else (None, None)
        embedded = self.output == self.raw
        jpeg = self._jpeg()
        if raw is not None:
            picture = _as_sensor(read_image(self.output) if jpeg is None else jpeg, raw)
        else:
            picture = read_image(self.output) if jpeg is None else jpeg.upright
        iso = (raw and raw.iso) or (jpeg and jpeg.iso) or self.settings.iso
        picture, file = np.ascontiguousarray(picture), None if linear else file
        return Loaded(self.name, picture, jpeg, raw, clean, self.settings, embedded, iso, file)

    def _jpeg(self) -> Jpeg | None:
        if self.output == self.raw:
            data = embedded_jpeg(self.output)
            if data is None:
                raise InputError(f"{self.output}: embeds no full-size JPEG")
            return decode_jpeg(data, f"{self.output} (embedded JPEG)")
        return read_jpeg(self.output) if self.output.suffix.lower() in _JPEG_SUFFIXES else None


@dataclass(frozen=True, repr=False)
class Dataset:
    """The pairs of a folder, and the files in it that make no pair with the reason."""

    __repr__ = brief

    folder: Path
    kind: str
    pairs: tuple[Pair, ...]
    problems: tuple[tuple[Path, str], ...]
    settings: Settings


def open_dataset(folder: PathLike, *, kind: str | None = None) -> Dataset:
    """Find the pairs of a folder; nothing but names, dataset.toml and embedded previews is read.

    Args:
        folder: the data set.
        kind: "raw+jpeg", "clean+noisy" or "jpeg+jpeg"; needed only where the folder holds pairs of several.

    Raises:
        InputError: no such folder, no pair in it, pairs of several kinds, or a bad dataset.toml.
    """
    folder = Path(folder)
    files = list_folder(folder)
    if not files:
        raise InputError(f"{folder}: is empty, expected a data set of pairs")
    stems = _by_stem(files)
    settings = SettingsFile(folder)
    settings.check_stems(stems)
    twins, others = _twins(stems)
    found = {RAW_JPEG: _raw_pairs(others), CLEAN_NOISY: _clean_pairs(others), JPEG_JPEG: (twins, [])}
    kind = kind or _kind(folder, found)
    if kind not in found:
        raise InputError(f"{folder}: {kind!r} is no kind of data set, expected {', '.join(found)}")
    if not found[kind][0]:
        raise InputError(f"{folder}: holds no {kind} pair{_first(found[kind][1])}")
    pairs, problems = found[kind]
    if kind == JPEG_JPEG:
        problems = [(path, "has no other picture beside it") for path in _pictures(others)]
    settled = tuple(replace(p, settings=settings.of(p.name)) for p in pairs)
    return Dataset(folder, kind, settled, tuple(problems), settings.common)


Found = tuple[list[Pair], list[tuple[Path, str]]]


def _kind(folder: Path, found: Mapping[str, Found]) -> str:
    held = [kind for kind, (pairs, _) in found.items() if pairs]
    if len(held) == 1:
        return held[0]
    if held:
        counts = " and ".join(f"{len(found[k][0])} {k} pairs" for k in held)
        raise InputError(f"{folder}: holds {counts}, expected one kind in a folder")
    lone = {path: why for _, problems in found.values() for path, why in problems}
    raise InputError(
        f"{folder}: holds no pair of RAW and JPEG, of clean and noisy, or of two JPEGs"
        f"{_first(list(lone.items()))}"
    )


def _first(problems: list[tuple[Path, str]]) -> str:
    return f" ({problems[0][0].name}: {problems[0][1]})" if problems else ""


def _by_stem(files: list[Path]) -> dict[str, dict[str, Path]]:
    """Files by stem and role; names that have no role are passed over."""
    stems: dict[str, dict[str, Path]] = {}
    for path in files:
        found = _role(path.name)
        if found:
            stem, role = found
            other = stems.setdefault(stem, {}).setdefault(role, path)
            if other != path:
                raise InputError(f"{path}: and {other.name} both are the {role} file of {stem!r}")
    return stems


def _role(name: str) -> tuple[str, str] | None:
    lower = name.lower()
    if lower.endswith(".raw.npy"):
        return name[: -len(".raw.npy")], "raw"
    stem, dot, suffix = name.rpartition(".")
    suffix = dot + suffix.lower()
    if suffix in RAW_SUFFIXES:
        return stem, "raw"
    for role, suffixes in (("clean", _CLEAN_SUFFIXES), ("noisy", _NOISY_SUFFIXES)):
        if stem.lower().endswith("." + role) and suffix in suffixes:
            return stem[: -len(role) - 1], role
    if suffix in _JPEG_SUFFIXES:
        return stem, "jpeg"
    return (stem, "png") if suffix == ".png" else None


def _pair(stem: str, output: Path, raw: Path | None = None, clean: Path | None = None) -> Pair:
    return Pair(stem, *scene_and_frame(stem), output, raw, clean, Settings())


def _twins(stems: Mapping[str, Mapping[str, Path]]) -> tuple[list[Pair], dict[str, Mapping[str, Path]]]:
    """Pairs of NAME.a.jpg and NAME.b.jpg, which have nothing else beside them; and all other stems."""
    pairs: list[Pair] = []
    others = dict(stems)
    for stem in sorted(stems):
        name, _, which = stem.rpartition(".")
        both = [stems.get(f"{name}.{letter}", {}) for letter in "ab"]
        if which == "a" and all(set(files) == {"jpeg"} for files in both):
            pairs.append(_pair(name, both[1]["jpeg"], clean=both[0]["jpeg"]))
            others = {s: files for s, files in others.items() if s not in (stem, f"{name}.b")}
    return pairs, others


def _pictures(stems: Mapping[str, Mapping[str, Path]]) -> list[Path]:
    return [path for _, files in sorted(stems.items()) for path in files.values()]


def _raw_pairs(stems: Mapping[str, Mapping[str, Path]]) -> Found:
    pairs: list[Pair] = []
    problems: list[tuple[Path, str]] = []
    for stem, files in sorted(stems.items()):
        raw, picture = files.get("raw"), files.get("jpeg", files.get("png"))
        if raw and picture is None:
            picture = _embedding(raw, problems)
        if raw and picture:
            pairs.append(_pair(stem, picture, raw=raw))
        elif picture:
            problems.append((picture, "has no RAW file beside it"))
    return pairs, problems


def _embedding(raw: Path, problems: list[tuple[Path, str]]) -> Path | None:
    """The RAW itself where it embeds its full-size JPEG; else the reason goes to `problems`."""
    try:
        if not raw.name.lower().endswith(".npy") and embedded_jpeg(raw) is not None:
            return raw
    except InputError as error:
        problems.append((raw, str(error).removeprefix(f"{raw}: ")))
        return None
    problems.append((raw, "has no JPEG beside it, and embeds no full-size one"))
    return None


def _clean_pairs(stems: Mapping[str, Mapping[str, Path]]) -> Found:
    pairs: list[Pair] = []
    problems: list[tuple[Path, str]] = []
    used = set()
    for stem, files in sorted(stems.items()):
        output = files.get("noisy", files.get("jpeg"))
        scene = next((s for s in (stem, scene_and_frame(stem)[0]) if "clean" in stems.get(s, {})), None)
        if output and scene is not None:
            used.add(scene)
            pairs.append(_pair(stem, output, clean=stems[scene]["clean"]))
        elif output:
            problems.append((output, "has no clean file beside it"))
    for stem, files in sorted(stems.items()):
        if "clean" in files and stem not in used:
            problems.append((files["clean"], "has no noisy file beside it"))
    return pairs, problems


def _as_sensor(picture: Jpeg | np.ndarray, raw: Raw) -> np.ndarray:
    """The picture turned as the RAW is stored.

    Orientation tags are believed, unless only leaving the pixels alone makes both portrait or both
    landscape (tools that turn pixels and forget the tag, or strip it).
    """
    stored = picture if isinstance(picture, np.ndarray) else picture.image
    orientation = raw.orientation if isinstance(picture, np.ndarray) else picture.orientation
    turned = unorient(orient(stored, orientation), raw.orientation)

    def portrait(shape: tuple[int, ...]) -> bool:
        return shape[0] > shape[1]

    wanted = portrait(raw.mosaic.shape)
    return stored if portrait(turned.shape) != wanted and portrait(stored.shape) == wanted else turned
