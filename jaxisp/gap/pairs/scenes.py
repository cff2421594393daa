"""Repeated frames: which scene each pair shows, which scenes are held out, what is independent."""

import dataclasses
import re
from collections.abc import Sequence

import numpy as np


@dataclasses.dataclass(frozen=True)
class Split:
    """Pairs that parameters are fitted on, and those that every figure comes from."""

    fit: tuple[int, ...]
    held_out: tuple[int, ...]


def scene_name(name: str) -> str:
    """The stem without the number of a repeated frame."""
    return re.sub(r"\.f\d{2,}$", "", name)


def split_of(names: Sequence[str]) -> Split:
    """Every other scene is fitted, with all of its frames; of one scene alone, every other frame."""
    scenes = [scene_name(name) for name in names]
    order = list(dict.fromkeys(scenes))
    if len(order) == 1:
        order, scenes = list(names), list(names)
    fitted = set(order[::2])
    which = [[i for i, s in enumerate(scenes) if (s in fitted) == first] for first in (True, False)]
    return Split(tuple(which[0]), tuple(which[1]))


def by_scene(values: np.ndarray, names: Sequence[str]) -> np.ndarray:
    """(N, U) values of pictures as (scenes, frames times U), NaN where a scene has fewer frames than another:
    frames tell of one scene only, however many they are."""
    scenes = [scene_name(name) for name in names]
    most = max(scenes.count(s) for s in scenes)
    found = np.full((len(set(scenes)), most * values.shape[1]), np.nan)
    for at, scene in enumerate(dict.fromkeys(scenes)):
        own = values[[s == scene for s in scenes]].ravel()
        found[at, : len(own)] = own
    return found
