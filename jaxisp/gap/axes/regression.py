"""The share of a residual that each axis explains, cross-validated over scenes.

Each axis is a regression of the residual on features of a pixel: luma, radius times value, position in the
8x8 grid and so on. It is fitted on some scenes and scored on others. Neither many bins nor the layout of one
scene can therefore raise a share. Scenes that are not scored are used for fitting too.

Features that belong to simpler axes are fitted first and do not count. For example, the neighbourhood counts
only beyond a curve of luma; this curve is either each scene's own or common to all scenes.

Significance comes from random sign flips of whole tiles, compared with the largest of all axes.
"""

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from jaxisp.gap.axes import pixel_features
from jaxisp.gap.axes.interval import Draws
from jaxisp.gap.axes.pixel_features import POLAR_AXES, Scene
from jaxisp.gap.axes.profiles import Profiles
from jaxisp.gap.axes.scores import Bins, Changing, Explained, Lines, Regression, Repeated, Tail, Tiles, cut

DRAWS = 199
_SLACK = 0.01  # share of the energy added to the denominator of a share, where simpler axes leave little
_ROUNDING = 0.3  # 8-bit steps, standard deviation of rounding

Find = Callable[[np.ndarray, Tiles], Explained]


def where(
    residual: np.ndarray,
    picture: np.ndarray,
    weight: np.ndarray,
    *,
    cfa_period: int = 2,
    scenes: Sequence[str] | None = None,
    scored: int | None = None,
    earlier: tuple[int, int] = (0, 0),
    draws: int = DRAWS,
    rng: np.random.Generator,
) -> list[dict[str, Any]]:
    """Rank the axes by the share of the residual that they explain.

    Args:
        residual: (N, h, w, 3) target minus simulator, Y'CbCr in 8-bit steps.
        picture: (N, h, w, 3) the simulator's picture, likewise. Its corner is a corner of the CFA's cells and
            of the 8x8 blocks.
        weight: (N, h, w) weight of each pixel, in [0, 1].
        cfa_period: period of the colour filter array [px].
        scenes: (N,) name of each picture's scene; default: every picture shows a scene of its own.
        scored: number of leading pictures that are scored; the others are only used for fitting. None: all.
        earlier: row and column, 0 to 7, where the 8x8 blocks of an earlier compression begin; (0, 0) if none.
        draws: of signs, for p-values; with 0 these are all 1, and shares and profiles the same.
        rng: for folds and signs.

    Returns:
        one row for each axis, largest share first:

        - `axis`: its name.
        - `share`: explained share of the weighted mean square that simpler axes leave, in [0, 1].
        - `ci`: [low, high], the 90 % bootstrap interval of the share over scenes, with the fit held fixed;
          None if there is one scene.
        - `p_value`: corrected for the number of axes.
        - `bins`, `profile`, `unit`: the profile to plot.
        - `channel`, `channels`: the channel with the largest share, and the share of each channel.

    Raises:
        ValueError: the shapes do not match, or a side is shorter than 64 px.
    """
    n, h, w = weight.shape
    if residual.shape != (n, h, w, 3) or picture.shape != residual.shape or min(h, w) < 64:
        raise ValueError(
            f"residual {residual.shape}, picture {picture.shape}, weight {weight.shape}: "
            "expected (N, h, w, 3) twice and (N, h, w), with 64 px or more a side"
        )
    weight = weight.astype(np.float32)
    residual = np.where(weight[..., None] > 0, residual, 0).astype(np.float32)
    names = list(scenes or range(n))
    order = list(dict.fromkeys(names))
    shown_in = np.array([order.index(name) for name in names])
    scored = n if scored is None else scored
    tiles = cut(weight.shape, rng, shown_in, scored)
    evidence = _Evidence(tiles, cfa_period, shown_in, scored, earlier, rng)
    for own, shown, counted in zip(residual, picture, weight):
        evidence.add(Scene(shown), own, counted)
    signs = rng.choice((-1.0, 1.0), (draws + 1, tiles.count))
    signs[0] = 1
    explained = {axis: find(signs, tiles) for axis, find in evidence.axes().items()}
    p_values = _corrected({axis: e.own.sum(1) for axis, e in explained.items()})
    found, drawn = [], Draws.of(names[:scored])
    for axis, e in explained.items():
        energies = np.stack(evidence.energies)[:, int(axis in POLAR_AXES)]
        shares, row = _explains(e, energies, drawn)
        row |= {"axis": axis, "p_value": p_values[axis]}
        found.append(row | evidence.profiles.of(axis, shares))
    return sorted(found, key=lambda f: -f["share"])


