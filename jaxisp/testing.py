"""The contract of a stage, as checks that a stage of your own can be put through.

    from jaxisp.testing import check_stage
    check_stage("halation")

The library's own stages go through the same checks in its test suite.
"""

import dataclasses
import functools
import re
import zlib
from collections.abc import Callable, Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax

from jaxisp.arrays.extents import Extent
from jaxisp.checks import several
from jaxisp.node import Stage, stage
from jaxisp.params import map_specs, specs
from jaxisp.pipeline import compiled, run, run_batch, sections, signature

__all__ = ["CHECKS", "Subject", "check_stage", "imprecise_products", "smooth_image"]

_HIGHEST = lax.Precision.HIGHEST


def smooth_image(shape: tuple[int, ...], seed: int = 0, low: float = 0.02, high: float = 0.98) -> np.ndarray:
    """A float64 picture of waves, an edge and some texture.

    Args:
        shape: (H, W) or (H, W, C) [px].
        seed: of the waves and the texture.
        low: smallest value.
        high: largest value.
    """
    rng = np.random.default_rng(seed)
    y, x = np.mgrid[: shape[0], : shape[1]]
    out = np.zeros(shape)
    for c in range(shape[2] if len(shape) == 3 else 1):
        fy, fx, phase = *rng.uniform(0.05, 0.3, 2), rng.uniform(0, 6)
        plane = 0.5 + 0.3 * np.sin(fy * y + phase) * np.cos(fx * x) + 0.15 * (x > shape[1] / 2)
        plane += 0.03 * rng.standard_normal(shape[:2])
        out[(..., c) if len(shape) == 3 else ...] = plane
    return np.clip(out, low, high)


@dataclasses.dataclass(frozen=True)
class Subject:
    """A stage under test, with inputs drawn for it.

    Attributes:
        node: the stage, with its static options.
        size: (H, W) of its images [px]; uneven, so that axes cannot be mistaken for each other.
    """

    node: Stage
    size: tuple[int, int] = (21, 34)

    def image(self, seed: int = 0, dtype: Any = np.float32) -> np.ndarray:
        """A smooth image of the shape that the stage takes."""
        shape = self.size if self.node.domain_in.channels == 1 else (*self.size, 3)
        return smooth_image(shape, seed).astype(dtype)

    def params(self, share: float | None = None, seed: int = 0, dtype: Any = np.float32) -> Any:
        """Parameters at a share of each range: 0 and 1 are the bounds, None draws within them."""
        rng = np.random.default_rng(seed + zlib.crc32(self.node.name.encode()))

        def value(spec: Any) -> np.ndarray:
            s = rng.uniform(0.2, 0.8, spec.shape) if share is None else np.full(spec.shape, share)
            low, high = spec.bounds
            if spec.scale == "log":
                return np.asarray(np.exp(np.log(low) + s * np.log(high / low)), dtype).clip(low, high)
            return np.asarray(low + s * (high - low), dtype)

        return map_specs(lambda spec, _: value(spec), self.node.init())

    @property
    def declared_gradient(self) -> str:
        """The first word of the docstring's `Gradient:` section: exact, surrogate or none."""
        words = sections(self.node.fn).get("Gradient", "").split()
        return words[0].strip(".,:;") if words else ""

    @functools.cached_property
    def weights(self) -> np.ndarray:
        """Weights of the output's values, whose weighted sum is differentiated."""
        out = compiled.eval_shape(self.node, self.params(), self.image(), jax.random.key(0))
        return np.random.default_rng(1).standard_normal(out.shape).astype(np.float32)

    @functools.cached_property
    def gradient(self) -> Any:
        """From (params, image, weights, key) to the weighted sum and its gradients; compiled once."""
        node = self.node
        return jax.jit(
            jax.value_and_grad(lambda p, x, w, key: jnp.sum(node(p, x, key=key) * w), argnums=(0, 1))
        )


