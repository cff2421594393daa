"""Clean+noisy pairs beside a reference, the same camera without the effect: what differs from the reference.

The base is fitted to the reference and taken over with nothing free. Where both sets hold the same exposures,
developed in two ways, the reference's pictures are added to the base (`simulator.remainder`), noise and all:
effects act on them. Elsewhere what the base's statistics are off by on the reference is taken off the real
pictures'. Either way only what the reference does not show is a gap.
"""

import dataclasses
from collections.abc import Sequence
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from scipy.ndimage import gaussian_filter

from jaxisp.gap.base import cfa_phase
from jaxisp.gap.base.clean_noisy import fitted_plain, sensor_quantization
from jaxisp.gap.base.given_chain import on_own_stage
from jaxisp.gap.base.mean import MeanFit, fit_mean
from jaxisp.gap.base.plain_clean import BALANCES, Camera, read_out
from jaxisp.gap.case import Case, Tick
from jaxisp.gap.criteria import CRITERIA, Criteria
from jaxisp.gap.objective.measure import Measure
from jaxisp.gap.objective.statistics import StatisticsObjective
from jaxisp.gap.pairs.align_clean import clean_pairs
from jaxisp.gap.pairs.earlier_grid import earlier_grid
from jaxisp.gap.pairs.headers import stated_by
from jaxisp.gap.pairs.pairs import Pairs, to_steps
from jaxisp.gap.pairs.scenes import split_of
from jaxisp.gap.simulator.choices import with_earlier_grid
from jaxisp.gap.simulator.effects import CLEAN_NOISY, candidates
from jaxisp.gap.simulator.model import Model, build
from jaxisp.gap.simulator.remainder import REMAINDER, Remainder, with_remainder
from jaxisp.gap.simulator.render import Kept, render
from jaxisp.io.datasets import Loaded
from jaxisp.pipeline import Chain, Params

_SHARED = 0.6
"""Correlation of what two pictures have beside the noise-free base, above which they are of one exposure; of
two exposures only the base's own error is alike."""


class _Fitted(NamedTuple):
    """The base on the reference: its case, its mean, and (N, 2) what its pairs were moved by."""

    case: Case
    mean: MeanFit
    moved: np.ndarray


def clean_case_on_reference(
    loaded: Sequence[Loaded],
    reference: Sequence[Loaded],
    exclude: Sequence[str],
    seed: int,
    tick: Tick,
    *,
    criteria: Criteria = CRITERIA[CLEAN_NOISY],
) -> Case:
    """Build the case of clean+noisy pairs on the plain base of a reference.

    Args:
        loaded: the pairs.
        reference: pairs of the same camera without the effect. A scene that both have, with the same clean
            picture, is compared with itself, and chance that both share does not count.
        exclude: names of effects that are not tried.
        seed: of the simulated noise.
        tick: progress callback, called with (done, total, text).
        criteria: thresholds of the verdict.
    """
    own, theirs = clean_pairs(loaded), clean_pairs(reference)
    fitted = _fitted(reference, theirs, seed, tick)
    same = _same_scenes(own, theirs)
    pairs = _exposed(own, fitted, same)
    pictures = _same_noise(fitted, pairs, same)
    model = _taken_over(fitted.case.point.model, fitted.mean.camera, pairs, exclude)
    place = (0, 0)
    seen: tuple[str, ...] = ()
    if "double_compression" in model.effects:
        place = earlier_grid(to_steps(pairs.pictures)[..., 0])
        model = with_earlier_grid(model, place)
        seen = ("double_compression",) if place != (0, 0) else ()
    z = np.zeros(len(model.coordinates))

    def noise_free(light: jax.Array) -> np.ndarray:
        point = fitted.mean.point
        return to_steps(point.model.render(point.z, light))

    read = sensor_quantization(model.shared, fitted.mean.camera, pairs)
    objective = StatisticsObjective.of(model, pairs, noise_free, split_of(pairs.names), read, seed=seed)
    if pictures is None:
        measure = objective.measure.less(_offset(fitted.case, same, len(pairs.names)))
    else:  # what is simulated are real pictures too
        measure = dataclasses.replace(objective.measure, again=objective.measure.reference)
        model = _with_pictures(model, measure, pictures)
    objective = dataclasses.replace(objective, measure=measure)
    objective = objective.with_unit(objective.at(model, z))
    objective = objective.with_unit(objective.at(model, z), emphasise=True)
    file = loaded[0].jpeg
    stated = stated_by(file) | ({"double_compression"} if file is None and not seen else set())
    return Case(
        kind=CLEAN_NOISY, criteria=criteria, pairs=pairs, evidence=objective, point=objective.at(model, z),
        floors=np.ones(len(pairs.names)), absorbed={}, offered=[n for n in model.effects if n not in stated],
        statistics=objective, seen=seen, given="plain camera, fitted to the reference",
        reference=fitted.case.reference, reference_gap=fitted.case.gap().before,
    )  # fmt: skip


def _fitted(reference: Sequence[Loaded], theirs: Pairs, seed: int, tick: Tick) -> _Fitted:
    """The plain base on the reference, with every effect."""
    file, described = reference[0].jpeg, reference[0].settings.raw
    cfa = described.cfa if described else None
    tick(0, 3, "fitting the base to the reference")
    mean = fit_mean(file, theirs, split_of(theirs.names), cfa)
    return _Fitted(*fitted_plain(theirs, mean, candidates(CLEAN_NOISY), file, cfa, seed, tick))


