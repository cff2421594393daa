"""Priors: a params-shaped tree whose leaves are distributions, or numbers where nothing is drawn."""

import zlib
from dataclasses import dataclass
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from jaxisp.checks import InputError
from jaxisp.params import Spec, specs


@dataclass(frozen=True)
class Uniform:
    """Uniform on [low, high], independently for each element of the parameter."""

    low: float
    high: float

    def sample(self, key: jax.Array, shape: tuple[int, ...]) -> jax.Array:
        return jax.random.uniform(key, shape, minval=self.low, maxval=self.high)

    @property
    def support(self) -> tuple[float, float]:
        return self.low, self.high


@dataclass(frozen=True)
class LogUniform:
    """exp of a uniform on [log low, log high]; low must be positive."""

    low: float
    high: float

    def sample(self, key: jax.Array, shape: tuple[int, ...]) -> jax.Array:
        drawn = jax.random.uniform(key, shape, minval=np.log(self.low), maxval=np.log(self.high))
        return jnp.clip(jnp.exp(drawn), self.low, self.high)

    @property
    def support(self) -> tuple[float, float]:
        return self.low, self.high


@dataclass(frozen=True)
class PowerUniform:
    """u**exponent with u uniform on [low, high]: a variance (exponent 2) whose std is uniform."""

    low: float
    high: float
    exponent: float

    def sample(self, key: jax.Array, shape: tuple[int, ...]) -> jax.Array:
        return jax.random.uniform(key, shape, minval=self.low, maxval=self.high) ** self.exponent

    @property
    def support(self) -> tuple[float, float]:
        return self.low**self.exponent, self.high**self.exponent


@dataclass(frozen=True)
class Normal:
    """Normal, truncated to [low, high]."""

    mean: float
    std: float
    low: float
    high: float

    def sample(self, key: jax.Array, shape: tuple[int, ...]) -> jax.Array:
        a, b = (self.low - self.mean) / self.std, (self.high - self.mean) / self.std
        return self.mean + self.std * jax.random.truncated_normal(key, a, b, shape)

    @property
    def support(self) -> tuple[float, float]:
        return self.low, self.high


@dataclass(frozen=True)
class Bernoulli:
    """1 with probability p, else 0: for switches."""

    p: float

    def sample(self, key: jax.Array, shape: tuple[int, ...]) -> jax.Array:
        return jax.random.bernoulli(key, self.p, shape).astype(jnp.float32)

    @property
    def support(self) -> tuple[float, float]:
        return 0.0, 1.0


@dataclass(frozen=True)
class Choice:
    """One of the values, all equally likely: for levels, as a JPEG's quality."""

    values: tuple[float, ...]

    def sample(self, key: jax.Array, shape: tuple[int, ...]) -> jax.Array:
        return jax.random.choice(key, jnp.asarray(self.values, jnp.float32), shape)

    @property
    def support(self) -> tuple[float, float]:
        return min(self.values), max(self.values)


Distribution = Uniform | LogUniform | PowerUniform | Normal | Bernoulli | Choice
DISTRIBUTIONS: dict[str, type] = {
    "uniform": Uniform,
    "log_uniform": LogUniform,
    "power_uniform": PowerUniform,
    "normal": Normal,
    "bernoulli": Bernoulli,
    "choice": Choice,
}


def is_distribution(value: Any) -> bool:
    """Whether a leaf of a prior is drawn, not a constant."""
    return isinstance(value, Distribution)


def check_prior(prior: dict[str, Any]) -> dict[str, Any]:
    """Return `prior`; raise InputError where a distribution can draw what is out of bounds."""
    for stage, tree in prior.items():
        for field, spec in specs(type(tree)).items():
            value = getattr(tree, field)
            low, high = value.support if is_distribution(value) else (np.min(value), np.max(value))
            tolerance = 1e-6 * (spec.bounds[1] - spec.bounds[0])
            if not (spec.bounds[0] - tolerance <= low <= high <= spec.bounds[1] + tolerance):
                bounds = f"[{spec.bounds[0]:g}, {spec.bounds[1]:g}]"
                raise InputError(f"{stage}.{field}: [{low:g}, {high:g}] is not within {bounds}")
            if isinstance(value, LogUniform) and low <= 0:
                raise InputError(f"{stage}.{field}: log_uniform needs a positive low, got {low:g}")
    return prior


def draw(key: jax.Array, prior: dict[str, Any], like: dict[str, Any] | None = None) -> dict[str, Any]:
    """Draw parameters. Each is drawn from its own key, folded in by name, so that adding or
    removing one leaves the others' draws as they were.

    Args:
        key: of this draw.
        prior: distributions and constants.
        like: parameters whose shapes are drawn; the specs' unless given.
    """

    def one(path: str, spec: Spec, value: Any, like: Any) -> jax.Array:
        if not is_distribution(value):
            return jnp.asarray(value, jnp.float32)
        own = jax.random.fold_in(key, zlib.crc32(path.encode()) & 0x7FFFFFFF)
        return value.sample(own, spec.shape if like is None else np.shape(like)).astype(jnp.float32)

    def tree(stage: str, values: Any) -> Any:
        shapes = None if like is None else like[stage]
        fields = specs(type(values)).items()
        return type(values)(
            **{f: one(f"{stage}.{f}", s, getattr(values, f), getattr(shapes, f, None)) for f, s in fields}
        )

    return {stage: tree(stage, values) for stage, values in prior.items()}