def _explains(e: Explained, energies: np.ndarray, draws: Draws | None) -> tuple[np.ndarray, dict[str, Any]]:
    """Shares (3,) by channel, and the total `share` with its interval `ci`; `energies` is (N, 3)."""
    shares = _shares(e.own[0], np.broadcast_to(e.known, e.own.shape)[0], energies.sum(0))
    share, ci = float(np.clip(shares.sum(), 0, 1)), None
    if draws is not None:
        by = (np.broadcast_to(a, e.own_by.shape)[: len(energies)] for a in (e.own_by, e.known_by))
        ci = draws.interval(share, _shares(*map(draws.means, (*by, energies))).sum(-1))
    return shares, {"share": share, "ci": ci}


def _shares(own: np.ndarray, known: np.ndarray, energy: np.ndarray) -> np.ndarray:
    """Explained share (..., 3) by channel of the energy that simpler axes leave; the shares add up.

    Args:
        own: (..., 3) as in `Explained`.
        known: (..., 3) as in `Explained`.
        energy: (..., 3) sums of weighted squares of the residual.
    """
    total = energy.sum(-1, keepdims=True) + 1e-9
    known = np.clip(known, 0, energy)
    return (
        own
        / np.where(known > 0, energy - known + _SLACK * total, total)
        * np.where(known > 0, energy / total, 1)
    )


def _corrected(shares: dict[str, np.ndarray]) -> dict[str, float]:
    """P-value of each axis: how often the largest of all axes is as large under random signs.

    Each axis is standardised by its own null distribution. `shares` holds (D,) by axis; draw 0 has no flips.
    """
    every = np.stack(list(shares.values()))
    scaled = (every - every.mean(1, keepdims=True)) / (every.std(1, keepdims=True) + 1e-15)
    largest = scaled.max(0)
    return {axis: float(np.mean(largest >= own[0] - 1e-12)) for axis, own in zip(shares, scaled)}


