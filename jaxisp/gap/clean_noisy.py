"""Clean+noisy pairs: the problem whose errors are differences of statistics, and its base."""

import dataclasses
import re
from collections.abc import Mapping, Sequence
from types import MappingProxyType
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from jaxisp.fit.align import estimate, same_scene
from jaxisp.gap import prepare
from jaxisp.gap.effects import CLEAN_NOISY
from jaxisp.gap.model import Choice, Model
from jaxisp.gap.noisy_base import fit_mean, fit_noise
from jaxisp.gap.noisy_mean import normalised_regressors
from jaxisp.gap.noisy_units import axis_of, repeats, tolerances, weights
from jaxisp.gap.residual import BORDER, Pairs, to_steps
from jaxisp.gap.statistics import feature_names, features, frames_of
from jaxisp.gap.which import Part, Split, Tick
from jaxisp.io.datasets import Loaded

_REPLICATES = 4


class StatisticsProblem:
    """Statistics of the real pictures against those of simulated ones; has what `Problem` has.

    Differences are averaged over the pairs of a half before they are squared: what a camera does is alike in
    all of its pictures, and chance is not. The noise of a simulated picture is drawn from one key a pair,
    whatever the parameters, so that a change of statistics is the parameters' doing.
    """

    choices: Sequence[Choice] = ()
    references: Mapping[int, float] = MappingProxyType({})

    def __init__(self, model: Model, pairs: Pairs, noise_free: np.ndarray, split: Split, seed: int) -> None:
        self.model, self.pairs, self.split, self.seed = model, pairs, split, seed
        self.inner = (slice(None), slice(BORDER, -BORDER), slice(BORDER, -BORDER))
        self.mask = jnp.asarray(pairs.mask[self.inner], jnp.float32)
        self.base_picture = jnp.asarray(noise_free[self.inner])
        self.target = to_steps(pairs.pictures[self.inner])
        self.weight = np.sqrt(np.broadcast_to(np.asarray(self.mask)[..., None], self.target.shape))
        self._frames = frames_of([_scene(name) for name in pairs.names])
        self._maps = tuple(normalised_regressors(self.base_picture, self.mask, c) for c in range(3))
        self.real = self.measured(self.target)
        self.floors = np.ones(len(pairs.names))
        self._set_scale(np.ones_like(self.real))  # until it is measured, chance is alike for all
        self.move_to(np.zeros(len(model.coordinates)))

    def keys(self, replicate: int = 0) -> jax.Array:
        root = jax.random.fold_in(jax.random.key(self.seed), replicate)
        return jax.vmap(lambda i: jax.random.fold_in(root, i))(jnp.arange(len(self.pairs.names)))

    def rendered(self, z: np.ndarray, replicate: int = 0) -> np.ndarray:
        """(N, H, W, 3) encoded, noise and all."""
        return self.model.render(z, self.pairs.light, self.keys(replicate))

    def picture(self, z: np.ndarray, replicate: int = 0) -> np.ndarray:
        return to_steps(self.rendered(z, replicate)[self.inner])

    def simulated(self, z: np.ndarray, replicate: int = 0) -> np.ndarray:
        """(N, F) statistics of a simulated set."""
        return self.measured(self.picture(z, replicate))

    def measured(self, pictures: np.ndarray) -> np.ndarray:
        """(N, F) statistics of pictures in steps, their border cut off."""
        found = features(jnp.asarray(pictures), self.base_picture, self.mask, self._maps, self._frames)
        return np.asarray(found, float)

    def set_unit(self) -> None:
        """Take the scatter from draw to draw into the unit of each statistic, and into the floor, which is
        what is harmless and chance together."""
        draws = np.stack([self.simulated(self.z, k) for k in range(1, 1 + _REPLICATES)])
        self._set_scale(draws.var(0, ddof=1))
        self.move_to(self.z)
        chance = np.stack([self._mean(self._scale * (d - self._simulated)) ** 2 for d in draws]).mean(0)
        self.floors = (chance + self._harmless).mean(1)

    def _set_scale(self, chance: np.ndarray) -> None:
        """(N, F) what differences are multiplied by, so that their mean over a half is in units.

        A statistic that a picture has no pixels for does not vary, and does not count there.
        """
        counted = (chance > 1e-12) + 1e-9
        shares = counted / self._mean(counted)
        sizes = np.array([len(self._half(i)) for i in range(len(chance))])[:, None]
        scatter = repeats() * self._mean(shares**2 * chance) / sizes
        unit = np.sqrt(tolerances() ** 2 + 2 * scatter)
        self._scale = shares / unit * np.sqrt(weights())
        self._harmless = weights() * (tolerances() / unit) ** 2

    def _half(self, pair: int) -> list[int]:
        return list(self.split.fit if pair in self.split.fit else self.split.held_out)

    def _mean(self, values: np.ndarray) -> np.ndarray:
        """(N, ...) each pair gets the mean of its half."""
        found = np.empty_like(values, float)
        for half in (self.split.fit, self.split.held_out):
            found[list(half)] = values[list(half)].mean(0)
        return found

    def units(self, z: np.ndarray) -> np.ndarray:
        """(N, 1) each pair's part in the error of its half: an interval is drawn over pairs."""
        return self.errors(z)[:, None]

    def errors(self, z: np.ndarray) -> np.ndarray:
        """(N,) each pair's part in the square of its half's mean difference, the mean of these parts."""
        own = self._scale * (self.real - self.simulated(z))
        return (own * self._mean(own)).mean(1)

    def move_to(self, z: np.ndarray) -> None:
        self.z = np.asarray(z, float)
        self._simulated = self.simulated(self.z)
        self.difference = self._mean(self._scale * (self.real - self._simulated))
        self.columns: dict[int, np.ndarray] = {}

    @property
    def residual(self) -> np.ndarray:
        return (self.target - np.asarray(self.base_picture)) * self.weight

    @property
    def current(self) -> np.ndarray:
        return np.asarray(self.base_picture)

    def take(self, which: Sequence[int]) -> Part:
        """Some of the pairs; what repeats in all of them is still looked for in all."""
        return Part(self, which)

    def choose(self, choice: Choice) -> None:
        self.model = self.model.chosen(choice)
        self.move_to(self.z)

    def compute(self, which: Sequence[int], steps: Mapping[int, float] | None = None) -> None:
        for i in set(which) - set(self.columns):
            moved, step = self.model.probe(self.z, i, (steps or {}).get(i))
            self.columns[i] = self._mean(self._scale * (self.simulated(moved) - self._simulated)) / step

    def normal(self, which: Sequence[int]) -> tuple[np.ndarray, np.ndarray]:
        stacked = np.stack([self.columns[i] for i in which], 1)
        count = stacked.shape[-1]
        return stacked @ stacked.transpose(0, 2, 1) / count, np.einsum(
            "nkf,nf->nk", stacked, self.difference
        ) / count

    def located(self, held: Sequence[int]) -> list[dict[str, Any]]:
        """The axes by their share of what the gap at the point has above what is harmless and chance."""
        names = feature_names()
        axes = np.array([axis_of(name) for name in names])
        mean = self.difference[list(held)].mean(0)
        excess = mean**2 - weights()
        above = {str(axis): max(float(excess[axes == axis].sum()), 0.0) for axis in axes}
        mean = mean / np.sqrt(weights())
        found = [
            {
                "axis": axis,
                "share": own / (sum(above.values()) + 1e-9),
                "p_value": _p_value(float((mean[axes == axis] ** 2).mean())),
                "bins": [_short(n) for n, a in zip(names, axes) if a == axis],
                "profile": [float(v) for v in mean[axes == axis]],
                "unit": "what is harmless or chance",
            }
            for axis, own in above.items()
        ]
        return sorted(found, key=lambda f: -float(str(f["share"])))


