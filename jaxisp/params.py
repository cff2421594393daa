"""Parameters: frozen dataclasses of float leaves that carry their bounds, unit and scale.

Everything that is "per parameter" (values, specs, priors, gradients, `in_axes`, error bars) is a
tree of the same shape, so one `jax.tree.map` does each job. Nothing is validated in a constructor:
JAX rebuilds these objects with tracers. `jaxisp.checks` validates on the host.
"""

import dataclasses
import functools
from typing import Any, Literal, TypeVar, dataclass_transform

import jax
import jax.numpy as jnp
import numpy as np

__all__ = [
    "Spec", "batch_axes", "map_specs", "param", "parameters", "spec_tree", "specs", "strong", "to_bounded",
    "to_unbounded",
]  # fmt: skip
__dir__ = __all__.copy  # what an editor completes

T = TypeVar("T")
Tree = Any
Leaf = Any
"""A parameter's value: a number, an array or a tracer; in a prior, a distribution."""


@dataclasses.dataclass(frozen=True)
class Spec:
    """What a parameter is: its default, its inclusive bounds, its unit, and the scale to vary it on.

    `bounds` say what is valid, for every element; priors say what is drawn. A vector with
    `any_length` may be longer or shorter than its default.
    """

    default: Any
    bounds: tuple[float, float]
    unit: str
    scale: Literal["linear", "log"]
    doc: str
    any_length: bool = False

    @property
    def shape(self) -> tuple[int, ...]:
        return np.shape(self.default)


def param(
    default: Any,
    bounds: tuple[float, float],
    unit: str,
    *,
    log: bool = False,
    doc: str = "",
    any_length: bool = False,
) -> Any:
    """Declare a field of a `@parameters` class.

    Args:
        default: a number, or nested tuples of numbers for a vector or matrix.
        bounds: smallest and largest valid value, finite, both included.
        unit: "px", "EV", "K", "1" for a ratio, "level" for a share of the white level, ...
        log: vary it on a logarithmic scale (bounds must be positive).
        doc: one line for help texts.
        any_length: a vector whose length the user chooses.
    """
    low, high = bounds
    if not (np.isfinite(low) and np.isfinite(high) and low < high):
        raise ValueError(f"param: bounds {bounds} must be finite and increasing")
    if log and low <= 0:
        raise ValueError(f"param: a log scale needs a positive lower bound, got {low}")
    if np.min(default) < low or np.max(default) > high:
        raise ValueError(f"param: default {default} is outside {bounds}")
    spec = Spec(default, (float(low), float(high)), unit, "log" if log else "linear", doc, any_length)
    return dataclasses.field(
        default_factory=functools.partial(np.asarray, default, np.float32), metadata={"spec": spec}
    )


@dataclass_transform(kw_only_default=True, frozen_default=True, field_specifiers=(dataclasses.field,))
def parameters(cls: type[T]) -> type[T]:
    """Make a class of `param` fields a frozen, keyword-only dataclass and a JAX pytree.

    Example:
        >>> @parameters
        ... class Halation:
        ...     strength: Leaf = param(0.0, (0.0, 0.5), "1", doc="share of light that is spread")
        ...     radius: Leaf = param(4.0, (0.5, 32.0), "px", log=True, doc="standard deviation")
        >>> Halation(strength=0.1).radius.item(), specs(Halation)["radius"].unit
        (4.0, 'px')
    """
    cls = dataclasses.dataclass(frozen=True, kw_only=True, eq=False, repr=False)(cls)
    for field in dataclasses.fields(cls):  # type: ignore[arg-type]
        if "spec" not in field.metadata:
            raise TypeError(f"{cls.__name__}.{field.name}: declare it with param(...)")
    if "__repr__" not in vars(cls):
        cls.__repr__ = _text  # type: ignore[method-assign]
    cls._repr_html_ = _html  # type: ignore[attr-defined]
    return jax.tree_util.register_dataclass(cls)


def _text(params: Any) -> str:
    from jaxisp.shown import params_text

    return params_text(params)


def _html(params: Any) -> str:
    from jaxisp.shown import params_html

    return params_html(params)


def specs(cls: type) -> dict[str, Spec]:
    """The specs of a `@parameters` class by field name."""
    return {f.name: f.metadata["spec"] for f in dataclasses.fields(cls)}


