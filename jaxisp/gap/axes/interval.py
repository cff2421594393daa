"""Confidence intervals of shares by a bootstrap over scenes."""

from collections.abc import Hashable, Sequence
from dataclasses import dataclass

import numpy as np

_DRAWS = 400


@dataclass(frozen=True)
class Draws:
    """Bootstrap draws of scenes, with replacement; a scene is drawn with all its frames.

    Attributes:
        times: (D, N) number of times that each picture counts in each draw.
        scenes: number of scenes, two or more.
    """

    times: np.ndarray
    scenes: int

    @classmethod
    def of(cls, scenes: Sequence[Hashable]) -> "Draws | None":
        """Draw from the scene names (N,) of pictures; None if there are fewer than two scenes.

        The seed is fixed, so the same scenes give the same draws.
        """
        order = list(dict.fromkeys(scenes))
        n = len(order)
        if n < 2:
            return None
        times = np.random.default_rng(0).multinomial(n, np.full(n, 1 / n), _DRAWS)
        return cls(times[:, [order.index(s) for s in scenes]].astype(float), n)

    def means(self, values: np.ndarray) -> np.ndarray:
        """Mean (D, ...) over each draw of values (N, ...) by picture."""
        return np.asarray(self.times @ values / self.times.sum(1, keepdims=True))

    def interval(self, share: float, drawn: np.ndarray) -> list[float]:
        """The 90 % interval [low, high] of a share, from its values in the draws.

        The interval contains the share. It is wider than the draws by the factor `few_scenes`.

        Args:
            share: in [0, 1].
            drawn: (D,) the share in each draw.
        """
        low, high = np.percentile(drawn, (5, 95))
        factor = few_scenes(self.scenes)
        ends = share - factor * max(share - low, 0.0), share + factor * max(high - share, 0.0)
        return [float(np.clip(end, 0, 1)) for end in ends]


_LEAST_WHOLE = 0.25  # least gap of a draw, as a share of the mean gap; it may vanish near the floor


def interval(drop: np.ndarray, whole: np.ndarray | float, seed: int = 0) -> tuple[float, float]:
    """The 90 % interval of mean drop over mean gap, by a bootstrap of pairs and of units within pairs.

    Args:
        drop: (N, U) drop of the gap by pair and unit (tile); NaN for units without pixels.
        whole: the gap; one number, or (N, U) likewise. Given by unit, it is drawn together with the drop, so
            that scenes with more of the gap do not widen the interval.
        seed: of the bootstrap.

    Returns:
        low and high end.
    """
    rng = np.random.default_rng(seed)
    n, u = drop.shape
    pairs = rng.integers(n, size=(_DRAWS, n))
    units = rng.integers(u, size=(_DRAWS, n, u))
    means = np.nanmean(drop[pairs[..., None], units], (1, 2))
    if isinstance(whole, np.ndarray):
        sizes = np.nanmean(whole[pairs[..., None], units], (1, 2))
        whole = np.maximum(sizes, _LEAST_WHOLE * np.nanmean(whole))
    low, high = np.percentile(means / whole, (5, 95))
    return float(low), float(high)


def few_scenes(count: int | None) -> float:
    """Factor that widens a bootstrap's 90 % interval of a mean over `count` independent values.

    It replaces the normal quantile by Student's t, and n by n - 1 in the variance. It is 1 for one value, and
    for None, which stands for a bootstrap of tiles.
    """
    if count is None or count < 2:
        return 1.0
    from scipy.stats import norm, t

    return float(np.sqrt(count / (count - 1)) * t.ppf(0.95, count - 1) / norm.ppf(0.95))
