"""Frames that pictures of many sizes share, so that they share programs too."""

from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from jaxisp.arrays.extents import LEAST, Size, has_room

MOST_FRAMES = 8
"""Programs of a recipe for a folder of pictures, whatever their sizes."""
MOST_PIXELS = 2_000_000
"""Of pictures that share frames. Larger ones go alone: in strips of rows, which frames are not cut into."""
_AT_ONCE = 256  # sizes that are compared with each other


@dataclass(frozen=True)
class Frames:
    """Frames for pictures of more than `MOST_FRAMES` sizes; none for those of fewer, or of a recipe that
    depends on the frame.

    Args:
        sizes: of the frames.
        exact: those of them that are for pictures of their own size alone, which fill them.
        margin: how much larger than a picture a frame is, along an axis where it is not as large [px].
    """

    sizes: tuple[Size, ...] = ()
    exact: frozenset[Size] = frozenset()
    margin: int = 0

    def of(self, size: Size) -> Size | None:
        """The smallest frame for pictures of a size; None where they go alone."""
        if size in self.exact:
            return size
        fits = [f for f in self.sizes if f not in self.exact and has_room(size, f, self.margin)]
        return min(fits, key=lambda frame: frame[0] * frame[1], default=None)


def shared_frames(counts: Mapping[Size, int], margin: int) -> Frames:
    """Few frames for many sizes, with few pixels in all.

    Two groups of sizes after another are joined, those where this adds the fewest pixels.

    Args:
        counts: pictures of each size.
        margin: `Node.margin` of what they go through.
    """
    small = {s: n for s, n in counts.items() if min(s) >= LEAST and s[0] * s[1] <= MOST_PIXELS}
    if len(counts) <= MOST_FRAMES or not small:
        return Frames()
    low, high, pictures = _groups(small)
    while len(high) > MOST_FRAMES:
        least = np.minimum(low[:, None], low)
        most = np.maximum(high[:, None], high)
        both = pictures[:, None] + pictures
        alone = pictures * _area(low, high, margin)
        more = both * _area(least, most, margin) - (alone[:, None] + alone)
        i, j = sorted(np.unravel_index(np.argmin(np.where(np.eye(len(high)), np.inf, more)), more.shape))
        low[i], high[i], pictures[i] = least[i, j], most[i, j], both[i, j]
        low, high, pictures = (np.delete(x, j, 0) for x in (low, high, pictures))
    sizes = [(int(h), int(w)) for h, w in high + margin * (low < high)]
    exact = frozenset(size for size, same in zip(sizes, (low == high).all(1)) if same)
    return Frames(tuple(sizes), exact, margin)


def _groups(counts: Mapping[Size, int]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The least and the greatest size of each group, (N, 2), and its pictures: groups of one size each, or
    as few pixels apart as makes few groups."""
    step = 1
    while len(found := Counter((-(-h // step), -(-w // step)) for h, w in counts)) > _AT_ONCE:
        step += 1
    own: dict[Size, list[Size]] = {key: [] for key in found}
    for h, w in counts:
        own[-(-h // step), -(-w // step)].append((h, w))
    groups = [np.array(sizes) for sizes in own.values()]
    low, high = (np.array([fn(g, 0) for g in groups]) for fn in (np.min, np.max))
    return low, high, np.array([sum(counts[s] for s in sizes) for sizes in own.values()])


def _area(low: np.ndarray, high: np.ndarray, margin: int) -> np.ndarray:
    return np.prod(high + margin * (low < high), -1)
