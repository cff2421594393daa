"""A recipe: a pipeline with priors, jitted over batches, in and out of TOML."""

import dataclasses
import functools
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import tomli_w
from jax.typing import ArrayLike

from jaxisp import shown
from jaxisp.arrays.barriers import store
from jaxisp.arrays.extents import LEAST, Extent, has_room
from jaxisp.checks import check_count, check_key, check_start
from jaxisp.domains import CAMERA, ENCODED, LINEAR, PROPHOTO, XYZ_D65, Domain, accepts
from jaxisp.edits import by_stage, same
from jaxisp.errors import InputError, meant, one_line, short
from jaxisp.io.files import parse_toml, read_toml, write_text
from jaxisp.params import specs, strong
from jaxisp.pipeline import Chain, Node, Order, over_batch, sample_indices, sample_keys, signature
from jaxisp.priors import check_prior, draw, is_traced
from jaxisp.process.selfcheck import check_backend
from jaxisp.serialize import decode_node, decode_params, encode_node, encode_params
from jaxisp.stages.draws import by_index

Degraded = tuple[jax.Array, jax.Array, dict[str, Any]]

ENCODED_LEVELS = -0.25, 1.25
"""What sharpening or resizing may make of encoded pictures, whose levels are 0 to 1; 0 to 1.5 is no such."""
LIGHT_LEVELS = -0.25, 4.0
"""Linear light may be brighter than white; 8-bit levels are brighter than this."""
EDITED = "-edited"
"""How the name of a recipe ends that was made of another."""
_SIZE = (64, 64)  # of the picture that a recipe is tried on


