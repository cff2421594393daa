"""From a data set on disk to pairs of one size, and the base that is put before them."""

import dataclasses
from collections.abc import Mapping, Sequence
from types import MappingProxyType
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from jaxisp.camera import params_for, shaded_mosaic, with_cfa
from jaxisp.color import srgb_to_linear
from jaxisp.errors import InputError, meant
from jaxisp.gap.base.absorbed import taken_up
from jaxisp.gap.base.given_chain import check_camera, flat_nodes, on_own_stage, renamed
from jaxisp.gap.base.palette import is_colourless, typical_matrix
from jaxisp.gap.case import LEAST_UNIT, NULL_DROP, Gap
from jaxisp.gap.gauss_newton import fit
from jaxisp.gap.objective.pixels import Pairs, Problem, floor_difference, floor_errors, start_matrix
from jaxisp.gap.pairs.headers import stated_warp
from jaxisp.gap.simulator.effects import EFFECTS, RAW_JPEG, Effect
from jaxisp.gap.simulator.model import (
    HALVED,
    ROOTED,
    Choice,
    Coordinate,
    Model,
    build,
    is_file,
    plain_camera,
    plain_freedom,
    rooted,
)
from jaxisp.io import Raw
from jaxisp.io.datasets import Loaded
from jaxisp.io.jpeg import Jpeg
from jaxisp.pipeline import Chain, Node, Params, Stage, run, stage
from jaxisp.priors import is_distribution
from jaxisp.recipe import Recipe
from jaxisp.stages.balance import ColorMatrix, WhiteBalance
from jaxisp.stages.choice import DEMOSAICKERS, ChromaSubsampling, Demosaicking, demosaicking
from jaxisp.stages.optics import RectilinearWarp

SMALLEST, LARGEST = 64, 512  # px a side
TILES = " ("  # after the name of a pair that is alone
_SAMPLING = "chroma_subsampling"
_GRID = 16  # crops start at multiples of this, so that CFA and JPEG blocks keep their phase


