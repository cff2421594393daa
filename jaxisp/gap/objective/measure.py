"""Pictures made into statistics: what real ones show, and what a simulator's do."""

import dataclasses
import functools
import itertools
from collections.abc import Callable, Sequence
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from jaxisp.gap.features.mean import Maps, normalised_regressors
from jaxisp.gap.features.quantization import Quantization
from jaxisp.gap.features.residual_statistics import Frames, features, frames_of, mean_features
from jaxisp.gap.objective import tones
from jaxisp.gap.pairs.pairs import INNER, Pairs, to_steps
from jaxisp.gap.pairs.scenes import Split, scene_name
from jaxisp.gap.parallel import Memo
from jaxisp.gap.simulator.model import Model

_KEPT = 128
"""Points whose statistics are kept: a search compares with where it has looked."""

Shown = tuple[np.ndarray, np.ndarray]
"""(N, F) statistics and (N, T) means of blocks of a simulated set."""


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


@dataclasses.dataclass(frozen=True, eq=False)
class Measure:
    """Statistics of pairs, real and simulated.

    The noise of a simulated picture is drawn from one key a pair, whatever the parameters, so that a change
    of statistics is the parameters' doing.

    A clean picture whose file compressed it lacks what that took, and the noisy one does not. What that was
    nobody knows; what compressing it once more takes is alike. So a simulated picture, made of the clean one,
    is looked at against that compressed again, as a real one is against the clean one.

    Attributes:
        pairs: clean light and noisy pictures.
        split: which are fitted and which held out.
        numbers: (N,) of the keys that noise is drawn from.
        seed: of these.
        mask: (N, h, w) float, 1 where a pixel counts; borders are cut off here and below.
        target: (N, h, w, 3) the real pictures, in steps.
        frames: which pictures are of one scene.
        read: how to get back to what the sensor read.
        reference, again: what real and simulated pictures are looked at against.
        tones: (N, T) means of the real pictures' blocks.
        real: (N, F) their statistics, less `offset`.
        offset: (N, F) by how much real pictures differ from the base's where nothing is missing, as a
            reference tells; None where there is none.
    """

    pairs: Pairs
    split: Split
    numbers: tuple[int, ...]
    seed: int
    mask: jax.Array
    target: np.ndarray
    frames: Frames
    read: Quantization
    reference: Reference
    again: Reference
    tones: np.ndarray
    real: np.ndarray
    offset: np.ndarray | None = None
    known: Memo[Shown] = dataclasses.field(default_factory=lambda: Memo(_KEPT), repr=False)

    @classmethod
    def of(
        cls,
        pairs: Pairs,
        split: Split,
        noise_free: Callable[[jax.Array], np.ndarray],
        read: Quantization,
        seed: int = 0,
    ) -> "Measure":
        """Of pairs, and of the pictures (N, H, W, 3) in steps that the base makes of their light without
        noise."""
        mask = jnp.asarray(pairs.mask[INNER], jnp.float32)
        target = to_steps(pairs.pictures[INNER])
        frames = frames_of([scene_name(name) for name in pairs.names])
        reference = again = Reference.of(noise_free(pairs.light)[INNER], mask)
        if pairs.again is not None:
            again = Reference.of(noise_free(pairs.again)[INNER], mask)
        real = _measured(target, reference, mask, frames, read)
        numbers = tuple(range(len(pairs.names)))
        blocks = tones.of(target, mask)
        return cls(pairs, split, numbers, seed, mask, target, frames, read, reference, again, blocks, real)

    def less(self, offset: np.ndarray) -> "Measure":
        """With (N, F) of the real pictures' statistics taken off."""
        return dataclasses.replace(self, real=self.real - offset, offset=offset)

    def measured_real(self, pictures: np.ndarray) -> np.ndarray:
        """(N, F) statistics of pictures in steps, their border cut off, as `real` has them."""
        found = self.measured(pictures, self.reference)
        return found if self.offset is None else found - self.offset

    @functools.cached_property
    def fitted(self) -> "Measure":
        """Of the fitted pairs alone."""
        index = list(self.split.fit)
        pairs, at = self.pairs.take(index), np.array(index)
        frames = frames_of([scene_name(name) for name in pairs.names])
        reference, mask, target = self.reference.take(index), self.mask[at], self.target[at]
        own = Measure(
            pairs, Split(tuple(range(len(index))), ()), tuple(index), self.seed, mask, target, frames,
            self.read, reference, self.again.take(index), self.tones[at],
            _measured(target, reference, mask, frames, self.read),
        )  # fmt: skip
        return own if self.offset is None else own.less(self.offset[at])

    def scenes(self, which: Sequence[int]) -> list[str]:
        """The names of the scenes that these pairs show."""
        return [scene_name(self.pairs.names[i]) for i in which]

    def keys(self, replicate: int = 0) -> jax.Array:
        """(N,) of one draw of the noise."""
        root = jax.random.fold_in(jax.random.key(self.seed), replicate)
        return jax.vmap(lambda i: jax.random.fold_in(root, i))(jnp.asarray(self.numbers))

    def rendered(self, model: Model, z: np.ndarray, replicate: int = 0) -> np.ndarray:
        """(N, H, W, 3) encoded, noise and all; the model is that of all pairs."""
        return self._own(model).render(z, self.pairs.light, self.keys(replicate))

    def picture(self, model: Model, z: np.ndarray, replicate: int = 0) -> np.ndarray:
        """(N, h, w, 3) in steps, its border cut off."""
        return self._own(model).in_steps(z, self.pairs.light, self.keys(replicate))

    def _own(self, model: Model) -> Model:
        """The model of these pairs."""
        return model.take(self.numbers) if model.per_pair else model

    def simulated(self, model: Model, z: np.ndarray, replicate: int = 0) -> np.ndarray:
        """(N, F) statistics of a simulated set."""
        return self.measured(self.picture(model, z, replicate), self.again)

    def shown(self, model: Model, z: np.ndarray) -> Shown:
        """Statistics and block means of a simulated set, kept for the last models and places. Block means,
        and the mean's statistics, are without the effects that are noise: where a pattern has its pixels is
        chance, and the same in all pictures."""
        return self.known.get((model.key, z.tobytes()), lambda: self._shown(model, z))

    def _shown(self, model: Model, z: np.ndarray) -> Shown:
        picture, still = self.picture(model, z), model.still(z)
        found = self.measured(picture, self.again)
        if (still != z).any():
            picture = self.picture(model, still)
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
        return _measured(pictures, against, mask, self.frames, self.read)

    @functools.cached_property
    def real_quarters(self) -> np.ndarray:
        """(4, N, F) of the real pictures."""
        return self.quarters(self.target, self.reference)

    def quarters(self, pictures: np.ndarray, against: Reference) -> np.ndarray:
        """(4, N, F) statistics of each quarter of the frame."""
        height, width = (n // 2 for n in self.mask.shape[1:])
        sides = [slice(None, height), slice(height, None)], [slice(None, width), slice(width, None)]
        return np.stack([self.measured(pictures, against, part) for part in itertools.product(*sides)])

    def product(self, one: np.ndarray, other: np.ndarray) -> np.ndarray:
        """(N,) means over the pixels that count, and channels, of the product of two (N, h, w, 3)."""
        mask = np.asarray(self.mask)
        found = (one * other * mask[..., None]).mean(-1).sum((1, 2)) / mask.sum((1, 2))
        return np.asarray(found, float)


def _measured(
    pictures: np.ndarray, against: Reference, mask: jax.Array, frames: Frames, read: Quantization
) -> np.ndarray:
    found = features(jnp.asarray(pictures), against.picture, mask, against.maps, frames, read)
    return np.asarray(found, float)
