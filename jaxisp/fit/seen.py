"""Which tones and hues a camera was fitted on, and whether a RAW has others.

They are those of the white-balanced mosaic, so that nothing that was fitted is in them.
"""

import dataclasses
from typing import Any

import numpy as np

from jaxisp.camera import shaded_mosaic
from jaxisp.errors import InputError
from jaxisp.io import Raw
from jaxisp.recipe import Recipe

BLOCK = 16  # px, over which noise is averaged
HUES = ("red", "orange", "yellow", "yellow-green", "green", "blue-green",
        "cyan", "azure", "blue", "violet", "magenta", "rose")  # fmt: skip
COLOURED = 0.15  # least chroma, of the largest channel, that has a hue: camera RGB is paler than sRGB
FEWEST = 2e-3  # share of the blocks that a hue or a stop must have to count as seen
ENDS = 0.5  # percent of the blocks on either side that do not count as seen tones
BEYOND = 1.0  # EV that a tone may be beyond those seen
SHOWS = 0.05  # share of a picture's blocks with other tones or hues that is told
DARKEST = 2.0**-8  # level below which tones are alike, and hues are noise
DEEPEST = 9  # stop that these lie in


@dataclasses.dataclass(frozen=True)
class Seen:
    """What a fit saw.

    Args:
        levels: the darkest and the brightest level, of the mean of balanced red, green and blue.
        hues: those of `HUES` that were there.
        gaps: whole stops between these levels that were not there, as EV below white: 3 is from 1/8 to 1/4.
    """

    levels: tuple[float, float]
    hues: tuple[str, ...]
    gaps: tuple[int, ...] = ()

    @classmethod
    def of(cls, colours: np.ndarray) -> "Seen":
        """Of (N, 3) balanced camera RGB, means of blocks."""
        level = colours.mean(axis=1)
        low, high = np.percentile(level, [ENDS, 100 - ENDS])
        hue = _hues(colours)
        shares = np.bincount(hue[hue >= 0], minlength=len(HUES)) / max(len(hue), 1)
        names = tuple(name for name, share in zip(HUES, shares) if share >= FEWEST)
        stops = np.bincount(_stops(level), minlength=DEEPEST + 1) / max(len(level), 1)
        brightest, darkest = _stops(np.asarray([high, low]))
        gaps = tuple(ev for ev in range(brightest + 1, darkest) if stops[ev] < FEWEST)
        return cls((float(low), float(high)), names, gaps)

    def as_dict(self) -> dict[str, Any]:
        """As `meta.seen` of a camera's file has it."""
        return {"levels": list(self.levels), "hues": list(self.hues), "gaps": list(self.gaps)}

    @classmethod
    def from_dict(cls, stated: Any, camera: str) -> "Seen":
        """What a camera's file states.

        Raises:
            InputError: it is not as `as_dict` gives it.
        """
        try:
            low, high = (float(level) for level in stated["levels"])
            hues = tuple(str(name) for name in stated["hues"])
            gaps = tuple(int(ev) for ev in stated.get("gaps", ()))
        except (KeyError, TypeError, ValueError):
            raise InputError(f"{camera!r}: meta.seen is not as `jaxisp fit` writes it") from None
        return cls((low, high), hues, gaps)

    def beyond(self, colours: np.ndarray) -> list[str]:
        """What of (N, 3) blocks the fit did not see, a phrase each; empty where that is little."""
        level, hue = colours.mean(axis=1), _hues(colours)
        found = []
        reach = 2.0**BEYOND
        darker = level < max(self.levels[0], DARKEST) / reach
        brighter = level > self.levels[1] * reach
        for what, where in ("darker", darker), ("brighter", brighter):
            if where.mean() > SHOWS:
                found.append(f"{100 * where.mean():.0f} % {what} than all that was fitted")
        between = np.isin(_stops(level), self.gaps)
        if between.mean() > SHOWS:
            found.append(f"{100 * between.mean():.0f} % of tones that lack between those that were fitted")
        for index, name in enumerate(HUES):
            share = (hue == index).mean()
            if name not in self.hues and share > SHOWS:
                found.append(f"{100 * share:.0f} % {name}, a hue that was not fitted")
        return found


def _stops(level: np.ndarray) -> np.ndarray:
    """(N,) whole stops below white that levels lie in: 1 from a half up, DEEPEST for all that is as dark."""
    deep = np.floor(-np.log2(np.maximum(level, DARKEST))) + 1
    return np.clip(deep, 1, DEEPEST).astype(int)


def blocks(raw: Raw) -> np.ndarray:
    """(N, 3) means of balanced red, green and blue over blocks, up to white."""
    gains = np.ones(3) if raw.white_balanced else np.asarray(raw.white_balance)
    return block_means(shaded_mosaic(raw), raw.cfa, gains)


def block_means(mosaic: np.ndarray, cfa: str, gains: np.ndarray | None = None) -> np.ndarray:
    """(N, 3) means of the three colours over the whole blocks of a mosaic (..., H, W), up to white."""
    size = min(BLOCK, *(n // 2 * 2 for n in mosaic.shape[-2:]))
    h, w = (n // size for n in mosaic.shape[-2:])
    cells = mosaic[..., : h * size, : w * size].reshape(-1, h, size // 2, 2, w, size // 2, 2)
    planes = cells.mean(axis=(2, 5)).transpose(0, 1, 3, 2, 4).reshape(-1, 4)
    means = np.stack([planes[:, [c == name for c in cfa]].mean(axis=1) for name in "RGB"], axis=1)
    return np.clip(means * (np.ones(3) if gains is None else gains), 0, 1)


def _hues(colours: np.ndarray) -> np.ndarray:
    """(N,) index in `HUES`, by the hexagon's hue; -1 for what is grey."""
    top, bottom = colours.max(axis=1), colours.min(axis=1)
    chroma = top - bottom
    r, g, b = colours.T
    safe = np.where(chroma > 0, chroma, 1)
    sixth = np.select(
        [top == r, top == g], [((g - b) / safe) % 6, (b - r) / safe + 2], default=(r - g) / safe + 4
    )
    index = np.rint(sixth * len(HUES) / 6).astype(int) % len(HUES)
    return np.where((top > DARKEST) & (chroma > COLOURED * top), index, -1)


def unseen(raw: Raw, camera: Recipe | None) -> list[str]:
    """A sentence where a RAW has tones or hues that the camera was not fitted on; none for a camera whose
    file does not say what it saw.

    Raises:
        InputError: `meta.seen` is not as `jaxisp fit` writes it.
    """
    if camera is None or "seen" not in camera.meta:
        return []
    found = Seen.from_dict(camera.meta["seen"], camera.name).beyond(blocks(raw))
    return [f"the camera was not fitted on such a picture: {', '.join(found)}"] if found else []
