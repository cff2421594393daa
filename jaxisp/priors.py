"""Priors: a params-shaped tree whose leaves are distributions, or numbers where nothing is drawn.

A distribution that is none (a std of 0, low above high) raises InputError when it is made. Draws are float32,
and the same whatever `jax_enable_x64` says. Distributions are pytrees of their numbers: those of a schedule
may be traced, and then nothing is checked.
"""

import dataclasses
import math
import zlib
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from jaxisp.checks import InputError, expected
from jaxisp.errors import short
from jaxisp.params import Spec, specs

__all__ = [
    "DISTRIBUTIONS", "Bernoulli", "Choice", "Distribution", "LogUniform", "Normal", "PowerUniform", "Uniform",
    "arguments", "check_prior", "draw", "is_distribution", "is_traced",
]  # fmt: skip
__dir__ = __all__.copy  # what an editor completes


@dataclass(frozen=True)
class Uniform:
    """Uniform on [low, high], independently for each element of the parameter.

    Example:
        >>> import jax
        >>> drawn = Uniform(0.1, 0.2).sample(jax.random.key(0), (1000,))
        >>> bool((drawn >= 0.1).all() and (drawn <= 0.2).all())
        True
    """

    low: float
    high: float

    def __post_init__(self) -> None:
        _numbers(self)
        _require(self, lambda: self.low <= self.high, "low is above high")

    def sample(self, key: jax.Array, shape: tuple[int, ...]) -> jax.Array:
        return jax.random.uniform(key, shape, jnp.float32, self.low, self.high)

    @property
    def support(self) -> tuple[float, float]:
        return self.low, self.high


