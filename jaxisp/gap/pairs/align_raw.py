"""Pictures aligned to their RAW files: sizes, shifts, and files that are not a pair."""

import dataclasses
from collections.abc import Mapping, Sequence
from types import MappingProxyType
from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np

from jaxisp.camera import shaded_mosaic
from jaxisp.cfa import shifted
from jaxisp.errors import InputError
from jaxisp.fit.align import Alignment, estimate, same_scene, warp
from jaxisp.gap.pairs.crops import common_crop, in_halves, usable
from jaxisp.gap.pairs.headers import stated_warp
from jaxisp.gap.pairs.pairs import BORDER, Pairs
from jaxisp.io.datasets import Loaded
from jaxisp.pipeline import run, stage

_STRETCH = 0.75  # px at the border by which two scales may differ and count as one
_UNLIKE = 0.1  # a correlation that even flat pairs of one scene reach
_ALIKE = 0.4  # what most pairs of a set reach that is neither


class Aligned(NamedTuple):
    """Pairs whose halves are aligned.

    Attributes:
        kept: the pairs.
        failed: (name, reason) of files that are not a pair.
        rows: what was done, for report.json: by how much the picture was found off the other file.
        sample: what part of the set these are, for report.json: numbers of pairs and sizes (height, width).
    """

    kept: list[Loaded]
    failed: list[tuple[str, str]]
    rows: list[dict[str, Any]]
    sample: Mapping[str, Any] = MappingProxyType({})


def row(
    name: str, off: Sequence[Any], done: str, *, certain: bool, scale: Sequence[Any] = (1.0, 1.0)
) -> dict[str, Any]:
    """One of `Aligned.rows`: about its middle the picture's details lie `off` (rows, columns) px from where
    the other file has them, `scale` times as far apart; whether the two surely show one scene."""
    shift, scales = ([round(float(v), digits) + 0.0 for v in own] for own, digits in ((off, 2), (scale, 4)))
    return {"name": name, "shift_px": shift, "scale": scales, "done": done, "certain": certain}


def _placed(pair: Loaded) -> Alignment:
    """Where the picture lies on the mosaic, seen through the means of its 2x2 cells, and by a lens that is
    corrected as the file says."""
    assert pair.raw is not None
    mosaic = shaded_mosaic(pair.raw)
    cell = mosaic[:-1, :-1] + mosaic[1:, :-1] + mosaic[:-1, 1:] + mosaic[1:, 1:]
    stated = stated_warp(pair.raw)
    if stated is not None:
        three = jnp.repeat(jnp.asarray(cell)[..., None], 3, -1)
        cell = np.asarray(run(stage("rectilinear_warp"), {"rectilinear_warp": stated}, three))[..., 1]
    # one fewer and half a pixel later than the pixels: about the same centre
    return estimate(np.sqrt(np.clip(cell, 0, None)), pair.picture)


def align_raw(loaded: Sequence[Loaded]) -> Aligned:
    """RAW+JPEG pairs whose halves have one size.

    A picture of another size is aligned where it belongs: cut, or resampled where its scale is another. One
    of the same size is moved by whole pixels, at most as far as the border that is not counted; what is not a
    whole pixel stays in the gap. A pair of two scenes is left out.

    Raises:
        InputError: no pair is left.
    """
    places = [_placed(pair) for pair in loaded]
    usual = float(np.median([place.correlation for place in places]))
    aligned = Aligned([], [], [])
    for pair, place in zip(loaded, places):
        assert pair.raw is not None
        off, scale = (place.dy, place.dx), (place.scale_y, place.scale_x)
        other_size = pair.raw.mosaic.shape != pair.picture.shape[:2]
        certain = same_scene(place, pair.raw.mosaic.shape, pair.picture.shape)
        if not certain and (other_size or usual > _ALIKE or place.correlation < _UNLIKE):
            reason = f"the two files do not show one scene: their correlation is {place.correlation:.2f}"
            aligned.failed.append((pair.name, f"{pair.name}: {reason}"))
        elif other_size:
            first = aligned.kept[0].raw if aligned.kept else None
            found, done = _cut(pair, place, first.cfa if first else None)
            aligned.kept.append(found)
            aligned.rows.append(row(pair.name, off, done, certain=certain, scale=scale))
        elif certain:
            move = [-int(np.clip(round(float(v)), -BORDER, BORDER)) for v in off]
            aligned.kept.append(dataclasses.replace(pair, picture=np.roll(pair.picture, move, (0, 1))))
            done = "moved" if any(move) else "nothing"
            aligned.rows.append(row(pair.name, off, done, certain=True, scale=scale))
        else:
            aligned.kept.append(pair)
            aligned.rows.append(row(pair.name, (0, 0), "nothing", certain=False))
    if not aligned.kept:
        raise InputError("; ".join(reason for _, reason in aligned.failed))
    return aligned


def _cut(pair: Loaded, place: Alignment, cfa: str | None) -> tuple[Loaded, str]:
    """Both halves cut to what they share, and what that took; the mosaic starts at a site that gives it the
    pattern wanted."""
    assert pair.raw is not None
    picture, sizes = pair.picture, np.array(pair.raw.mosaic.shape)
    stretch = max(abs(s - 1) * n / 2 for s, n in zip((place.scale_y, place.scale_x), sizes))
    if stretch > _STRETCH:
        picture, offsets = np.asarray(warp(jnp.asarray(picture), place, pair.raw.mosaic.shape)), [0, 0]
    else:
        centres = (np.array(picture.shape[:2]) - sizes) / 2
        offsets = [round(float(c + d)) for c, d in zip(centres, (place.dy, place.dx))]
    starts = [max(0, -o) for o in offsets]
    stops = [min(n, m - o) for n, m, o in zip(sizes, picture.shape, offsets)]
    if cfa is not None:
        starts = next(
            [starts[0] + y, starts[1] + x]
            for y in (0, 1) for x in (0, 1)
            if shifted(pair.raw.cfa, starts[0] + y, starts[1] + x) == cfa
        )  # fmt: skip
    of_mosaic = tuple(slice(a, b) for a, b in zip(starts, stops))
    of_picture = tuple(slice(a + o, b + o) for a, b, o in zip(starts, stops, offsets))
    cut = pair.raw.mosaic[of_mosaic]
    crop = (pair.raw.crop[0] + starts[0], pair.raw.crop[1] + starts[1], *cut.shape)
    raw = dataclasses.replace(pair.raw, mosaic=cut, crop=crop, cfa=shifted(pair.raw.cfa, *starts))
    done = "resampled" if stretch > _STRETCH else "cut"
    return dataclasses.replace(pair, raw=raw, picture=picture[of_picture]), done


def raw_pairs(loaded: Sequence[Loaded]) -> Pairs:
    """RAW+JPEG pairs, cropped alike; what the sensor or the file clipped does not count."""
    loaded = list({p.name: p for p in loaded}.values())
    crops = common_crop(loaded)
    light = np.stack([shaded_mosaic(p.raw)[c] for p, c in zip(loaded, crops) if p.raw is not None])
    pictures = np.stack([p.picture[c] for p, c in zip(loaded, crops)]).astype(np.float32)
    names = tuple(p.name for p in loaded)
    return in_halves(Pairs(names, jnp.asarray(light, jnp.float32), pictures, usable(pictures)))
