"""Statistics of residuals: numbers that say how a real picture differs from a simulated one.

Pixels of two noise realisations never agree, so statistics of the residual are compared: what its mean
follows (light, radius, edges, hue ...), see `mean`, how its noise is spread, correlated, shaped and
repeated, and how light and colour change between the frames of a scene. The noise is measured on what is left
when the mean's part, a regression on the noise-free picture's local features, is taken out: an error of the
mean at edges is no noise. Repeated frames give it without any.
"""

import functools
from collections.abc import Iterable, Sequence
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from jaxisp.gap.features.mean import CHANNELS, Maps, mean_names, named
from jaxisp.gap.features.noise import noise_part
from jaxisp.gap.features.quantization import Quantization, unknown_quantization
from jaxisp.gap.features.repeats import pattern_part


class Frames(NamedTuple):
    """Which pictures are of one scene.

    Attributes:
        average: (N, N) the mean over the frames of the own scene; zero where there is one only.
        others: (N, N) the mean over the frames of other scenes, or of the own where there is no other.
    """

    average: jax.Array
    others: jax.Array

    @property
    def repeated(self) -> bool:
        """Whether any scene has several."""
        return bool((self.average > 0).any())


def frames_of(scenes: Sequence[str]) -> Frames:
    """From the name of the scene of each picture."""
    same = np.equal.outer(scenes, scenes).astype(float)
    average = np.where(same.sum(1, keepdims=True) > 1, same / same.sum(1, keepdims=True), 0)
    others = 1 - same if (same == 0).any() else 1 - np.eye(len(same))
    others = others / np.maximum(others.sum(1, keepdims=True), 1)
    return Frames(jnp.asarray(average, jnp.float32), jnp.asarray(others, jnp.float32))


def features(
    y: jax.Array,
    s: jax.Array,
    mask: jax.Array,
    maps: Sequence[tuple[Maps, ...]],
    frames: Frames,
    seen: Quantization,
) -> np.ndarray:
    """(N, F) statistics of pictures (N, h, w, 3) against noise-free ones, all in Y'CbCr in 8-bit steps.

    Args:
        maps: `normalised_regressors` of the pictures.
        frames: where a scene has several, their noise is what each differs in from their mean.
        seen: how to get back to what the sensor read.
    """
    means, whole = _regressed(y, s, mask, maps)
    noise = _apart(whole, mask, frames.average)
    each = [_noise_part(*own, seen) for own in zip(noise, y, s, mask)]
    changes = np.zeros((len(y), len(_CHANGES)))
    if frames.repeated:
        changes = _changes(y - s, s[..., 0], mask, frames.average)
    others = np.concatenate([np.stack(each), _patterns(whole, s, mask, frames.others), changes], 1)
    return np.concatenate([means, others[:, _others()[1]]], 1)


def noise_of(
    y: jax.Array, s: jax.Array, mask: jax.Array, maps: Sequence[tuple[Maps, ...]], frames: Frames
) -> jax.Array:
    """(N, h, w, 3) the noise that `features` are of: what a regression on the maps leaves, and where a scene
    has several frames what each differs in from their mean."""
    return _apart(_regressed(y, s, mask, maps)[1], mask, frames.average)


def _regressed(
    y: jax.Array, s: jax.Array, mask: jax.Array, maps: Sequence[tuple[Maps, ...]]
) -> tuple[jax.Array, jax.Array]:
    """(N, M) amplitudes of the maps, and (N, h, w, 3) what a regression on them leaves."""
    parts = [_mean_part(*own) for own in zip(y, s, mask, maps)]  # compiled once for any N
    means, whole = (jnp.stack(part) for part in zip(*parts))
    return means, whole


def compile_features(counts: Iterable[int], shape: tuple[int, int]) -> None:
    """Compile the parts of `features` that take longest, for so many pictures of (h, w) each."""
    black, mask = jnp.zeros((*shape, 3)), jnp.zeros(shape)
    _noise_part(black, black, black, mask, unknown_quantization(shape))
    for n in counts:
        whole = jnp.zeros((n, *black.shape))
        _patterns(whole, whole, jnp.zeros((n, *shape)), jnp.zeros((n, n)))


