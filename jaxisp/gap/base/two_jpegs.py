"""Two JPEGs of a scene, before and after a change: the first is the simulator's input.

Nothing is fitted before effects are tried, so that tone and colour can be named too.
"""

import dataclasses
from collections.abc import Sequence
from typing import Any

import jax.numpy as jnp
import numpy as np

from jaxisp.color import linear_to_srgb
from jaxisp.gap.case import Case, Tick
from jaxisp.gap.criteria import CRITERIA, Criteria
from jaxisp.gap.objective.pixels import PixelObjective
from jaxisp.gap.pairs.align_clean import linear_scenes
from jaxisp.gap.pairs.crops import in_halves, usable
from jaxisp.gap.pairs.earlier_grid import earlier_grid
from jaxisp.gap.pairs.headers import stated_by
from jaxisp.gap.pairs.pairs import Pairs, to_steps
from jaxisp.gap.pairs.scenes import split_of
from jaxisp.gap.pairs.stored_twice import stored_twice
from jaxisp.gap.simulator.choices import encoder_of, with_earlier_grid
from jaxisp.gap.simulator.effects import JPEG_JPEG, RAW_JPEG, Effect, candidates
from jaxisp.gap.simulator.model import Model, build
from jaxisp.io import Jpeg
from jaxisp.io.datasets import Loaded
from jaxisp.pipeline import Chain, Params, Stage, stage
from jaxisp.stages.choice import HALVED, ChromaSubsampling

_OF_MOSAIC = ("mosaic", "demosaic")
"""Sites that a picture no longer has."""
_SAMPLING = "file_chroma"


def jpeg_case(
    loaded: Sequence[Loaded], exclude: Sequence[str], tick: Tick, *, criteria: Criteria = CRITERIA[JPEG_JPEG]
) -> Case:
    """Build the case of JPEG+JPEG pairs: what takes the first picture to the second.

    Args:
        loaded: the pairs, aligned; the first picture as the clean one.
        exclude: names of effects that are not tried.
        tick: progress callback, called with (done, total, text).
        criteria: thresholds of the verdict.
    """
    tick(0, criteria.most_causes, "reading the pictures")
    loaded = list({p.name: p for p in loaded}.values())
    pairs, firsts = _pairs(loaded)
    effects = [e for e in candidates(RAW_JPEG, exclude) if e.site not in _OF_MOSAIC]
    files = [[p.clean_file for p in loaded], [p.jpeg for p in loaded]]
    files = [own * (len(pairs.names) // len(loaded)) for own in files]  # of one pair that is two halves
    first, second = files[0][0], files[1][0]
    model, z = picture_model(effects, first, second), None
    references: dict[int, float] = {}
    seen: tuple[str, ...] = ()
    place = (0, 0)
    if second is not None:
        place = earlier_grid(to_steps(pairs.pictures)[..., 0])
        if "double_compression" in model.effects:
            model = with_earlier_grid(model, place)
            if place == (0, 0):
                references = dict.fromkeys(model.indices(["double_compression"]), float(second.quality))
            else:
                seen = ("double_compression",)
    objective = PixelObjective.of(pairs, split_of(pairs.names))
    objective = dataclasses.replace(objective, references=references, earlier=place)
    z = np.zeros(len(model.coordinates))
    at = objective.at(model, z)
    stored = stored_twice(firsts, pairs.pictures, files)
    stated = stated_by(second)
    return Case(
        kind=JPEG_JPEG, criteria=criteria, pairs=pairs, evidence=objective, point=at, pixels=objective,
        floors=objective.mean_squares(stored * objective.weight), absorbed={},
        offered=[name for name in model.effects if name not in stated],
        stored=None if "film_grain" in exclude else stored,
        given="the first picture of each pair", seen=seen, encoder=encoder_of(second),
        about={"headers": _headers(first, second)},
    )  # fmt: skip


def picture_model(effects: Sequence[Effect], first: Jpeg | None, second: Jpeg | None) -> Model:
    """Linear light of the first picture to the second's encoding, with every effect, switched off.

    Chroma is sampled as the second's header states it, unless the first's is alike.
    """
    nodes: list[Stage] = [stage("srgb_oetf", name="picture_encoded")]
    params: Params = {}
    sampling = "" if second is None else second.subsampling
    if sampling in HALVED and (first is None or first.subsampling != sampling):
        nodes.append(stage("chroma_subsampling", name=_SAMPLING))
        horizontal, vertical = (np.float32(share) for share in HALVED[sampling])
        params[_SAMPLING] = ChromaSubsampling(horizontal=horizontal, vertical=vertical)
    return build(Chain(tuple(nodes), "first picture"), params, {}, [], effects)


def _pairs(loaded: Sequence[Loaded]) -> tuple[Pairs, np.ndarray]:
    """The pairs, whose light is that of the first pictures; and these (N, H, W, 3), encoded."""
    light = linear_scenes(loaded)
    firsts = np.clip(linear_to_srgb(light), 0, 1).astype(np.float32)
    pictures = np.stack([p.picture for p in loaded]).astype(np.float32)
    names = tuple(p.name for p in loaded)
    mask = usable(pictures) & usable(firsts)
    pairs = in_halves(Pairs(names, jnp.asarray(light, jnp.float32), pictures, mask))
    return pairs, np.concatenate([firsts] * (len(pairs.names) // len(names)))


def _headers(first: Jpeg | None, second: Jpeg | None) -> dict[str, Any]:
    """What the two headers state, of the first and of the second file."""
    files = (first, second)
    return {
        "quality": [None if f is None else float(f.quality) for f in files],
        "subsampling": [None if f is None else f.subsampling for f in files],
    }