@dataclasses.dataclass(frozen=True, eq=False, repr=False)
class Recipe:
    """A pipeline, what its parameters are drawn from, and what it is for.

    Two recipes are equal where their TOML and the functions of their stages are. Recipes of equal chains
    share one compile if their priors are of the same kinds: numbers are traced. A recipe is a pytree of
    these numbers, so that a jitted function takes one as an argument.

    Example:
        >>> import jax, jaxisp, numpy as np
        >>> from jaxisp.priors import Uniform
        >>> recipe = jaxisp.recipes.amwgn().override(shot_read_noise={"read": Uniform(0.0, 0.02)})
        >>> images = np.full((2, 16, 16, 3), 0.5, np.float32)
        >>> noisy, clean, params = recipe.degrade(jax.random.key(0), images)
        >>> noisy.shape, params["shot_read_noise"].read.shape
        ((2, 16, 16, 3), (2,))
        >>> jaxisp.Recipe.from_toml(recipe.to_toml()) == recipe
        True
    """

    chain: Chain
    prior: dict[str, Any] = dataclasses.field(default_factory=dict)
    """What parameters are drawn from, by stage name; what is left out is the default."""
    description: str = ""
    meta: dict[str, Any] = dataclasses.field(default_factory=dict)
    """Where it comes from and how it is meant: plain TOML values that no computation needs."""
    _before: dict[str, Any] | None = dataclasses.field(default=None, repr=False)
    """The prior that `dataclasses.replace` hands on: what a new prior leaves out keeps it."""

    def __post_init__(self) -> None:
        if not isinstance(self.chain, Chain):
            raise TypeError(f"Recipe takes a Chain((stage(...), ...), NAME), got {short(self.chain)}")
        for field, wanted, example in (
            ("prior", dict, "a dict by stage name, as {'gaussian_noise': GaussianNoise(std=0.1)}"),
            ("description", str, "text"),
            ("meta", dict, "a dict"),
        ):
            if not isinstance(given := getattr(self, field), wanted):
                raise InputError(f"recipe {self.name!r}: {field} must be {example}, got {short(given)}")
        default = self.chain.init()
        for name, own in self.prior.items():
            if name not in default:
                hint = meant(name, default) or f"; it has {sorted(default)}"
                raise InputError(f"recipe {self.name!r} has no stage {name}{hint}")
            if not isinstance(own, type(default[name])):
                kind = type(default[name]).__name__
                raise InputError(f"recipe {self.name!r}: {name} must be a {kind}(...), got {short(own)}")
        kept = {n: own for n, own in (self._before or {}).items() if isinstance(own, type(default.get(n)))}
        # in the order of the chain, so that equal recipes have equal text
        whole = {n: self.prior.get(n, kept.get(n, values)) for n, values in default.items()}
        object.__setattr__(self, "prior", whole)
        object.__setattr__(self, "_before", whole)
        check_prior(whole)

    @property
    def name(self) -> str:
        return self.chain.name

    @property
    def margin(self) -> int | None:
        """`Chain.margin`: how much larger than pictures of several sizes their images are, see `degrade`."""
        return self.chain.margin

    @functools.cached_property
    def _text(self) -> str:
        return self.to_toml()

    def __eq__(self, other: object) -> bool:
        if not isinstance(other, Recipe) or self is other:
            return self is other
        # by its text alone, a stage that was edited would go on as it was compiled before
        if self.chain != other.chain or is_traced(self.prior) or is_traced(other.prior):
            return False
        return self._text == other._text

    def __hash__(self) -> int:
        return hash(self.chain)

    def __repr__(self) -> str:
        return shown.recipe_text(self)

    def _repr_html_(self) -> str:
        return shown.recipe_html(self)

    def named(self, name: str) -> "Recipe":
        """The recipe by another name; nothing else changes, and nothing is compiled anew.

        What is edited (`override`, `insert`, `replace`, `without`) has the ending `-edited` until it is
        named.
        Raises TypeError where the name is no text, InputError where it is empty.

        Example:
            >>> import jaxisp
            >>> loud = jaxisp.recipes.awgn().override(gaussian_noise={"std": 0.2})
            >>> loud.name, loud.named("loud").name
            ('awgn-edited', 'loud')
        """
        if isinstance(name, str) and not name.strip():
            raise InputError(f"recipe {self.name!r}: its new name is empty")
        return dataclasses.replace(self, chain=dataclasses.replace(self.chain, name=name))

    def override(
        self, stages: Mapping[str, dict[str, Any]] | None = None, /, **named: dict[str, Any]
    ) -> "Recipe":
        """The recipe with some parameters drawn otherwise, or other static options; all others stay.

        `recipe.override(shot_read_noise={"read": Uniform(0.0, 0.05)})`, or the same as one dict; a number is
        not drawn.

        Raises:
            InputError: there is no such stage, parameter or option, or it may not be what is given.
        """
        changed, options = {}, {}
        has = {s.name: dict(signature(s.fn).static) for s in self.chain.stages()}
        has = {name: has.get(name, {}) for name in {**has, **self.prior}}
        for name, values in by_stage(self.name, stages, named).items():
            if name not in has:
                hint = meant(name, has) or f"; it has {sorted(has)}"
                raise InputError(f"recipe {self.name!r} has no stage {name}{hint}")
            known = specs(type(self.prior[name])) if name in self.prior else {}
            also = f" and the options {sorted(has[name])}" if has[name] else ""
            takes = f"recipe {self.name!r}: {name} takes a dict of {sorted(known)}{also}"
            if not isinstance(values, dict):
                raise InputError(f"{takes}, got {short(values)}")
            if unknown := [str(n) for n in values if n not in known and n not in has[name]]:
                hint = meant(unknown[0], {**known, **has[name]})
                raise InputError(f"{takes}, got {unknown[0]!r}{hint}")
            if drawn := {n: v for n, v in values.items() if n in known}:
                changed[name] = dataclasses.replace(self.prior[name], **drawn)
            if static := {n: v for n, v in values.items() if n not in known}:
                options[name] = static
        chain = self.chain.override(options) if options else self.chain
        if not changed and not options:
            return self
        return dataclasses.replace(self, chain=_edited(chain), prior=changed)

    def insert(
        self, *nodes: Node | Iterable[Node], before: str | None = None, after: str | None = None
    ) -> "Recipe":
        """The recipe with stages before or after the one of a name; their parameters are the defaults.

        `recipe.insert(stage("vignetting"), before="mosaic").override(vignetting={...})`

        Raises:
            InputError: there is no stage of that name, or the chain could not be built.
            TypeError: what is inserted is no stage.
        """
        return self._with(self.chain.insert(*nodes, before=before, after=after))

    def replace(self, name: str, node: Node) -> "Recipe":
        """The recipe with another stage in the place of one. Raises what `insert` does.

        Where name and class of the parameters are the same, they stay; else they are the defaults.
        """
        return self._with(self.chain.replace(name, node))

    def without(self, *names: str | Iterable[str]) -> "Recipe":
        """The recipe less the stages of those names; the others' draws and noise stay to the bit.

        Raises what `insert` does.
        """
        return self._with(self.chain.without(*names))

    def _with(self, chain: Chain) -> "Recipe":
        if same(chain.nodes, self.chain.nodes):
            return self
        sizes = {name: np.shape(v.priority) for name, v in chain.init().items() if isinstance(v, Order)}
        # constant priorities of fewer or more nodes say nothing of the order now
        kept = {
            name: own
            for name, own in self.prior.items()
            if not isinstance(own, Order) or np.shape(own.priority) in ((), sizes.get(name))
        }
        return dataclasses.replace(self, chain=_edited(chain), prior={}, _before=kept)

    def draw(self, key: jax.Array) -> dict[str, Any]:
        """One draw of the parameters. Raises TypeError where the key is none."""
        check_key(f"recipe {self.name!r}", key)
        return draw(key, self.prior, self.chain.init())

    def degrade(
        self, key: jax.Array, images: ArrayLike, start: Any = 0, sizes: ArrayLike | None = None
    ) -> Degraded:
        """Degrade a batch on the device, with one draw of the parameters an image.

        Image i depends on the key and on its index, start + i, alone: the same bits at any batch size
        (but for `rsblur`, see there).

        Args:
            key: a JAX key, as `jax.random.key(0)`.
            images: (N, H, W, 3) floats, encoded sRGB in [0, 1]; taken as float32.
            start: the global index of the first image, or (N,) indices; from 0 to 2**31 - 1.
            sizes: (N, 2) rows and columns, where pictures of several sizes are the top left of their images,
                which are larger by `margin`, or as large, along each axis. A picture comes out as it
                would alone, to the bit; what is around it has no meaning. Traced ones are not checked.

        Returns:
            noisy (N, H, W, 3) float32 encoded sRGB, clean (the images), and the drawn parameters,
            one more axis a leaf.

        Raises:
            TypeError: images are not (N, H, W, 3) floats, or the key is none.
            InputError: no such sizes, or a stage's result depends on the frame; or the key is not Threefry's.
            ValueError: images hold NaN or are outside [0, 1] by more than 0.25, as levels of 0 to 255, 0 to 2
                or -1 to 1 are (not known of traced ones; linear light may reach 4); they have no pixels; or
                there is no such index.
        """
        check_backend()
        who = f"recipe {self.name!r}"
        given = taken(who, key, images, start, self.chain.domain_in)
        return _degrade(
            self.chain, strong(self.prior), *given, extents_of(who, (self.chain,), sizes, *given[:2])
        )

    def repeat(self, key: jax.Array, params: dict[str, Any], images: ArrayLike, start: Any = 0) -> jax.Array:
        """Degrade again with parameters drawn before: the same bits for the same key and start.

        Takes and raises what `degrade` does, and InputError where the parameters are those of another recipe
        or of another number of images, or one is NaN or out of its bounds (of traced ones nothing is known).
        """
        who = f"recipe {self.name!r}"
        key, images, start = taken(who, key, images, start, self.chain.domain_in)
        check_drawn(who, self.chain, params)
        self.chain.check(params)
        check_count(params, len(images))
        return _repeat(self.chain, key, params, images, start)

    def to_toml(self) -> str:
        """The recipe as TOML; `from_toml` reads it back equal."""
        head: dict[str, Any] = {"name": self.name, "description": self.description}
        if self.meta:
            head["meta"] = self.meta
        nodes = [encode_node(n) for n in self.chain.nodes]
        return tomli_w.dumps({**head, "stages": nodes, "params": encode_params(self.prior)})

    @classmethod
    def from_toml(cls, text: str, source: str = "recipe") -> "Recipe":
        """Read a recipe. Raises InputError that names `source` and what is wrong."""
        return cls.from_table(parse_toml(text, source), source)

    @classmethod
    def from_table(cls, table: dict[str, Any], source: str = "recipe") -> "Recipe":
        """Read a recipe that stands in a larger TOML file. Raises what `from_toml` does."""
        try:
            if "mixture" in table:
                raise InputError("a mixture is several recipes: jaxisp.recipes.load_degradation reads it")
            unknown = set(table) - {"name", "description", "meta", "stages", "params"}
            if unknown or not isinstance(table.get("stages"), list):
                raise InputError(
                    f"a recipe has name, description, meta, stages and params; got {short(sorted(table))}"
                )
            if not isinstance(table.get("meta", {}), dict):
                raise InputError(f"meta must be a table, got {short(table['meta'])}")
            nodes = tuple(decode_node(t) for t in table["stages"])
            chain = Chain(nodes, str(table.get("name", "recipe")))
            params = decode_params(table.get("params", {}), chain)
            return cls(chain, params, str(table.get("description", "")), table.get("meta", {}))
        except ValueError as error:
            raise InputError(f"{source}: {error}") from None

    def save(self, path: str | Path) -> None:
        """Write the TOML file, whole or not at all."""
        write_text(path, self.to_toml())

    @classmethod
    def load(cls, path: str | Path) -> "Recipe":
        """Read a TOML file. Raises InputError where it is missing, wrong, or too large to be one."""
        return cls.from_table(read_toml(path), str(path))


