"""Fit a camera's tone, colour, denoising and sharpening to RAW+JPEG pairs.

The RAW is white-balanced and demosaicked; what follows is rendered on tiles, with the shift and scale
between the two pictures among the parameters, and fitted by Gauss-Newton steps on a robust distance.
Half the picture, in a checkerboard of tiles, is fitted; every held-out figure comes from the other half.
"""

import dataclasses
import time
from collections.abc import Callable, Sequence
from concurrent.futures import Future
from pathlib import Path
from typing import Any

import jax
import numpy as np
from jax.sharding import Mesh

from jaxisp.checks import several
from jaxisp.errors import InputError, meant
from jaxisp.fit import model
from jaxisp.fit.curvature import Identified, standard_errors
from jaxisp.fit.evaluate import evaluate
from jaxisp.fit.journal import Journal, alone, fingerprint
from jaxisp.fit.lens import Lens
from jaxisp.fit.pair import FROM_FILE, Example
from jaxisp.fit.raw_noise import RawNoise
from jaxisp.fit.result import FitResult, PairResult
from jaxisp.fit.scenes import held_out
from jaxisp.fit.search import Options, Outcome, Search, Tick
from jaxisp.fit.seen import Seen, block_means
from jaxisp.fit.sharing import FIXED, IMAGE, Layout, canonical, mean_of, sharing
from jaxisp.fit.spread import agree, ahead, compile_for
from jaxisp.fit.tiles import HOW, TILES, Shot, prepare, with_source
from jaxisp.params import specs
from jaxisp.pipeline import Params, Stage
from jaxisp.recipe import Recipe
from jaxisp.recipes import RecipeLike, find_recipe

STEPS = 30
HOLD_OUT = ("tiles", "scenes")
_MOST_TILES = 32  # of one pair
_MOST_CHUNKS = 24  # of all pairs together; each pair has at least one

Given = Example | Callable[[], Example]


def fit_examples(
    examples: Sequence[Given],
    *,
    steps: int = STEPS,
    demosaic: str = "auto",
    median: str = "auto",
    place: str = "camera",
    start: RecipeLike | None = None,
    insert: str | Stage | Sequence[str | Stage] = (),
    per_image: str | Sequence[str] = (),
    freeze: str | Sequence[str] = (),
    free: str | Sequence[str] = (),
    starts: int = 1,
    hold_out: str = HOLD_OUT[0],
    journal: str | Path | None = None,
    mesh: Mesh | None = None,
    tick: Tick = lambda done, total, text: None,
) -> FitResult:
    """Fit one camera to RAW+JPEG pairs.

    Args:
        examples: the pairs, all of one camera; or functions that load them, called when they are needed,
            so that many large pairs need not be in memory at once.
        steps: most Gauss-Newton steps of each phase.
        demosaic: a demosaicking stage, or "demosaic_ahd_libraw"; "auto" tries all, and mixes
            of two where none is near enough.
        median: footprint of the median filter ("cross", "3x3", "5x5"), "none", or "auto".
        place: where denoising is: "camera" RGB or "encoded" RGB.
        start: a camera that an earlier fit wrote, or its file: the fit goes on from its parameters, with the
            stages that were inserted and, where these are "auto", from its choices.
        insert: stages to fit beside the others: `STAGE` or a stage, after the tone curve, or `STAGE@NAME`,
            elsewhere.
            They take encoded pictures and act on each pixel for itself; see `model.insertion`.
        per_image: parameters that each image has of its own: stages, `stage.field`s, "tone", "colour".
            The camera gets their mean.
        freeze: parameters that stay where they start, named likewise, beside those of `FIXED_NAMES`.
        free: those of `FIXED_NAMES` that are fitted all the same.
        starts: of these many settings to start from the best is taken after a few steps; see `model.starts`.
        hold_out: "tiles" reports those that were not fitted; "scenes" also fits the camera again without
            each pair in turn, or without each half of the only one, and reports that; see `scenes`.
        journal: a file for what is done, from which a stopped fit goes on. It stays, so that a result that
            cannot be saved is not lost: the caller deletes it then. One process at a time; of several that
            fit together all read it and the first writes it.
        mesh: devices of one kind, along one axis, that the tiles are spread over; also those of other
            processes (`jax.distributed`), which must call this with the same pairs. All get the result.
        tick: called with (done, total, text).

    Returns:
        the camera, with the figures of each pair; pairs that cannot be fitted are in `failed`, and those
        that no global camera can have made have `flags`.

    Raises:
        InputError: no pair can be fitted, there is no such choice or parameter, another process has the
            journal, or processes that fit together see different pairs.
    """
    names = several(per_image), several(freeze), several(free)
    camera = None if start is None else find_recipe(start)
    inserted = tuple(model.insertion(own) for own in several(insert))
    given = [node.name for node, _ in inserted]
    if len(set(given)) < len(given):
        raise InputError(f"insert: one stage twice: {', '.join(given)}")
    if camera is not None:
        inserted += tuple(own for own in model.inserted_in(camera) if own[0].name not in given)
    text = "" if camera is None else camera.to_toml()
    options = Options(steps, demosaic, median, place, *names, starts, inserted, text)
    _check(options)
    if hold_out not in HOLD_OUT:
        raise InputError(f"{hold_out!r} cannot be held out; there are {', '.join(HOLD_OUT)}")
    with alone(journal if jax.process_index() == 0 else None):
        return _fitted(examples, options, journal, tick, mesh, hold_out == "scenes")