def check_stage(
    subject: Stage | str | Callable[..., jax.Array], only: str | Sequence[str] | None = None
) -> list[str]:
    """Put a stage through the contract that every stage of the library keeps.

    Args:
        subject: a stage, a registered name, or a stage function.
        only: names of `CHECKS`, or one; all of them unless given.

    Returns:
        The names of the checks that it passed, which are all that were asked for.

    Raises:
        AssertionError: the first check that failed, and why.
        KeyError: no stage, or no check, of that name.

    Example:
        >>> check_stage("unsharp_mask", only=["declaration", "no_retrace"])
        ['declaration', 'no_retrace']
    """
    under_test = Subject(subject if isinstance(subject, Stage) else stage(subject))
    names = list(CHECKS) if only is None else list(several(only))
    if unknown := [name for name in names if name not in CHECKS]:
        raise KeyError(f"no check named {unknown[0]!r}; there are {', '.join(CHECKS)}")
    for name in names:
        CHECKS[name](under_test)
    return names


def _declaration(subject: Subject) -> None:
    """The name, the docstring's sections, and unit and help of each parameter."""
    fn, name = subject.node.fn, subject.node.fn.__name__
    declared, found = signature(fn), sections(fn)
    _require(re.fullmatch(r"[a-z][a-z0-9]*(_[a-z0-9]+)*", name), f"{name}: stages are named in snake_case")
    _require(not name.startswith(("apply_", "do_", "get_")), f"{name}: stages are nouns")
    for title in ("Summary", "Args", "Returns", "Gradient", "Source"):
        _require(found.get(title), f"{name}: docstring lacks {title}")
    known = {"exact", "surrogate", "none"}
    _require(
        subject.declared_gradient in known, f"{name}: Gradient must begin with {', '.join(sorted(known))}"
    )
    arguments = [n for n, _ in declared.static] + ["image"] + ["params"] * bool(declared.params)
    for argument in arguments:
        _require(f"{argument}:" in found["Args"], f"{name}: Args lacks {argument}")
    for field, spec in specs(declared.params).items() if declared.params else ():
        _require(spec.unit and spec.doc, f"{name}: {field} needs a unit and a doc")


def _total(subject: Subject) -> None:
    """Finite float32 for every finite input: black, white, above 1, negative, parameters on their bounds."""
    node = subject.node
    for share, where in _PLACES.items():
        for what, image in _extremes(subject).items():
            out = run(node, subject.params(share), image, jax.random.key(0))
            _require(out.dtype == jnp.float32, f"{node.name}: {out.dtype} comes of float32")
            _require(np.isfinite(out).all(), f"{node.name}: not finite on {what}, {where}")
            wanted = {1: 2, 3: 3, None: image.ndim}[node.domain_out.channels]
            _require(out.ndim == wanted, f"{node.name}: {out.shape} is not {node.domain_out.name}")


def _gradient_is_finite(subject: Subject) -> None:
    """Finite gradients for the same inputs."""
    for share, where in _PLACES.items():
        for what, image in _extremes(subject).items():
            found = subject.gradient(subject.params(share), image, subject.weights, jax.random.key(0))[1]
            finite = all(np.isfinite(leaf).all() for leaf in jax.tree.leaves(found))
            _require(finite, f"{subject.node.name}: gradient not finite on {what}, {where}")


def _products_are_precise(subject: Subject) -> None:
    """Every matrix product and convolution asks for full precision: a GPU's default has 10 bits."""
    node, params, image, key = subject.node, subject.params(), subject.image(), jax.random.key(0)
    forward = compiled.trace(node, params, image, key).jaxpr  # a custom rule has its own
    backward = subject.gradient.trace(params, image, subject.weights, key).jaxpr
    found = imprecise_products(forward) + imprecise_products(backward)
    _require(not found, f"{node.name}: give precision=HIGHEST to {found[:1]}")


def _gradient_gives_the_value(subject: Subject) -> None:
    """A custom rule has a forward pass of its own; it gives the stage's value."""
    params, image, key = subject.params(), subject.image(), jax.random.key(0)
    terms = np.asarray(run(subject.node, params, image, key)) * subject.weights
    got = subject.gradient(params, image, subject.weights, key)[0]
    np.testing.assert_allclose(got, terms.sum(dtype=float), atol=1e-4 * np.abs(terms).sum())


