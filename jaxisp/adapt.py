"""A recipe narrowed to a camera, from nothing but noisy pictures of it.

Parameters are drawn from the recipe and applied to clean crops. Statistics of these crops predict what the
cameras did (their noise, their sharpness, their parameters); the draws whose predictions are nearest to those
of the camera's own crops are kept, and each prior is narrowed to them. Then again, from the narrowed priors.
What the statistics do not tell stays as it was.

Source: approximate Bayesian computation with predictions as statistics (Fearnhead & Prangle 2012) and with
regression adjustment (Beaumont, Zhang & Balding 2002).
"""

import dataclasses
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from scipy.spatial.distance import cdist
from scipy.special import ndtr, ndtri

from jaxisp.checks import check_seed, check_whole
from jaxisp.data.clean import CleanImages, load_clean
from jaxisp.data.procedural import DRAWN, drawn_images
from jaxisp.errors import InputError
from jaxisp.io.files import find_images
from jaxisp.io.images import read_with_header
from jaxisp.mixture import check_runs
from jaxisp.models.cells import CELL, LEAST, cell_statistics, told_levels
from jaxisp.models.levels import measured_map
from jaxisp.node import Around, Node
from jaxisp.params import specs
from jaxisp.phase import CfaPhase
from jaxisp.pipeline import Gate, Row
from jaxisp.priors import Bernoulli, Choice, Distribution, LogUniform, Normal, PowerUniform, Uniform
from jaxisp.recipe import Recipe
from jaxisp.recipes import RecipeLike, find_recipe
from jaxisp.shown import brief
from jaxisp.stages.choice import HALVED
from jaxisp.train.target import without_noise

__all__ = ["EFFECTS", "Adaptation", "Narrowed", "adapt"]

SIDE = 128
"""Of the crops that are compared [px]."""
BATCH = 32
KEPT = 0.02
"""Share of the draws that is kept for each crop of the camera."""
FEWEST = 16
"""Draws that are kept at least."""
WITHIN = 0.95
"""Share of what was kept that a narrowed range holds."""
EFFECTS = (
    "noise of luma [1/255]", "noise of chroma [1/255]",
    "sharpness at 0.19 cycles/px", "sharpness at 0.31 cycles/px", "sharpness at 0.44 cycles/px",
)  # fmt: skip
"""What is predicted beside parameters: the mean standard deviation of the noise, and how much of the detail
of the clean crops the camera passes."""
ADAPTED = "narrowed to noisy pictures of one camera"
TOLD = 0.05
"""Share of its variance that must be told of a parameter whose prior is narrowed: what is kept of another is
a few draws by chance."""
ROUNDS = 2
"""Each draws from what the one before left."""
STRANGE = 0.99
"""A crop that is farther from its nearest draws than this share of the draws are from theirs is strange."""


@dataclasses.dataclass(frozen=True)
class Narrowed:
    """A parameter's prior before and after.

    Args:
        name: "stage.parameter".
        before: the recipe's distribution.
        after: the narrowed one.
        told: share of the parameter's variance that the statistics predict, 0 to 1; of a vector, the mean of
            its elements. 1 of what the files' headers state.
    """

    name: str
    before: Distribution
    after: Distribution
    told: float


@dataclasses.dataclass(frozen=True, repr=False)
class Adaptation:
    """What `adapt` found.

    Args:
        recipe: the narrowed recipe.
        priors: each parameter's, in the order of the recipe.
        crops: of the camera that were compared.
        effects: what the camera does, by the names of `EFFECTS`: mean of what its crops tell.
        strange: share of them that no draw of the recipe resembles. Above some .2 the recipe lacks an effect
            of this camera: `jaxisp diagnose` says which.
        skipped: (file, reason) of pictures that could not be used.
    """

    __repr__ = brief

    recipe: Recipe
    priors: tuple[Narrowed, ...]
    crops: int
    effects: dict[str, float]
    strange: float
    skipped: tuple[tuple[str, str], ...]


