"""Clean+noisy pairs: the problem whose errors are differences of statistics."""

import copy
import functools
import itertools
from collections.abc import Callable, Mapping, Sequence
from types import MappingProxyType
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from jaxisp.gap.axes.statistics import credited, in_one_place, located
from jaxisp.gap.case import Ladders, Part, Rows, Split
from jaxisp.gap.features.mean import Maps, normalised_regressors
from jaxisp.gap.features.quantization import Codes
from jaxisp.gap.features.residual_statistics import features, frames_of, mean_features
from jaxisp.gap.objective import tones
from jaxisp.gap.objective.pixels import BORDER, Pairs, to_steps
from jaxisp.gap.objective.starts import noisier, placed, starts, told_by_noise
from jaxisp.gap.objective.tolerances import (
    by_place,
    emphasis,
    emphasised,
    left_by_shift,
    noise_only,
    repeats,
    units,
    weights,
)
from jaxisp.gap.pairs.scenes import by_scene, scene_name
from jaxisp.gap.parallel import each
from jaxisp.gap.simulator.model import Choice, Model

_REPLICATES = 4
_KEPT = 128
"""Points whose statistics are kept: where a search has looked it goes, and compares with."""
_FEWEST = 4  # scenes that tell how they differ


class Reference(NamedTuple):
    """What pictures are looked at against.

    Attributes:
        picture: (N, h, w, 3) without noise.
        maps: `normalised_regressors` of it.
    """

    picture: jax.Array
    maps: Sequence[tuple[Maps, ...]]

    @classmethod
    def of(cls, picture: np.ndarray, mask: jax.Array) -> "Reference":
        return cls(jnp.asarray(picture), normalised_regressors(picture, mask))

    def take(self, index: Sequence[int]) -> "Reference":
        return Reference(self.picture[np.array(index)], [self.maps[i] for i in index])


