"""What PSNR does not see: the noise in flat regions, its grain, and the overshoot of edges.

Flat regions are blocks of 16x16 px whose smoothed luma is nearly a plane. In each the plane is taken
away; what is left has a standard deviation and a correlation with its neighbour. All is in encoded
levels, of luma and of chroma (Cb and Cr together), by intensity.
"""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from jaxisp.color import LUMA_601, rgb_to_ycbcr_planes
from jaxisp.fit.planes import blur
from jaxisp.fit.strips import in_strips, strips

BLOCK = 16
BINS = 3
_FLAT_SHARE = 0.35  # of the blocks of one intensity, the flattest
_EDGE_SHARE = 0.04  # of the pixels, the steepest
_FEWEST = 4  # blocks that make a figure
KINDS = ("luma", "chroma")
SUMS = BINS * 2 * 3 + 2
"""What `moments` returns: how many."""
_ROUNDING = np.asarray([0.447, 0.410]) / 12 / 255**2  # variance of 8-bit RGB in luma, in Cb and Cr on average


class Regions(NamedTuple):
    """Where statistics are taken.

    Args:
        flat: (..., BINS, rows, columns) weight of each block in each intensity bin.
        edges: (..., H, W) weight of each pixel that lies at a strong edge.
        levels: (BINS,) mean luma of each bin; NaN where it is empty.
    """

    flat: np.ndarray
    edges: np.ndarray
    levels: np.ndarray


def regions(target: np.ndarray, mask: np.ndarray) -> Regions:
    """Flat blocks and strong edges of a picture.

    Args:
        target: (H, W, 3) encoded; sizes that are no multiple of 16 lose the rest.
        mask: (H, W), where pixels count.
    """
    y = target @ np.asarray(LUMA_601, target.dtype)
    smooth = in_strips(lambda part: blur(blur(part.astype(np.float64))), y)
    parts = [smooth[rows] for rows in strips(len(smooth))]
    structure = np.concatenate([np.sqrt(np.mean(_detrended(p, np) ** 2, axis=(-2, -1))) for p in parts])
    level = np.concatenate([_blocks(part, np).mean(axis=(-2, -1)) for part in parts])
    whole = _blocks(mask, np).all(axis=(-2, -1))
    flat = np.zeros((BINS, *level.shape), np.float32)
    if whole.sum() >= _FEWEST:
        inner = np.quantile(level[whole], np.linspace(0, 1, BINS + 1)[1:-1])
        index = np.searchsorted(inner, level)
        for i in range(BINS):
            own = whole & (index == i)
            if own.sum() >= _FEWEST:
                flat[i] = own & (structure <= np.quantile(structure[own], _FLAT_SHARE))
    slopes = in_strips(lambda part: np.hypot(*np.gradient(part)), smooth)
    edges = mask & (slopes >= np.quantile(slopes[mask], 1 - _EDGE_SHARE)) if mask.any() else mask
    with np.errstate(invalid="ignore", divide="ignore"):
        levels = (flat * level).sum((1, 2)) / flat.sum((1, 2))
    return Regions(flat, edges.astype(np.float32), levels)


def moments(image: Any, flat: Any, edges: Any, xp: Any = np) -> Any:
    """Sums that the statistics follow from; they add up over tiles.

    Args:
        image: (H, W, 3) encoded.
        flat, edges: of `Regions`.
        xp: jax.numpy where it is part of a program: by itself that takes longer to compile than to run.

    Returns:
        (SUMS,): per bin and kind the weight, the sum of squares and of neighbour products
        of the noise; the weight of edges, and the sum of squared detail there.
    """

    def planes(image: Any) -> Any:
        return rgb_to_ycbcr_planes(*xp.moveaxis(image, -1, 0))

    def products(plane: Any) -> Any:
        noise = _detrended(plane, xp)
        across = (noise[..., 1:] * noise[..., :-1]).mean((-2, -1))
        down = (noise[..., 1:, :] * noise[..., :-1, :]).mean((-2, -1))
        return xp.stack([(noise * noise).mean((-2, -1)), (across + down) / 2])

    if xp is jnp:  # mapped, a third is compiled
        whole = planes(image)
        y, cb, cr = jax.vmap(products)(xp.stack(whole))
        detail = _detail(whole[0], xp)
    else:
        parts = [[products(plane) for plane in planes(image[rows])] for rows in strips(len(image))]
        y, cb, cr = np.concatenate(parts, axis=2)
        detail = in_strips(lambda part: _detail(planes(part)[0], xp), image)
    count = flat.sum((-2, -1))
    per_kind = [
        xp.stack([channels * count, *(flat[None] * each[:, None]).sum((-2, -1))], -1)
        for channels, each in ((1, y), (2, cb + cr))
    ]
    sharp = edges * detail**2
    return xp.concatenate([xp.stack(per_kind, 1).ravel(), xp.stack([edges.sum(), sharp.sum()])])


def rounded(sums: np.ndarray) -> np.ndarray:
    """The sums of a render as they are after rounding to 8 bits: white noise is added."""
    out = np.array(sums, np.float64)
    table = out[:-2].reshape(BINS, 2, 3)
    table[..., 1] += table[..., 0] * _ROUNDING
    return out