def adapt(
    noisy: str | Path | Sequence[str | Path],
    recipe: RecipeLike = "any-camera",
    *,
    clean: str | Path | Sequence[str | Path] | None = None,
    downsample: int = 3,
    draws: int = 2048,
    per_image: int = 8,
    seed: int = 0,
    tick: Callable[[int, int, str], Any] = lambda done, total, text: None,
) -> Adaptation:
    """Narrow a recipe to the camera of noisy pictures.

    Args:
        noisy: pictures of one camera at one setting, and folders of them; of 128 px and more.
        recipe: what its parameters are drawn from at first.
        clean: folders of clean pictures; the noisy ones made smaller and drawn ones unless given.
        downsample: the factor by which clean pictures are made smaller.
        draws: of the recipe's parameters, each on a crop of its own.
        per_image: crops of a noisy picture that are compared.
        seed: of draws and crops.
        tick: called with (done, total, text).

    Raises:
        InputError: no picture can be used, too few draws, or the recipe draws nothing, is not for
            photographs, or cannot run on any.
    """
    check_whole("draws", draws, 4 * FEWEST)
    check_whole("per_image", per_image, 1)
    check_seed(seed)
    recipe = find_recipe(recipe)
    check_runs(recipe)
    laws = dict(_laws(recipe))
    if not laws:
        raise InputError(f"recipe {recipe.name!r} draws no parameter: there is nothing to narrow")
    starts = recipe.chain.init()
    sizes = [np.size(getattr(starts[stage], field)) for stage, field in laws]
    ends = np.cumsum(sizes)[:-1]
    columns = [law for law, size in zip(laws.values(), sizes) for _ in range(size)]
    rng = np.random.default_rng(seed)
    options: dict[str, Any] = {
        "patch": SIDE, "downsample": downsample, "per_image": per_image, "seed": seed,
    }  # fmt: skip
    given = None if clean is None else load_clean(clean, **options)
    crops, headers, skipped = _noisy_crops(noisy, per_image, rng)
    pictures = given or _smaller(noisy, **options).joined(drawn_images(DRAWN, seed))
    seen = _summaries(crops)
    stated = _stated(recipe, laws, headers)
    begun = recipe.override(stated)
    found, now = [], begun
    for i in range(ROUNDS):
        start, end = (draws * n // ROUNDS for n in (i, i + 1))
        made = [
            _drawn(now, laws, pictures.images, seed, range(n, min(n + BATCH, end)), rng, draws, tick)
            for n in range(start, end, BATCH)
        ]
        statistics, effects, drawn = (np.concatenate(part) for part in zip(*made))
        found.append(_nearest(statistics, effects, drawn, seen, columns))
        changed: dict[str, dict[str, Any]] = {}
        # how much is told of a parameter, and what is like no draw, by the draws from all of the recipe
        told, strange = [float(own.mean()) for own in np.split(found[0].told, ends)], found[0].strange
        for (stage, field), share, values in zip(laws, told, np.split(found[-1].kept, ends, axis=1)):
            if share >= TOLD and field not in stated.get(stage, ()):
                changed.setdefault(stage, {})[field] = _narrowed(laws[stage, field], values)
        now = begun.override(changed)
    about = {"crops": len(crops), "draws": draws, "strange": round(strange, 3)}
    narrowed = dataclasses.replace(
        now,
        chain=dataclasses.replace(now.chain, name=f"{recipe.name}-adapted"),
        description=f"{recipe.description}; {ADAPTED}".removeprefix("; "),
        meta={**recipe.meta, "adapted": about},
    )
    priors = tuple(
        Narrowed(
            f"{stage}.{field}", law, getattr(now.prior[stage], field),
            1.0 if field in stated.get(stage, ()) else round(share, 3),
        )
        for ((stage, field), law), share in zip(laws.items(), told)
    )  # fmt: skip
    known = {path for path, _ in skipped}
    skipped += [one for one in pictures.skipped if one[0] not in known]
    return Adaptation(narrowed, priors, len(crops), _in_units(found[-1].effects), strange, tuple(skipped))


class _Header(NamedTuple):
    """What a JPEG's header states: the libjpeg quality nearest to its tables, and its chroma sampling."""

    quality: float
    sampling: str


def _laws(recipe: Recipe) -> Iterator[tuple[tuple[str, str], Distribution]]:
    """What is drawn, by stage and parameter; where a mosaic begins is no property of a camera's crops."""
    for stage, prior in recipe.prior.items():
        for field in specs(type(prior)):
            law = getattr(prior, field)
            if isinstance(law, Distribution) and not isinstance(prior, CfaPhase):
                yield (stage, field), law


def _stated(
    recipe: Recipe, laws: Mapping[tuple[str, str], Distribution], headers: Sequence[_Header | None]
) -> dict[str, dict[str, Distribution]]:
    """What headers of JPEGs tell of the recipe's last compression: that there is one, its quality, and how
    chroma is sampled, where a stage of its own does that."""
    known = [header for header in headers if header is not None]
    last = [s for s in recipe.chain.stages() if s.fn.__name__ == "jpeg"][-1:]
    if len(known) < len(headers) or not last or (last[0].name, "quality") not in laws:
        return {}
    quality = [header.quality for header in known]
    found: dict[str, dict[str, Distribution]] = {
        last[0].name: {"quality": Uniform(min(quality), max(quality))},
        **{switch: {"on": Bernoulli(1.0)} for switch in _switches(recipe.chain, last[0].name)},
    }
    sampling = [HALVED.get(header.sampling, (0.0, 0.0)) for header in known]
    chroma = [s for s in recipe.chain.stages() if s.fn.__name__ == "chroma_subsampling"][-1:]
    whole = last[0].options.get("subsampling") == "4:4:4"
    if whole and chroma and {header.sampling for header in known} <= {*HALVED, "4:4:4"}:
        halved = [own for own in sampling if any(own)]
        for switch in [*_switches(recipe.chain, chroma[0].name)][-1:]:
            found[switch] = {"on": Bernoulli(len(halved) / len(known))}
            sampling = halved or sampling
        shares = np.mean(sampling, 0).tolist()
        found[chroma[0].name] = dict(zip(("horizontal", "vertical"), map(Bernoulli, shares)))
    return {
        stage: own
        for stage, fields in found.items()
        if (own := {field: law for field, law in fields.items() if (stage, field) in laws})
    }


def _switches(node: Node, stage: str) -> Iterator[str]:
    """The switches around a stage, the outermost first."""
    if isinstance(node, Gate) and stage in node.names():
        yield node.name
    inner = node.nodes if isinstance(node, Row) else [node.node] if isinstance(node, Around) else []
    for own in inner:
        yield from _switches(own, stage)


def _smaller(noisy: Any, **options: Any) -> CleanImages:
    """The noisy pictures made smaller, which are known to be pictures; none where all become too small."""
    try:
        return load_clean(noisy, **options)
    except InputError:
        return CleanImages((), ())


def _noisy_crops(
    noisy: Any, per_image: int, rng: np.random.Generator
) -> tuple[np.ndarray, list[_Header | None], list[tuple[str, str]]]:
    """Crops, what the headers of their files state, and (file, reason) of what cannot be used."""
    crops: list[np.ndarray] = []
    headers: list[_Header | None] = []
    skipped: list[tuple[str, str]] = []
    for path in find_images(noisy, recursive=True):
        if path.stem.lower().endswith(".clean"):  # as a data set names it
            skipped.append((str(path), f"{path}: is the clean picture of a pair"))
            continue
        try:
            image, file = read_with_header(path)
        except InputError as error:
            skipped.append((str(path), str(error)))
            continue
        if min(image.shape[:2]) < SIDE:
            size = "x".join(map(str, image.shape[:2]))
            skipped.append((str(path), f"{path}: {size} px is smaller than a crop of {SIDE} px"))
            continue
        headers.append(None if file is None else _Header(float(file.quality), file.subsampling))
        room = np.asarray(image.shape[:2]) - SIDE
        corners = {tuple(8 * rng.integers(0, room // 8 + 1)) for _ in range(per_image)}  # on a JPEG's grid
        crops += [image[y : y + SIDE, x : x + SIDE] for y, x in sorted(corners)]
    if not crops:
        raise InputError(f"no picture can be used: {skipped[0][1]}" if skipped else "there are no pictures")
    return np.stack(crops).astype(np.float32), headers, skipped


def _crop(images: Sequence[np.ndarray], rng: np.random.Generator) -> np.ndarray:
    """A crop of clean pictures, flipped and turned at random."""
    image = images[int(rng.integers(len(images)))]
    if image.ndim == 4:  # kept as crops
        image = image[int(rng.integers(len(image)))]
    y, x = (rng.integers(0, n - SIDE + 1) for n in image.shape[:2])
    crop = np.rot90(image[y : y + SIDE, x : x + SIDE], int(rng.integers(4)))
    return (crop[:, ::-1] if rng.integers(2) else crop).astype(np.float32) / 65535


def _drawn(
    recipe: Recipe,
    laws: Any,
    pictures: Sequence[np.ndarray],
    seed: int,
    indices: range,
    rng: np.random.Generator,
    draws: int,
    tick: Callable[[int, int, str], Any],
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Statistics, effects and parameters of a batch of draws."""
    key, clean = jax.random.key(seed), np.stack([_crop(pictures, rng) for _ in indices])
    noisy, _, params = recipe.degrade(key, clean, indices.start)
    camera = without_noise(recipe).degrade(key, clean, indices.start)[0]  # of the same draw
    tick(indices.stop, draws, "drawing cameras")
    effects = np.asarray(_effects(clean, camera, noisy), np.float64)
    return _summaries(np.asarray(noisy)), effects, _values(params, laws)


@jax.jit
def _effects(clean: jax.Array, camera: jax.Array, noisy: jax.Array) -> jax.Array:
    """(N, 5) of `EFFECTS`: logarithms of noise and of sharpness in bands."""
    noise = told_levels(measured_map(noisy, camera)).mean((1, 2))
    # of luma: the mean energies in the bands of frequencies 3, 5 and 7, along rows and along columns
    after, before = (
        cell_statistics(x)[..., :14].reshape(len(x), -1, 7, 2).mean((1, 3))[:, 2::2] for x in (camera, clean)
    )
    return jnp.concatenate([noise, (after - before) / 2], -1)


def _in_units(effects: np.ndarray) -> dict[str, float]:
    told = 2 ** (4 * effects)
    values = [*(LEAST * 255 * (told[:2] - 1)), *told[2:]]
    return {name: round(float(value), 3) for name, value in zip(EFFECTS, values)}


@jax.jit
def _of_parts(images: jax.Array) -> jax.Array:
    """Mean statistics of the quarter of the cells that is flattest, and of that with most detail."""
    cells = cell_statistics(images)
    cells = cells.reshape(len(images), -1, cells.shape[-1])
    slow = cells[..., :2].sum(-1)  # of luma, in its lowest band
    order = jnp.argsort(slow, axis=1)
    quarter = (SIDE // CELL) ** 2 // 4
    ends = order[:, :quarter], order[:, -quarter:]
    parts = [jnp.take_along_axis(cells, end[..., None], 1) for end in ends]
    return jnp.concatenate([part.mean(1) for part in parts], -1)


def _summaries(images: np.ndarray) -> np.ndarray:
    batches = [images[i : i + BATCH] for i in range(0, len(images), BATCH)]
    return np.concatenate([np.asarray(_of_parts(batch), np.float64) for batch in batches])


def _scaled(law: Distribution, values: np.ndarray) -> np.ndarray:
    """Values on the scale on which they are drawn evenly."""
    if isinstance(law, LogUniform):
        return np.log(values)
    if isinstance(law, PowerUniform):
        return np.sign(values) * np.abs(values) ** (1 / law.exponent)
    return ndtr((values - law.mean) / law.std) if isinstance(law, Normal) else values


def _values(params: Any, laws: dict[tuple[str, str], Distribution]) -> np.ndarray:
    """(N, columns) of a batch: one a parameter, or one an element of a vector."""
    columns = []
    for (stage, field), law in laws.items():
        values = np.asarray(getattr(params[stage], field), np.float64)
        columns.append(_scaled(law, values).reshape(len(values), -1))
    return np.concatenate(columns, 1)


class _Nearest(NamedTuple):
    told: np.ndarray
    """Share of each column's variance that is predicted."""
    effects: np.ndarray
    """Mean of what is predicted for the camera's crops."""
    kept: np.ndarray
    """(kept, columns): those of the draws nearest to each crop."""
    strange: float
    """Share of crops that are farther from their nearest draws than draws are from theirs."""


def _nearest(
    statistics: np.ndarray,
    effects: np.ndarray,
    drawn: np.ndarray,
    seen: np.ndarray,
    laws: Sequence[Distribution],
) -> _Nearest:
    """The draws that are nearest to what was seen; `laws` are those of the columns of `drawn`."""
    mean, scale = statistics.mean(0), statistics.std(0) + 1e-6
    wanted = np.concatenate([effects, drawn], 1)
    middle, spread = wanted.mean(0), wanted.std(0) + 1e-12
    predicted, left_out, residual = _ridge(
        (statistics - mean) / scale, (wanted - middle) / spread, (seen - mean) / scale
    )
    # what did not vary is not told, however well it is predicted
    told = np.where(np.ptp(wanted, axis=0) > 0, np.clip(1 - (residual**2).mean(0), 0, 1), 0.0)
    weight = np.sqrt(told) / np.sqrt((residual**2).mean(0) + 1e-6)
    count = max(FEWEST, round(KEPT * len(drawn)))

    def nearest(points: np.ndarray, own: bool) -> tuple[np.ndarray, np.ndarray]:
        apart = cdist(points * weight, left_out * weight)
        if own:
            np.fill_diagonal(apart, np.inf)
        order = np.argsort(apart, axis=1)[:, :count]
        return order, np.take_along_axis(apart, order, 1).mean(1)

    order, far = nearest(predicted, own=False)
    usual = np.quantile(nearest(left_out, own=True)[1], STRANGE)
    # what was drawn, moved by what its crop and the camera's differ in: a draw is never just like the camera
    first = effects.shape[1]
    inside = np.clip(predicted, left_out.min(0), left_out.max(0))  # a regression holds no further
    moved = drawn[order] + ((inside[:, None] - left_out[order]) * spread)[..., first:]
    levels = [isinstance(law, Bernoulli | Choice) for law in laws]
    kept = np.where(levels, drawn[order], moved)
    return _Nearest(
        told[first:], (predicted * spread + middle)[:, :first].mean(0), kept.reshape(-1, len(laws)),
        float((far > usual).mean()),
    )  # fmt: skip


def _ridge(x: np.ndarray, y: np.ndarray, seen: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Predictions for what was seen, and for each row of x without that row; the errors of the latter.

    The penalty is that of least error so left out, for each column.
    """
    u, s, vt = np.linalg.svd(x, full_matrices=False)
    projected, coordinates = u.T @ y, seen @ vt.T
    best: list[tuple[float, np.ndarray, np.ndarray]] = [(np.inf, y, seen)] * y.shape[1]
    for penalty in len(x) * np.geomspace(1e-4, 10, 12):
        shrink = s**2 / (s**2 + penalty)
        leverage = (u**2 @ shrink)[:, None] + 1 / len(x)
        left_out = y - (y - u @ (shrink[:, None] * projected)) / (1 - leverage)
        predicted = coordinates @ ((shrink / np.maximum(s, 1e-12))[:, None] * projected)
        for i, error in enumerate(((y - left_out) ** 2).mean(0)):
            if error < best[i][0]:
                best[i] = error, left_out[:, i], predicted[:, i]
    left_out = np.stack([own[1] for own in best], 1)
    return np.stack([own[2] for own in best], 1), left_out, y - left_out


def _narrowed(law: Distribution, kept: np.ndarray) -> Distribution:
    """The distribution on the range, or of the values, that hold most of what was kept; or with its share."""
    if isinstance(law, Bernoulli):
        return Bernoulli(float(np.clip(kept.mean(), 0, 1)))
    if isinstance(law, Choice):
        shares = {value: float((kept == np.float32(value)).mean()) for value in law.values}
        likely, held = set(), 0.0
        for value in sorted(shares, key=lambda own: -shares[own]):
            likely.add(value)
            held += shares[value]
            if held >= WITHIN:
                break
        return Choice(tuple(value for value in law.values if value in likely))
    low, high = np.quantile(kept, [(1 - WITHIN) / 2, (1 + WITHIN) / 2])
    # of values that lie as they were drawn, the range that they were drawn from
    spare = (high - low) * (1 / WITHIN - 1) / 2
    first, last = _scaled(law, np.asarray(law.support))
    half = min((high - low) / 2, last - first)  # a camera beyond the range is at its end, and no point
    low, high = np.clip(low - spare, first, last - half), np.clip(high + spare, first + half, last)
    if isinstance(law, LogUniform):
        return LogUniform(float(np.exp(low)), float(np.exp(high)))
    if isinstance(law, Normal):
        low, high = np.clip(law.mean + law.std * ndtri([low, high]), law.low, law.high)
    return dataclasses.replace(law, low=float(low), high=float(high))