def mean_features(
    y: jax.Array, s: jax.Array, mask: jax.Array, maps: Sequence[tuple[Maps, ...]]
) -> np.ndarray:
    """(N, M) the first of the `features`, those of the mean, alone."""
    return np.stack([_mean_part(*own)[0] for own in zip(y, s, mask, maps)])


@jax.jit
def _noise_part(*arguments: Any) -> jax.Array:
    return jnp.concatenate([v for _, v in sorted(noise_part(*arguments).items())])


@jax.jit
def _patterns(*arguments: Any) -> jax.Array:
    return jnp.concatenate([v for _, v in sorted(pattern_part(*arguments).items())], 1)


@jax.jit
def _mean_part(
    y: jax.Array, s: jax.Array, mask: jax.Array, maps: tuple[Maps, ...]
) -> tuple[jax.Array, jax.Array]:
    """The amplitudes of one picture's maps, and what a regression on them leaves of its residual."""
    means, left = [], []
    for c, (m, inverse) in enumerate(maps):
        flat = (y - s)[..., c].reshape(-1)
        amplitude = jnp.einsum("kp,p->k", m, flat, precision="highest")
        fitted = jnp.einsum("kp,k->p", m, inverse @ amplitude, precision="highest")
        means.append(amplitude)
        left.append((flat - fitted).reshape(mask.shape))
    return jnp.concatenate(means), jnp.stack(left, -1) * mask[..., None]


@jax.jit
def _apart(whole: jax.Array, mask: jax.Array, average: jax.Array) -> jax.Array:
    """What each picture differs in from the mean of its scene's frames."""
    return jnp.tensordot(_differing(average), whole, 1, precision="highest") * mask[..., None]


def _differing(average: jax.Array) -> jax.Array:
    """(N, N) each picture less the mean of its scene's frames, as large as if the mean were known."""
    apart = jnp.eye(len(average)) - average
    return apart / jnp.sqrt((apart**2).sum(1, keepdims=True))


_CHANGES = named("change frame {} {}", CHANNELS, ("dark", "bright"))


@jax.jit
def _changes(residual: jax.Array, light: jax.Array, mask: jax.Array, average: jax.Array) -> jax.Array:
    """(N, K) by how many steps the darker and the brighter half of a picture differ from what they are on
    average over its scene's frames; 0 where there is one frame only."""
    middle = ((light * mask).sum((1, 2)) / (mask.sum((1, 2)) + 1e-3))[:, None, None]
    halves = jnp.stack([mask * (light <= middle), mask * (light > middle)], -1)
    sums = jnp.einsum("nhwc,nhwk->nck", residual, halves, precision="highest")
    means = (sums / (halves.sum((1, 2)) + 1e-3)[:, None]).reshape(len(residual), -1)
    apart = jnp.abs(jnp.dot(_differing(average), means, precision="highest"))
    return apart * (average.sum(1, keepdims=True) > 0)


@functools.cache
def _others() -> tuple[tuple[str, ...], np.ndarray]:
    """The names of what is no mean, and where each stands in what `_noise_part`, `_patterns` and `_changes`
    give."""
    shape = jax.ShapeDtypeStruct((32, 32, 3), jnp.float32)
    mask = jax.ShapeDtypeStruct((32, 32), jnp.float32)
    noise = jax.eval_shape(noise_part, shape, shape, shape, mask, unknown_quantization((32, 32)))
    many = jax.ShapeDtypeStruct((2, 32, 32, 3), jnp.float32)
    masks, pairs = (jax.ShapeDtypeStruct(n, jnp.float32) for n in ((2, 32, 32), (2, 2)))
    patterns = jax.eval_shape(pattern_part, many, many, masks, pairs)
    names = np.array([name for part in (noise, patterns) for own in sorted(part) for name in own])
    names = np.append(names, _CHANGES)
    order = np.argsort(names)
    return tuple(map(str, names[order])), order


@functools.cache
def feature_names() -> tuple[str, ...]:
    """In the order of the columns of `features`; "kind axis what"."""
    return *mean_names(), *_others()[0]
