"""Clean+noisy pairs: numbers that say how a real picture's residual differs from a simulated one's.

Pixels of two noise realisations never agree, so statistics of the residual are compared: what its mean
follows (light, radius, edges, hue ...), see `noisy_mean`, and how its noise is spread, correlated, shaped and
repeated. The noise is measured on what is left when the mean's part, a regression on the noise-free picture's
local features, is taken out: an error of the mean at edges is no noise. Repeated frames give it without any.
"""

import functools
from collections.abc import Sequence
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from jaxisp.gap.noisy_codes import Codes, unknown_codes
from jaxisp.gap.noisy_mean import Maps, mean_names
from jaxisp.gap.noisy_noise import noise_part
from jaxisp.gap.noisy_patterns import pattern_part


class Frames(NamedTuple):
    """Which pictures are of one scene.

    Attributes:
        average: (N, N) the mean over the frames of the own scene; zero where there is one only.
        others: (N, N) the mean over the frames of other scenes, or of the own where there is no other.
    """

    average: jax.Array
    others: jax.Array


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
    seen: Codes,
) -> np.ndarray:
    """(N, F) statistics of pictures (N, h, w, 3) against noise-free ones, all in Y'CbCr in 8-bit steps.

    Args:
        maps: `normalised_regressors` of the pictures.
        frames: where a scene has several, their noise is what each differs in from their mean.
        seen: how to get back to what the sensor read.
    """
    parts = [_mean_part(*own) for own in zip(y, s, mask, maps)]  # compiled once for any N
    means, whole = (jnp.stack(part) for part in zip(*parts))
    noise = _apart(whole, mask, frames.average)
    each = [_noise_part(*own, seen) for own in zip(noise, y, s, mask)]
    others = np.concatenate([np.stack(each), _patterns(whole, s, mask, frames.others)], 1)
    return np.concatenate([means, others[:, _others()[1]]], 1)


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
    apart = jnp.eye(len(whole)) - average
    apart = apart / jnp.sqrt((apart**2).sum(1, keepdims=True))
    return jnp.tensordot(apart, whole, 1, precision="highest") * mask[..., None]


@functools.cache
def _others() -> tuple[tuple[str, ...], np.ndarray]:
    """The names of what is no mean, and where each stands in what `_noise_part` and `_patterns` give."""
    shape = jax.ShapeDtypeStruct((32, 32, 3), jnp.float32)
    mask = jax.ShapeDtypeStruct((32, 32), jnp.float32)
    noise = jax.eval_shape(noise_part, shape, shape, shape, mask, unknown_codes((32, 32)))
    many = jax.ShapeDtypeStruct((2, 32, 32, 3), jnp.float32)
    masks, pairs = (jax.ShapeDtypeStruct(n, jnp.float32) for n in ((2, 32, 32), (2, 2)))
    patterns = jax.eval_shape(pattern_part, many, many, masks, pairs)
    names = np.array([name for part in (noise, patterns) for own in sorted(part) for name in own])
    order = np.argsort(names)
    return tuple(map(str, names[order])), order


@functools.cache
def feature_names() -> tuple[str, ...]:
    """In the order of the columns of `features`; "kind axis what"."""
    return *mean_names(), *_others()[0]