def taken(
    who: str, key: jax.Array, images: ArrayLike, start: Any, domain: Domain = ENCODED
) -> tuple[jax.Array, jax.Array, Any]:
    """Key, images and start as they are computed with, checked as far as the host knows them."""
    shape, dtype = np.shape(images), getattr(images, "dtype", None)
    if dtype is None or len(shape) != 4 or shape[-1] != 3 or not jnp.issubdtype(dtype, jnp.floating):
        got = type(images).__name__ if dtype is None else f"{dtype}{shape}"
        advice = ""
        if dtype is None:
            advice = ": give an array, as np.asarray(image, np.float32)[None] / 255"
        elif len(shape) == 3 and shape[-1] == 3:
            advice = ": give one picture as image[None]"
        elif len(shape) == 4 and shape[1] == 3 != shape[-1]:
            advice = ": move the channels last"
        elif dtype is not None and jnp.issubdtype(dtype, jnp.integer):
            advice = ": divide 8 bits by 255"
        elif len(shape) == 4 and shape[-1] == 4:
            advice = ": leave the fourth channel out, as images[..., :3]"
        elif len(shape) == 3:
            advice = ": make three channels of grey, as np.stack(3 * [images], -1)"
        raise TypeError(f"{who} takes (N, H, W, 3) floats in [0, 1], got {got}{advice}")
    check_key(who, key)
    check_levels(images, who, domain)
    return key, jnp.asarray(images, jnp.float32), check_start(start, shape[0])


