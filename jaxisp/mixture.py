"""A mixture: each image of a batch is degraded by one of several recipes, drawn by their shares.

Images are sorted by recipe on the device, and run in groups of one recipe each. A batch costs what the
recipes of its images cost, and at most the padding of a group a recipe. All recipes are one program.
"""

import dataclasses
import functools
import itertools
import tomllib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import tomli_w
from jax import lax
from jax.typing import ArrayLike

from jaxisp import shown
from jaxisp.arrays.barriers import store
from jaxisp.arrays.varying import alike, spread_over
from jaxisp.checks import LAST_INDEX, check_count
from jaxisp.errors import InputError, short
from jaxisp.io.files import parse_toml, write_text
from jaxisp.params import strong
from jaxisp.pipeline import Chain, over_batch, spread
from jaxisp.priors import draw
from jaxisp.process.selfcheck import check_backend
from jaxisp.recipe import (
    Degraded,
    Recipe,
    check_drawn,
    check_photographs,
    check_traces,
    extents_of,
    sample_halves,
    taken,
)  # fmt: skip

GROUPS = 8
"""Groups that a batch of one recipe runs in. Fewer run faster each, and pad more."""
WHICH = "recipe"
"""The entry of the parameters that says which recipe each image had."""

Branches = tuple[tuple[str, Chain], ...]


@dataclasses.dataclass(frozen=True, eq=False, repr=False)
class Mixture:
    """Recipes by name, and the share of the images that each is for. Make it with `jaxisp.recipes.mix`.

    A pytree of the shares and of the numbers of its recipes, as a recipe is of its own. Of traced shares
    nothing is known; their ratios count.
    """

    recipes: dict[str, Recipe]
    shares: tuple[Any, ...]

    def __post_init__(self) -> None:
        for name, recipe in self.recipes.items():
            if name == WHICH:
                raise InputError(
                    f"a recipe in a mixture may not be named {WHICH!r}: give recipe.named('other')"
                )
            check_photographs(recipe)
        if any(isinstance(share, jax.core.Tracer) for share in self.shares):
            _check_each(self.shares, self.recipes)
            return
        try:
            given = np.asarray([_number(share) for share in self.shares])
        except (TypeError, ValueError, OverflowError):
            raise InputError(
                f"shares of a mixture must be numbers, as {{'phone': 0.8, 'clean': 0.2}}, got {self._told}"
            ) from None
        object.__setattr__(self, "shares", tuple(given.tolist()))
        _check_each(self.shares, self.recipes)
        if not (np.isfinite(given).all() and (given >= 0).all()):
            raise InputError(f"shares of a mixture must be 0 or more and sum to 1, got {self._told}")
        if abs(given.sum() - 1) >= 1e-6:
            raise InputError(f"shares of a mixture must sum to 1, got {self._told}, {given.sum():.6g} in all")

    @property
    def _told(self) -> str:
        return short(dict(zip(self.recipes, self.shares)))

    def __repr__(self) -> str:
        return f"mix({dict(zip(self.recipes, map(_plain, self.shares)))})"

    def _repr_html_(self) -> str:
        return shown.mixture_html(self)

    @property
    def name(self) -> str:
        """What it mixes, as `phone-awgn`."""
        return "-".join(self.recipes)

    @property
    def description(self) -> str:
        """What it mixes, with the shares."""
        shares = (f"{100 * float(share):.3g} % {name}" for name, share in zip(self.recipes, self.shares))
        return f"a mixture: {', '.join(shares)}"

    def to_toml(self) -> str:
        """The mixture as TOML, with its recipes in it; `from_toml` reads it back equal."""
        tables = [tomllib.loads(recipe.to_toml()) for recipe in self.recipes.values()]
        parts = [{"share": s, "recipe": table} for s, table in zip(map(_plain, self.shares), tables)]
        return tomli_w.dumps({"mixture": parts})

    @classmethod
    def from_toml(cls, text: str, source: str = "mixture") -> "Mixture":
        """Read a mixture. Raises InputError that names `source` and what is wrong."""
        table = parse_toml(text, source)
        parts = table.get("mixture")
        wanted = {"share", "recipe"}
        if set(table) != {"mixture"} or not isinstance(parts, list):
            raise InputError(f"{source}: a mixture has [[mixture]] tables alone, got {short(sorted(table))}")
        if not all(isinstance(part, dict) and set(part) == wanted for part in parts):
            raise InputError(f"{source}: each [[mixture]] has a share and a recipe")
        recipes = [Recipe.from_table(part["recipe"], source) for part in parts]
        if len({recipe.name for recipe in recipes}) < len(recipes):
            raise InputError(f"{source}: two recipes of a mixture have one name")
        try:
            return cls({recipe.name: recipe for recipe in recipes}, tuple(part["share"] for part in parts))
        except InputError as error:
            raise InputError(f"{source}: {error}") from None

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Mixture) and self._parts == other._parts

    def __hash__(self) -> int:
        return hash(self._parts)

    @property
    def _parts(self) -> tuple[Any, ...]:
        return tuple(self.recipes), tuple(map(_plain, self.shares)), tuple(self.recipes.values())

    def save(self, path: str | Path) -> None:
        """Write the TOML file, whole or not at all."""
        write_text(path, self.to_toml())

    def drawn(self, params: dict[str, Any]) -> tuple[Recipe, dict[str, Any]]:
        """The recipe of one image, and its parameters, out of what `degrade` drew for it."""
        name = self.names[int(params[WHICH])]
        return self.recipes[name], params[name]

    @property
    def names(self) -> tuple[str, ...]:
        """Of the recipes; `params["recipe"]` counts in this order."""
        return tuple(self.recipes)

    @property
    def _branches(self) -> Branches:
        return tuple((name, recipe.chain) for name, recipe in self.recipes.items())

    @property
    def margin(self) -> int | None:
        """As that of a recipe; None where that of one is."""
        each = [recipe.margin for recipe in self.recipes.values()]
        return None if None in each else max(filter(None, each), default=0)

    def degrade(
        self, key: jax.Array, images: ArrayLike, start: Any = 0, sizes: ArrayLike | None = None
    ) -> Degraded:
        """Degrade a batch on the device, each image by a recipe of its own.

        An image that has a recipe gets the draws that this recipe gives for the same key and index. Which one
        it has depends on key and index alone. Takes and raises what `Recipe.degrade` does.

        Returns:
            noisy, clean, and the parameters: `params["recipe"]`, (N,) int32, is each image's recipe as an
            index into `names`; `params[NAME]` holds the recipe's parameters, NaN for the images of others.
        """
        check_backend()
        prior = {name: strong(recipe.prior) for name, recipe in self.recipes.items()}
        given = taken("a mixture", key, images, start)
        chains = [chain for _, chain in self._branches]
        extents = extents_of("a mixture", chains, sizes, *given[:2])
        return _degrade(self._branches, _ends(self.shares), prior, *given, extents)

    def repeat(self, key: jax.Array, params: dict[str, Any], images: ArrayLike, start: Any = 0) -> jax.Array:
        """Degrade again with parameters drawn before: the same bits for the same key and start.

        Takes and raises what `degrade` does, and InputError where a parameter of an image's recipe is NaN or
        out of its bounds (of traced ones nothing is known).
        """
        told = "a mixture repeats with the parameters that its degrade returned"
        if not isinstance(params, dict) or set(params) != {WHICH, *self.recipes}:
            raise InputError(f"{told}, with {', '.join([WHICH, *self.recipes])}; got {short(params)}")
        key, images, start = taken("a mixture", key, images, start)
        if np.shape(params[WHICH]) != (len(images),):
            got = f"{np.shape(params[WHICH])} for {len(images)} images"
            raise InputError(f"{told}: {WHICH!r} has the shape {got}")
        for name, chain in self._branches:
            check_drawn(f"a mixture, of {name!r},", chain, params[name])
            check_count(params[name], len(images))
        if not any(isinstance(leaf, jax.core.Tracer) for leaf in jax.tree.leaves(params)):
            for i, (name, chain) in enumerate(self._branches):
                own = np.asarray(params[WHICH]) == i  # NaN elsewhere
                chain.check(jax.tree.map(lambda v, own=own: np.asarray(v)[own], params[name]))
        return _repeat(self._branches, key, params, images, start)