class StatisticsProblem:
    """Statistics of the real pictures against those of simulated ones; has what `Problem` has.

    Differences are averaged over the pairs of a half before they are squared: what a camera does is alike in
    all of its pictures, and chance is not. The noise of a simulated picture is drawn from one key a pair,
    whatever the parameters, so that a change of statistics is the parameters' doing.

    A clean picture whose file compressed it lacks what that took, and the noisy one does not. What that was
    nobody knows; what compressing it once more takes is alike. So a simulated picture, made of the clean one,
    is looked at against that compressed again, as a real one is against the clean one.
    """

    references: Mapping[int, float] = MappingProxyType({})
    rival: Choice | None = None
    difference: np.ndarray
    _scale: np.ndarray

    def __init__(
        self,
        model: Model,
        pairs: Pairs,
        noise_free: Callable[[jax.Array], np.ndarray],
        split: Split,
        seen: Codes,
        choices: Sequence[Choice] = (),
        seed: int = 0,
    ) -> None:
        self.model, self.pairs, self.split, self.seed = model, pairs, split, seed
        self.choices = choices
        self.inner = (slice(None), slice(BORDER, -BORDER), slice(BORDER, -BORDER))
        self.mask = jnp.asarray(pairs.mask[self.inner], jnp.float32)
        self.target = to_steps(pairs.pictures[self.inner])
        self.weight = np.sqrt(np.broadcast_to(np.asarray(self.mask)[..., None], self.target.shape))
        self._frames = frames_of([scene_name(name) for name in pairs.names])
        light, again = pairs.light, pairs.again
        self.reference = Reference.of(noise_free(light)[self.inner], self.mask)
        self.again = self.reference
        if again is not None:
            self.again = Reference.of(noise_free(again)[self.inner], self.mask)
        self._codes = seen
        self._weights = weights(self._frames.repeated)
        self._counted = np.ones_like(self._weights)
        self._emphasis: np.ndarray | None = None
        self._before: np.ndarray | None = None  # what blocks are off by where a fit starts
        self._known: dict[tuple[int, bytes], tuple[Model, tuple[np.ndarray, np.ndarray]]] = {}
        self.fresh: Sequence[int] = told_by_noise(model)
        self.real = self.measured(self.target, self.reference)
        self.floors = np.ones(len(pairs.names))
        self._numbers = list(range(len(pairs.names)))  # of the keys
        self._tones = tones.of(self.target, self.mask)
        self._simulated, self._toned = self.real, self._tones
        self.z = np.zeros(len(model.coordinates))
        self._set_scale(np.ones_like(self.real))  # until it is measured, chance is alike for all
        self.move_to(self.z)

    def keys(self, replicate: int = 0) -> jax.Array:
        root = jax.random.fold_in(jax.random.key(self.seed), replicate)
        return jax.vmap(lambda i: jax.random.fold_in(root, i))(jnp.asarray(self._numbers))

    def rendered(self, z: np.ndarray, replicate: int = 0) -> np.ndarray:
        """(N, H, W, 3) encoded, noise and all."""
        return self.model.render(z, self.pairs.light, self.keys(replicate))

    def picture(self, z: np.ndarray, replicate: int = 0) -> np.ndarray:
        return to_steps(self.rendered(z, replicate)[self.inner])

    def simulated(self, z: np.ndarray, replicate: int = 0) -> np.ndarray:
        """(N, F) statistics of a simulated set."""
        return self.measured(self.picture(z, replicate), self.again)

    def _seen(self, z: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """(N, F) statistics and (N, T) tones of a simulated set, these and the mean's statistics without the
        effects that are noise: where a pattern has its pixels is chance, and the same in all pictures."""
        key = id(self.model), z.tobytes()
        known = self._known.get(key)  # another thread may forget it meanwhile
        if known is None:
            known = self.model, self._looked_at(z)  # the model is held on to, so that its id stays its own
            if len(self._known) >= _KEPT:
                self._known.clear()
            self._known[key] = known
        return known[1]

    def _looked_at(self, z: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        picture, still = self.picture(z), self.model.still(z)
        found = self.measured(picture, self.again)
        if (still != z).any():
            picture = self.picture(still)
            means = mean_features(jnp.asarray(picture), self.again.picture, self.mask, self.again.maps)
            found[:, : means.shape[1]] = means
        return found, tones.of(picture, self.mask)

    def measured(
        self, pictures: np.ndarray, against: Reference, part: tuple[slice, slice] | None = None
    ) -> np.ndarray:
        """(N, F) statistics of pictures in steps, their border cut off; of a part of the frame, or all."""
        mask = self.mask
        if part is not None:
            mask = jnp.zeros_like(mask).at[:, *part].set(mask[:, *part])
        found = features(
            jnp.asarray(pictures), against.picture, mask, against.maps, self._frames, self._codes
        )
        return np.asarray(found, float)

    def set_unit(self, emphasise: bool = False) -> None:
        """Take the scatter from draw to draw and from scene to scene into the unit of each statistic; the
        floor is one such unit. `emphasise` what the fitted pairs have most of their gap in."""
        draws = np.stack([self.simulated(self.z, k) for k in range(1, 1 + _REPLICATES)])
        self._set_scale(draws.var(0, ddof=1))
        self.move_to(self.z)
        if emphasise:
            self._emphasis = emphasis(self.difference[self.split.fit[0]] ** 2 / self._weights)
            plain, self._weights = self._weights, emphasised(self._weights, self._emphasis)
            self._scale = self._scale * np.sqrt(self._weights / plain)
            self.move_to(self.z)

    def count(self, which: np.ndarray) -> None:
        """Let only these statistics (F,) count from now on."""
        self._counted = which
        self.move_to(self.z)

    def _set_scale(self, chance: np.ndarray) -> None:
        """(N, F) what differences are multiplied by, so that their mean over a half is in units.

        A statistic that a picture has no pixels for does not vary, and does not count there.
        """
        counted = (chance > 1e-12) + 1e-9
        shares = counted / self._mean(counted)
        sizes = np.array([len(self._half(i)) for i in range(len(chance))])[:, None]
        scatter = 2 * repeats() * self._mean(shares**2 * chance) / sizes
        squares = units(np.maximum(scatter, self._unlike(shares)), self._uneven(shares))
        self._scale = shares * np.sqrt(self._weights / squares)

    def _unlike(self, shares: np.ndarray) -> np.ndarray:
        """(N, F) how the mean's error, which follows what a scene shows and where, scatters from scene to
        scene: the variance of its mean over a half. 0 for the noise's, and where scenes are few."""
        scenes = [scene_name(name) for name in self.pairs.names]
        if len(set(scenes)) < _FEWEST:
            return np.zeros_like(shares)
        apart = shares * (self.real - self._simulated)
        variance = ((apart - apart.mean(0)) ** 2).sum(0) / (len(apart) - 1) * (1 - noise_only())
        return np.stack([variance / len({scenes[k] for k in self._half(i)}) for i in range(len(scenes))])

    def _uneven(self, shares: np.ndarray) -> np.ndarray:
        """(N, F) how the noise's statistics differ from quarter to quarter of the frame: the variance of
        their mean over a half. Hot pixels are few, and the same in all pictures. 0 for the mean's."""
        simulated = self._quarters(self.picture(self.z), self.again)
        found = [self._mean(shares * own) for own in self._real_quarters - simulated]
        return np.var(found, 0, ddof=1) / len(found) * by_place()

    @functools.cached_property
    def _real_quarters(self) -> np.ndarray:
        return self._quarters(self.target, self.reference)

    def _quarters(self, pictures: np.ndarray, against: Reference) -> np.ndarray:
        """(4, N, F) statistics of each quarter of the frame."""
        height, width = (n // 2 for n in self.mask.shape[1:])
        sides = [slice(None, height), slice(height, None)], [slice(None, width), slice(width, None)]
        return np.stack([self.measured(pictures, against, part) for part in itertools.product(*sides)])

    def _half(self, pair: int) -> list[int]:
        return list(self.split.fit if pair in self.split.fit else self.split.held_out)

    def _mean(self, values: np.ndarray) -> np.ndarray:
        """(N, ...) each pair gets the mean of its half."""
        found = np.empty_like(values, float)
        for half in (self.split.fit, self.split.held_out):
            if half:
                found[list(half)] = values[list(half)].mean(0)
        return found

    def units(self, z: np.ndarray) -> np.ndarray:
        """(N, 1) each pair's part in the error of its half."""
        return self.errors(z)[:, None]

    def clustered(self, values: np.ndarray, which: Sequence[int]) -> np.ndarray:
        """(scenes, frames) values (N, 1) of these pairs, for intervals over what is independent."""
        return by_scene(values, [self.pairs.names[i] for i in which])

    def scenes(self, which: Sequence[int]) -> int | None:
        """How many scenes these pairs are of."""
        return len({scene_name(self.pairs.names[i]) for i in which})

    def errors(self, z: np.ndarray) -> np.ndarray:
        """(N,) each pair's part in the square of its half's mean difference, the mean of these parts."""
        simulated, toned = self._seen(z)
        own = self._scale * self._counted * (self.real - simulated)
        mean = self._mean(own)
        found = (own * mean * self._spoiled(mean) ** 2).mean(1)
        return found if self._before is None else found * tones.excess(self._tones - toned, self._before)

    def _spoiled(self, difference: np.ndarray) -> np.ndarray:
        """(N, F) of at least one: what a difference is multiplied by where a fit must not spoil what was
        right: then it counts as much as what was as wrong at the base."""
        if self._before is None or self._emphasis is None:
            return np.ones_like(difference)
        now = emphasis(difference**2 / self._weights)
        return np.sqrt(np.maximum(now / self._emphasis, 1.0))

    def distances(self, z: np.ndarray) -> np.ndarray:
        """(N,) mean squares of what the real pictures differ in from what is simulated on average; of two
        draws, so that only the real noise is in it."""
        return self._product(*(self.target - self.picture(z, k) for k in (0, 1)))

    def scatter(self, z: np.ndarray) -> np.ndarray:
        """(N,) likewise of what one simulated picture differs in from their average: the noise."""
        one, other, third = (self.picture(z, k) for k in (0, 1, 2))
        return self._product(third - one, third - other)

    def _product(self, one: np.ndarray, other: np.ndarray) -> np.ndarray:
        """(N,) means over pixels and channels."""
        mask = np.asarray(self.mask)
        found = (one * other * mask[..., None]).mean(-1).sum((1, 2)) / mask.sum((1, 2))
        return np.asarray(found, float)

    def move_to(self, z: np.ndarray) -> None:
        self.z = np.asarray(z, float)
        self._simulated, self._toned = self._seen(self.z)
        self.difference = self._mean(self._scale * self._counted * (self.real - self._simulated))
        self.columns: dict[int, np.ndarray] = {}

    def follow(self, z: np.ndarray) -> None:
        """Go to a point and take the columns along, each turned so that together they say what the way there
        did (Broyden 1965): a step then costs one set of pictures, not one a coordinate."""
        columns, start, before = self.columns, self.z, self._state()
        self.move_to(z)
        way = {i: self.z[i] - start[i] for i in columns if self.z[i] != start[i]}
        if not way:
            return
        off = self._state() - before - sum(columns[i] * step for i, step in way.items())
        length = sum((step / self.model.steps[i]) ** 2 for i, step in way.items())
        turned = {i: columns[i] + off * (way[i] / self.model.steps[i] ** 2 / length) for i in way}
        self.columns = columns | turned

    def _state(self) -> np.ndarray:
        """(N, F + T) what columns are the changes of, but for what does not change."""
        return np.concatenate([-self.difference, self._toned], 1)

    @property
    def residual(self) -> np.ndarray:
        return (self.target - self.current) * self.weight

    @property
    def current(self) -> np.ndarray:
        return np.asarray(self.reference.picture)

    def choose(self, choice: Choice) -> None:
        """Put a choice into the base, and stay at the same point."""
        self.model = self.model.chosen(choice)
        self.move_to(self.z)

    def placed(self, z: np.ndarray, i: int, value: float) -> np.ndarray:
        """The point with one coordinate elsewhere; a noise that is added there is taken from read noise."""
        return placed(self.model, z, i, value)

    def starts(self, own: Sequence[int]) -> list[Ladders]:
        """Where to begin fitting these coordinates, form by form."""
        return starts(self.model, self.z, own)

    def noisier(self, z: np.ndarray, i: int) -> Ladders:
        """The point, and with more noise than it has where coordinate i may smooth it."""
        return noisier(self.model, z, i)

    def take(self, which: Sequence[int]) -> Any:
        """Those that are fitted as a problem of their own, which takes half as long to move; others as part
        of the whole, where what repeats is looked for in all."""
        if tuple(which) != tuple(self.split.fit):
            return Part(self, which)
        part, index = copy.copy(self), list(which)
        part.__dict__.update(self._fitted)
        part._scale = self._scale[index]
        part._simulated, part._toned = part._seen(part.z)
        part._before = part._tones - part._toned
        part.difference = part._mean(part._scale * part._counted * (part.real - part._simulated))
        part.columns = {i: column[index] for i, column in self.columns.items()}
        return part

    @functools.cached_property
    def _fitted(self) -> dict[str, Any]:
        """What a problem of the fitted pairs alone has in place of the whole one's."""
        index = list(self.split.fit)
        own: dict[str, Any] = {"pairs": self.pairs.take(index), "split": Split(tuple(range(len(index))), ())}
        own |= {name: getattr(self, name)[np.array(index)] for name in ("mask", "target", "_tones")}
        own |= {name: getattr(self, name).take(index) for name in ("reference", "again")}
        own["_frames"] = frames_of([scene_name(name) for name in own["pairs"].names])
        own["_numbers"] = index
        own["_known"] = {}
        part = copy.copy(self)
        part.__dict__.update(own)
        return own | {"real": part.measured(part.target, part.reference)}

    def compute(self, which: Sequence[int], steps: Mapping[int, float] | None = None) -> None:
        def column(i: int) -> np.ndarray:
            behind, ahead, step = self.model.probe(self.z, i, (steps or {}).get(i))
            here = (behind == self.z).all()
            before = (self._simulated, self._toned) if here else self._seen(behind)
            change, moved = (a - b for a, b in zip(self._seen(ahead), before))
            own = self._mean(self._scale * self._counted * change)
            return np.concatenate([own, moved], 1) / step

        new = sorted(set(which) - set(self.columns))
        self.columns.update(zip(new, each(column, new)))

    def normal(self, which: Sequence[int]) -> tuple[np.ndarray, np.ndarray]:
        if not which:
            n = len(self.difference)
            return np.zeros((n, 0, 0)), np.zeros((n, 0))
        spoiled = self._spoiled(self.difference)
        count = spoiled.shape[1]
        columns = np.stack([self.columns[i] for i in which], 1)
        stacked = columns[..., :count] * spoiled[:, None]
        gram = stacked @ stacked.transpose(0, 2, 1) / count
        slope = np.einsum("nkf,nf->nk", stacked, self.difference * spoiled) / count
        if self._before is None:
            return gram, slope
        error = float(((self.difference * spoiled) ** 2).mean())
        off = self._tones - self._toned
        return tones.beside((gram, slope), error, columns[..., count:], off, self._before)

    def located(self, held: Sequence[int]) -> Rows:
        """The axes by their share of what the gap at the point has above what is harmless and chance."""
        index = list(held)
        apart, scenes = self._apart(self.real)[index], self._scenes_of(index)
        return located(self.difference[index].mean(0), self._weights, apart, scenes)

    def left_by_shift(self, split: Split) -> float:
        """The held-out gap at the point, were statistics moved by what the fitted pairs differ in."""
        return left_by_shift(self._apart(self.real), self._scale, self._weights, split.fit, split.held_out)

    def _apart(self, real: np.ndarray) -> np.ndarray:
        """(N, F) what these statistics of each pair differ in from the simulated ones, in units."""
        return np.asarray(self._scale * self._counted * (real - self._simulated))

    def _scenes_of(self, which: Sequence[int]) -> list[str]:
        return [scene_name(self.pairs.names[i]) for i in which]

    def credited(self, rows: Rows, held: Sequence[int]) -> Rows:
        """These, where what stands in one place in all pictures is looked at without what it does to other
        statistics."""
        simulated = self.picture(self.z)
        place = in_one_place(self.target - simulated, self._scenes_of(range(len(self.real))))
        if not place.any():
            return rows
        without = self.measured(np.where(place[..., None], simulated, self.target), self.reference)
        index, both = list(held), [self._apart(real) for real in (self.real, without)]
        difference, left = self.difference[index].mean(0), self._mean(both[1])[index].mean(0)
        apart = [own[index] for own in both]
        return credited(rows, difference, left, self._weights, apart, self._scenes_of(index))