def _fitted(
    examples: Sequence[Given],
    options: Options,
    journal: str | Path | None,
    tick: Tick,
    mesh: Mesh | None,
    scenes: bool,
) -> FitResult:
    clock = time.perf_counter()
    shots, failed, begun = _prepared(examples, options, tick, mesh)
    same = fingerprint(options, *_contents([s for _, s in shots]))
    book = Journal.open(journal, same, writes=jax.process_index() == 0)
    search = Search([s for _, s in shots], options, book, tick, mesh)
    for compiled in begun:
        compiled.result()
    agree(fingerprint(same, book.entries))
    outcome = search.run()
    pairs = _measured(outcome, shots)
    bad = [i for i, pair in enumerate(pairs) if pair.flags]
    if len(bad) == len(pairs):
        raise InputError("; ".join(f"{p.name}: {', '.join(p.flags)}" for p in pairs))
    if bad:  # what no camera made must not pull on the camera
        failed += [(pairs[i].name, f"{pairs[i].name}: left out: {', '.join(pairs[i].flags)}") for i in bad]
        shots = [s for i, s in enumerate(shots) if i not in bad]
        search = Search([s for _, s in shots], options, Journal.open(None, ""), tick, mesh)
        outcome = search.finish(outcome.design, _without(outcome, bad), "without flagged pairs")
        pairs = _measured(outcome, shots)
    kept = [s for _, s in shots]
    found = held_out(outcome, search, kept, lambda i: _loaded(shots[i][0])) if scenes else None
    result = _result(outcome, kept, pairs, failed, book.resumed)
    return dataclasses.replace(result, scenes=found, seconds=time.perf_counter() - clock)


def _loaded(given: Given) -> Example:
    return given() if callable(given) else given


def _check(options: Options) -> None:
    known = {
        "demosaicker": (options.demosaic, ["auto", *model.demosaickers()]),
        "median": (options.median, ["auto", "none", *(m for m in model.MEDIANS if m)]),
        "place of denoising": (options.place, list(model.PLACES)),
    }
    for what, (given, names) in known.items():
        if given not in names:
            hint = meant(str(given), names) or f"; there are {', '.join(names)}"
            raise InputError(f"{given!r} is no {what}{hint}")
    _ = options.given  # refuses what is no camera
    sharing(model.start(options.inserted), options.per_image, options.fixed, options.free)
    if not 1 <= options.starts <= len(model.starts()):
        raise InputError(f"{options.starts} starts: there are 1 to {len(model.starts())}")


def _ahead(options: Options, shot: Shot, mesh: Mesh | None) -> list["Future[Any]"]:
    """Begin to compile what the fit of a pair like this one needs, while others are still aligned."""
    return [
        ahead(lambda: compile_for(options.problem(shot.jpeg), mesh)),
        ahead(lambda: with_source(shot.chunks[0], shot.cfa, options.first)),
        ahead(lambda: [with_source(shot.chunks[0], shot.cfa, d, once=True) for d in options.others]),
    ]