def _number(share: Any) -> float:
    """A share that is a number, and no text or switch."""
    if isinstance(share, str | bytes | bool | np.bool_):
        raise TypeError
    return float(_plain(share))


def _plain(share: Any) -> Any:
    """A float32 by its shortest decimal, which reads back the same; others as they are."""
    if isinstance(share, jax.Array) and not isinstance(share, jax.core.Tracer):
        share = np.asarray(share)[()]
    return float(str(share)) if isinstance(share, np.floating) else share


def _check_each(shares: tuple[Any, ...], recipes: dict[str, Recipe]) -> None:
    if len(shares) != len(recipes) or not shares:
        raise InputError(f"a mixture takes a share for each of its recipes, got {short(shares)}")


def _ends(shares: tuple[Any, ...]) -> Any:
    """Where on [0, 1] the part of each recipe ends: the same bits whether or not shares are traced."""
    numbers = jnp if any(isinstance(share, jax.core.Tracer) for share in shares) else np
    sums = list(itertools.accumulate(numbers.float32(share) for share in shares))
    return numbers.stack([end / sums[-1] for end in sums])


def _flatten(mixture: Mixture) -> tuple[tuple[Any, ...], Any]:
    shares = tuple(np.float32(s) if isinstance(s, float | np.generic) else s for s in mixture.shares)
    return (shares, tuple(mixture.recipes.values())), tuple(mixture.recipes)


