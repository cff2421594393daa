"""The base of clean+noisy pairs, plain or given, and the case that it leaves to explain."""

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
from jaxisp.gap.case import Case, Floor, Tick
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
from jaxisp.process.memory import give_back
from jaxisp.recipe import Recipe
from jaxisp.stages.choice import DEMOSAICKERS, Demosaicking

_SMOOTHING = 2.0
_TWO_SCENES = "its two pictures are hardly alike, and far from what fits the others: they show two scenes"
_NOT_CARRIED = "colours and tones of the fitted pairs do not carry over: more pairs, of scenes that differ"
_OUTLIER = 12.0
"""Largest mean squared error of a held-out pair, relative to the median of the fitted pairs. Beyond it, the
fitted matrix and curve do not generalise to the pair's colours."""
_UNLIKE_PAIR = 4.0
"""Largest mean squared error, relative to the median of all pairs, of a pair that may show two scenes."""
_PASSES = 3
"""Largest number of passes that align the pairs' patterns; the first pass sees a mixture of patterns."""
_UNLIKE = 0.25
"""Difference in log exposure between scenes that exceeds the error of the fit."""


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
    """Fit the base of clean+noisy pairs: first the mean by pixels, then the noise by its statistics.

    A plain base is always fitted first. It finds the exposure of each scene, the Bayer pattern, and an
    approximate map from pictures back to sensor values.

    A given recipe keeps its constants; the parameters that it draws at random are fitted. A given camera,
    from mosaic to picture, is kept whole. The curve and matrix from the clean picture to its sensor are
    fitted, and the sensor's noise.

    Args:
        loaded: the pairs.
        simulator: the base; default: fit a plain camera.
        exclude: names of effects that are not tried.
        seed: of the simulated noise.
        tick: progress callback, called with (done, total, text).
        is_camera: whether the simulator takes a mosaic instead of an encoded picture.
        uncertain: names of pairs whose halves may show different scenes.
        criteria: thresholds of the verdict.

    Raises:
        InputError: no usable pair, an unknown effect, or a simulator that cannot be a base.
    """
    pairs = clean_pairs(loaded, _SMOOTHING if simulator else 0.0)
    split = split_of(pairs.names)
    effects = candidates(CLEAN_NOISY, exclude)
    file, described = loaded[0].jpeg, loaded[0].settings.raw
    if simulator is not None:  # reports a bad simulator before the slow fit
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
        reasons = {name: _TWO_SCENES if name in uncertain else _NOT_CARRIED for name in outliers}
        return dataclasses.replace(case, outliers=reasons | dict(case.outliers))
    if simulator is None:
        case, mean, _ = fitted_plain(pairs, mean, effects, file, cfa, seed, tick)
    else:
        if is_camera:
            given, pairs = of_camera(simulator, effects, mean)
        else:
            given = of_recipe(simulator, effects, mean.camera.cfa, file)
            pairs = _believed(pairs, mean.objective.pairs)
        read = sensor_quantization(mean.model.shared, mean.camera, pairs)
        case = _given_case(given, pairs, read, split, effects, seed, tick)
    believed = simulator is not None and not is_camera
    reference = _toned(case.pairs.light, None if believed else mean)
    offered = _not_stated(case, file)
    return dataclasses.replace(case, offered=offered, reference=reference, criteria=criteria)


def _not_stated(case: Case, file: Jpeg | None) -> list[str]:
    """The offered effects without those whose parameters the file's header states."""
    stated = stated_by(file)
    if file is None and not case.seen:  # one compression on the picture's own grid is not a double one
        stated.add("double_compression")
    return [name for name in case.offered if name not in stated]


def fitted_plain(
    pairs: Pairs,
    mean: MeanFit,
    effects: Sequence[Effect],
    file: Jpeg | None,
    cfa: str | None,
    seed: int,
    tick: Tick,
) -> tuple[Case, MeanFit, np.ndarray]:
    """Fit the noise of a plain camera; without a file, with the pairs shifted to a common CFA phase.

    A shift would move the 8x8 grid of a JPEG.

    Args:
        pairs: as they were read.
        mean: the fitted mean of these.
        effects: the effects.
        file: a JPEG with the header to use; None if the pictures are not JPEGs.
        cfa: Bayer pattern; None: it was searched for.
        seed: of the simulated noise.
        tick: progress callback.

    Returns:
        the case; the fitted mean; (N, 2) rows and columns that pairs were moved by.
    """
    case = plain_case(mean, effects, seed, tick)
    total = np.zeros((len(pairs.names), 2), int)
    for _ in range(_PASSES if file is None else 0):
        assert case.statistics is not None
        measure, at = case.statistics.measure, case.point
        by = cfa_phase.moves(measure.real, measure.simulated(at.model, at.z), mean)
        if not by.any():
            break
        tick(0, 3, "fitting the base again: pairs are cut at different places of the colour filter array")
        pairs, total = cfa_phase.moved(pairs, by), total + by
        mean = fit_mean(None, pairs, case.split, cfa)
        case = plain_case(mean, effects, seed, tick)
    return case, mean, total