def _gradient_reaches_parameters(subject: Subject) -> None:
    """No declared parameter is dead: its gradient, exact or surrogate, is not zero everywhere."""
    cls, name = signature(subject.node.fn).params, subject.node.name
    if cls is None or subject.declared_gradient == "none":
        return
    drawn = [(subject.params(seed=i), subject.image(i), subject.weights, jax.random.key(i)) for i in range(3)]
    grads = [subject.gradient(*arguments)[1][0] for arguments in drawn]
    for field in specs(cls):
        _require(
            any(np.abs(getattr(g[name], field)).max() > 0 for g in grads), f"{name}.{field} has no gradient"
        )


def _gradient_is_exact(subject: Subject) -> None:
    """A gradient declared exact agrees with central differences in float64, along a random direction."""
    if subject.declared_gradient != "exact":
        return
    with jax.enable_x64(True):
        rng = np.random.default_rng(3)
        params, image, key = (
            subject.params(dtype=np.float64), subject.image(dtype=np.float64), jax.random.key(0),
        )  # fmt: skip
        weights = rng.standard_normal(subject.weights.shape)

        def weighted(p: Any, x: jax.Array) -> jax.Array:
            return jnp.sum(subject.node(p, x, key=key) * weights)

        both = jax.jit(
            jax.value_and_grad(weighted, argnums=(0, 1))
        )  # one program: values are differenced too
        direction = jax.tree.map(
            lambda v: rng.standard_normal(np.shape(v)) * (np.abs(v) + 1e-3), (params, image)
        )
        grads = both(params, image)[1]
        got = sum(float(np.sum(g * d)) for g, d in zip(jax.tree.leaves(grads), jax.tree.leaves(direction)))

        def error(h: float) -> float:
            up, down = (
                jax.tree.map(lambda v, d, e=e: v + e * d, (params, image), direction) for e in (h, -h)
            )
            want = (float(both(*up)[0]) - float(both(*down)[0])) / (2 * h)
            return abs(got - want) / (abs(want) + 1e-3)

        best = min(error(h) for h in (1e-5, 1e-6, 1e-7))
    _require(best < 1e-4, f"{subject.node.name}: gradient differs from differences by {best:.2e} of it")


def _numeric_modes(subject: Subject) -> None:
    """In each of JAX's numeric modes it traces, with gradients, and its result has the image's dtype.

    Half precision; double precision enabled, with an image of either; strict dtype promotion; no implicit
    rank promotion. Nothing is compiled.
    """
    node, params, image, key = subject.node, subject.params(), subject.image(), jax.random.key(0)
    weights = subject.weights

    def gives(mode: str, dtype: Any) -> None:
        given = jax.ShapeDtypeStruct(image.shape, dtype)
        try:
            out = jax.eval_shape(lambda p, x: node(p, x, key=key), params, given)
        except (TypeError, ValueError) as error:
            raise AssertionError(f"{node.name}: {mode}: {error}") from error
        _require(out.dtype == dtype, f"{node.name}: {mode}: {out.dtype} comes of {jnp.dtype(dtype)}")

    gives("half precision", jnp.bfloat16)
    with jax.numpy_dtype_promotion("strict"), jax.numpy_rank_promotion("raise"):
        try:
            subject.gradient.trace(params, image, weights, key)
        except (TypeError, ValueError) as error:
            raise AssertionError(f"{node.name}: without implicit promotion: {error}") from error
        with jax.enable_x64(True):
            # in float32: what is float64 by default then meets it, and is refused
            gives("double precision enabled", jnp.float32)


def _batch_agrees(subject: Subject) -> None:
    """A batch under `vmap` agrees with its images one by one."""
    node, root = subject.node, jax.random.key(7)
    images = np.stack([subject.image(seed) for seed in range(3)])
    params = jax.tree.map(lambda *v: np.stack(v), *[subject.params(seed=seed) for seed in range(3)])
    batch = run_batch(node, params, images, root)
    for i in range(3):
        jitted = run(node, subject.params(seed=i), images[i], jax.random.fold_in(root, i))
        np.testing.assert_allclose(batch[i], jitted, atol=2e-5, rtol=2e-5)