def extents_of(
    who: str, chains: Sequence[Chain], sizes: ArrayLike | None, key: jax.Array, images: jax.Array
) -> Extent | None:
    """The sizes of pictures in larger images as they are computed with. Raises InputError."""
    if sizes is None:
        return None
    margins = {node.name: node.margin for chain in chains for node in chain.nodes}
    if alone := [name for name, margin in margins.items() if margin is None]:
        told = ", ".join(alone)
        raise InputError(f"{who}: what {told} gives depends on the size of the image: leave sizes out")
    margin = max(filter(None, margins.values()), default=0)
    if not by_index(key):
        raise InputError(f"{who}: noise of pictures in larger images needs a key of Threefry")
    traced, frame = isinstance(sizes, jax.core.Tracer), (images.shape[1], images.shape[2])
    given: Any = sizes if traced else np.asarray(sizes)
    if given.shape != (len(images), 2) or not jnp.issubdtype(given.dtype, jnp.integer):
        raise InputError(f"{who}: sizes are ({len(images)}, 2) rows and columns, got {short(given)}")
    for height, width in () if traced else np.unique(given, axis=0).tolist():
        if not has_room((height, width), frame, margin):
            raise InputError(
                f"{who}: a picture of {height} x {width} px in an image of {frame[0]} x {frame[1]}: a side "
                f"is the same or {margin} px less, and at least {LEAST}"
            )
    return Extent(*(jnp.asarray(sides, jnp.int32) for sides in given.T))


