"""Clean+noisy pairs: from the data set to the problem at its base, plain or given."""

import dataclasses
from collections.abc import Sequence

import jax
import jax.numpy as jnp
import numpy as np

from jaxisp.gap.base import cfa_phase, raw_jpeg
from jaxisp.gap.base.absorbed import noise_taken_up, taken_up
from jaxisp.gap.base.given import Given, of_recipe
from jaxisp.gap.base.given_camera import of_camera
from jaxisp.gap.base.given_chain import check_camera
from jaxisp.gap.base.mean import fit_mean
from jaxisp.gap.base.noise import fit_noise, rebased
from jaxisp.gap.base.open_numbers import fit_open
from jaxisp.gap.base.plain_clean import Camera
from jaxisp.gap.case import Case, Split
from jaxisp.gap.features.quantization import Codes, codes
from jaxisp.gap.features.residual_statistics import compile_features
from jaxisp.gap.objective.pixels import BORDER, Pairs, Problem, to_steps
from jaxisp.gap.objective.statistics import StatisticsProblem
from jaxisp.gap.pairs.align_clean import clean_pairs
from jaxisp.gap.pairs.earlier_grid import earlier_grid
from jaxisp.gap.pairs.scenes import split_of
from jaxisp.gap.parallel import beside
from jaxisp.gap.search.stepwise import Tick
from jaxisp.gap.simulator.effects import CLEAN_NOISY, Effect
from jaxisp.gap.simulator.model import Choice, Model
from jaxisp.io.datasets import Loaded
from jaxisp.io.jpeg import Jpeg
from jaxisp.pipeline import Params, stage
from jaxisp.recipe import Recipe
from jaxisp.stages.choice import DEMOSAICKERS, Demosaicking

_SMOOTHING = 2.0
_STRAY = 12.0
"""How many times the mean square error of the fitted pairs a held-out one's may be: matrix and curve that
were fitted to few colours say nothing of others."""
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
    doubted: Sequence[str] = (),
) -> Case:
    """The base fitted to clean+noisy pairs: the mean by pixels, then the noise by its statistics.

    A recipe is believed in what it has for constants, and fitted in what it draws. A plain base is fitted
    before it all the same: it says how each scene was exposed, how its photosites lie, and roughly how to get
    from a picture back to what the sensor read. A camera, mosaic to picture, is believed; the curve and the
    matrix that take the clean picture to what its sensor saw are fitted, and the sensor's noise.

    Args:
        loaded: the pairs.
        simulator: the base; a plain one is fitted where there is none.
        exclude: effects that are not tried.
        seed: of the simulated noise.
        tick: called with (done, total, text).
        is_camera: whether the simulator takes a mosaic, not an encoded picture.
        doubted: names of pairs whose halves may not show one scene.

    Raises:
        InputError: no usable pair, an unknown effect, a simulator that cannot be a base.
    """
    pairs = clean_pairs(loaded, _SMOOTHING if simulator else 0.0)
    split = split_of(pairs.names)
    effects = raw_jpeg.candidates(CLEAN_NOISY, exclude)
    file, described = loaded[0].jpeg, loaded[0].settings.raw
    if simulator is not None:  # a fault here should not cost a fit
        check_camera(simulator) if is_camera else of_recipe(simulator, effects, "RGGB", file)
    tick(0, 3, "fitting the base")
    cfa = described.cfa if described else None
    with beside(lambda: compile_features({len(pairs.names), len(split.fit)}, _inside(pairs))):
        camera, mean = fit_mean(file, pairs, split.fit, cfa)
    strays = _strays(mean, split, doubted)
    kept = [p for p in loaded if p.name not in strays]
    if 1 < len(kept) < len(loaded):
        case = clean_case(kept, simulator, exclude, seed, tick, is_camera=is_camera, doubted=doubted)
        return dataclasses.replace(case, strays=(*strays, *case.strays))
    if simulator is None:
        case = plain_case(camera, mean, split, effects, seed, tick)
        if file is None:  # a file's own grid would be elsewhere
            case, mean = _laid_alike(pairs, case, mean, cfa, effects, seed, tick)
    else:
        if is_camera:
            given, pairs = of_camera(simulator, effects, camera, mean, split.fit)
        else:
            given, pairs = of_recipe(simulator, effects, camera.cfa, file), _believed(pairs, mean.pairs)
        seen = _codes(mean.model.moved(mean.z).shared, camera, pairs)
        case = _given(given, pairs, seen, split, effects, seed, tick)
    believed = simulator is not None and not is_camera
    reference = _toned(case.problem.pairs.light, None if believed else mean)
    return dataclasses.replace(case, offered=_not_stated(case, file), reference=reference)


def _not_stated(case: Case, file: Jpeg | None) -> list[str]:
    """The effects that are offered, but for what the file's header states."""
    stated = raw_jpeg.stated_by(file)
    if file is None and not case.seen:  # on the picture's own grid it is the one compression there was
        stated.add("double_compression")
    return [name for name in case.offered if name not in stated]