def common_crop(loaded: Sequence[Loaded]) -> list[tuple[slice, slice]]:
    """For each pair, whose halves have one size, the middle, of a size that all have, at most 512 px a side.

    Raises:
        InputError: that is too small to be diagnosed.
    """
    sizes = [pair.picture.shape[:2] for pair in loaded]
    size = [min(LARGEST, *(s[axis] for s in sizes)) for axis in (0, 1)]
    if min(size) < SMALLEST:
        smallest = min(loaded, key=lambda pair: min(pair.picture.shape[:2])).name
        raise InputError(
            f"{smallest}: all pairs have {size[1]}x{size[0]} px in common, too few to be diagnosed; expected "
            f"{SMALLEST} or more a side"
        )
    crops = []
    for shape in sizes:
        starts = [(n - wanted) // 2 // _GRID * _GRID for n, wanted in zip(shape, size)]
        crops.append((slice(starts[0], starts[0] + size[0]), slice(starts[1], starts[1] + size[1])))
    return crops


def raw_pairs(loaded: Sequence[Loaded]) -> Pairs:
    """RAW+JPEG pairs, cropped alike; what the sensor or the file clipped does not count."""
    loaded = list({p.name: p for p in loaded}.values())
    crops = common_crop(loaded)
    light = np.stack([shaded_mosaic(p.raw)[c] for p, c in zip(loaded, crops) if p.raw is not None])
    pictures = np.stack([p.picture[c] for p, c in zip(loaded, crops)]).astype(np.float32)
    names = tuple(p.name for p in loaded)
    return in_halves(Pairs(names, jnp.asarray(light, jnp.float32), pictures, usable(pictures)))


def in_halves(pairs: Pairs) -> Pairs:
    """A pair that is alone becomes two: the even and the odd tiles of a checkerboard of 64x64."""
    if len(pairs.names) > 1:
        return pairs
    y, x = np.indices(pairs.mask.shape[1:])
    even = (y // 64 + x // 64) % 2 == 0
    names = tuple(f"{pairs.names[0]}{TILES}{which} tiles)" for which in ("even", "odd"))
    twice = np.concatenate([pairs.pictures] * 2)
    relit = pairs.relit(lambda light: jnp.concatenate([light] * 2))
    mask = np.stack([even, ~even]) & pairs.mask
    return dataclasses.replace(relit, names=names, pictures=twice, mask=mask)


def usable(pictures: np.ndarray) -> np.ndarray:
    """Where no channel is at an end of its range."""
    return np.asarray(((pictures > 1.5 / 255) & (pictures < 253.5 / 255)).all(-1))


def candidates(kind: str, exclude: Sequence[str] = ()) -> list[Effect]:
    """The effects that this kind of data can show, less those excluded."""
    for name in exclude:
        if name not in EFFECTS:
            among = meant(name, EFFECTS) or f"; there are {', '.join(EFFECTS)}"
            raise InputError(f"no effect named {name!r}{among}")
    tried = [e for e in EFFECTS.values() if kind in e.shows_in and e.name not in exclude]
    # beside a RAW, noise that is added later cannot be predicted pixel by pixel
    return [e for e in tried if not (e.random and kind == RAW_JPEG)]


def stated_by(file: Jpeg | None) -> set[str]:
    """The effects that a file's header tells all about, and that are not looked for."""
    if file is None:
        return set()
    return {"jpeg_quantization"} | ({"chroma_subsampling"} if file.subsampling != "4:4:4" else set())


class Base(NamedTuple):
    """What is put before RAW+JPEG pairs.

    Attributes:
        model: the base, with every effect in it, off.
        absorbed: what the base took up of each effect that is part of it, as a share of the error that would
            be there without.
        choices: how it may demosaick besides.
        rival: where it demosaicks square roots, the best choice that does not: halved chroma is imitated by
            them.
        unsaid: effects that are part of it and that these pairs say nothing of: it has what is usual.
    """

    model: Model
    absorbed: Mapping[str, float] = MappingProxyType({})
    choices: Sequence[Choice] = ()
    rival: Choice | None = None
    unsaid: tuple[str, ...] = ()


def raw_model(
    loaded: Sequence[Loaded], pairs: Pairs, effects: Sequence[Effect], fit_on: Sequence[int]
) -> Base:
    """The plain camera fitted to RAW+JPEG pairs, its demosaicker the best of all; see `fit_base`."""
    (raws, cfa), jpeg = _raws(loaded), loaded[0].jpeg
    sampling = jpeg.subsampling if jpeg else "4:4:4"
    gains, matrix, usual = _start(raws, pairs, cfa)
    balance = WhiteBalance(gains=np.asarray(gains, np.float32))
    per_pair = {"mosaic_white_balance": balance, "later_balance": _neutral(balance)}
    parts = [(c[0].start, c[1].start) for c in common_crop(loaded)]
    shape = (pairs.mask.shape[1], pairs.mask.shape[2])
    warps = [stated_warp(raw, start, shape) for raw, start in zip(raws, parts)]
    warped = any(w is not None for w in warps)
    if warped:
        own = [w or RectilinearWarp() for w in warps]
        per_pair["rectilinear_warp"] = jax.tree.map(lambda *v: np.stack(v), *own)
    chain, params = plain_camera(cfa, subsampling=sampling, warped=warped)

    def fitted(matrix: np.ndarray, free: Sequence[Coordinate]) -> Base:
        start = params | {"color_matrix": ColorMatrix(matrix=np.asarray(np.clip(matrix, -4, 4), np.float32))}
        return fit_base(build(chain, start, per_pair, free, effects), pairs, fit_on)

    found = fitted(matrix, plain_freedom())
    if usual is None or _all_told(found, pairs, fit_on, [p.jpeg for p in loaded]):
        return found
    held = fitted(usual, [c for c in plain_freedom() if c.node != "color_matrix"])
    said = {name: share for name, share in held.absorbed.items() if name != "color_matrix"}
    return held._replace(absorbed=said, unsaid=("color_matrix",))


def _raws(loaded: Sequence[Loaded]) -> tuple[list[Raw], str]:
    """The RAW of each pair, and the colour filter array that all have."""
    raws = [p.raw for p in loaded if p.raw is not None]
    cfa = raws[0].cfa
    if len(raws) < len(loaded) or any(raw.cfa != cfa for raw in raws):
        raise InputError("the RAW files have different colour filter arrays; diagnose one camera at a time")
    return raws, cfa


def _all_told(base: Base, pairs: Pairs, which: Sequence[int], files: Sequence[Jpeg | None]) -> bool:
    """Whether it leaves no more of these pairs than rounding and the files' compression do."""
    problem, which = Problem(base.model, pairs), list(which)
    problem.weigh(problem.robust_weights())
    floor = floor_errors(problem, floor_difference(problem, files))[which].mean()
    left = Gap(float(problem.errors(problem.z)[which].mean()), float(floor), LEAST_UNIT[RAW_JPEG])
    return not left.exceeds(NULL_DROP[RAW_JPEG])


def fit_base(model: Model, pairs: Pairs, fit_on: Sequence[int]) -> Base:
    """The base fitted, with the demosaicker that explains the pairs best: before or after white balance, of
    linear values or of their square roots."""
    whole = Problem(model, pairs)
    part, seen = whole.take(fit_on), range(len(fit_on))
    fit(part, model.base_indices, seen, steps=6)
    part.weigh(part.robust_weights(), part.z)
    found = choices(model)
    fitted, roots = part.model, [_on_roots(choice) for choice in found]

    def error_of(choice: Choice) -> float:
        part.model = fitted.chosen(choice.take(fit_on))
        return float(part.errors(part.z).mean())

    errors, of_roots = ([error_of(choice) for choice in some] for some in (found, roots))
    linear, root = found[int(np.argmin(errors))], roots[int(np.argmin(of_roots))]
    rooted_best = min(of_roots) < ROOTED * min(errors)
    best, rival = (root, linear) if rooted_best else (linear, None)
    part.model = fitted
    part.choose(best.take(fit_on))
    fit(part, model.base_indices, seen, steps=4)
    absorbed = taken_up(part, seen, part.model.moved(part.z), model.shared)
    absorbed["demosaicking"] = 1 - min(errors) / max(errors)
    return Base(model.chosen(best).moved(part.z), absorbed, [*found, root], rival)


def choices(model: Model) -> list[Choice]:
    """Each demosaicker, before and after white balance."""
    first = model.per_pair["mosaic_white_balance"]
    orders = [(first, _neutral(first)), (_neutral(first), first)]
    return [
        Choice(
            {"demosaicking": Demosaicking(shares=shares)} | rooted(False),
            {"mosaic_white_balance": early, "later_balance": late},
        )
        for shares in np.eye(len(DEMOSAICKERS), dtype=np.float32)
        for early, late in orders
    ]


def _on_roots(choice: Choice) -> Choice:
    return dataclasses.replace(choice, shared=choice.shared | rooted(True))


def _neutral(balance: WhiteBalance) -> WhiteBalance:
    return WhiteBalance(gains=np.ones_like(balance.gains))


def camera_model(camera: Recipe, loaded: Sequence[Loaded], effects: Sequence[Effect]) -> Model:
    """A given camera, whose parameters are believed, with what each RAW states put in.

    An effect that the camera has as a stage of the same name acts on that stage, unless each RAW states its
    parameters or the effect is searched for. It is left out where it has no room to act, and demosaicking
    where the camera's own is no known algorithm.

    Raises:
        InputError: it does not turn a mosaic into encoded sRGB, or draws noise or parameters at random.
    """
    check_camera(camera)
    raws, cfa = _raws(loaded)
    own = [params_for(camera, raw) for raw in raws]
    stated = [n for n, believed in camera.prior.items() if any(o[n] is not believed for o in own)]
    searched = [e.name for e in effects if any(m.grid for m in e.moves)]
    flat = [with_cfa(node, cfa) for node in flat_nodes(camera.chain.nodes, camera)]
    drawn = [n.name for n in flat if n.stochastic or any(map(is_distribution, _leaves(own[0].get(n.name))))]
    if drawn:
        raise InputError(
            f"camera {camera.name!r}: {', '.join(drawn)} draws at random; beside a RAW, which has its noise, "
            "a diagnosis needs a camera without noise whose parameters are numbers"
        )
    nodes, names = renamed(flat, effects, [*stated, *searched])
    nodes, sampling = _sampled(nodes, loaded[0].jpeg)
    chain = with_choice(Chain(tuple(nodes), camera.name))
    shared = {names.get(n, n): value for n, value in own[0].items() if n not in stated} | sampling
    per_pair = {names.get(n, n): jax.tree.map(lambda *v: np.stack(v), *(o[n] for o in own)) for n in stated}
    there = {s.name for s in chain.stages()}
    tried = [e for e in effects if e.site != "demosaic" or e.name in there]
    model = build(chain, shared, per_pair, [], tried)
    acting = {e.name: on_own_stage(e, model.shared[e.name]) for e in tried if e.name in there}
    moving = {name: acting.get(name, moves) for name, moves in model.effects.items()}
    return dataclasses.replace(model, effects={name: moves for name, moves in moving.items() if moves})


def _leaves(params: Any) -> list[Any]:
    return jax.tree.leaves(params, is_leaf=is_distribution)


def _sampled(nodes: Sequence[Node], file: Jpeg | None) -> tuple[list[Node], Params]:
    """The nodes with chroma sampled as the file states, or as the camera's own encoder has it where no file
    states it, in place of what they do as a file; and the parameters of that."""
    kept, sampling = list(nodes), "" if file is None else file.subsampling
    while isinstance(last := kept[-1], Stage) and is_file(last):
        sampling = sampling or str(last.options.get("subsampling", ""))
        kept.pop()
    if sampling not in HALVED:
        return kept, {}
    name = f"file_{_SAMPLING}" if any(n.name == _SAMPLING for n in kept) else _SAMPLING
    horizontal, vertical = (np.float32(share) for share in HALVED[sampling])
    halved = ChromaSubsampling(horizontal=horizontal, vertical=vertical)
    return [*kept, stage(_SAMPLING, name=name)], {name: halved}


def with_earlier_grid(model: Model, place: tuple[int, int]) -> Model:
    """The model whose earlier compression, if it is tried, began at this row and column."""
    name = "double_compression"
    row, column = (np.float32(v) for v in place)
    moved = dataclasses.replace(model.shared[name], row=row, column=column)
    return dataclasses.replace(model, shared=model.shared | {name: moved})


def with_choice(chain: Chain) -> Chain:
    """The chain with its demosaicking stage as a choice of all, so that another can be tried."""
    algorithms = {fn.__name__: name for name, fn in DEMOSAICKERS.items()}
    nodes = []
    for node in chain.nodes:
        if isinstance(node, Stage) and node.fn.__name__ in algorithms and set(dict(node.static)) <= {"cfa"}:
            node = stage("demosaicking", cfa=node.options["cfa"], algorithm=algorithms[node.fn.__name__])
        nodes.append(node)
    return Chain(tuple(nodes), chain.name)


def _start(raws: Sequence[Raw], pairs: Pairs, cfa: str) -> tuple[np.ndarray, np.ndarray, np.ndarray | None]:
    """Where the fit of a base begins: (N, 3) gains, and a (3, 3) colour matrix by least squares. Of scenes
    without colours a usual matrix too: what is fitted to the noise in their greys imitates whatever took of
    that, compression first."""
    gains = np.stack([np.ones(3) if raw.white_balanced else raw.white_balance for raw in raws])
    silent = np.allclose(gains, 1) and not raws[0].white_balanced
    light, linear = _balanced(pairs, cfa, gains), srgb_to_linear(pairs.pictures)
    grey = is_colourless(light, pairs.mask)

    def shade(pixels: np.ndarray) -> np.ndarray:
        return np.asarray(pixels[pairs.mask].mean(0))

    if silent:
        if grey:
            white = shade(light) / shade(linear)
        else:  # the matrix's own
            white = np.linalg.solve(start_matrix(light, pairs.pictures, pairs.mask), np.ones(3))
        gains = np.clip(white[1] / white, 0.125, 8)[None].repeat(len(raws), 0)
        light = _balanced(pairs, cfa, gains)
    matrix = start_matrix(light, pairs.pictures, pairs.mask)
    if not grey:
        return gains, matrix, None
    return gains, matrix, typical_matrix(shade(linear) / (typical_matrix(np.ones(3)) @ shade(light)))


def _balanced(pairs: Pairs, cfa: str, gains: np.ndarray) -> np.ndarray:
    """(N, H, W, 3) the mosaics, white balanced by (N, 3) gains and demosaicked."""
    rgb = []
    balanced, flat = (
        stage("mosaic_white_balance", cfa=cfa),
        stage(demosaicking, cfa=cfa, algorithm="bilinear"),
    )
    for mosaic, gain in zip(pairs.light, gains):
        own = run(balanced, {balanced.name: WhiteBalance(gains=np.asarray(gain, np.float32))}, mosaic)
        rgb.append(np.asarray(run(flat, flat.init(), own)))
    return np.stack(rgb)