def _prepared(
    examples: Sequence[Given], options: Options, tick: Tick, mesh: Mesh | None
) -> tuple[list[tuple[Given, Shot]], list[tuple[str, str]], list["Future[Any]"]]:
    """The pairs that can be fitted, why others cannot, and what is being compiled."""
    begun: list[Future[Any]] = []
    shots, failed = [], []
    most = min(_MOST_TILES, TILES * max(1, _MOST_CHUNKS // max(len(examples), 1)))
    for index, example in enumerate(examples):
        tick(0, 1, f"aligning {index + 1} of {len(examples)}")
        name = getattr(example, "name", f"pair {index + 1}")
        try:
            loaded = _loaded(example)
            name = loaded.name
            shots.append((example, prepare(loaded, most)))
            begun = begun or _ahead(options, shots[0][1], mesh)
        except InputError as error:
            failed.append((name, str(error)))
    if not shots:
        raise InputError("; ".join(reason for _, reason in failed) or "no RAW+JPEG pair to fit")
    return shots, failed, begun


def _contents(shots: Sequence[Shot]) -> list[Any]:
    """What tells one fit from another: names and pixels."""
    return [part for s in shots for part in (s.name, *(a for c in s.chunks for a in (c.source, c.target)))]


def _measured(outcome: Outcome, shots: Sequence[tuple[Given, Shot]]) -> list[PairResult]:
    pairs = []
    for i, (example, shot) in enumerate(shots):
        pairs.append(evaluate(outcome.fit, outcome.state, i, shot, _loaded(example)))
    return pairs


def _params(outcome: Outcome, pair: int) -> Params:
    """The bounded parameters of one image."""
    layout, state = outcome.fit.problem.layout, outcome.state
    return layout.bounded(outcome.fit.fixed, state.camera, state.images[pair])


def _without(outcome: Outcome, bad: Sequence[int]) -> Any:
    state = outcome.state

    def kept(values: tuple[np.ndarray, ...]) -> tuple[np.ndarray, ...]:
        return tuple(v for i, v in enumerate(values) if i not in bad)

    return type(state)(state.camera, kept(state.images), kept(state.places))


def _result(
    outcome: Outcome,
    shots: Sequence[Shot],
    pairs: list[PairResult],
    failed: list[tuple[str, str]],
    resumed: bool,
) -> FitResult:
    each = [canonical(_params(outcome, i)) for i in range(len(shots))]
    params = each[0] if len(each) == 1 or not outcome.fit.problem.layout.size(IMAGE) else mean_of(each)
    plain = outcome.fit.without_encoder()  # what it rounds is the noise that parameters are told in
    identified = standard_errors(plain, outcome.state, plain.equations(outcome.state))
    unused = set(params) - set(model.fitted(outcome.design).init())
    identified = [_restated(p, params) for p in identified if p.name.split(".")[0] not in unused]
    own = {
        shot.name: {
            s: {f: np.asarray(getattr(values[s], f)).tolist() for f in specs(type(values[s]))}
            for s in dict.fromkeys(stage for stage, _ in outcome.fit.problem.layout.names[IMAGE])
        }
        for shot, values in zip(shots, each)
    }
    unknown = [p.name for p in identified if not p.known]
    camera = _camera(params, outcome, shots, unknown)
    return FitResult(
        camera,
        pairs,
        np.asarray([value for _, value in outcome.losses]),
        tuple(name for name, _ in outcome.losses),
        float("nan"),
        HOW,
        failed,
        outcome.design.text,
        outcome.tried,
        identified,
        _at_bound(camera, outcome.fit.problem.layout),
        own if outcome.fit.problem.layout.size(IMAGE) else {},
        resumed,
        Lens.of(params).in_the_corner(float(shots[0].chunks[0].corner)) if outcome.design.lens else {},
    )


def _restated(found: Identified, params: Params) -> Identified:
    """With the value as the camera's file has it; see `canonical`."""
    path, _, index = found.name.partition("[")
    stage, field = path.split(".")
    value = np.asarray(getattr(params[stage], field))
    at = tuple(map(int, index[:-1].split(", "))) if index else ()
    return dataclasses.replace(found, value=float(value[at]))


def _camera(params: Params, outcome: Outcome, shots: Sequence[Shot], unknown: list[str]) -> Recipe:
    jpeg = None if outcome.design.sampling else shots[0].jpeg
    whole, tables = model.with_jpeg(model.camera(shots[0].cfa, outcome.design), jpeg)
    own = {name: values for name, values in params.items() if name in whole.init()}
    meta = {
        **FROM_FILE,
        "fitted_to": [s.name for s in shots],
        "held_out": HOW,
        "design": outcome.design.text,
        "not_identified": unknown,
        "inserted": [node.name for node, _ in outcome.design.inserted],
        "seen": _seen(shots).as_dict(),
    }
    noise = [s.sensor_noise for s in shots if s.sensor_noise is not None]
    if noise:
        meta["raw_noise"] = {name: [getattr(n, name) for n in noise] for name in RawNoise._fields}
    prior = whole.init() | model.shares(outcome.design) | own | tables
    return Recipe(whole, prior, "fitted to RAW+JPEG pairs", meta)


def _seen(shots: Sequence[Shot]) -> Seen:
    """Of the tiles that are fitted."""
    parts = [(chunk, shot.cfa) for shot in shots for chunk in shot.chunks]
    fitted = [np.asarray(chunk.source)[np.asarray(chunk.mask).any(axis=(1, 2))] for chunk, _ in parts]
    return Seen.of(np.concatenate([block_means(tiles, cfa) for tiles, (_, cfa) in zip(fitted, parts)]))


def _at_bound(camera: Recipe, layout: Layout) -> list[str]:
    """stage.field of what ended within 0.1 % of the range of a bound and is fitted."""
    found = []
    for stage, field, flag, _ in layout.leaves:
        if flag == FIXED or stage not in camera.prior:
            continue
        value = np.asarray(getattr(camera.prior[stage], field))
        low, high = specs(type(camera.prior[stage]))[field].bounds
        near = 1e-3 * (high - low)
        if ((value - low < near) | (high - value < near)).any():
            found.append(f"{stage}.{field}")
    return found