def _laid_alike(
    pairs: Pairs,
    case: Case,
    mean: Problem,
    cfa: str | None,
    effects: Sequence[Effect],
    seed: int,
    tick: Tick,
) -> tuple[Case, Problem]:
    """The plain base of pairs and the problem its mean was fitted with, or both anew with the pairs moved to
    one place of the colour filter array: crops need not have been cut alike."""
    for _ in range(_PASSES):
        by = cfa_phase.moves(case.problem.real, case.problem.simulated(case.problem.z), mean)
        if not by.any():
            break
        tick(0, 3, "fitting the base again: pairs are cut at different places of the colour filter array")
        pairs = cfa_phase.moved(pairs, by)
        camera, mean = fit_mean(None, pairs, case.split.fit, cfa)
        case = plain_case(camera, mean, case.split, effects, seed, tick)
    return case, mean


def _strays(mean: Problem, split: Split, doubted: Sequence[str]) -> tuple[str, ...]:
    """The held-out pairs that the colours and tones of the fitted ones do not carry over to, and of all those
    that may be of two scenes."""
    errors, names = mean.errors(mean.z), mean.pairs.names
    usual = float(np.median(errors[list(split.fit)]))
    far = [names[i] for i in split.held_out if errors[i] > _STRAY * usual]
    unlike = [
        n for n, error in zip(names, errors) if n in doubted and error > _UNLIKE_PAIR * np.median(errors)
    ]
    return tuple(dict.fromkeys((*far, *unlike)))


def _toned(light: jax.Array, mean: Problem | None) -> np.ndarray:
    """(N, H, W, 3) encoded sRGB in [0, 1]: clean light in the tones that a base has for it, pixel by pixel,
    where those are not the clean picture's own."""
    oetf, curve = stage("srgb_oetf"), stage("spline_curve")
    if mean is None:
        return np.clip(np.asarray(oetf.fn(light)), 0, 1)
    shared = mean.model.moved(mean.z).shared
    matrix = jnp.asarray(shared["color_matrix"].matrix, jnp.float32)
    linear = jnp.matmul(mean.pairs.light, matrix.T, precision="highest")
    encoded = jax.vmap(lambda x: curve.fn(shared["tone_curve"], oetf.fn(x)))(linear)
    return np.clip(np.asarray(encoded), 0, 1)


def plain_case(
    camera: Camera, mean: Problem, split: Split, effects: Sequence[Effect], seed: int, tick: Tick
) -> Case:
    """A plain camera whose mean was fitted, with its noise fitted too and all effects in it, off."""
    model, shown = _placed(camera.whole_model(mean.model.moved(mean.z), effects), mean.pairs)
    seen = _codes(model.shared, camera, mean.pairs)
    choices = [  # the demosaicker nearest to the pictures may imitate an effect
        Choice({"demosaicking": Demosaicking(shares=shares)}, {})
        for shares in np.eye(len(DEMOSAICKERS), dtype=np.float32)
    ]

    def noise_free(light: jax.Array) -> np.ndarray:
        return to_steps(mean.model.render(mean.z, light))

    problem = StatisticsProblem(model, mean.pairs, noise_free, split, seen, choices, seed)
    tick(0, 3, "fitting the noise")
    before = model.shared["balanced_noise"]
    fit_noise(problem, split.fit, rebased)
    plain = camera.mean_model({}).shared
    taken = taken_up(mean, split.fit, mean.model.moved(mean.z), plain)
    taken["noise_level"] = noise_taken_up(problem, split.fit, before)
    offered = [e.name for e in effects if e.name not in taken]
    return Case(CLEAN_NOISY, problem, split, problem.floors, taken, offered, seen=shown)


def _given(
    given: Given,
    pairs: Pairs,
    seen: Codes,
    split: Split,
    effects: Sequence[Effect],
    seed: int,
    tick: Tick,
) -> Case:
    model, offered, absorbed = given.whole_model(effects)
    model, shown = _placed(model, pairs)
    problem = StatisticsProblem(model, pairs, given.noise_free, split, seen, seed=seed)
    tick(0, 3, "fitting what the simulator leaves open")
    fit_open(problem, given.open, split.fit)
    problem.model = given.rebased(problem.model, problem.z)
    fit_noise(problem, split.fit, given.rebased)
    taken = dict.fromkeys(absorbed)  # not measured
    about, names = given.about, tuple(sorted(given.fitted))
    floors = problem.floors
    return Case(CLEAN_NOISY, problem, split, floors, taken, offered, None, about, names, seen=shown)


def _placed(model: Model, pairs: Pairs) -> tuple[Model, tuple[str, ...]]:
    """The model whose earlier compression, if it is tried, is where the noisy pictures show one, and whether
    they do: its name then."""
    if "double_compression" not in model.effects:
        return model, ()
    place = earlier_grid(to_steps(pairs.pictures)[..., 0])
    return raw_jpeg.with_earlier_grid(model, place), ("double_compression",) if place != (0, 0) else ()


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


def _codes(shared: Params, camera: Camera, pairs: Pairs) -> Codes:
    return codes(shared, camera.cfa, camera.gains, _inside(pairs), BORDER)


def _inside(pairs: Pairs) -> tuple[int, int]:
    """Height and width of what is measured."""
    height, width = pairs.mask.shape[1:]
    return height - 2 * BORDER, width - 2 * BORDER
