"""Frames of one light and exposure, summed up one by one: no more than two are in memory.

Sums are of squares after projections that take away what is no noise of a pixel. Within a block of one
colour, rows and columns less their means (`interactions`) know no row noise, no column noise, no flicker of
the lamp and no slope of the light. Along a profile of row or column means, what a moving mean leaves knows no
shading. The projections are linear, so that squares about the mean over frames follow from sums of squares.
"""

import dataclasses
from collections.abc import Callable, Iterable
from pathlib import Path

import numpy as np

from jaxisp.cfa import is_xtrans
from jaxisp.errors import InputError
from jaxisp.io import Raw, read_raw
from jaxisp.io.files import PathLike, list_folder
from jaxisp.io.raw import RAW_SUFFIXES
from jaxisp.io.settings import SettingsFile, scene_and_frame

BLOCK = 16
"""Photosites of one place of the cell, a side of a block."""
MEAN = 15
"""Lines of the moving mean that profiles are told against."""
_SAME_LIGHT = 0.03  # of the mean level: lamps flicker by less, exposures that differ differ by more
_LEAST = 5e-4  # level: means in the dark differ by less

Tick = Callable[[int, int, str], None]


@dataclasses.dataclass
class Stack:
    """Sums over frames of one light.

    Args:
        iso, exposure: as the files state them [s], None where they do not.
        scene: the name that repeated frames share, "" where they have none.
        first: the first frame, without its mosaic: what its file states.
        total: (H, W) sum of the frames.
        squares: (4, h, w) sums of squares of `interactions` in each block.
        largest: (4, h, w) the highest level of each block.
        lines: (2, 2) sums of squares of high-passed profiles: rows and columns, even and odd.
        pair_squares, pair_fourths: (4, h, w) of `interactions` of the difference to the frame before.
        lowest: share of the pixels that are at the frame's lowest level.
        names, means: of the frames.
    """

    iso: float | None
    exposure: float | None
    scene: str
    first: Raw
    count: int
    total: np.ndarray
    squares: np.ndarray
    largest: np.ndarray
    lines: np.ndarray
    pair_squares: np.ndarray
    pair_fourths: np.ndarray
    lowest: float
    names: list[str] = dataclasses.field(default_factory=list)
    means: list[float] = dataclasses.field(default_factory=list)
    _before: np.ndarray | None = None

    @classmethod
    def of(cls, raw: Raw, iso: float | None, scene: str) -> "Stack":
        """No frame yet, of the kind of this one."""
        shape = (4, *(n // 2 // BLOCK for n in raw.mosaic.shape))
        zeros = [np.zeros(shape) for _ in range(4)]
        kept = dataclasses.replace(raw, mosaic=raw.mosaic[:0])
        total = np.zeros(raw.mosaic.shape)
        squares, largest, second, fourth = zeros
        return cls(
            iso, raw.exposure_time, scene, kept, 0, total, squares, largest - np.inf, np.zeros((2, 2)),
            second, fourth, 0.0,
        )  # fmt: skip

    @property
    def mean(self) -> np.ndarray:
        return self.total / self.count

    @property
    def level(self) -> float:
        return float(self.mean.mean())

    def add(self, raw: Raw) -> None:
        """One more frame."""
        frame = raw.mosaic.astype(np.float64)
        own = blocks(frame)
        self.total += frame
        self.squares += (interactions(own) ** 2).sum((-2, -1))
        self.largest = np.maximum(self.largest, own.max((-2, -1)))
        self.lines += line_squares(frame)
        if self._before is not None:
            difference = interactions(blocks(frame - self._before)) ** 2
            self.pair_squares += difference.sum((-2, -1))
            self.pair_fourths += (difference**2).sum((-2, -1))
        self._before = frame
        self.lowest = max(self.lowest, float((raw.mosaic == raw.mosaic.min()).mean()))
        self.count += 1
        self.names.append(raw.path.name)
        self.means.append(float(frame.mean()))

    def join(self, other: "Stack") -> None:
        """All frames of another stack of the same light."""
        for name in ("total", "squares", "lines", "pair_squares", "pair_fourths"):
            setattr(self, name, getattr(self, name) + getattr(other, name))
        if self._before is not None and other._before is not None and self.count == other.count == 1:
            difference = interactions(blocks(other._before - self._before)) ** 2
            self.pair_squares, self.pair_fourths = difference.sum((-2, -1)), (difference**2).sum((-2, -1))
        self.largest = np.maximum(self.largest, other.largest)
        self.lowest = max(self.lowest, other.lowest)
        self.count += other.count
        self.names += other.names
        self.means += other.means


def blocks(mosaic: np.ndarray) -> np.ndarray:
    """(4, h, w, BLOCK, BLOCK) of the four places of the cell; what is no whole block is left out."""
    planes = [mosaic[y::2, x::2] for y in (0, 1) for x in (0, 1)]
    h, w = (n // 2 // BLOCK for n in mosaic.shape)
    cut = np.stack([p[: h * BLOCK, : w * BLOCK] for p in planes])
    return cut.reshape(4, h, BLOCK, w, BLOCK).swapaxes(2, 3)


def interactions(own: np.ndarray) -> np.ndarray:
    """Blocks less the means of their rows and columns: (BLOCK - 1)**2 degrees of freedom each."""
    rows, columns = own.mean(-1, keepdims=True), own.mean(-2, keepdims=True)
    return own - rows - columns + own.mean((-2, -1), keepdims=True)


def profiles(mosaic: np.ndarray) -> list[list[np.ndarray]]:
    """Means of rows, and of columns; those of even and odd ones apart, as they hold other colours."""
    return [[mosaic.mean(axis)[parity::2] for parity in (0, 1)] for axis in (1, 0)]


def high_passed(profile: np.ndarray) -> np.ndarray:
    """A profile less its moving mean, without the ends that have none."""
    return profile[MEAN // 2 : -(MEAN // 2)] - np.convolve(profile, np.full(MEAN, 1 / MEAN), "valid")


def line_squares(mosaic: np.ndarray) -> np.ndarray:
    """(2, 2) sums of squares of high-passed profiles: rows and columns, even and odd."""
    return np.array([[(high_passed(p) ** 2).sum() for p in pair] for pair in profiles(mosaic)])


def raw_files(folder: PathLike) -> list[Path]:
    """The RAW files of a folder, or the one that is named."""
    path = Path(folder)
    if not path.is_dir():
        return [path]
    found = [p for p in list_folder(path) if _is_raw(p.name.lower())]
    if not found:
        raise InputError(f"{path}: holds no RAW file, expected frames as NAME.dng or NAME.raw.npy")
    return found


def _is_raw(name: str) -> bool:
    return name.endswith((".raw.npy", *RAW_SUFFIXES))


def read_stacks(
    paths: Iterable[Path], tick: Tick, what: str, failed: list[tuple[str, str]] | None = None
) -> list[Stack]:
    """The frames by ISO, exposure, name of the scene, and light; what cannot be read goes into `failed`.

    Raises:
        InputError: a file is no Bayer mosaic, is too small, or differs from others in size or pattern; no
            file can be read, or one of them where `failed` is None.
    """
    files, stacks = list(paths), list[Stack]()
    for index, path in enumerate(files):
        tick(index, len(files), f"{what} frames")
        try:
            raw = read_raw(path)
        except InputError as error:
            if failed is None or (path == files[-1] and not stacks):
                raise
            failed.append((str(path), str(error)))
            continue
        _check(raw, stacks)
        stem = path.name[: -len(".raw.npy")] if path.name.lower().endswith(".raw.npy") else path.stem
        scene, frame = scene_and_frame(stem)
        iso = raw.iso or SettingsFile(path.parent).of(stem).iso
        new = Stack.of(raw, iso, "" if frame is None else scene)
        new.add(raw)
        same = next((s for s in stacks if _alike(s, new)), None)
        if same is None:
            stacks.append(new)
        else:
            same.add(raw)
    return stacks


def _alike(stack: Stack, new: Stack) -> bool:
    stated = all(getattr(stack, n) == getattr(new, n) for n in ("iso", "exposure", "scene"))
    return stated and abs(stack.level - new.level) < _LEAST + _SAME_LIGHT * abs(stack.level)


def _check(raw: Raw, stacks: list[Stack]) -> None:
    if is_xtrans(raw.cfa):
        raise InputError(f"{raw.path}: is an X-Trans RAW; calibrating needs a Bayer mosaic")
    smallest = 4 * max(BLOCK, MEAN)
    if min(raw.mosaic.shape) < smallest:
        raise InputError(
            f"{raw.path}: has {raw.mosaic.shape[1]}x{raw.mosaic.shape[0]} px, "
            f"expected {smallest} or more a side"
        )
    for stack in stacks[:1]:
        check_same_sensor(stack.first, stack.total.shape, raw, raw.mosaic.shape)


def check_same_sensor(one: Raw, size: tuple[int, ...], other: Raw, other_size: tuple[int, ...]) -> None:
    """Raise InputError where two frames differ in size or pattern."""
    if (size, one.cfa) != (other_size, other.cfa):
        raise InputError(
            f"{other.path}: is {other_size[1]}x{other_size[0]} {other.cfa}, but {one.path.name} is "
            f"{size[1]}x{size[0]} {one.cfa}; expected frames of one sensor"
        )