def _frame_agrees(subject: Subject) -> None:
    """Where a margin is declared, a picture comes out of larger frames as it does alone, to the bit."""
    node, key, margin = subject.node, jax.random.key(0), subject.node.margin
    if margin is None or (node.reach == 0 and not node.stochastic):
        return

    @jax.jit
    def framed(params: Any, frame: jax.Array, extent: Extent) -> jax.Array:
        return node(params, frame, key=key, extent=extent)

    height, width = subject.size
    for seed, (rows, columns) in enumerate([subject.size, (height - 1, width), (height - 4, width - 5)]):
        image, params = subject.image(seed)[:rows, :columns], subject.params(seed=seed)
        around = [(0, height + margin - rows), (0, width + margin - columns), (0, 0)][: image.ndim]
        frame = np.pad(image, around, constant_values=0.7)
        out = framed(params, frame, Extent(jnp.int32(rows), jnp.int32(columns)))[:rows, :columns]
        same = np.asarray(out).tobytes() == np.asarray(run(node, params, image, key)).tobytes()
        _require(same, f"{node.name}: {rows} x {columns} px come out otherwise of a larger frame")


def _plain_call_agrees(subject: Subject) -> None:
    """The compiled stage agrees with a plain call, which compiles each operation by itself."""
    params, image, key = subject.params(), jnp.asarray(subject.image()), jax.random.key(0)
    jitted, plain = run(subject.node, params, image, key), subject.node(params, image, key=key)
    np.testing.assert_allclose(jitted, plain, atol=2e-5, rtol=2e-5)


def _no_retrace(subject: Subject) -> None:
    """New values are not traced again."""
    programs = [
        compiled.trace(subject.node, subject.params(seed=i), subject.image(i), jax.random.key(i)).jaxpr
        for i in range(2)
    ]  # the other checks run the first; a trace that JAX has already is the same object
    _require(programs[0] is programs[1], f"{subject.node.name}: new values are traced again")


def _wrong_shapes_are_refused(subject: Subject) -> None:
    """Wrong shapes and dtypes raise a TypeError that names the stage."""
    node, key = subject.node, jax.random.key(0)
    wrong = [np.zeros(shape, np.float32) for shape in ((2, 21, 34, 3), (21, 34, 4), (5,))]
    wrong.append((subject.image() * 255).astype(np.uint8))
    for image in wrong:
        try:
            node(subject.params(), jnp.asarray(image), key=key)
        except TypeError as error:
            _require(node.name in str(error), f"{node.name}: {error} does not name it")
        else:
            raise AssertionError(f"{node.name} takes {image.dtype} of shape {image.shape}")


CHECKS: dict[str, Callable[[Subject], None]] = {
    "declaration": _declaration,
    "total": _total,
    "gradient_is_finite": _gradient_is_finite,
    "products_are_precise": _products_are_precise,
    "gradient_gives_the_value": _gradient_gives_the_value,
    "gradient_reaches_parameters": _gradient_reaches_parameters,
    "gradient_is_exact": _gradient_is_exact,
    "numeric_modes": _numeric_modes,
    "batch_agrees": _batch_agrees,
    "frame_agrees": _frame_agrees,
    "plain_call_agrees": _plain_call_agrees,
    "no_retrace": _no_retrace,
    "wrong_shapes_are_refused": _wrong_shapes_are_refused,
}
"""What a stage must do, by name; each raises AssertionError where it does not."""


def imprecise_products(program: Any) -> list[str]:
    """The products of a jaxpr, branches and loops included, that are less than float32 on some device."""
    found = []
    for step in program.eqns:
        if step.primitive.name in ("dot_general", "conv_general_dilated"):
            floats = all(jnp.issubdtype(v.aval.dtype, jnp.floating) for v in step.invars)
            if floats and step.params["precision"] not in (_HIGHEST, (_HIGHEST, _HIGHEST)):
                found.append(str(step))
        for value in jax.tree.leaves(list(step.params.values()), is_leaf=lambda v: hasattr(v, "eqns")):
            inner = getattr(value, "jaxpr", value)
            found += imprecise_products(inner) if hasattr(inner, "eqns") else []
    return found


_PLACES = {
    None: "parameters within their ranges",
    0.0: "parameters at their lower bounds",
    1.0: "parameters at their upper bounds",
}


def _extremes(subject: Subject) -> dict[str, np.ndarray]:
    ordinary = subject.image()
    return {
        "a smooth picture": ordinary,
        "black": np.zeros_like(ordinary),
        "white": np.ones_like(ordinary),
        "levels from -1 to 3": 4 * ordinary - 1,
    }


def _require(condition: Any, text: str) -> None:
    if not condition:
        raise AssertionError(text)
