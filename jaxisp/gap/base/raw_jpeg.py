"""The base of RAW+JPEG pairs, fitted or given, and the case that it leaves to explain."""

import dataclasses
from collections.abc import Sequence
from typing import Any

import jax
import numpy as np

from jaxisp.camera import params_for, with_cfa
from jaxisp.errors import InputError
from jaxisp.gap.axes.interval import interval
from jaxisp.gap.base.given_chain import check_camera, flat_nodes, on_own_stage, renamed
from jaxisp.gap.base.given_light import freedom, refitted, start, with_refit
from jaxisp.gap.base.plain_raw import Base, raw_model, stated_gains
from jaxisp.gap.base.reference import OnReference, on_reference
from jaxisp.gap.case import Case, Floor, Gap, Tick
from jaxisp.gap.criteria import CRITERIA, Criteria
from jaxisp.gap.objective.pixels import PixelObjective
from jaxisp.gap.objective.protocol import Point
from jaxisp.gap.pairs.align_raw import raw_pairs
from jaxisp.gap.pairs.crops import usable
from jaxisp.gap.pairs.earlier_grid import earlier_grid
from jaxisp.gap.pairs.headers import raws_of, stated_by
from jaxisp.gap.pairs.pairs import to_steps
from jaxisp.gap.pairs.same_raw import of_same_raws
from jaxisp.gap.pairs.scenes import Split, by_scene, split_of
from jaxisp.gap.pairs.stored_twice import stored_twice
from jaxisp.gap.simulator.choices import encoder_of, with_choice, with_earlier_grid
from jaxisp.gap.simulator.effects import RAW_JPEG, Effect, candidates
from jaxisp.gap.simulator.model import Model, build, is_file
from jaxisp.io.datasets import Loaded
from jaxisp.io.jpeg import Jpeg
from jaxisp.pipeline import Chain, Node, Params, Stage, stage
from jaxisp.priors import is_distribution
from jaxisp.recipe import Recipe
from jaxisp.stages.choice import HALVED, ChromaSubsampling

_SAMPLING = "chroma_subsampling"
_NO_COUNTERPART = "the reference has no picture of its RAW file, and of others it has"


def camera_model(camera: Recipe, loaded: Sequence[Loaded], effects: Sequence[Effect]) -> Model:
    """Build the model of a given camera, with its own parameters and those that each RAW states.

    Its base coordinates are those of a light refit, see `given_light`.

    If the camera has a stage with the name of an effect, the effect acts on that stage. Exceptions are stages
    whose parameters each RAW states, and effects that are searched on a grid. Effects without room to move
    are left out. Demosaicking is left out if the camera's algorithm is unknown.

    Raises:
        InputError: the camera does not turn a mosaic into encoded sRGB, or draws noise or parameters at
            random.
    """
    check_camera(camera)
    raws, cfa = raws_of(loaded)
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
    chain = with_choice(Chain(tuple(with_refit(nodes)), camera.name))
    shared = {names.get(n, n): value for n, value in own[0].items() if n not in stated} | sampling
    shared |= start(chain)
    per_pair = {names.get(n, n): jax.tree.map(lambda *v: np.stack(v), *(o[n] for o in own)) for n in stated}
    there = {s.name for s in chain.stages()}
    tried = [e for e in effects if e.site != "demosaic" or e.name in there]
    model = build(chain, shared, per_pair, freedom(), tried)
    acting = {e.name: on_own_stage(e, model.shared[e.name]) for e in tried if e.name in there}
    moving = {name: acting.get(name, moves) for name, moves in model.effects.items()}
    return dataclasses.replace(model, effects={name: moves for name, moves in moving.items() if moves})


def _leaves(params: Any) -> list[Any]:
    return jax.tree.leaves(params, is_leaf=is_distribution)


def _sampled(nodes: Sequence[Node], file: Jpeg | None) -> tuple[list[Node], Params]:
    """Replace the file's compression by its chroma sampling.

    The sampling is that of the file's header or, without a header, of the camera's own encoder.

    Returns:
        the nodes; the parameters of the chroma sampling.
    """
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


