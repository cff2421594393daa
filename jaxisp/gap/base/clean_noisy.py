"""Clean+noisy pairs: their base, plain or given, and what it leaves to explain."""

import dataclasses
from collections.abc import Mapping, Sequence

import jax
import jax.numpy as jnp
import numpy as np

from jaxisp.gap.base import cfa_phase
from jaxisp.gap.base.absorbed import absorbed_noise, absorbed_shares
from jaxisp.gap.base.given import GivenBase, of_recipe
from jaxisp.gap.base.given_camera import of_camera
from jaxisp.gap.base.given_chain import check_camera
from jaxisp.gap.base.mean import MeanFit, fit_mean
from jaxisp.gap.base.noise import fit_noise, rebased
from jaxisp.gap.base.open_numbers import fit_open
from jaxisp.gap.base.plain_clean import Camera
from jaxisp.gap.case import Case, Tick
from jaxisp.gap.criteria import CRITERIA, Criteria
from jaxisp.gap.features.quantization import Quantization, quantization
from jaxisp.gap.features.residual_statistics import compile_features
from jaxisp.gap.objective.protocol import Point
from jaxisp.gap.objective.statistics import StatisticsObjective
from jaxisp.gap.pairs.align_clean import clean_pairs
from jaxisp.gap.pairs.earlier_grid import earlier_grid
from jaxisp.gap.pairs.headers import stated_by
from jaxisp.gap.pairs.pairs import BORDER, Pairs, to_steps
from jaxisp.gap.pairs.scenes import Split, split_of
from jaxisp.gap.parallel import in_background
from jaxisp.gap.simulator.choices import with_earlier_grid
from jaxisp.gap.simulator.effects import CLEAN_NOISY, Effect, candidates
from jaxisp.gap.simulator.model import Model, Variant
from jaxisp.io.datasets import Loaded
from jaxisp.io.jpeg import Jpeg
from jaxisp.pipeline import Params, stage
from jaxisp.recipe import Recipe
from jaxisp.stages.choice import DEMOSAICKERS, Demosaicking

_SMOOTHING = 2.0
_OUTLIER = 12.0
"""How many times the mean square error of the fitted pairs a held-out one's may be: matrix and curve that
were fitted to few colours do not carry over to others."""
_UNLIKE_PAIR = 4.0
"""Likewise, of the median of all, where the two halves of a pair are hardly alike: they show two scenes."""
_PASSES = 3
"""How often pairs may be moved to a pattern that all have: the first is that of a mixture."""
_UNLIKE = 0.25
"""Logarithm of the exposure by which a scene differs from the others beyond what is the fit's error."""


def clean_case(
    loaded: Sequence[Loaded],
    simulator: Recipe | None,
    exclude: Sequence[str],
    seed: int,
    tick: Tick,
    *,
    is_camera: bool = False,
    uncertain: Sequence[str] = (),
    criteria: Criteria = CRITERIA[CLEAN_NOISY],
) -> Case:
    """The base fitted to clean+noisy pairs: the mean by pixels, then the noise by its statistics.

    A recipe is believed in what it has for constants, and fitted in what it draws. A plain base is fitted
    before it all the same: it says how each scene was exposed, how its photosites lie, and roughly how to get
    from a picture back to what the sensor read. A camera, mosaic to picture, is believed; the curve and the
    matrix that take the clean picture to what its sensor saw are fitted, and the sensor's noise.

    Args:
        loaded: the pairs.
        simulator: the base; default: fit a plain camera.
        exclude: effects that are not tried.
        seed: of the simulated noise.
        tick: called with (done, total, text).
        is_camera: whether the simulator takes a mosaic, not an encoded picture.
        uncertain: names of pairs whose halves may not show one scene.
        criteria: what the verdict is decided by.

    Raises:
        InputError: no usable pair, an unknown effect, a simulator that cannot be a base.
    """
    pairs = clean_pairs(loaded, _SMOOTHING if simulator else 0.0)
    split = split_of(pairs.names)
    effects = candidates(CLEAN_NOISY, exclude)
    file, described = loaded[0].jpeg, loaded[0].settings.raw
    if simulator is not None:  # a fault here should not cost a fit
        check_camera(simulator) if is_camera else of_recipe(simulator, effects, "RGGB", file)
    tick(0, 3, "fitting the base")
    cfa = described.cfa if described else None
    with in_background(lambda: compile_features({len(pairs.names), len(split.fit)}, _inside(pairs))):
        mean = fit_mean(file, pairs, split, cfa)
    outliers = _outliers(mean, uncertain)
    kept = [p for p in loaded if p.name not in outliers]
    if 1 < len(kept) < len(loaded):
        case = clean_case(
            kept, simulator, exclude, seed, tick, is_camera=is_camera, uncertain=uncertain, criteria=criteria
        )
        return dataclasses.replace(case, outliers=(*outliers, *case.outliers))
    if simulator is None:
        case = plain_case(mean, effects, seed, tick)
        if file is None:  # a file's own grid would be elsewhere
            case, mean = _with_one_pattern(pairs, case, mean, cfa, effects, seed, tick)
    else:
        if is_camera:
            given, pairs = of_camera(simulator, effects, mean)
        else:
            given = of_recipe(simulator, effects, mean.camera.cfa, file)
            pairs = _believed(pairs, mean.objective.pairs)
        read = _quantization(mean.model.shared, mean.camera, pairs)
        case = _given_case(given, pairs, read, split, effects, seed, tick)
    believed = simulator is not None and not is_camera
    reference = _toned(case.pairs.light, None if believed else mean)
    offered = _not_stated(case, file)
    return dataclasses.replace(case, offered=offered, reference=reference, criteria=criteria)