def _short(name: str) -> str:
    """A statistic's name without its axis."""
    kind, _, what = name.split(" ", 2)
    return f"{kind} {what}"


def _p_value(mean_square: float) -> float:
    """Of a mean square of differences in units of what is harmless, taken for four independent ones."""
    from scipy.stats import chi2

    return float(chi2.sf(4 * mean_square, 4))


def clean_problem(
    loaded: Sequence[Loaded], exclude: Sequence[str], seed: int, tick: Tick
) -> tuple[StatisticsProblem, Split, dict[str, float], list[str], np.ndarray]:
    """The base fitted to clean+noisy pairs: the mean by pixels, then the noise by its statistics."""
    pairs = _pairs(loaded)
    split = _split(pairs.names)
    effects = prepare.candidates(CLEAN_NOISY, exclude)
    tick(0, 3, "fitting the base")
    file = loaded[0].jpeg
    described = loaded[0].settings.raw
    camera, mean = fit_mean(file, pairs, split.fit, described.cfa if described else None)
    pairs, noise_free = mean.pairs, to_steps(mean.rendered(mean.z))
    model = camera.whole_model(mean.model.moved(mean.z), effects)
    problem = StatisticsProblem(model, pairs, noise_free, split, seed)
    tick(0, 3, "fitting the noise")
    fit_noise(problem, split.fit)
    problem.set_unit()
    absorbed = dict.fromkeys(
        ("tone_curve", "color_matrix", "white_balance", "black_level_offset", "noise_level"), 0.0
    )
    stated = {"jpeg_quantization"} if file is not None else set()
    if file is not None and file.subsampling != "4:4:4":
        stated.add("chroma_subsampling")
    offered = [e.name for e in effects if e.name not in stated and e.name not in absorbed]
    return problem, split, absorbed, offered, problem.floors