def check_levels(images: ArrayLike, who: str, domain: Domain = ENCODED) -> None:
    """Raise ValueError where images hold what those of a domain do not: NaN, 0 to 255, -1 to 1.

    Wherever they are; of traced images, and of those that other processes hold a part of, nothing is known.
    """
    if isinstance(images, jax.core.Tracer) or not np.size(images):
        return
    light = domain in (CAMERA, LINEAR, PROPHOTO, XYZ_D65)
    darkest, brightest = LIGHT_LEVELS if light else ENCODED_LEVELS
    if isinstance(images, jax.Array):
        if not images.is_fully_addressable:
            return
        with jax.ensure_compile_time_eval():  # also of images that a program that is traced holds
            if bool(_within(images, darkest, brightest)):
                return
    given = np.asarray(images)
    with np.errstate(invalid="ignore"):  # NumPy warns of NaN in bfloat16
        low, high = float(given.min()), float(given.max())  # NaN where one is
    if low >= darkest and high <= brightest:
        return
    if not np.isfinite(low + high):
        what, advice = "NaN or infinite values", ""
    elif high > LIGHT_LEVELS[1]:
        what, advice = f"levels from {low:g} to {high:g}", ": divide 8 bits by 255"
    elif low < darkest:
        what, advice = f"levels from {low:g} to {high:g}", ": for -1 to 1 give (x + 1) / 2"
    else:
        what, advice = f"levels from {low:g} to {high:g}", ": scale them, or cut what is above"
    kind = "linear light whose white is 1" if light else "levels in [0, 1]"
    raise ValueError(f"{who} takes {kind}, got {what}{advice}")


@functools.partial(jax.jit, static_argnums=(1, 2))
def _within(images: jax.Array, darkest: float, brightest: float) -> jax.Array:
    # NaN is not; a minimum and a maximum take four times as long, and pass over NaN of other devices
    return ((images >= darkest) & (images <= brightest)).all()


def check_drawn(who: str, chain: Chain, params: Any) -> None:
    """Raise InputError where parameters are not those that a chain has, by name."""
    told = f"{who} repeats with the parameters that its degrade returned"
    if not isinstance(params, dict):
        raise InputError(f"{told}, a dict by stage name, got {type(params).__name__}")
    own = set(chain.init())
    for what, names in (("lack", own - set(params)), ("are of another recipe, with", set(params) - own)):
        if names:
            raise InputError(f"{told}; these {what} {', '.join(sorted(map(str, names)))}")


def _edited(chain: Chain) -> Chain:
    """The chain by the name of one that was edited."""
    return dataclasses.replace(chain, name=f"{chain.name.removesuffix(EDITED)}{EDITED}")