def statistics(sums: np.ndarray) -> dict[str, np.ndarray]:
    """{"count", "std", "lag1"} as (BINS, 2) each and "edge", a number, from `moments`; NaN where empty."""
    table, edge = np.asarray(sums[:-2], np.float64).reshape(BINS, 2, 3), sums[-2:]
    with np.errstate(invalid="ignore", divide="ignore"):
        variance = table[..., 1] / table[..., 0]
        return {
            "count": table[..., 0],
            "std": np.sqrt(variance),
            "lag1": table[..., 2] / np.maximum(table[..., 1], 1e-12),
            "edge": np.sqrt(np.float64(edge[1]) / edge[0]),
        }


def misfit(sums: np.ndarray, wanted: np.ndarray, std: float = 0.05, lag1: float = 0.03) -> np.ndarray:
    """How far the statistics of a render are from those of the camera's picture, in tolerances: (17,).

    By intensity and kind, then of all intensities together with half the tolerance, then of edges.
    """
    ours, theirs = statistics(sums), statistics(wanted)
    usable = (theirs["count"] >= _FEWEST) & (theirs["std"] > 1e-4)
    ours_together, theirs_together = _pooled(sums, usable), _pooled(wanted, usable)
    rows = [
        *_distance(ours, theirs, usable, std, lag1),
        *_distance(ours_together, theirs_together, np.asarray(usable.any(axis=0)), std / 2, lag1 / 2),
        np.log(np.maximum(ours["edge"], 1e-6) / np.maximum(theirs["edge"], 1e-6)) / std,
    ]
    return np.nan_to_num(np.concatenate([np.ravel(r) for r in rows]))


TOGETHER = slice(4 * BINS, 4 * BINS + 4)
"""Of `misfit`: all intensities together."""


def _distance(
    ours: dict[str, np.ndarray], theirs: dict[str, np.ndarray], usable: np.ndarray, std: float, lag1: float
) -> tuple[np.ndarray, np.ndarray]:
    """Of the standard deviations (logarithms) and of the correlations, in tolerances."""
    a, b = (np.maximum(s["std"], 1e-6) for s in (ours, theirs))
    return usable * np.log(a / b) / std, usable * (ours["lag1"] - theirs["lag1"]) / lag1


def _pooled(sums: np.ndarray, usable: np.ndarray) -> dict[str, np.ndarray]:
    """{"std", "lag1"}, (2,) each, of all usable bins together."""
    count, square, product = np.moveaxis(
        (np.asarray(sums[:-2], np.float64).reshape(BINS, 2, 3) * usable[..., None]).sum(0), -1, 0
    )
    with np.errstate(invalid="ignore", divide="ignore"):
        return {"std": np.sqrt(square / count), "lag1": product / np.maximum(square, 1e-12)}


def report(ours: np.ndarray, theirs: np.ndarray, levels: np.ndarray) -> dict[str, Any]:
    """The figures as plain numbers: by kind and intensity, and pooled; `theirs` is the camera's picture."""
    a, b = statistics(ours), statistics(theirs)
    out: dict[str, Any] = {}
    for k, kind in enumerate(KINDS):
        rows = [
            {
                "level": round(float(levels[i]), 4),
                "blocks": int(b["count"][i, k] / (k + 1)),
                "std": [float(a["std"][i, k]), float(b["std"][i, k])],
                "lag1": [float(a["lag1"][i, k]), float(b["lag1"][i, k])],
            }
            for i in range(BINS)
            if b["count"][i, k] >= _FEWEST
        ]
        pooled = {}
        if rows:
            (_, s0, s1), (_, t0, t1) = (
                np.asarray(s[:-2]).reshape(BINS, 2, 3)[:, k].sum(0) for s in (ours, theirs)
            )
            pooled = {
                "std_ratio": float(np.sqrt(s0 / max(t0, 1e-12))),
                "lag1_difference": float(s1 / max(s0, 1e-12) - t1 / max(t0, 1e-12)),
            }
        out[kind] = {**pooled, "by_level": rows}
    if np.isfinite(b["edge"]):
        out["edge_detail_ratio"] = float(a["edge"] / max(b["edge"], 1e-9))
    return out


def _blocks(plane: Any, xp: Any) -> Any:
    h, w = (n // BLOCK for n in plane.shape)
    return xp.swapaxes(plane[: h * BLOCK, : w * BLOCK].reshape(h, BLOCK, w, BLOCK), 1, 2)


def _detrended(plane: Any, xp: Any) -> Any:
    """(rows, columns, 16, 16): each block less the plane that fits it best."""
    b = _blocks(plane, xp)
    arm = (np.arange(BLOCK) - (BLOCK - 1) / 2).astype(plane.dtype)
    down, across = arm[None, None, :, None], arm[None, None, None]
    power = float((arm**2).sum() * BLOCK)
    b = b - b.mean(axis=(-2, -1), keepdims=True)
    tilt_y = (b * down).sum(axis=(-2, -1), keepdims=True) / power
    tilt_x = (b * across).sum(axis=(-2, -1), keepdims=True) / power
    return b - tilt_y * down - tilt_x * across


def _detail(plane: Any, xp: Any) -> Any:
    """What a 5x5 box takes away: large in the overshoot of an edge."""
    h, w = plane.shape
    padded = xp.pad(plane, 2, mode="edge")
    rows = sum(padded[i : i + h] for i in range(5))
    return plane - sum(rows[:, j : j + w] for j in range(5)) / 25
