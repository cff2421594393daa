"""Statistics of residuals, which describe how a real picture differs from a simulated one.

Pixels of two noise realisations never agree, so statistics of the residual are compared:

- the mean residual as a function of light, radius, edges, hue and so on, see `mean`;
- variance, correlation, distribution and repetition of the noise;
- changes of light and colour between the frames of a scene.

The noise is the residual without its mean. The mean is a regression on local features of the noise-free
picture, so errors of the mean at edges do not count as noise. With repeated frames, the noise is the
difference from the scene's average, without regression errors.
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
    """Averaging matrices over pictures of the same scene and of other scenes.

    Attributes:
        average: (N, N) mean over the frames of the picture's own scene; zero if the scene has one frame.
        others: (N, N) mean over the frames of other scenes; over other frames of the own scene if all
            pictures show one scene.
    """

    average: jax.Array
    others: jax.Array

    @property
    def repeated(self) -> bool:
        """Whether any scene has several frames."""
        return bool((self.average > 0).any())


def frames_of(scenes: Sequence[str]) -> Frames:
    """Build the averaging matrices from the scene name of each of N pictures."""
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
    """Compute the statistics of pictures against noise-free pictures.

    Args:
        y: (N, h, w, 3) the pictures, Y'CbCr in 8-bit steps.
        s: (N, h, w, 3) the noise-free pictures, likewise.
        mask: (N, h, w) weight of each pixel.
        maps: `normalised_regressors` of the noise-free pictures.
        frames: groups pictures by scene. The noise of repeated frames is their difference from the mean.
        seen: the map from a picture back to sensor values.

    Returns:
        (N, F) statistics in the order of `feature_names`.
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
    """Noise (N, h, w, 3) that `features` measures, Y'CbCr in 8-bit steps; arguments as there.

    It is the remainder of the regression on the maps. The mean of repeated frames is subtracted from it.
    """
    return _apart(_regressed(y, s, mask, maps)[1], mask, frames.average)


def _regressed(
    y: jax.Array, s: jax.Array, mask: jax.Array, maps: Sequence[tuple[Maps, ...]]
) -> tuple[jax.Array, jax.Array]:
    """Amplitudes (N, M) of the maps, and the remainder (N, h, w, 3) of the regression on them."""
    parts = [_mean_part(*own) for own in zip(y, s, mask, maps)]  # compiled once for any N
    means, whole = (jnp.stack(part) for part in zip(*parts))
    return means, whole


def compile_features(counts: Iterable[int], shape: tuple[int, int]) -> None:
    """Compile the slowest parts of `features` for each number of pictures in `counts`; `shape` is (h, w)."""
    black, mask = jnp.zeros((*shape, 3)), jnp.zeros(shape)
    _noise_part(black, black, black, mask, unknown_quantization(shape))
    for n in counts:
        whole = jnp.zeros((n, *black.shape))
        _patterns(whole, whole, jnp.zeros((n, *shape)), jnp.zeros((n, n)))


def mean_features(
    y: jax.Array, s: jax.Array, mask: jax.Array, maps: Sequence[tuple[Maps, ...]]
) -> np.ndarray:
    """Statistics (N, M) of the mean alone: the first M columns of `features`."""
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
    """Amplitudes (M,) of one picture's maps, and the remainder (h, w, 3) of the regression on them."""
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
    """Difference (N, h, w, 3) of each picture from the mean of its scene's frames."""
    return jnp.tensordot(_differing(average), whole, 1, precision="highest") * mask[..., None]


def _differing(average: jax.Array) -> jax.Array:
    """Matrix (N, N) that subtracts the mean of the scene's frames and keeps the variance of the noise."""
    apart = jnp.eye(len(average)) - average
    return apart / jnp.sqrt((apart**2).sum(1, keepdims=True))


_CHANGES = named("change frame {} {}", CHANNELS, ("dark", "bright"))


@jax.jit
def _changes(residual: jax.Array, light: jax.Array, mask: jax.Array, average: jax.Array) -> jax.Array:
    """Absolute change (N, K) of the darker and of the brighter half of each picture, in 8-bit steps.

    The reference is the mean over the scene's frames. The change is 0 if the scene has one frame.
    """
    middle = ((light * mask).sum((1, 2)) / (mask.sum((1, 2)) + 1e-3))[:, None, None]
    halves = jnp.stack([mask * (light <= middle), mask * (light > middle)], -1)
    sums = jnp.einsum("nhwc,nhwk->nck", residual, halves, precision="highest")
    means = (sums / (halves.sum((1, 2)) + 1e-3)[:, None]).reshape(len(residual), -1)
    apart = jnp.abs(jnp.dot(_differing(average), means, precision="highest"))
    return apart * (average.sum(1, keepdims=True) > 0)


@functools.cache
def _others() -> tuple[tuple[str, ...], np.ndarray]:
    """Sorted names of all statistics other than those of the mean, and the permutation that sorts them.

    The permutation applies to the joined outputs of `_noise_part`, `_patterns` and `_changes`.
    """
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
    """Names "kind axis detail" of the columns of `features`."""
    return *mean_names(), *_others()[0]
