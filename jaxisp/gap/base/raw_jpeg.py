"""RAW+JPEG pairs: their base, fitted or given, and what it leaves to explain."""

import dataclasses
from collections.abc import Sequence

import jax
import numpy as np

from jaxisp.camera import params_for, with_cfa
from jaxisp.errors import InputError
from jaxisp.gap.base.plain_raw import Base, raw_model
from jaxisp.gap.case import Case, Tick
from jaxisp.gap.criteria import CRITERIA
from jaxisp.gap.objective.pixels import PixelObjective
from jaxisp.gap.pairs.align_raw import raw_pairs
from jaxisp.gap.pairs.earlier_grid import earlier_grid
from jaxisp.gap.pairs.headers import stated_by
from jaxisp.gap.pairs.pairs import to_steps
from jaxisp.gap.pairs.scenes import Split, split_of
from jaxisp.gap.simulator.choices import with_choice, with_earlier_grid
from jaxisp.gap.simulator.effects import RAW_JPEG, Effect, candidates
from jaxisp.gap.simulator.model import Model, build
from jaxisp.io.datasets import Loaded
from jaxisp.pipeline import Chain
from jaxisp.recipe import Recipe


def camera_model(camera: Recipe, loaded: Sequence[Loaded], effects: Sequence[Effect]) -> Model:
    """A given camera, whose parameters are believed, with what each RAW states put in."""
    raws = [p.raw for p in loaded if p.raw is not None]
    chain = with_cfa(camera.chain, raws[0].cfa)
    if (chain.domain_in.name, chain.domain_out.name) != ("mosaic", "encoded sRGB") or not isinstance(
        chain, Chain
    ):
        raise InputError("the camera must turn a mosaic into encoded sRGB")
    own = [params_for(camera, raw) for raw in raws]
    stated = [name for name in camera.meta.get("from_file", []) if name in own[0]]
    per_pair = {name: jax.tree.map(lambda *v: np.stack(v), *(o[name] for o in own)) for name in stated}
    shared = {name: value for name, value in own[0].items() if name not in stated}
    return build(with_choice(chain), shared, per_pair, [], effects)


def raw_case(
    loaded: Sequence[Loaded],
    camera: Recipe | None,
    exclude: Sequence[str],
    tick: Tick,
    split: Split | None = None,
) -> Case:
    """RAW+JPEG pairs with the base before them: a camera, or a plain one that is fitted. Every other scene
    is fitted, unless a split says otherwise."""
    pairs, criteria, file = raw_pairs(loaded), CRITERIA[RAW_JPEG], loaded[0].jpeg
    split = split_of(pairs.names) if split is None else split
    effects = candidates(RAW_JPEG, exclude)
    tick(0, criteria.most_causes, "fitting the base")
    if camera is None:
        base = raw_model(loaded, pairs, effects, split.fit)
    else:
        base = Base(camera_model(camera, loaded, effects))
    model, absorbed = base.model, base.absorbed
    references: dict[int, float] = {}
    seen: tuple[str, ...] = ()
    place = (0, 0)
    if file is not None:
        place = earlier_grid(to_steps(pairs.pictures)[..., 0])  # where the gap lies, tried or not
        if "double_compression" in model.effects:
            model = with_earlier_grid(model, place)
            if place == (0, 0):  # the file's own grid
                references = dict.fromkeys(model.indices(["double_compression"]), float(file.quality))
            else:
                seen = ("double_compression",)
    objective, z = PixelObjective.of(pairs, split, base.choices, base.rival), np.zeros(len(model.coordinates))
    objective = objective.robust(objective.at(model, z))
    objective = dataclasses.replace(objective, references=references, earlier=place)
    at = objective.at(model, z)
    stated = stated_by(file)
    if file is None:  # was compressed once, if at all
        stated.add("double_compression")
    apart = stated | {*absorbed, *base.unidentifiable}
    stored = objective.floor_difference(at, [p.jpeg for p in loaded])
    return Case(
        kind=RAW_JPEG, criteria=criteria, pairs=pairs, evidence=objective, point=at, pixels=objective,
        absorbed=absorbed, floors=objective.floor_errors(stored),
        offered=[e.name for e in effects if e.name not in apart],
        stored=None if "film_grain" in exclude else stored,
        given=f"camera {camera.name}" if camera else None,
        seen=seen,
        unidentifiable=base.unidentifiable,
    )  # fmt: skip
