"""How sure the share of an axis is: what it would be, were other scenes of the same kind looked at."""

from collections.abc import Hashable, Sequence
from dataclasses import dataclass

import numpy as np

_DRAWS = 400


@dataclass(frozen=True)
class Draws:
    """Draws of as many scenes as there are, with replacement and with all frames of each: a bootstrap.

    Attributes:
        times: (D, N) how many times each picture counts.
        scenes: how many there are, two or more.
    """

    times: np.ndarray
    scenes: int

    @classmethod
    def of(cls, scenes: Sequence[Hashable]) -> "Draws | None":
        """The draws, the same each time, of pictures that show these (N,) scenes; None where these are fewer
        than two: then there is nothing else to draw."""
        order = list(dict.fromkeys(scenes))
        n = len(order)
        if n < 2:
            return None
        times = np.random.default_rng(0).multinomial(n, np.full(n, 1 / n), _DRAWS)
        return cls(times[:, [order.index(s) for s in scenes]].astype(float), n)

    def means(self, values: np.ndarray) -> np.ndarray:
        """(D, ...) of (N, ...) values by picture, draw by draw."""
        return np.asarray(self.times @ values / self.times.sum(1, keepdims=True))

    def interval(self, share: float, drawn: np.ndarray) -> list[float]:
        """[low, high], the 90 % interval of a share in [0, 1] that is (D,) in the draws. It holds the share,
        and is as much wider than the draws' as these are too alike where scenes are few."""
        low, high = np.percentile(drawn, (5, 95))
        factor = few_scenes(self.scenes)
        ends = share - factor * max(share - low, 0.0), share + factor * max(high - share, 0.0)
        return [float(np.clip(end, 0, 1)) for end in ends]


_LEAST_WHOLE = 0.25  # of the gap in what is drawn: near the floor a part of it may be none


def interval(drop: np.ndarray, whole: np.ndarray | float, seed: int = 0) -> tuple[float, float]:
    """90 % interval of the mean of (N, U) drops over the whole, by a bootstrap of pairs and their units.

    Where the whole is given unit by unit a scene that has more of the gap is drawn with it, and does not make
    the share uncertain.
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
    """How many times as wide as a bootstrap's the 90 % interval of a mean over so many independent figures
    is: Student's t for the normal's, and the variance with n - 1. 1 for one figure; for None, of tiles too.
    """
    if count is None or count < 2:
        return 1.0
    from scipy.stats import norm, t

    return float(np.sqrt(count / (count - 1)) * t.ppf(0.95, count - 1) / norm.ppf(0.95))