class _Evidence:
    """Sums for all axes, accumulated scene by scene: scored scenes first, then scenes used to fit only."""

    def __init__(
        self,
        tiles: Tiles,
        period: int,
        scenes: np.ndarray,
        scored: int,
        earlier: tuple[int, int],
        rng: np.random.Generator,
    ) -> None:
        self._tiles, self._period, self._scored = tiles, period, scored
        scenes = scenes[:scored]
        self._known = pixel_features.REGRESSIONS | {"cfa_phase": pixel_features.cfa_features(period)}
        self._regressions = {axis: Regression(given) for axis, (_, given) in self._known.items()}
        self._displaced = Regression((4, 4, 4))
        self._lag = [Regression((1, 1, 1)) for _ in range(3)]
        self._rows, self._columns = Lines(), Lines()
        self._repeated, self._tail = Repeated(scenes), Tail(rng)
        self._changing = Changing(scenes)
        self._bins: dict[str, Bins] = {}
        self._grids = {grid: _opposite(grid, earlier) for grid in {(0, 0), earlier}}
        self._blocks = {grid: (Bins(), Bins()) for grid in self._grids}
        self.profiles = Profiles(period)
        self.energies: list[np.ndarray] = []  # (2, 3) by picture: chroma plain or polar, and channel
        self._scenes = len(set(scenes))
        self._frames = [f"{s + 1}.{list(scenes[:i]).count(s)}" for i, s in enumerate(scenes)]

    def add(self, scene: Scene, residual: np.ndarray, weight: np.ndarray) -> None:
        """Add one scene: residual (h, w, 3) in 8-bit steps, weight (h, w)."""
        polar = scene.polar(residual)
        for axis, (build, _) in self._known.items():
            self._regressions[axis].add(
                build(scene), polar if axis in POLAR_AXES else residual, weight, self._tiles
            )
        self._displaced.add(pixel_features.displaced(scene), residual, weight, self._tiles)
        self._add_places(scene, residual, weight)
        self._add_blocks(scene, residual * weight[..., None])
        flat = _flat(scene.edge, weight)
        self._add_lags(residual, flat)
        if len(self.energies) == self._scored:
            return
        squares = (weight[..., None] * a**2 for a in (residual, polar))
        self.energies.append(np.stack([s.sum((0, 1), dtype=np.float64) for s in squares]))
        detail = residual - np.stack([pixel_features.ring(residual[..., c]) for c in range(3)], -1)
        self._add_tail(detail, flat)
        self._add_lines(residual, weight)
        self._repeated.add(_unlocked(detail * weight[..., None]))
        self._changing.add(residual, weight, self._tiles)
        self.profiles.add(scene, residual, polar, detail, weight, flat)

    def _add_places(self, scene: Scene, residual: np.ndarray, weight: np.ndarray) -> None:
        h, w = weight.shape
        side = np.arange(max(h, w)) % 8
        place = np.arange(64)
        coarse = place // 8 % self._period * self._period + place % self._period
        if not self._bins:
            nested = coarse if 8 % self._period == 0 else place * 0
            self._bins = {"row": Bins(side[:h]), "column": Bins(side[:w]), "phase": Bins(nested)}
        weighted = residual * weight[..., None]
        phase = scene.rows % 8 * 8 + scene.columns % 8
        for part in self._tiles.slices:
            for axis, index, count in (
                ("row", scene.rows, h), ("column", scene.columns, w), ("phase", phase, 64),
            ):  # fmt: skip
                self._bins[axis].add(*_sums(index[part], weighted[part], weight[part], count))

    def _add_lines(self, residual: np.ndarray, weight: np.ndarray) -> None:
        h, w = weight.shape
        across = [c for _, c in self._tiles.slices[: self._tiles.across]]
        down = [r for r, _ in self._tiles.slices[:: self._tiles.across]]
        tile_of_row, tile_of_column = (
            np.searchsorted([s.start for s in edges], np.arange(n), "right") - 1
            for edges, n in ((down, h), (across, w))
        )
        self._rows.add(residual, weight, tile_of_row, across)
        self._columns.add(residual.swapaxes(0, 1), weight.T, tile_of_column, down)

    def _add_blocks(self, scene: Scene, residual: np.ndarray) -> None:
        """Add slopes of the residual's 8x8 cosine coefficients on the picture's, on each grid and off it."""
        for grid, off in self._grids.items():
            for place, bins in zip((grid, off), self._blocks[grid]):
                ours, theirs = (
                    [
                        pixel_features.block_transform(np.roll(a, (-place[0], -place[1]), (0, 1)))
                        for a in planes
                    ]
                    for planes in (scene.planes, np.moveaxis(residual, -1, 0))
                )
                for rows, columns in self._tiles.slices:
                    part = tuple(slice(s.start // 8, s.stop // 8) for s in (rows, columns))
                    sums = [_slopes(a[part], b[part]) for a, b in zip(ours, theirs)]
                    bins.add(np.stack([s for s, _ in sums], -1), np.stack([c for _, c in sums], -1))

    def _add_lags(self, residual: np.ndarray, flat: np.ndarray) -> None:
        for channel, regression in enumerate(self._lag):
            target = np.zeros_like(residual)
            target[..., channel] = residual[..., channel]
            regression.add(pixel_features.lag_features(residual, channel), target, flat, self._tiles)

    def _add_tail(self, detail: np.ndarray, flat: np.ndarray) -> None:
        for part in self._tiles.slices:
            values = detail[part][flat[part] > 0.5]
            if len(values) > 100:
                scale = np.maximum(1.4826 * np.median(np.abs(values), 0), _ROUNDING)
                self._tail.add(values, scale, len(self.energies) - 1)

    def axes(self) -> dict[str, Find]:
        """By axis, a function that returns the energy explained under given signs."""
        bins, lines = self._bins, (self._rows, self._columns)
        scored = self._scored * len(self._tiles.slices)  # number of tiles of the scored pictures

        def alone(find: Find) -> Find:
            return lambda signs, tiles: find(signs[:, :scored], tiles)

        def row(signs: np.ndarray, tiles: Tiles) -> Explained:
            return _larger(bins["row"].explained(signs, tiles), lines[0].explained(signs, tiles))

        def column(signs: np.ndarray, tiles: Tiles) -> Explained:
            return _larger(
                bins["column"].explained(signs, tiles), lines[1].explained(signs, tiles, transposed=True)
            )

        def block_phase(signs: np.ndarray, tiles: Tiles) -> Explained:
            found = bins["phase"].explained(signs, tiles)
            for grid in self._blocks.values():
                on, off = (b.explained(signs, tiles) for b in grid)
                found = _larger(found, Explained(on.own - off.own, on.own_by - off.own_by))
            return found

        def edge(signs: np.ndarray, tiles: Tiles) -> Explained:
            """The larger of two models: one filter everywhere, or a displacement that varies by place."""
            own = self._displaced.nearby(signs[:, :scored], tiles)
            return _larger(self._regressions["edge"].explained(signs, tiles), own)

        def neighbourhood(signs: np.ndarray, tiles: Tiles) -> Explained:
            """The larger of two models: beyond a luma curve by scene, or beyond one curve of all scenes."""
            regression = self._regressions["neighbourhood"]
            return _larger(regression.explained(signs, tiles), regression.shared(signs, tiles))

        def lag(signs: np.ndarray, tiles: Tiles) -> Explained:
            parts = [r.explained(signs, tiles) for r in self._lag]
            return Explained(np.sum([p.own for p in parts], 0), np.sum([p.own_by for p in parts], 0))

        found: dict[str, Find] = {axis: r.explained for axis, r in self._regressions.items()}
        found |= {"row": row, "column": column, "block_phase": block_phase, "lag": lag}
        found |= {"edge": edge, "neighbourhood": neighbourhood}
        found["tail"] = self._tail.explained
        if self._scenes >= 3:
            found["fixed_pattern"] = alone(self._repeated.explained)
        if self._changing.repeated:
            found["frame"] = alone(self._changing.explained)
            self.profiles.add_frames(self._frames, self._changing.means())
        return found


def _opposite(grid: tuple[int, int], earlier: tuple[int, int]) -> tuple[int, int]:
    """A reference grid half a block away, or a quarter of a block if another grid lies there.

    A residual that is not locked to a grid explains the same on and off it.
    """
    half, quarter = (((grid[0] + by) % 8, (grid[1] + by) % 8) for by in (4, 2))
    return quarter if half in ((0, 0), earlier) else half


def _flat(edge: np.ndarray, weight: np.ndarray) -> np.ndarray:
    """Weight (h, w) restricted to the flatter half of a scene, without the border of 7 px.

    Filters repeat pixels at the border.
    """
    inner = np.zeros_like(weight)
    inner[7:-7, 7:-7] = weight[7:-7, 7:-7]
    counted = edge[inner > 0]
    return inner * (edge <= np.median(counted)) if len(counted) else inner


def _larger(a: Explained, b: Explained) -> Explained:
    """The larger of two explained energies, chosen separately for each draw."""
    first = a.own.sum(1, keepdims=True) >= b.own.sum(1, keepdims=True)
    own, known = np.where(first, a.own, b.own), np.where(first, a.known, b.known)
    chosen = a if first[0] else b
    return Explained(own, chosen.own_by, known, chosen.known_by)


def _sums(
    index: np.ndarray, weighted: np.ndarray, weight: np.ndarray, count: int
) -> tuple[np.ndarray, np.ndarray]:
    flat = index.ravel()
    sums = [np.bincount(flat, weighted[..., c].ravel(), count) for c in range(3)]
    counts = np.bincount(flat, weight.ravel(), count)
    return np.stack(sums, -1), np.repeat(counts[:, None], 3, 1)


def _slopes(ours: np.ndarray, theirs: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Sums (512,) of products and of squares, by cosine coefficient and its magnitude in octaves."""
    octave = np.clip(np.log2(np.abs(ours) + 1e-6).astype(int) + 1, 0, 7)
    index = (octave + 8 * np.arange(64).reshape(8, 8)).ravel()
    return np.bincount(index, (ours * theirs).ravel(), 512), np.bincount(index, (ours**2).ravel(), 512)


def _unlocked(detail: np.ndarray) -> np.ndarray:
    """Subtract the means of rows, columns and positions in the 8x8 grid, which other axes measure."""
    detail = detail - detail.mean(0, keepdims=True)
    detail = detail - detail.mean(1, keepdims=True)
    for dy in range(8):
        for dx in range(8):
            detail[dy::8, dx::8] -= detail[dy::8, dx::8].mean((0, 1))
    return detail