def _unflatten(names: tuple[str, ...], children: Any) -> Mixture:
    mixture = object.__new__(Mixture)
    # unchecked: JAX puts anything where the numbers were
    object.__setattr__(mixture, "shares", children[0])
    object.__setattr__(mixture, "recipes", dict(zip(names, children[1])))
    return mixture


jax.tree_util.register_pytree_node(Mixture, _flatten, _unflatten)

Degradation = Recipe | Mixture
"""What degrades pictures."""


def parts(degradation: Degradation) -> tuple[Recipe, ...]:
    """The recipes of a mixture, or the one recipe."""
    return tuple(degradation.recipes.values()) if isinstance(degradation, Mixture) else (degradation,)


def check_runs(degradation: Degradation) -> None:
    """Raise InputError where a recipe is not for photographs, or cannot run on any."""
    for recipe in parts(degradation):
        check_photographs(recipe)
        check_traces(recipe)


@functools.partial(jax.jit, static_argnums=0)
def _degrade(
    branches: Branches,
    ends: Any,
    prior: dict[str, Any],
    key: jax.Array,
    images: jax.Array,
    start: Any,
    extents: Any,
) -> Degraded:
    drawing, _ = sample_halves(key, start, len(images))
    choosing = jax.vmap(jax.random.fold_in, in_axes=(0, None))(drawing, LAST_INDEX)  # no parameter's name
    chance = jax.vmap(lambda own: jax.random.uniform(own, (), jnp.float32))(choosing)
    which = jnp.sum(chance[:, None] >= ends[None, :-1], 1, dtype=jnp.int32)
    params: dict[str, Any] = {WHICH: which}
    for i, (name, chain) in enumerate(branches):
        sample = functools.partial(draw, prior=prior[name], like=chain.init())
        params[name] = jax.tree.map(functools.partial(_where, which == i), store(jax.vmap(sample)(drawing)))
    return _repeat(branches, key, params, images, start, extents), images, params


def _where(own: jax.Array, values: jax.Array) -> jax.Array:
    return jnp.where(own.reshape(-1, *[1] * (values.ndim - 1)), values, jnp.nan)


@functools.partial(jax.jit, static_argnums=0)
def _repeat(
    branches: Branches,
    key: jax.Array,
    params: dict[str, Any],
    images: jax.Array,
    start: Any,
    extents: Any = None,
) -> jax.Array:
    _, noise = sample_halves(key, start, len(images))
    return _by_branch(branches, params, images, noise, extents)


def _by_branch(
    branches: Branches, params: dict[str, Any], images: jax.Array, keys: jax.Array, extents: Any = None
) -> jax.Array:
    """Each image by its own branch: groups of images of one branch, one after another."""
    mesh = spread_over(images)
    if mesh is not None:
        if extents is not None:
            raise TypeError("pictures in larger frames are not spread over devices")
        axes = jax.tree.map(lambda _: 0, params)
        return spread(mesh, functools.partial(_by_branch, branches), axes, params, images, keys)
    count = len(images)
    if not count:
        return images
    which = jnp.clip(params[WHICH], 0, len(branches) - 1)
    size = -(-count // GROUPS)
    # all in int32: with double precision enabled, sums and places would be 64-bit integers
    counts = jnp.sum(which[:, None] == jnp.arange(len(branches), dtype=jnp.int32)[None], 0, dtype=jnp.int32)
    order = jnp.argsort(which, stable=True).astype(jnp.int32)
    first = jnp.cumsum(counts, dtype=jnp.int32) - counts  # in `order`, of each branch
    last_group = jnp.cumsum(-(-counts // size), dtype=jnp.int32)
    first_group = last_group - -(-counts // size)

    def run(group: jax.Array) -> jax.Array:
        # groups beyond the last are of no branch; a branch's last group is padded with its first image
        branch = jnp.sum(group >= last_group, dtype=jnp.int32)
        own = jnp.minimum(branch, len(branches) - 1)
        at = (group - first_group[own]) * size + jnp.arange(size, dtype=jnp.int32)
        rows = order[jnp.clip(first[own] + jnp.where(at < counts[own], at, 0), 0, count - 1)]
        taken_rows = jax.tree.map(lambda v: v[rows], (params, images, keys, extents))
        return lax.switch(branch, runs, *alike(taken_rows))

    runs: list[Callable[..., jax.Array]] = [functools.partial(_run, name, chain) for name, chain in branches]
    runs.append(lambda params, images, keys, extents: images)
    groups = (count + len(branches) * (size - 1)) // size
    done = lax.map(run, jnp.arange(groups, dtype=jnp.int32)).reshape(-1, *images.shape[1:])
    place = jnp.argsort(order).astype(jnp.int32) - first[which]  # among the images of its branch
    return done[first_group[which] * size + place]


def _run(
    name: str, chain: Chain, params: dict[str, Any], images: jax.Array, keys: jax.Array, extents: Any
) -> jax.Array:
    return alike(over_batch(chain, params[name], images, keys, extents), images)
