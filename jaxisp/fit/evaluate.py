"""A fitted pair measured on the tiles that were not fitted, and whether a global camera can have made it."""

import dataclasses
import math

import numpy as np

from jaxisp.color import LUMA_601
from jaxisp.fit import noise
from jaxisp.fit.pair import Example
from jaxisp.fit.render import render, similarity
from jaxisp.fit.result import PairResult
from jaxisp.fit.solve import Fit
from jaxisp.fit.state import State
from jaxisp.fit.strips import strips
from jaxisp.fit.tiles import Shot, Split, split
from jaxisp.io import orient
from jaxisp.metrics import SMALLEST_MSE

SHOWN = 1024  # px of a side that are kept for reports
PATCH = 32  # px of the tiles that local processing is looked for in
MOST_TONE = 0.025  # level, rms of what is left in means of tiles
MOST_BLURRED = 0.12  # share of detailed tiles whose detail is gone
FEWEST_DB = 22.0  # held out


def evaluate(fit: Fit, state: State, pair: int, shot: Shot, example: Example) -> PairResult:
    """Render a pair, its file's JPEG tables included, and measure its fitted and its held-out tiles."""
    example = turned(example, shot)
    target = example.picture
    masks = split(target, shot.alignment, example.raw.mosaic.shape, shot.lens)
    vector, place = fit.vector(state, pair), state.places[pair]
    done = render(fit, vector, pair, shot, example)
    similar = similarity(done, target)
    shift = shot.geometry[:2] + place[:2]
    whole = shot.geometry + np.append(np.rint(shift) - shift, [0, 0]).astype(np.float32)
    shown = np.zeros(target.shape[:2], bool)
    _middle(shown, copy=False)[:] = True
    result = PairResult(
        shot.name,
        masked_psnr(done, target, masks.fitted),
        float(similar[masks.fitted].mean()),
        masked_psnr(done, target, masks.held_out),
        float(similar[masks.held_out].mean()),
        (-float(shift[0]), -float(shift[1])),
        _middle(render(fit, fit.vector(fit.start, pair), pair, shot, example, where=shown)),
        _middle(done),
        _middle(target),
        _noise(done, target, masks.held_out),
        masked_psnr(render(fit, vector, pair, shot, example, whole, masks.held_out), target, masks.held_out),
        notes=shot.notes,
    )
    return dataclasses.replace(result, flags=_flags(result, done, target, masks))


def turned(example: Example, shot: Shot) -> Example:
    """The pair as the alignment turned it."""
    return dataclasses.replace(
        example, picture=np.ascontiguousarray(orient(example.picture, shot.orientation))
    )


def masked_psnr(a: np.ndarray, b: np.ndarray, mask: np.ndarray) -> float:
    """Of the pixels of a mask [dB], as `jaxisp.metrics.psnr` of them; NaN where it has none."""
    squared, count = 0.0, 0
    for rows in strips(len(a)):
        error = a[rows][mask[rows]].astype(np.float64) - b[rows][mask[rows]]
        squared, count = squared + float(np.sum(error * error)), count + error.size
    return -10 * math.log10(max(squared / count, SMALLEST_MSE)) if count else math.nan


def _middle(image: np.ndarray, copy: bool = True) -> np.ndarray:
    """A copy, so that a large picture can go."""
    top, left = (max(n - SHOWN, 0) // 2 for n in image.shape[:2])
    part = image[top : top + SHOWN, left : left + SHOWN]
    return part.copy() if copy else part


def _noise(done: np.ndarray, target: np.ndarray, mask: np.ndarray) -> dict[str, object]:
    h, w = (n // noise.BLOCK * noise.BLOCK for n in target.shape[:2])
    done, target, mask = done[:h, :w], target[:h, :w], mask[:h, :w]
    found = noise.regions(target, mask)
    sums = [noise.moments(p, found.flat, found.edges) for p in (done, target)]
    return noise.report(sums[0], sums[1], found.levels)


def _flags(pair: PairResult, done: np.ndarray, target: np.ndarray, masks: Split) -> tuple[str, ...]:
    """What no pipeline with one setting for the whole picture does, each with the figure that shows it."""
    tone, blurred = local_processing(done, target, masks.fitted | masks.held_out)
    flags = []
    if pair.held_out_psnr < FEWEST_DB:
        flags.append(f"no camera fits: {pair.held_out_psnr:.1f} dB on held-out tiles (below {FEWEST_DB:g})")
    if tone > MOST_TONE:
        flags.append(
            f"brightness was changed locally, as an HDR merge does: means of {PATCH} px tiles are left "
            f"{tone:.3f} levels off (above {MOST_TONE:g})"
        )
    if blurred > MOST_BLURRED:
        flags.append(
            f"detail was removed locally, as a portrait blur does: gone from {100 * blurred:.0f} % of the "
            f"detailed tiles (above {100 * MOST_BLURRED:g} %)"
        )
    return tuple(flags)


def local_processing(done: np.ndarray, target: np.ndarray, mask: np.ndarray) -> tuple[float, float]:
    """(rms of what is left in the means of tiles [level], share of detailed tiles that lost their detail)."""
    luma = np.asarray(LUMA_601, np.float32)
    a, b = (_patches(picture @ luma) for picture in (done, target))
    whole = _patches(mask).all(axis=(-2, -1))
    if not whole.any():
        return 0.0, 0.0
    left = (b - a).mean(axis=(-2, -1))[whole]
    tone = float(np.sqrt(np.mean((left - np.median(left)) ** 2)))
    detail = [np.sqrt(np.mean(_high(p) ** 2, axis=(-2, -1)))[whole] for p in (a, b)]
    detailed = detail[0] > max(float(np.quantile(detail[0], 0.7)) / 2, 0.006)  # not the noise of flat ones
    if detailed.sum() < 8:
        return tone, 0.0
    ratio = detail[1][detailed] / detail[0][detailed]
    return tone, float((ratio < 0.4 * np.quantile(ratio, 0.9)).mean())


def _patches(plane: np.ndarray) -> np.ndarray:
    h, w = (n // PATCH for n in plane.shape)
    return plane[: h * PATCH, : w * PATCH].reshape(h, PATCH, w, PATCH).swapaxes(1, 2)


def _high(patches: np.ndarray) -> np.ndarray:
    """Second differences along both axes, on half the size: above the noise, below the blur."""
    shape = (*patches.shape[:2], PATCH // 2, 2, PATCH // 2, 2)
    small = patches.reshape(shape).mean(axis=(3, 5))
    core = small[..., 1:-1, 1:-1]
    around = small[..., :-2, 1:-1] + small[..., 2:, 1:-1] + small[..., 1:-1, :-2] + small[..., 1:-1, 2:]
    return core - around / 4
