"""Clean+noisy pairs: read, cut to one size and laid on each other; which scene they show, who is held out."""

import dataclasses
import re
from collections.abc import Sequence

import jax.numpy as jnp
import numpy as np
from scipy.ndimage import gaussian_filter

from jaxisp.color import srgb_to_linear
from jaxisp.fit.align import Alignment, estimate, same_scene, warp
from jaxisp.gap import prepare
from jaxisp.gap.measured import Split
from jaxisp.gap.residual import BORDER, Pairs
from jaxisp.io.datasets import Loaded

_PART = 0.3  # of a pixel by which a scene may be off and is moved by whole pixels


def split_of(names: Sequence[str]) -> Split:
    """Every other scene is fitted, with all of its frames."""
    scenes = [scene_name(name) for name in names]
    order = list(dict.fromkeys(scenes))
    if len(order) == 1:
        order, scenes = list(names), list(names)
    fitted = set(order[::2])
    which = [[i for i, s in enumerate(scenes) if (s in fitted) == first] for first in (True, False)]
    return Split(tuple(which[0]), tuple(which[1]))


def scene_name(name: str) -> str:
    """The stem without the number of a repeated frame."""
    return re.sub(r"\.f\d{2,}$", "", name)


def by_scene(values: np.ndarray, names: Sequence[str]) -> np.ndarray:
    """(N, 1) values of pictures as (scenes, frames), NaN where a scene has fewer frames than another: frames
    tell of one scene only, however many they are."""
    scenes = [scene_name(name) for name in names]
    most = max(scenes.count(s) for s in scenes)
    found = np.full((len(set(scenes)), most), np.nan)
    for row, scene in enumerate(dict.fromkeys(scenes)):
        own = [float(v[0]) for v, s in zip(values, scenes) if s == scene]
        found[row, : len(own)] = own
    return found


def clean_pairs(loaded: Sequence[Loaded], smoothing: float = 0.0) -> Pairs:
    """The pairs, cropped alike and laid on each other; what the file clipped does not count.

    Args:
        loaded: as read.
        smoothing: standard deviation [px] over which a picture is averaged before it is looked at for that.
            A simulator that clips as the camera does must not be compared where the camera's own noise
            happened to clip: its noise is another.
    """
    loaded = [framed(p) for p in {p.name: p for p in loaded}.values()]
    crops = prepare.common_crop(loaded)
    clean = np.stack([_linear(p)[c] for p, c in zip(loaded, crops)])
    pictures = np.stack([p.picture[c] for p, c in zip(loaded, crops)]).astype(np.float32)
    clean = np.stack([laid_under(s, p) for s, p in zip(clean, pictures)])
    names = tuple(p.name for p in loaded)
    seen = gaussian_filter(pictures, (0, smoothing, smoothing, 0))
    return prepare.in_halves(Pairs(names, jnp.asarray(clean, jnp.float32), pictures, prepare.usable(seen)))


def framed(pair: Loaded) -> Loaded:
    """The clean picture cut, or continued, by a few pixels to the size of the noisy one, about its middle."""
    clean, wanted = np.asarray(pair.clean), pair.picture.shape
    if any(abs(a - b) > 2 * BORDER for a, b in zip(clean.shape[:2], wanted[:2])):
        return pair  # too far apart for that: left for the check of sizes to refuse
    for axis in (0, 1):
        missing = wanted[axis] - clean.shape[axis]
        if missing > 0:
            width = [(missing // 2, missing - missing // 2) if a == axis else (0, 0) for a in range(3)]
            clean = np.pad(clean, width, mode="edge")
        start = -missing // 2 if missing < 0 else 0
        clean = np.take(clean, range(start, start + wanted[axis]), axis)
    return dataclasses.replace(pair, clean=clean)


def laid_under(scene: np.ndarray, picture: np.ndarray) -> np.ndarray:
    """The scene moved to where the picture has its details: the picture keeps its place on the grids of its
    colour filter array and of its file. By whole pixels where that is about all; another scale is left."""
    light = np.sqrt(np.clip(scene.mean(-1), 0, None))
    found = estimate(picture, light)
    shift = np.array([float(found.dy), float(found.dx)])
    near = np.round(shift)
    move = [-int(v) for v in near]
    moved = np.roll(light, move, (0, 1))
    known = same_scene(found, light.shape) or _likeness(moved, picture) > _likeness(light, picture)
    if np.abs(shift).max() > BORDER or not known:
        return scene
    if np.abs(shift - near).max() < _PART:
        return np.roll(scene, move, (0, 1))
    return np.asarray(warp(jnp.asarray(scene), Alignment(*shift), scene.shape[:2]))


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
