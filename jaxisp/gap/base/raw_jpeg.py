"""From a data set on disk to pairs of one size, and the base that is put before them."""

from collections.abc import Sequence

import jax
import numpy as np

from jaxisp.camera import params_for, with_cfa
from jaxisp.errors import InputError
from jaxisp.gap.base.plain_raw import Base, raw_model
from jaxisp.gap.case import MOST_CAUSES, Case, Tick
from jaxisp.gap.objective.pixels import Problem, floor_difference, floor_errors
from jaxisp.gap.pairs.align_raw import raw_pairs
from jaxisp.gap.pairs.earlier_grid import earlier_grid
from jaxisp.gap.pairs.headers import stated_by
from jaxisp.gap.pairs.pairs import to_steps
from jaxisp.gap.pairs.scenes import Split, split_of
from jaxisp.gap.simulator.choices import with_choice, with_earlier_grid
from jaxisp.gap.simulator.effects import RAW_JPEG, Effect, candidates
from jaxisp.gap.simulator.model import (
    Model,
    build,
)
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
    pairs = raw_pairs(loaded)
    split = split_of(pairs.names) if split is None else split
    effects = candidates(RAW_JPEG, exclude)
    tick(0, MOST_CAUSES, "fitting the base")
    if camera is None:
        base = raw_model(loaded, pairs, effects, split.fit)
    else:
        base = Base(camera_model(camera, loaded, effects))
    model, absorbed = base.model, base.absorbed
    references: dict[int, float] = {}
    seen: tuple[str, ...] = ()
    place = (0, 0)
    if loaded[0].jpeg is not None:
        place = earlier_grid(to_steps(pairs.pictures)[..., 0])  # where the gap lies, tried or not
        if "double_compression" in model.effects:
            model = with_earlier_grid(model, place)
            if place == (0, 0):  # the file's own grid
                indices = model.indices(["double_compression"])
                references = dict.fromkeys(indices, float(loaded[0].jpeg.quality))
            else:
                seen = ("double_compression",)
    problem = Problem(model, pairs, base.choices, base.rival)
    problem.weigh(problem.robust_weights())
    problem.references, problem.earlier = references, place
    stated = stated_by(loaded[0].jpeg)
    if loaded[0].jpeg is None:  # was compressed once, if at all
        stated.add("double_compression")
    apart = stated | {*absorbed, *base.unsaid}
    offered = [e.name for e in effects if e.name not in apart]
    stored = floor_difference(problem, [p.jpeg for p in loaded])
    floors, given = floor_errors(problem, stored), f"camera {camera.name}" if camera else None
    grain = None if "film_grain" in exclude else stored
    return Case(
        RAW_JPEG, problem, split, floors, absorbed, offered, grain, given, seen=seen, unsaid=base.unsaid
    )