def _outliers(mean: MeanFit, uncertain: Sequence[str]) -> tuple[str, ...]:
    """Names of pairs with too large an error.

    They are held-out pairs to which colours and tones do not generalise, and uncertain pairs that show two
    scenes.
    """
    errors, names, split = mean.point.errors, mean.objective.names, mean.objective.split
    usual = float(np.median(errors[list(split.fit)]))
    far = [names[i] for i in split.held_out if errors[i] > _OUTLIER * usual]
    unlike = [
        n for n, error in zip(names, errors) if n in uncertain and error > _UNLIKE_PAIR * np.median(errors)
    ]
    return tuple(dict.fromkeys((*far, *unlike)))


def _toned(light: jax.Array, mean: MeanFit | None) -> np.ndarray:
    """Clean pictures (N, H, W, 3), encoded sRGB in [0, 1], in the tones of the fitted base.

    Without a fitted base (`mean` is None), the tones are those of the clean light (N, H, W, 3).
    """
    oetf, curve = stage("srgb_oetf"), stage("spline_curve")
    if mean is None:
        return np.clip(np.asarray(oetf.fn(light)), 0, 1)
    shared = mean.model.shared
    matrix = jnp.asarray(shared["color_matrix"].matrix, jnp.float32)
    linear = jnp.matmul(mean.objective.pairs.light, matrix.T, precision="highest")
    encoded = jax.vmap(lambda x: curve.fn(shared["tone_curve"], oetf.fn(x)))(linear)
    return np.clip(np.asarray(encoded), 0, 1)


def plain_case(mean: MeanFit, effects: Sequence[Effect], seed: int, tick: Tick) -> Case:
    """Fit the noise of a plain camera whose mean is fitted, and add all effects, switched off."""
    pairs, split, camera = mean.objective.pairs, mean.objective.split, mean.camera
    model, shown = _placed(camera.whole_model(mean.model, effects), pairs)
    read = sensor_quantization(model.shared, camera, pairs)
    choices = [  # the best demosaicker may only imitate an effect
        Variant({"demosaicking": Demosaicking(shares=shares)}, {})
        for shares in np.eye(len(DEMOSAICKERS), dtype=np.float32)
    ]

    def noise_free(light: jax.Array) -> np.ndarray:
        return to_steps(mean.point.model.render(mean.point.z, light))

    objective = StatisticsObjective.of(model, pairs, noise_free, split, read, choices, seed)
    give_back()
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
    case = _case(objective, at, dict.fromkeys(absorbed), offered, shown)  # without shares
    return dataclasses.replace(case, given=given.about, open_nodes=tuple(sorted(given.fitted)))


def _case(
    objective: StatisticsObjective,
    at: Point,
    absorbed: Mapping[str, float | None],
    offered: list[str],
    shown: tuple[str, ...],
) -> Case:
    held = list(objective.split.held_out)

    def floor_at(point: Point) -> Floor:
        drawn = objective.chance(point)
        low, high = np.percentile(drawn[:, held].mean(1), (5, 95))
        return Floor(drawn.mean(0), (float(low), float(high)))

    floor = floor_at(at)
    return Case(
        kind=CLEAN_NOISY, criteria=CRITERIA[CLEAN_NOISY], pairs=objective.measure.pairs, evidence=objective,
        point=at, floors=floor.each, floor_ci=floor.ci, floor_at=floor_at,
        absorbed=absorbed, offered=offered, statistics=objective, seen=shown,
    )  # fmt: skip


def _placed(model: Model, pairs: Pairs) -> tuple[Model, tuple[str, ...]]:
    """Put the earlier compression on the 8x8 grid that the noisy pictures show.

    Returns:
        the model; the name "double_compression" if the pictures show such a grid.
    """
    if "double_compression" not in model.effects:
        return model, ()
    place = earlier_grid(to_steps(pairs.pictures)[..., 0])
    return with_earlier_grid(model, place), ("double_compression",) if place != (0, 0) else ()


def _believed(pairs: Pairs, exposed: Pairs) -> Pairs:
    """Pairs for a given simulator.

    Scenes have their own exposures only if the plain base found clearly different ones. Its exposures are
    wrong by several per cent if noise is clipped at black.
    """
    light, found = (np.asarray(p.light, np.float64).mean((1, 2)) + 1e-9 for p in (pairs, exposed))
    gains = np.log(found / light)
    common = gains.mean()
    if np.abs(gains - common).max() > _UNLIKE:
        return exposed
    factor = np.exp(common) if abs(common) > np.log(2) else 1.0  # clean pictures may be far darker
    return pairs.relit(lambda light: light * np.float32(factor))


def sensor_quantization(shared: Params, camera: Camera, pairs: Pairs) -> Quantization:
    return quantization(shared, camera.cfa, camera.gains, _inside(pairs), BORDER)


def _inside(pairs: Pairs) -> tuple[int, int]:
    """Height and width of the measured frame, without the border [px]."""
    height, width = pairs.mask.shape[1:]
    return height - 2 * BORDER, width - 2 * BORDER
