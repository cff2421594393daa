"""Clean pictures aligned to their noisy ones, and both cut to one size."""

import dataclasses
from collections.abc import Sequence

import jax
import jax.numpy as jnp
import numpy as np
from scipy.ndimage import gaussian_filter

from jaxisp.color import linear_to_srgb, srgb_to_linear
from jaxisp.errors import InputError
from jaxisp.fit.align import Alignment, best_orientation, estimate, same_scene, turned_place, warp
from jaxisp.gap.pairs.align_raw import Aligned, row
from jaxisp.gap.pairs.crops import common_crop, in_halves, usable
from jaxisp.gap.pairs.pairs import BORDER, Pairs
from jaxisp.gap.pairs.stored import as_stored
from jaxisp.io.datasets import Loaded
from jaxisp.io.jpeg import Jpeg
from jaxisp.io.orientation import orient

_PART = 0.3  # of a pixel by which a scene may be off and is moved by whole pixels


def align_clean(loaded: Sequence[Loaded]) -> Aligned:
    """The pairs cut to one size, each clean picture made linear and aligned to its noisy one, turned as it
    is. A pair of sizes that are too far apart is left out. One that may be of two scenes is not: noise hides
    whether it is.

    Raises:
        InputError: no pair is left, or the largest size that all have is too small.
    """
    aligned = Aligned([], [], [])
    frames: dict[str, Loaded] = {}
    turned = set()
    for pair in loaded:
        own = _framed(pair)
        if own is None:
            own = _framed(_turned(pair, best_orientation(pair.picture, _light(_linear(pair)))))
            turned.add(pair.name)
        if own is not None:
            frames[pair.name] = own
        else:
            sizes = [f"{a.shape[1]}x{a.shape[0]} px" for a in (np.asarray(pair.clean), pair.picture)]
            reason = (
                f"the clean picture has {sizes[0]}, the noisy one {sizes[1]}; crop them to the same frame"
            )
            aligned.failed.append((pair.name, f"{pair.name}: {reason}"))
    if not frames:
        raise InputError("; ".join(reason for _, reason in aligned.failed))
    whole = {pair.name: pair for pair in loaded}
    for pair, crop in zip(frames.values(), common_crop([*frames.values()])):
        own, place = _cropped(pair, crop)
        orientation = turned_place(own.picture, _light(np.asarray(own.clean)), place)[1]
        upright = _framed(_turned(whole[pair.name], orientation)) if orientation != 1 else None
        if upright is not None:
            own, place = _cropped(upright, crop)
            turned.add(pair.name)
        clean, done = _aligned_to(np.asarray(own.clean), own.picture, place)
        aligned.kept.append(dataclasses.replace(own, clean=clean))
        off = (0, 0) if done == "nothing" else (-place.dy, -place.dx)
        done = "turned" if pair.name in turned else done
        certain = same_scene(place, own.picture.shape)
        aligned.rows.append(row(pair.name, off, done, certain=certain))
    return aligned


def clean_pairs(loaded: Sequence[Loaded], smoothing: float = 0.0) -> Pairs:
    """The pairs, which have one size and lie on each other; what the file clipped does not count.

    Args:
        loaded: as read.
        smoothing: standard deviation [px] over which a picture is averaged before it is looked at for that.
            A simulator that clips as the camera does must not be compared where the camera's own noise
            happened to clip: its noise is another.
    """
    loaded = list({p.name: p for p in loaded}.values())
    clean = linear_scenes(loaded)
    pictures = np.stack([p.picture for p in loaded]).astype(np.float32)
    names = tuple(p.name for p in loaded)
    seen = gaussian_filter(pictures, (0, smoothing, smoothing, 0))
    light, again = jnp.asarray(clean, jnp.float32), _compressed_again(clean, [p.clean_file for p in loaded])
    return in_halves(Pairs(names, light, pictures, usable(seen), again))


def linear_scenes(loaded: Sequence[Loaded]) -> np.ndarray:
    """(N, H, W, 3) linear light of the clean pictures, which have one size."""
    return np.stack([_linear(p) for p in loaded])


_GRIDS = ((0, 0), (3, 3), (5, 5))
"""Rows and columns that blocks may start at. On the grid of the first time nothing would be lost."""


