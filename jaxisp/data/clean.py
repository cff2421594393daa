"""Clean photographs in memory: read, made smaller in linear light, kept as 16 bits."""

from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from scipy.ndimage import gaussian_filter

from jaxisp.checks import check_whole
from jaxisp.color import linear_to_srgb, srgb_to_linear
from jaxisp.errors import InputError
from jaxisp.io.files import find_images
from jaxisp.io.images import read_image
from jaxisp.process import cores
from jaxisp.shown import brief

WHOLE_BYTES = 2 << 30
"""Up to this many bytes in all, photographs are kept whole; beyond it, as crops."""

_CROP = 2.0  # side of a kept crop, in patches


@dataclass(frozen=True, repr=False)
class CleanImages:
    """Photographs, encoded sRGB as uint16, and what could not be used.

    Args:
        names: of the files.
        images: (H, W, 3) uint16 each, 65535 is white.
        skipped: (file, reason) of the rest.
    """

    __repr__ = brief

    names: tuple[str, ...]
    images: tuple[np.ndarray, ...]
    skipped: tuple[tuple[str, str], ...] = ()

    def split(self, held_out: int) -> tuple["CleanImages", "CleanImages"]:
        """Two sets: all but, and, `held_out` photographs spread evenly over the names in order."""
        chosen = {round((i + 0.5) * len(self.names) / held_out - 0.5) for i in range(held_out)}

        def subset(inside: bool) -> "CleanImages":
            kept = [i for i in range(len(self.names)) if (i in chosen) == inside]
            return CleanImages(
                tuple(self.names[i] for i in kept), tuple(self.images[i] for i in kept), self.skipped
            )

        return subset(False), subset(True)

    def joined(self, other: "CleanImages") -> "CleanImages":
        """These, and then the others."""
        skipped = (*self.skipped, *other.skipped)
        return CleanImages((*self.names, *other.names), (*self.images, *other.images), skipped)


def load_clean(
    paths: str | Path | Sequence[str | Path],
    *,
    patch: int,
    downsample: int = 4,
    per_image: int = 5,
    seed: int = 0,
    tick: Callable[[int, int, str], Any] = lambda done, total, text: None,
) -> CleanImages:
    """Read the photographs of folders (and those below), each made smaller by a whole factor.

    Making a photograph smaller takes noise and the traces of its own processing away: `downsample_linear`.

    Args:
        paths: files and folders.
        patch: photographs smaller than this afterwards are skipped [px].
        downsample: the factor; 1 leaves them as they are.
        per_image: crops of each that are kept where all do not fit (over 2 GiB).
        seed: of where those crops lie.
        tick: called with (done, total, text).

    Raises:
        InputError: no folder, or no photograph that can be used.
    """
    for name, value in (("patch", patch), ("downsample", downsample), ("per_image", per_image)):
        check_whole(name, value, 1)
    files = find_images(paths, recursive=True)
    names: list[str] = []
    images: list[np.ndarray] = []
    skipped: list[tuple[str, str]] = []
    size, trimmed = 0, False

    def read(path: Path) -> np.ndarray | str:
        try:
            return _prepare(path, patch, downsample)
        except InputError as error:
            return str(error)

    with ThreadPoolExecutor(min(8, cores.available())) as pool:
        for done, (path, got) in enumerate(zip(files, _ahead(pool, read, files))):
            tick(done + 1, len(files), path.name)
            if isinstance(got, str):
                skipped.append((str(path), got))
                continue
            size += got.nbytes
            if size > WHOLE_BYTES and not trimmed:
                trimmed = True
                images = [_crops(image, patch, per_image, seed, i) for i, image in enumerate(images)]
            images.append(_crops(got, patch, per_image, seed, len(images)) if trimmed else got)
            names.append(str(path))
    if not images:
        raise InputError(f"no photograph can be used: {skipped[0][1]}")
    return CleanImages(tuple(names), tuple(images), tuple(skipped))


def _ahead(pool: ThreadPoolExecutor, read: Callable[[Path], Any], files: list[Path]) -> Any:
    """Results in order, a few files ahead of their use: not the whole folder at once."""
    waiting: list[Any] = []
    for path in files:
        waiting.append(pool.submit(read, path))
        if len(waiting) > 16:
            yield waiting.pop(0).result()
    for future in waiting:
        yield future.result()


def _prepare(path: Path, patch: int, downsample: int) -> np.ndarray:
    image = downsample_linear(read_image(path), downsample)
    if min(image.shape[:2]) < patch:
        h, w = image.shape[:2]
        raise InputError(
            f"{path}: {h}x{w} px after downsampling by {downsample} is smaller than a patch of {patch} px"
        )
    return np.round(image * np.float32(65535)).astype(np.uint16)


SOFTNESS = 0.55
"""Standard deviation of the Gaussian after downsampling [px]. Means of pixels alone are sharper than what a
lens and sensor record: the mean square difference of neighbours over that of next neighbours is .53 for
them, .36 after it, .33 and .35 for the clean pictures of PolyU and SIDD (Jaroensri et al. 2019
blur before they take every fourth pixel, which comes to .54 px)."""


def downsample_linear(image: np.ndarray, factor: int, softness: float = SOFTNESS) -> np.ndarray:
    """Means of factor x factor pixels of an encoded (H, W, 3) image, then a Gaussian, in linear light.

    Args:
        image: (H, W, 3) in [0, 1]; rows and columns beyond a multiple of the factor are cut off.
        factor: old size over new; at 1 the image is returned as it is.
        softness: standard deviation of the Gaussian [px of the result].
    """
    if factor == 1:
        return image
    h, w = (n // factor for n in image.shape[:2])
    linear = srgb_to_linear(image[: h * factor, : w * factor])
    small = linear.reshape(h, factor, w, factor, 3).mean(axis=(1, 3))
    soft = gaussian_filter(small, (softness, softness, 0))
    return linear_to_srgb(np.clip(soft, 0, 1)).astype(np.float32)


def _crops(image: np.ndarray, patch: int, count: int, seed: int, index: int) -> np.ndarray:
    """`count` random crops stacked from top to bottom, or the image where that is no smaller."""
    side = int(min(_CROP * patch, *image.shape[:2]))
    if side * side * count >= image.shape[0] * image.shape[1]:
        return image
    rng = np.random.default_rng((seed, index))
    tops, lefts = (rng.integers(0, n - side + 1, count) for n in image.shape[:2])
    return np.stack([image[y : y + side, x : x + side] for y, x in zip(tops, lefts)])