def _not_stated(case: Case, file: Jpeg | None) -> list[str]:
    """The effects that are offered, but for what the file's header states."""
    stated = stated_by(file)
    if file is None and not case.seen:  # on the picture's own grid it is the one compression there was
        stated.add("double_compression")
    return [name for name in case.offered if name not in stated]


def _with_one_pattern(
    pairs: Pairs,
    case: Case,
    mean: MeanFit,
    cfa: str | None,
    effects: Sequence[Effect],
    seed: int,
    tick: Tick,
) -> tuple[Case, MeanFit]:
    """The plain base of pairs and its mean, or both anew with the pairs moved to one place of the colour
    filter
    array: crops need not have been cut alike."""
    for _ in range(_PASSES):
        assert case.statistics is not None
        measure, at = case.statistics.measure, case.point
        by = cfa_phase.moves(measure.real, measure.simulated(at.model, at.z), mean)
        if not by.any():
            break
        tick(0, 3, "fitting the base again: pairs are cut at different places of the colour filter array")
        pairs = cfa_phase.moved(pairs, by)
        mean = fit_mean(None, pairs, case.split, cfa)
        case = plain_case(mean, effects, seed, tick)
    return case, mean


def _outliers(mean: MeanFit, uncertain: Sequence[str]) -> tuple[str, ...]:
    """The held-out pairs that the colours and tones of the fitted ones do not carry over to, and of all those
    that may be of two scenes."""
    errors, names, split = mean.point.errors, mean.objective.names, mean.objective.split
    usual = float(np.median(errors[list(split.fit)]))
    far = [names[i] for i in split.held_out if errors[i] > _OUTLIER * usual]
    unlike = [
        n for n, error in zip(names, errors) if n in uncertain and error > _UNLIKE_PAIR * np.median(errors)
    ]
    return tuple(dict.fromkeys((*far, *unlike)))


def _toned(light: jax.Array, mean: MeanFit | None) -> np.ndarray:
    """(N, H, W, 3) encoded sRGB in [0, 1]: clean light in the tones that a base has for it, pixel by pixel,
    where those are not the clean picture's own."""
    oetf, curve = stage("srgb_oetf"), stage("spline_curve")
    if mean is None:
        return np.clip(np.asarray(oetf.fn(light)), 0, 1)
    shared = mean.model.shared
    matrix = jnp.asarray(shared["color_matrix"].matrix, jnp.float32)
    linear = jnp.matmul(mean.objective.pairs.light, matrix.T, precision="highest")
    encoded = jax.vmap(lambda x: curve.fn(shared["tone_curve"], oetf.fn(x)))(linear)
    return np.clip(np.asarray(encoded), 0, 1)