@dataclass(frozen=True)
class LogUniform:
    """exp of a uniform on [log low, log high]; low must be positive.

    Example:
        >>> import jax, numpy as np
        >>> drawn = LogUniform(0.01, 1.0).sample(jax.random.key(0), (4000,))
        >>> round(float(np.median(drawn)), 1)
        0.1
    """

    low: float
    high: float
    # taken on the host: a compiler takes the logarithm of a constant otherwise than that of a variable
    _logs: tuple[Any, Any] = dataclasses.field(init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        _numbers(self)
        _require(self, lambda: self.low > 0, "low must be positive")
        _require(self, lambda: self.low <= self.high, "low is above high")
        log = jnp.log if is_traced(self) else np.log
        object.__setattr__(self, "_logs", (log(self.low), log(self.high)))

    def sample(self, key: jax.Array, shape: tuple[int, ...]) -> jax.Array:
        drawn = jax.random.uniform(key, shape, jnp.float32, *self._logs)
        return jnp.clip(jnp.exp(drawn), self.low, self.high)

    @property
    def support(self) -> tuple[float, float]:
        return self.low, self.high


@dataclass(frozen=True)
class PowerUniform:
    """u**exponent with u uniform on [low, high]: a variance (exponent 2) whose std is uniform.

    The exponent is positive; where low is negative, a whole number.

    Example:
        >>> PowerUniform(0.0, 0.02, 2).support
        (0.0, 0.0004)
    """

    low: float
    high: float
    exponent: float

    def __post_init__(self) -> None:
        _numbers(self)
        _require(self, lambda: self.low <= self.high, "low is above high")
        _require(self, lambda: self.exponent > 0, "the exponent must be positive")
        _require(
            self,
            lambda: self.low >= 0 or float(self.exponent).is_integer(),
            "a negative low needs a whole exponent",
        )

    def sample(self, key: jax.Array, shape: tuple[int, ...]) -> jax.Array:
        drawn = jax.random.uniform(key, shape, jnp.float32, self.low, self.high)
        exponent = jnp.asarray(self.exponent, jnp.float32)
        # a power is a few ulp off, and variances are squares
        return jnp.where(exponent == 2, drawn * drawn, drawn**exponent)

    @property
    def support(self) -> tuple[float, float]:
        nearest = min(max(self.low, 0.0), self.high)  # to 0, where an even power turns
        with np.errstate(over="ignore"):
            powers = np.power([self.low, nearest, self.high], float(self.exponent))
        return float(powers.min()), float(powers.max())


@dataclass(frozen=True)
class Normal:
    """Normal, truncated to [low, high].

    Example:
        >>> Normal(1.0, 0.1, low=0.8, high=1.2).support
        (0.8, 1.2)
    """

    mean: float
    std: float
    low: float
    high: float

    def __post_init__(self) -> None:
        _numbers(self)
        _require(self, lambda: self.std > 0, "std must be positive")
        _require(self, lambda: self.low <= self.high, "low is above high")

    def sample(self, key: jax.Array, shape: tuple[int, ...]) -> jax.Array:
        mean, std, low, high = (
            jnp.asarray(n, jnp.float32) for n in (self.mean, self.std, self.low, self.high)
        )
        a, b = (low - mean) / std, (high - mean) / std
        return mean + std * jax.random.truncated_normal(key, a, b, shape, jnp.float32)

    @property
    def support(self) -> tuple[float, float]:
        return self.low, self.high


@dataclass(frozen=True)
class Bernoulli:
    """1 with probability p, else 0: for switches.

    Example:
        >>> import jax
        >>> Bernoulli(1.0).sample(jax.random.key(0), (3,)).tolist()
        [1.0, 1.0, 1.0]
    """

    p: float

    def __post_init__(self) -> None:
        _numbers(self)
        _require(self, lambda: 0 <= self.p <= 1, "p must be from 0 to 1")

    def sample(self, key: jax.Array, shape: tuple[int, ...]) -> jax.Array:
        return jax.random.bernoulli(key, jnp.asarray(self.p, jnp.float32), shape).astype(jnp.float32)

    @property
    def support(self) -> tuple[float, float]:
        return 0.0, 1.0


@dataclass(frozen=True)
class Choice:
    """One of the values, all equally likely: for levels, as a JPEG's quality.

    Example:
        >>> import jax
        >>> set(Choice((75, 90)).sample(jax.random.key(0), (50,)).tolist()) == {75.0, 90.0}
        True
    """

    values: tuple[float, ...]

    def __post_init__(self) -> None:
        _numbers(self)
        _require(self, lambda: len(self.values) > 0, "there must be a value")

    def sample(self, key: jax.Array, shape: tuple[int, ...]) -> jax.Array:
        # not jax.random.choice, whose draws depend on jax_enable_x64
        which = jax.random.randint(key, shape, 0, len(self.values), jnp.int32)
        return jnp.asarray(self.values, jnp.float32)[which]

    @property
    def support(self) -> tuple[float, float]:
        return min(self.values), max(self.values)


Distribution = Uniform | LogUniform | PowerUniform | Normal | Bernoulli | Choice
"""What a parameter may be drawn from."""
DISTRIBUTIONS: dict[str, type] = {
    "uniform": Uniform,
    "log_uniform": LogUniform,
    "power_uniform": PowerUniform,
    "normal": Normal,
    "bernoulli": Bernoulli,
    "choice": Choice,
}
"""The distributions by the names that TOML files have for them."""


def _register(law: type) -> None:
    """Make a distribution a pytree of its numbers, in float32: other numbers are no other program."""
    names = [field.name for field in dataclasses.fields(law)]

    def flatten(own: Any) -> tuple[tuple[Any, ...], None]:
        return tuple(jax.tree.map(_leaf, getattr(own, name)) for name in names), None

    def unflatten(_: None, numbers: Any) -> Any:
        own: Any = object.__new__(law)  # unchecked: JAX puts anything where the numbers were
        for name, number in zip(names, numbers):
            object.__setattr__(own, name, number)
        return own

    jax.tree_util.register_pytree_node(law, flatten, unflatten)


def _leaf(number: Any) -> Any:
    return np.float32(number) if isinstance(number, int | float | np.generic) else number


for _law in DISTRIBUTIONS.values():
    _register(_law)


def arguments(law: Any) -> tuple[Any, ...]:
    """The numbers that a distribution was made of, those of a choice one by one."""
    if isinstance(law, Choice):
        return law.values
    return tuple(getattr(law, field.name) for field in dataclasses.fields(law) if field.init)


def is_traced(tree: Any) -> bool:
    """Whether a number of a prior is traced."""
    numbers = arguments(tree) if is_distribution(tree) else jax.tree.leaves(tree)
    return any(isinstance(number, jax.core.Tracer) for number in numbers)


def _number(given: Any) -> Any:
    if isinstance(given, jax.core.Tracer) and given.shape == ():
        return given
    if isinstance(given, str | bytes):
        raise TypeError
    number = float(given)  # an integer may be too large for one
    return given if type(given) in (int, float) else number


def _numbers(law: Any) -> None:
    """Make a distribution's numbers Python's, but for traced ones; raise InputError where they are none, or
    not finite."""
    for field in dataclasses.fields(law):
        if not field.init:
            continue
        given = getattr(law, field.name)
        try:
            number = tuple(map(_number, given)) if field.name == "values" else _number(given)
        except (TypeError, ValueError, OverflowError):
            wanted = "numbers, as Choice((1, 2))" if field.name == "values" else "a number"
            path = f"{type(law).__name__}.{field.name}"
            raise InputError(f"{path} must be {wanted}, got {short(given)}") from None
        several = number if isinstance(number, tuple) else (number,)
        if not all(isinstance(n, jax.core.Tracer) or math.isfinite(n) for n in several):
            raise InputError(f"{type(law).__name__}.{field.name} must be finite, got {short(given)}")
        object.__setattr__(law, field.name, number)


def _require(law: Any, fine: Callable[[], bool], what: str) -> None:
    if not is_traced(law) and not fine():
        raise InputError(f"{law}: {what}")


def is_distribution(value: Any) -> bool:
    """Whether a leaf of a prior is drawn, not a constant."""
    return isinstance(value, Distribution)


def check_prior(prior: dict[str, Any]) -> dict[str, Any]:
    """Return `prior`; raise InputError where a distribution can draw what is out of bounds.

    Of traced numbers nothing is known.
    """
    for stage, tree in prior.items():
        for field, spec in specs(type(tree)).items():
            value = getattr(tree, field)
            path = f"{stage}.{field}"
            if isinstance(value, jax.core.Tracer):
                _check_shape(path, spec, value.shape, value)
            if isinstance(value, jax.core.Tracer) or (is_distribution(value) and is_traced(value)):
                continue
            low, high = value.support if is_distribution(value) else _range(path, spec, value)
            tolerance = 1e-6 * (spec.bounds[1] - spec.bounds[0])
            if not (spec.bounds[0] - tolerance <= low <= high <= spec.bounds[1] + tolerance):
                shown = f" = {low:g}" if low == high else f": [{low:g}, {high:g}]"
                bounds = f"[{spec.bounds[0]:g}, {spec.bounds[1]:g}]"
                raise InputError(f"{path}{shown} is not within {bounds}")
    return prior


def _range(path: str, spec: Spec, value: Any) -> tuple[float, float]:
    """The least and the greatest of the numbers of a constant.

    Raises:
        InputError: a leaf of a prior is neither a distribution nor numbers of the right shape.
    """
    try:
        given = np.asarray(value)
    except (TypeError, ValueError, OverflowError):
        raise InputError(_told(path, spec, value)) from None
    whole = given.dtype.kind in ("iub" if spec.unit == "switch" else "iu")
    if not (whole or jnp.issubdtype(given.dtype, jnp.floating)):
        raise InputError(_told(path, spec, value))
    _check_shape(path, spec, given.shape, value)
    array = given.astype(np.float32)
    if not np.isfinite(array).all():
        raise InputError(_told(path, spec, value))
    return float(array.min()), float(array.max())


def _check_shape(path: str, spec: Spec, shape: tuple[int, ...], value: Any) -> None:
    if 0 in shape:
        raise InputError(f"{path} holds no number")
    if not (shape == spec.shape or (spec.any_length and len(shape) == len(spec.shape))):
        pair = isinstance(value, tuple | list) and shape == (2,)
        advice = f"; for a range give Uniform({value[0]!r}, {value[1]!r})" if pair else ""
        raise InputError(f"{path} has the shape {spec.shape}, got {short(value)}{advice}")


def _told(path: str, spec: Spec, value: Any) -> str:
    """What a parameter is drawn from, where something else is given."""
    low, high = (f"{bound:g}" for bound in spec.bounds)
    return (
        f"{path} must be {expected(spec)}, or drawn from such, as Uniform({low}, {high}); got {short(value)}"
    )


def draw(key: jax.Array, prior: dict[str, Any], like: dict[str, Any] | None = None) -> dict[str, Any]:
    """Draw parameters. Each is drawn from its own key, folded in by name, so that adding or
    removing one leaves the others' draws as they were.

    Args:
        key: of this draw.
        prior: distributions and constants.
        like: parameters whose shapes are drawn; the specs' unless given.

    Example:
        >>> import jax
        >>> from jaxisp.stages.noise import GaussianNoise
        >>> draw(jax.random.key(0), {"gaussian_noise": GaussianNoise(std=0.25)})["gaussian_noise"].std.item()
        0.25
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