def _compressed_again(clean: np.ndarray, files: Sequence[Jpeg | None]) -> jax.Array | None:
    """(N, H, W, 3) linear light as the files' compression leaves it once more, each on the grid that costs it
    most; None where no file has any."""
    if all(file is None for file in files):
        return None

    def coarser(picture: np.ndarray, file: Jpeg | None) -> np.ndarray:
        if file is None:
            return picture
        found = [
            np.roll(as_stored(np.roll(picture, (y, x), (0, 1)), file), (-y, -x), (0, 1)) for y, x in _GRIDS
        ]
        return max(found, key=lambda stored: float(((stored - picture) ** 2).sum()))

    encoded = np.clip(linear_to_srgb(clean), 0, 1)
    return jnp.asarray(srgb_to_linear(np.stack([coarser(*own) for own in zip(encoded, files)])), jnp.float32)


def _framed(pair: Loaded) -> Loaded | None:
    """The clean picture cut, or continued, by a few pixels to the size of the noisy one, about its middle;
    None where that is not enough."""
    clean, wanted = np.asarray(pair.clean), pair.picture.shape
    if any(abs(a - b) > 2 * BORDER for a, b in zip(clean.shape[:2], wanted[:2])):
        return None
    for axis in (0, 1):
        missing = wanted[axis] - clean.shape[axis]
        if missing > 0:
            width = [(missing // 2, missing - missing // 2) if a == axis else (0, 0) for a in range(3)]
            clean = np.pad(clean, width, mode="edge")
        start = -missing // 2 if missing < 0 else 0
        clean = np.take(clean, range(start, start + wanted[axis]), axis)
    return dataclasses.replace(pair, clean=clean)


def _turned(pair: Loaded, orientation: int) -> Loaded:
    return dataclasses.replace(pair, clean=np.ascontiguousarray(orient(np.asarray(pair.clean), orientation)))


def _cropped(pair: Loaded, crop: tuple[slice, slice]) -> tuple[Loaded, Alignment]:
    """Both pictures cut, the clean one made linear, and where it lies on the noisy one."""
    clean, picture = _linear(pair)[crop].copy(), pair.picture[crop].copy()
    settings = dataclasses.replace(pair.settings, clean_encoding="linear")
    own = dataclasses.replace(pair, picture=picture, clean=clean, settings=settings)
    return own, estimate(picture, _light(clean))


def _light(scene: np.ndarray) -> np.ndarray:
    return np.asarray(np.sqrt(np.clip(scene.mean(-1), 0, None)))


def _aligned_to(scene: np.ndarray, picture: np.ndarray, found: Alignment) -> tuple[np.ndarray, str]:
    """The scene moved to where the picture has its details, and what that took: the picture keeps its place
    on the grids of its colour filter array and of its file. By whole pixels where that is about all; another
    scale is left."""
    light = _light(scene)
    shift = np.array([float(found.dy), float(found.dx)])
    near = np.round(shift)
    move = [-int(v) for v in near]
    moved = np.roll(light, move, (0, 1))
    known = same_scene(found, light.shape) or _likeness(moved, picture) > _likeness(light, picture)
    if np.abs(shift).max() > BORDER or not known:
        return scene, "nothing"
    if np.abs(shift - near).max() < _PART:
        return np.roll(scene, move, (0, 1)), "moved" if any(move) else "nothing"
    return np.asarray(warp(jnp.asarray(scene), Alignment(*shift), scene.shape[:2])), "resampled"


def _likeness(light: np.ndarray, picture: np.ndarray) -> float:
    """Correlation of the details of a few pixels, which noise leaves most of."""
    details = [gaussian_filter(a, 1.5) - gaussian_filter(a, 5) for a in (light, picture.mean(-1))]
    inner = [d[BORDER:-BORDER, BORDER:-BORDER].ravel() for d in details]
    return float(np.corrcoef(*inner)[0, 1])


def _linear(pair: Loaded) -> np.ndarray:
    clean = np.asarray(pair.clean, np.float32)
    if pair.settings.clean_encoding == "linear":
        return clean
    return srgb_to_linear(clean)