def plain_case(mean: MeanFit, effects: Sequence[Effect], seed: int, tick: Tick) -> Case:
    """A plain camera whose mean was fitted, with its noise fitted too and all effects in it, off."""
    pairs, split, camera = mean.objective.pairs, mean.objective.split, mean.camera
    model, shown = _placed(camera.whole_model(mean.model, effects), pairs)
    read = _quantization(model.shared, camera, pairs)
    choices = [  # the demosaicker nearest to the pictures may imitate an effect
        Variant({"demosaicking": Demosaicking(shares=shares)}, {})
        for shares in np.eye(len(DEMOSAICKERS), dtype=np.float32)
    ]

    def noise_free(light: jax.Array) -> np.ndarray:
        return to_steps(mean.point.model.render(mean.point.z, light))

    objective = StatisticsObjective.of(model, pairs, noise_free, split, read, choices, seed)
    tick(0, 3, "fitting the noise")
    before = model.shared["balanced_noise"]
    objective, at = fit_noise(objective, objective.at(model, np.zeros(len(model.coordinates))), rebased)
    fit_on = list(split.fit)
    absorbed = absorbed_shares(mean.objective, mean.model, camera.mean_model({}).shared, fit_on)
    absorbed["noise_level"] = absorbed_noise(objective, at.model, before, fit_on)
    offered = [e.name for e in effects if e.name not in absorbed]
    return _case(objective, at, absorbed, offered, shown)


def _given_case(
    given: GivenBase,
    pairs: Pairs,
    read: Quantization,
    split: Split,
    effects: Sequence[Effect],
    seed: int,
    tick: Tick,
) -> Case:
    model, offered, absorbed = given.whole_model(effects)
    model, shown = _placed(model, pairs)
    objective = StatisticsObjective.of(model, pairs, given.noise_free, split, read, seed=seed)
    tick(0, 3, "fitting what the simulator leaves open")
    at = objective.at(model, np.zeros(len(model.coordinates)))
    objective, at = fit_open(objective, at, given.open)
    at = objective.at(given.rebased(at.model, at.z), at.z)
    objective, at = fit_noise(objective, at, given.rebased)
    case = _case(objective, at, dict.fromkeys(absorbed), offered, shown)  # shares are not measured
    return dataclasses.replace(case, given=given.about, open_nodes=tuple(sorted(given.fitted)))


def _case(
    objective: StatisticsObjective,
    at: Point,
    absorbed: Mapping[str, float | None],
    offered: list[str],
    shown: tuple[str, ...],
) -> Case:
    return Case(
        kind=CLEAN_NOISY, criteria=CRITERIA[CLEAN_NOISY], pairs=objective.measure.pairs, evidence=objective,
        point=at, floors=objective.floors,
        absorbed=absorbed, offered=offered, statistics=objective, seen=shown,
    )  # fmt: skip


def _placed(model: Model, pairs: Pairs) -> tuple[Model, tuple[str, ...]]:
    """The model whose earlier compression, if it is tried, is where the noisy pictures show one, and whether
    they do: its name then."""
    if "double_compression" not in model.effects:
        return model, ()
    place = earlier_grid(to_steps(pairs.pictures)[..., 0])
    return with_earlier_grid(model, place), ("double_compression",) if place != (0, 0) else ()


def _believed(pairs: Pairs, exposed: Pairs) -> Pairs:
    """The pairs as a simulator takes them that is believed: exposed scene by scene only where the plain base
    found scenes to differ clearly. It errs by several per cent where noise is clipped at black."""
    light, found = (np.asarray(p.light, np.float64).mean((1, 2)) + 1e-9 for p in (pairs, exposed))
    gains = np.log(found / light)
    common = gains.mean()
    if np.abs(gains - common).max() > _UNLIKE:
        return exposed
    factor = np.exp(common) if abs(common) > np.log(2) else 1.0  # a clean picture tens of times as dark
    return pairs.relit(lambda light: light * np.float32(factor))


def _quantization(shared: Params, camera: Camera, pairs: Pairs) -> Quantization:
    return quantization(shared, camera.cfa, camera.gains, _inside(pairs), BORDER)


def _inside(pairs: Pairs) -> tuple[int, int]:
    """Height and width of what is measured."""
    height, width = pairs.mask.shape[1:]
    return height - 2 * BORDER, width - 2 * BORDER