def _taken_over(fitted: Model, camera: Camera, pairs: Pairs, exclude: Sequence[str]) -> Model:
    """The fitted base with nothing free, ready for the reference's pictures.

    Effects whose stage it has act on it; those of light after colour and of the encoded picture act on both
    together.
    """
    effects = candidates(CLEAN_NOISY, exclude)
    chain, params = camera.chain()
    added, each = with_remainder(
        Chain(chain.nodes[:-1], chain.name), len(pairs.names), (pairs.mask.shape[1], pairs.mask.shape[2])
    )
    shared = {name: fitted.shared.get(name, own) for name, own in params.items()}
    model = build(
        Chain((*added.nodes, chain.nodes[-1]), chain.name), shared, each, [], effects, keep_file=True
    )
    there = {s.name for s in chain.stages()}
    acting = {e.name: on_own_stage(e, model.shared[e.name]) for e in effects if e.name in there}
    moving = {name: acting.get(name, moves) for name, moves in model.effects.items()}
    return dataclasses.replace(
        model,
        chain=read_out(model.chain, BALANCES[0]),
        effects={name: moves for name, moves in moving.items() if moves},
    )


def _same_noise(fitted: _Fitted, pairs: Pairs, same: Sequence[int | None]) -> np.ndarray | None:
    """(N, H, W, 3) the reference's pictures of the same exposures; None unless every pair has one.

    Noise of one exposure is alike, whatever was done to it.
    """
    theirs = fitted.mean.objective.pairs
    if any(i is None for i in same):
        return None
    pictures = np.stack([theirs.pictures[i] for i in same if i is not None]).astype(np.float32)
    still = fitted.mean.point.model.render(fitted.mean.point.z, pairs.light)

    def noise(seen: np.ndarray) -> np.ndarray:
        own = seen - still
        return np.asarray((own - gaussian_filter(own, (0, 1.5, 1.5, 0)))[pairs.mask].ravel())

    alike = float(np.corrcoef(noise(pairs.pictures), noise(pictures))[0, 1])
    return pictures if alike > _SHARED else None


def _with_pictures(model: Model, measure: Measure, pictures: np.ndarray) -> Model:
    """The model whose first draw of the noise makes exactly these pictures while its effects are off."""
    z, keys = np.zeros(len(model.coordinates)), measure.keys()
    bare = Chain(model.chain.nodes[:-1], model.chain.name)  # without the file
    made = render(bare, model.params(z), model.per_pair, measure.pairs.light, keys, Kept())
    added: Params = {REMAINDER: Remainder(added=np.asarray(pictures - made, np.float32))}
    return dataclasses.replace(model, per_pair=model.per_pair | added, kept=Kept())


def _same_scenes(own: Pairs, theirs: Pairs) -> list[int | None]:
    """For each pair the reference's with the same clean picture; None where there is none."""
    if own.light.shape[1:] != theirs.light.shape[1:]:
        return [None] * len(own.names)
    lights = np.asarray(theirs.light)
    return [
        next((i for i, other in enumerate(lights) if np.array_equal(light, other)), None)
        for light in np.asarray(own.light)
    ]


def _exposed(own: Pairs, fitted: _Fitted, same: Sequence[int | None]) -> Pairs:
    """The pairs as the base sees them: moved and exposed as the reference's own scenes were.

    A scene that the reference lacks has the exposure of most.
    """
    theirs = fitted.mean.objective.pairs
    by = np.array([fitted.moved[i] if i is not None else (0, 0) for i in same])
    moved = cfa_phase.moved(own, by) if by.any() else own
    light = np.array(moved.light, np.float32)
    known = [k for k, i in enumerate(same) if i is not None]
    gains = [np.asarray(theirs.light[same[k]]).mean() / max(float(light[k].mean()), 1e-9) for k in known]
    usual = float(np.median(gains)) if gains else 1.0
    for k, i in enumerate(same):
        light[k] = light[k] * np.float32(usual) if i is None else np.asarray(theirs.light[i])
    again = moved.again
    if again is not None:
        scale = light.mean((1, 2, 3)) / np.maximum(np.asarray(moved.light).mean((1, 2, 3)), 1e-9)
        again = again * jnp.asarray(scale, jnp.float32)[:, None, None, None]
    return dataclasses.replace(moved, light=jnp.asarray(light), again=again)


def _offset(case: Case, same: Sequence[int | None], count: int) -> np.ndarray:
    """(N, F) what the reference's statistics are off by: a scene's own where both have it.

    Elsewhere it is the mean of all, shrunk by its scatter (the positive part of James and Stein 1961).
    """
    assert case.statistics is not None
    measure, point = case.statistics.measure, case.point
    off = measure.real - measure.simulated(point.model, point.z)
    mean = off.mean(0)
    scatter = off.var(0, ddof=1) / len(off) if len(off) > 1 else mean**2
    usual = np.clip(1 - scatter / np.maximum(mean**2, 1e-12), 0, 1) * mean
    found = np.broadcast_to(usual, (count, len(usual))).copy()
    for k, i in enumerate(same):
        if i is not None:
            found[k] = off[i]
    return found