def check_photographs(recipe: Recipe) -> None:
    """Raise InputError where a recipe does not take and give encoded sRGB, as photographs are."""
    chain = recipe.chain
    for verb, domain, fits in (
        ("takes", chain.domain_in, accepts(chain.domain_in, ENCODED)),
        ("gives", chain.domain_out, accepts(ENCODED, chain.domain_out)),
    ):
        if not fits:
            raise InputError(f"recipe {recipe.name!r} {verb} {domain.name}, not photographs ({ENCODED.name})")


def check_traces(recipe: Recipe) -> None:
    """Raise InputError where a recipe cannot run on any image, before time is spent on some.

    It is traced, stage by stage, so that the error names the one that refuses an option or the length of a
    parameter. Where it takes three channels, pictures must come out as large as they went in.
    """
    chain = recipe.chain
    shapes = {1: _SIZE, 3: (*_SIZE, 3), None: (*_SIZE, 3)}
    image = jax.ShapeDtypeStruct(shapes[chain.domain_in.channels], jnp.float32)
    key = jax.eval_shape(jax.random.key, 0)
    params = jax.eval_shape(recipe.draw, key)
    for node in chain.nodes:
        try:
            image = jax.eval_shape(functools.partial(_call, node), params, image, key)
        except (TypeError, ValueError, LookupError, ArithmeticError) as error:
            options = ", ".join(f"{name} = {value!r}" for s in node.stages() for name, value in s.static)
            where = f"{node.name} ({options})" if options else node.name
            what = one_line(error).removeprefix(f"{node.name}: ")
            raise InputError(f"recipe {recipe.name!r}: {where}: {what}") from None
    if chain.domain_in.channels != 1 and image.shape != shapes[chain.domain_out.channels]:
        raise InputError(
            f"recipe {recipe.name!r} makes {image.shape} of a picture of {_SIZE} pixels, "
            "which must keep its size"
        )


def _call(node: Node, params: dict[str, Any], image: jax.Array, key: jax.Array) -> jax.Array:
    return node(params, image, key=key)


def sample_halves(key: jax.Array, start: Any, count: int) -> tuple[jax.Array, jax.Array]:
    """Per sample, one key for its parameters and one for its noise."""
    indices = sample_indices(start, count) if jnp.ndim(start) == 0 else start
    own = sample_keys(key, indices)
    fold = jax.vmap(jax.random.fold_in, in_axes=(0, None))
    return fold(own, 0), fold(own, 1)


@functools.partial(jax.jit, static_argnums=0)
def _degrade(
    chain: Chain, prior: dict[str, Any], key: jax.Array, images: jax.Array, start: Any, extents: Any = None
) -> Degraded:
    drawing, _ = sample_halves(key, start, len(images))
    # stored, or what is drawn would be computed, and rounded, within what uses it
    like = chain.init()
    params = store(jax.vmap(lambda own: draw(own, prior, like))(drawing))
    # the images leave as a copy: what was given may be overwritten or donated
    return _repeat(chain, key, params, images, start, extents), images, params


@functools.partial(jax.jit, static_argnums=0)
def _repeat(
    chain: Chain, key: jax.Array, params: Any, images: jax.Array, start: Any, extents: Extent | None = None
) -> jax.Array:
    _, noise = sample_halves(key, start, len(images))
    return over_batch(chain, params, images, noise, extents)


def _flatten(recipe: Recipe) -> tuple[tuple[Any, ...], Any]:
    # names of equal chains may differ: recipes that are edited are of one structure with what they were
    aux = tuple(recipe.prior), recipe.chain, recipe.description, tomli_w.dumps(recipe.meta)
    return tuple(recipe.prior.values()), aux


def _unflatten(aux: Any, children: Any) -> Recipe:
    names, chain, description, meta = aux
    recipe, prior = object.__new__(Recipe), dict(zip(names, children))
    own = {"chain": chain, "description": description, "meta": parse_toml(meta, "meta")}
    # unchecked: JAX puts anything where the numbers were
    for name, value in {**own, "prior": prior, "_before": prior}.items():
        object.__setattr__(recipe, name, value)
    return recipe


jax.tree_util.register_pytree_node(Recipe, _flatten, _unflatten)
