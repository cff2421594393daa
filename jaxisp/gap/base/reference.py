"""The same camera without the effect: its base, and what that leaves, taken over to the pairs in question.

Where both sets have the same RAW files, a reference picture tells what the base does not model, pixel by
pixel: it is added to the base (`simulator.remainder`), and the gap is what has changed between the two
pictures. Elsewhere the base is taken over as it is, and its gap on the reference is the floor.
"""

import dataclasses
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from jaxisp.errors import InputError
from jaxisp.gap.base.given_chain import on_own_stage
from jaxisp.gap.base.plain_raw import Base, plain_parts, raw_model, stated_gains
from jaxisp.gap.criteria import Criteria
from jaxisp.gap.objective.pixels import PixelObjective
from jaxisp.gap.pairs.align_raw import raw_pairs
from jaxisp.gap.pairs.file_noise import file_noise
from jaxisp.gap.pairs.headers import raws_of
from jaxisp.gap.pairs.pairs import Pairs
from jaxisp.gap.pairs.scenes import split_of
from jaxisp.gap.simulator.effects import Effect
from jaxisp.gap.simulator.model import Model, build
from jaxisp.gap.simulator.remainder import FILE_NOISE, REMAINDER, Remainder, with_remainder
from jaxisp.gap.simulator.render import Kept, render
from jaxisp.io import Jpeg
from jaxisp.io.datasets import Loaded
from jaxisp.pipeline import Params
from jaxisp.stages.balance import WhiteBalance


class OnReference(NamedTuple):
    """The base of pairs, taken over from a reference.

    Attributes:
        model: the base with every effect, switched off; nothing of it is fitted to the pairs.
        gap: what the base leaves on the reference's held-out pairs; None where reference pictures are a part
            of the base.
        same: (N, H, W, 3) the reference's pictures of the same RAW files; None where there are none.
        unidentifiable: effects that the reference cannot show.
    """

    model: Model
    gap: float | None
    same: np.ndarray | None
    unidentifiable: tuple[str, ...]


def on_reference(
    loaded: Sequence[Loaded],
    pairs: Pairs,
    reference: Sequence[Loaded],
    same: Sequence[Loaded],
    effects: Sequence[Effect],
    criteria: Criteria,
) -> OnReference:
    """Fit the plain base to a reference, and take it over; arguments as of `taken_over`.

    Args:
        criteria: thresholds of the fit.
    """
    theirs = raw_pairs(reference)
    fitted = raw_model(reference, theirs, [], split_of(theirs.names).fit, criteria)
    return taken_over(loaded, pairs, reference, theirs, same, fitted, effects)


def taken_over(
    loaded: Sequence[Loaded],
    pairs: Pairs,
    reference: Sequence[Loaded],
    theirs: Pairs,
    same: Sequence[Loaded],
    fitted: Base,
    effects: Sequence[Effect],
) -> OnReference:
    """A base that is fitted to a reference, for other pairs of the same camera.

    Args:
        loaded, pairs: what is diagnosed, and the same cropped alike.
        reference, theirs: pairs of the same camera without the effect, and the same cropped alike.
        same: the reference's pair of each RAW file that is diagnosed, see `of_same_raws`; empty where there
            are none.
        fitted: the plain base on these.
        effects: to be tried. Those that a fitted base absorbs are among them: this one is not fitted.

    Raises:
        InputError: the two sets have different colour filter arrays.
    """
    (raws, cfa), (_, other) = raws_of(loaded), raws_of(reference)
    if cfa != other:
        raise InputError(
            f"the reference's RAW files have the colour filter array {other}, these {cfa}; give "
            "pairs of the same camera, cut at the same place of its pattern"
        )
    model = _taken_over(fitted.model, loaded, pairs, stated_gains(raws), effects)
    if not same:
        return OnReference(model, _gap(fitted.model, theirs), None, fitted.unidentifiable)
    pictures = raw_pairs(same).pictures
    model = _with_pictures(model, pairs, pictures, [p.jpeg for p in same])
    return OnReference(model, None, pictures, fitted.unidentifiable)


def _taken_over(
    fitted: Model, loaded: Sequence[Loaded], pairs: Pairs, gains: np.ndarray | None, effects: Sequence[Effect]
) -> Model:
    """The fitted base for other pairs, with what their own files state, ready for the reference's pictures.

    Effects whose stage the base has act on it; nothing else of it may move.
    """
    early, late = (np.asarray(fitted.per_pair[n].gains) for n in ("mosaic_white_balance", "later_balance"))
    if gains is None:  # the fit has estimated them, alike for all pairs
        gains = (early * late)[:1].repeat(len(loaded), 0)
    chain, params, per_pair = plain_parts(loaded, pairs, gains)
    if np.allclose(early, 1):  # balanced after demosaicking
        balance = per_pair["mosaic_white_balance"]
        neutral = WhiteBalance(gains=np.ones_like(balance.gains))
        per_pair |= {"mosaic_white_balance": neutral, "later_balance": balance}
    chain, added = with_remainder(chain, len(loaded), pairs.mask.shape[1:], of_file=True)
    stated = {"chroma_subsampling"}
    own = {name: v for name, v in fitted.shared.items() if name in params and name not in stated}
    model = build(chain, params | own, per_pair | added, [], effects)
    there = {s.name for s in chain.stages()}
    acting = {e.name: on_own_stage(e, model.shared[e.name]) for e in effects if e.name in there}
    moving = {name: acting.get(name, moves) for name, moves in model.effects.items()}
    return dataclasses.replace(model, effects={name: moves for name, moves in moving.items() if moves})


def _with_pictures(model: Model, pairs: Pairs, pictures: np.ndarray, files: Sequence[Jpeg | None]) -> Model:
    """The model that makes exactly these pictures (N, H, W, 3) while its effects are off.

    Effects act on them less what their files did to them, as far as frequencies tell.
    """
    z = np.zeros(len(model.coordinates))
    made = render(model.chain, model.params(z), model.per_pair, pairs.light, None, Kept())
    beyond = np.asarray(pictures - made, np.float32)
    noise = file_noise(beyond, pictures, files)
    per_pair: Params = {REMAINDER: Remainder(added=beyond - noise), FILE_NOISE: Remainder(added=noise)}
    return dataclasses.replace(model, per_pair=model.per_pair | per_pair, kept=Kept())


def _gap(model: Model, pairs: Pairs) -> float:
    """What the base leaves on the reference's held-out pairs."""
    split = split_of(pairs.names)
    objective, z = PixelObjective.of(pairs, split), np.zeros(len(model.coordinates))
    objective = objective.robust(objective.at(model, z))
    return float(objective.at(model, z).errors[list(split.held_out)].mean())