def raw_case(
    loaded: Sequence[Loaded],
    camera: Recipe | None,
    exclude: Sequence[str],
    tick: Tick,
    split: Split | None = None,
    criteria: Criteria = CRITERIA[RAW_JPEG],
    reference: Sequence[Loaded] = (),
) -> Case:
    """Build the case of RAW+JPEG pairs on their base.

    Args:
        loaded: the pairs.
        camera: the base; default: fit a plain camera.
        exclude: names of effects that are not tried.
        tick: progress callback, called with (done, total, text).
        split: fitted and held-out pairs; default: every other scene is fitted.
        criteria: thresholds of the verdict.
        reference: pairs of the same camera without the effect, which the base is fitted to in place of these.
    """
    kept, same = of_same_raws(loaded, reference)
    outliers = {p.name: _NO_COUNTERPART for p in loaded if kept and p.name not in {k.name for k in kept}}
    loaded = kept or loaded
    pairs, file = raw_pairs(loaded), loaded[0].jpeg
    if same:  # what the reference has clipped tells nothing either
        pairs = dataclasses.replace(pairs, mask=pairs.mask & usable(raw_pairs(same).pictures))
    split = split_of(pairs.names) if split is None else split
    effects = candidates(RAW_JPEG, exclude)
    tick(0, criteria.most_causes, "fitting the base")
    taken, about = None, {}
    if reference:
        taken = on_reference(loaded, pairs, reference, same, effects, criteria)
        base = Base(taken.model, unidentifiable=taken.unidentifiable)
    elif camera is None:
        base = raw_model(loaded, pairs, effects, split.fit, criteria)
    else:
        found = refitted(camera_model(camera, loaded, effects), pairs, split.fit)
        base, about = Base(found.model, found.absorbed, found.choices), {"moved": found.moved}
    model, absorbed = base.model, base.absorbed
    references: dict[int, float] = {}
    seen: tuple[str, ...] = ()
    place = (0, 0)
    if file is not None:
        place = earlier_grid(to_steps(pairs.pictures)[..., 0])  # also used to locate the gap
        if "double_compression" in model.effects:
            model = with_earlier_grid(model, place)
            if place == (0, 0):  # the file's own grid
                references = dict.fromkeys(model.indices(["double_compression"]), float(file.quality))
            else:
                seen = ("double_compression",)
    objective, z = PixelObjective.of(pairs, split, base.choices, base.rival), np.zeros(len(model.coordinates))
    if taken is None or taken.same is None:  # a reference's pictures leave no error at edges
        objective = objective.robust(objective.at(model, z))
    objective = dataclasses.replace(objective, references=references, earlier=place)
    at = objective.at(model, z)
    stated = stated_by(file)
    if file is None:  # compressed at most once
        stated.add("double_compression")
    apart = stated | {*absorbed, *base.unidentifiable}
    files = [p.jpeg for p in loaded]
    stored, floors, left = _floors(objective, at, (files, [p.jpeg for p in same]), taken, criteria)

    def floor_at(point: Point) -> Floor:
        units = objective.floor_units(point, objective.floor_difference(point, files))
        held = list(split.held_out)
        drawn = by_scene(units[held], [pairs.names[i] for i in held])
        return Floor(np.nanmean(units, 1), interval(drawn, 1.0))

    return Case(
        kind=RAW_JPEG, criteria=criteria, pairs=pairs, evidence=objective, point=at, pixels=objective,
        absorbed=absorbed, floors=floors, floor_ci=floor_at(at).ci if left is None else None,
        floor_at=floor_at if left is None else None,  # a reference's gap is its own
        offered=[name for name in model.effects if name not in apart],
        stored=None if "film_grain" in exclude else stored,
        given=_given(camera, bool(reference)),
        encoder=encoder_of(file),
        from_file=() if camera is None and stated_gains(raws_of(loaded)[0]) is None else (*model.per_pair,),
        about=about,
        reference_gap=left,
        seen=seen,
        unidentifiable=base.unidentifiable,
        outliers=outliers,
    )  # fmt: skip


def _floors(
    objective: PixelObjective,
    at: Point,
    files: tuple[Sequence[Jpeg | None], Sequence[Jpeg | None]],
    taken: OnReference | None,
    criteria: Criteria,
) -> tuple[np.ndarray, np.ndarray, float | None]:
    """What a right simulator would leave; of the files, and of the reference's of the same RAWs.

    Two files with one header that come from one RAW are the same where nothing has changed. So there is a gap
    though it be no larger than what two compressions leave; all of it counts then.

    Returns:
        (N, h, w, 3) what the files do to the pictures; (N,) the gap of each pair; the gap of the reference.
    """
    if taken is not None and taken.same is not None:
        stored = stored_twice(taken.same, objective.pairs.pictures, files[::-1])
        floors, held = objective.mean_squares(stored * objective.weight), list(objective.split.held_out)
        gap = Gap(float(at.errors[held].mean()), float(floors[held].mean()), criteria.least_unit)
        if all(map(_one_header, *files)) and not gap.exceeds(criteria.null_drop):
            floors = np.zeros_like(floors)
        return stored, floors, float(floors[held].mean())
    stored = objective.floor_difference(at, files[0])
    floors = objective.floor_errors(at, stored)
    if taken is None or taken.gap is None:
        return stored, floors, None
    return stored, np.maximum(floors, taken.gap), taken.gap


def _one_header(one: Jpeg | None, other: Jpeg | None) -> bool:
    """Whether two files quantise and sample alike."""
    if one is None or other is None:
        return one is other
    return one.subsampling == other.subsampling and np.array_equal(one.tables, other.tables)


def _given(camera: Recipe | None, on_reference: bool) -> str | None:
    """What the base is, in words; None of one that is fitted to the pairs."""
    if on_reference:
        return "plain camera, fitted to the reference"
    return None if camera is None else f"camera {camera.name}"