def spec_tree(tree: Tree) -> Tree:
    """A tree of the same shape as `tree` (parameters, or a dict of them) whose leaves are `Spec`s."""
    if isinstance(tree, dict):
        return {name: spec_tree(value) for name, value in tree.items()}
    return type(tree)(**specs(type(tree)))


def map_specs(fn: Any, tree: Tree, *rest: Tree) -> Tree:
    """`fn(spec, leaf, *leaves)` over a parameter tree and others of its shape.

    A leaf is whatever stands in a parameter's field, so priors and None pass through whole.
    """
    if isinstance(tree, dict):
        return {name: map_specs(fn, value, *(r[name] for r in rest)) for name, value in tree.items()}
    return type(tree)(
        **{
            name: fn(spec, getattr(tree, name), *(getattr(r, name) for r in rest))
            for name, spec in specs(type(tree)).items()
        }
    )


def strong(tree: Tree) -> Tree:
    """The tree with strongly typed float32 leaves (a Python float would cost a second trace)."""
    return jax.tree.map(lambda x: x if isinstance(x, jax.Array) else np.asarray(x, np.float32), tree)


def to_unbounded(tree: Tree, margin: float = 1e-4) -> Tree:
    """Map parameters from their bounds to the real line (logit on the field's scale).

    Values closer to a bound than `margin` of the range are moved to that distance, which keeps
    the result finite.

    Example:
        >>> from jaxisp.stages.noise import GaussianNoise
        >>> there = to_unbounded(GaussianNoise(std=0.1))
        >>> round(float(to_bounded(there).std), 5)
        0.1
    """

    def forward(spec: Spec, value: Any) -> jax.Array:
        low, high = spec.bounds
        return bounds_to_line(value, low, high, spec.scale == "log", margin)

    return map_specs(forward, tree)


def bounds_to_line(value: Any, low: Any, high: Any, log: Any, margin: float = 1e-4) -> jax.Array:
    """Numbers between bounds as those on the real line, elementwise: the inverse of `line_to_bounds`."""
    value = jnp.asarray(value)
    low, high, first, span = _limits(low, high, log, jnp.result_type(value, float))
    if np.any(log):
        powers = jnp.log(jnp.clip(value, low, high))
        value = powers if np.all(log) else jnp.where(log, powers, value)
    share = jnp.clip((value - first) / span, margin, 1 - margin)
    return jnp.log(share) - jnp.log1p(-share)


def to_bounded(tree: Tree) -> Tree:
    """The inverse of `to_unbounded`."""

    def inverse(spec: Spec, value: Any) -> jax.Array:
        low, high = spec.bounds
        return line_to_bounds(value, low, high, spec.scale == "log")

    return map_specs(inverse, tree)


def line_to_bounds(value: Any, low: Any, high: Any, log: Any) -> jax.Array:
    """Numbers on the real line as those between bounds, elementwise: what `to_bounded` does with each.

    Args:
        value: finite.
        low, high: numbers, or arrays of its shape.
        log: whether the scale is logarithmic; a bool, or an array of them.
    """
    value = jnp.asarray(value)
    low, high, first, span = _limits(low, high, log, jnp.result_type(value, float))
    scaled = first + span * jax.nn.sigmoid(value)
    if np.any(log):
        # else a number that is not on that scale could be infinite, and its gradient none
        powers = jnp.exp(scaled if np.all(log) else jnp.where(log, scaled, 0))
        scaled = powers if np.all(log) else jnp.where(log, powers, scaled)
    # the last bit of exp or of the sum may step over a bound
    return jnp.clip(scaled, low, high)


def _limits(low: Any, high: Any, log: Any, dtype: Any) -> tuple[np.ndarray, ...]:
    """The bounds; and the lower one and how far they are apart, on the scale of the numbers."""
    first, last = (np.where(log, np.log(np.where(log, end, 1.0)), end) for end in (low, high))
    low, high, first, span = (np.asarray(part, dtype) for part in (low, high, first, last - first))
    return low, high, first, span


def batch_axes(tree: Tree) -> Tree:
    """`in_axes` for `vmap`: 0 where a leaf has one more axis than its spec, None where it is shared."""

    def axis(spec: Spec, value: Any) -> int | None:
        extra = np.ndim(value) - len(spec.shape)
        if extra not in (0, 1):
            raise ValueError(f"a parameter of shape {spec.shape} got a value of shape {np.shape(value)}")
        return 0 if extra else None

    return map_specs(axis, tree)