def _split(names: Sequence[str]) -> Split:
    """Every other scene is fitted, with all of its frames."""
    scenes = [_scene(name) for name in names]
    order = list(dict.fromkeys(scenes))
    if len(order) == 1:
        order, scenes = list(names), list(names)
    fitted = set(order[::2])
    which = [[i for i, s in enumerate(scenes) if (s in fitted) == first] for first in (True, False)]
    return Split(tuple(which[0]), tuple(which[1]))


def _scene(name: str) -> str:
    """The stem without the number of a repeated frame."""
    return re.sub(r"\.f\d{2,}$", "", name)


def _pairs(loaded: Sequence[Loaded]) -> Pairs:
    loaded = [_framed(p) for p in {p.name: p for p in loaded}.values()]
    crops = prepare.common_crop(loaded)
    clean = np.stack([_linear(p)[c] for p, c in zip(loaded, crops)])
    pictures = np.stack([p.picture[c] for p, c in zip(loaded, crops)]).astype(np.float32)
    clean = np.stack([_laid_under(s, p) for s, p in zip(clean, pictures)])
    names = tuple(p.name for p in loaded)
    return prepare.in_halves(
        Pairs(names, jnp.asarray(clean, jnp.float32), pictures, prepare.usable(pictures))
    )


def _framed(pair: Loaded) -> Loaded:
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


def _laid_under(scene: np.ndarray, picture: np.ndarray) -> np.ndarray:
    """The scene moved by whole pixels to where the picture has its details: the picture keeps its place on
    the grids of its colour filter array and of its file."""
    found = estimate(picture, np.sqrt(np.clip(scene.mean(-1), 0, None)))
    move = [-int(np.clip(round(float(v)), -BORDER, BORDER)) for v in (found.dy, found.dx)]
    return np.roll(scene, move, (0, 1)) if same_scene(found, scene.shape[:2]) else scene


def _linear(pair: Loaded) -> np.ndarray:
    clean = np.asarray(pair.clean, np.float32)
    if pair.settings.clean_encoding == "linear":
        return clean
    return np.where(clean <= 0.04045, clean / 12.92, ((clean + 0.055) / 1.055) ** 2.4)
