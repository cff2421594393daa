"""A given camera, from mosaic to picture, as the base of clean+noisy pairs.

A camera does not define the light on its sensor as a function of the clean picture, nor the noise of the
sensor. Both are fitted. The camera's processing of the mosaic is kept.
"""

import dataclasses
from collections.abc import Sequence

import jax.numpy as jnp
import numpy as np

from jaxisp.camera import with_cfa
from jaxisp.gap.base.given import GivenBase, Open, believed
from jaxisp.gap.base.given_chain import check_camera, flat_nodes, renamed, with_file
from jaxisp.gap.base.mean import MeanFit
from jaxisp.gap.base.plain_clean import narrowed
from jaxisp.gap.gauss_newton import fit
from jaxisp.gap.objective.pixels import PixelObjective
from jaxisp.gap.pairs.pairs import Pairs
from jaxisp.gap.simulator.choices import with_choice
from jaxisp.gap.simulator.effects import Effect
from jaxisp.gap.simulator.model import Coordinate, build, plain_freedom
from jaxisp.gap.simulator.render import Kept, render
from jaxisp.pipeline import Chain, Node, Params, Stage, stage
from jaxisp.priors import LogUniform
from jaxisp.recipe import Recipe
from jaxisp.stages.balance import ColorMatrix, WhiteBalance
from jaxisp.stages.balanced_noise import BalancedNoise

_TONE, _MATRIX, _NOISE = "scene_tone", "scene_matrix", "balanced_noise"
_OPEN = {"shot": (2e-5, 0.1), "read": (3e-4, 0.2), "red_gain": (0.2, 8.0), "blue_gain": (0.2, 8.0)}
_ABSORBED = ("tone_curve", "color_matrix", "white_balance")


def of_camera(recipe: Recipe, effects: Sequence[Effect], mean: MeanFit) -> tuple[GivenBase, Pairs]:
    """Build the base from a camera, preceded by a fitted map from the clean picture to its sensor.

    Args:
        recipe: the camera. If it takes white balance from the RAW, that of `mean` is used.
        effects: the effects; their names are reserved.
        mean: the fitted plain base, at which the fit of matrix and curve starts.

    Returns:
        the base; the pairs with the sensor's light as their light.

    Raises:
        InputError: the camera does not turn a mosaic into encoded sRGB.
    """
    check_camera(recipe)
    plain = mean.camera
    nodes, names = renamed([with_cfa(n, plain.cfa) for n in flat_nodes(recipe.chain.nodes, recipe)], effects)
    nodes, tables = with_file(nodes, plain.file)
    noisy = any(n.stochastic for n in nodes)
    sensor: list[Node] = [stage("mosaic", cfa=plain.cfa)]
    sensor += [] if noisy else [stage(_NOISE, cfa=plain.cfa)]
    chain = with_choice(Chain((*_scene().nodes, *sensor, *nodes), recipe.name))
    params, opened = believed(recipe, names, chain.init())
    params = params | tables
    gains = np.array([plain.gains[0], 1, plain.gains[1]], np.float32)
    for name in recipe.meta.get("from_file", []):
        if isinstance(recipe.prior.get(name), WhiteBalance):
            params[names.get(name, name)] = WhiteBalance(gains=gains)
    absorbed = _ABSORBED if noisy else (*_ABSORBED, "noise_level")
    if not noisy:
        params[_NOISE] = BalancedNoise(red_gain=np.float32(1), blue_gain=np.float32(1))
        opened += tuple(Open(_NOISE, field, (), LogUniform(*law)) for field, law in _OPEN.items())
    given = GivenBase(f"camera {recipe.name}", chain, params, opened, (), absorbed)
    seen = _seen(given, mean)
    given = dataclasses.replace(given, mean=tuple(narrowed(_freedom())))
    return given, seen


def _scene() -> Chain:
    """The chain from the clean picture's light to the sensor's light: one curve and one matrix."""
    matrix = Stage(stage("color_matrix").fn, _MATRIX)
    tone = Stage(stage("spline_curve").fn, _TONE)
    nodes = (stage("srgb_oetf", name="scene_encoded"), tone, stage("srgb_eotf", name="scene_light"), matrix)
    return Chain(nodes, "scene")


def _freedom() -> list[Coordinate]:
    """Coordinates of the scene's curve and matrix, as in the plain base."""
    names = {"color_matrix": _MATRIX, "tone_curve": _TONE}
    return [dataclasses.replace(c, node=names[c.node]) for c in plain_freedom() if c.node in names]


def _seen(given: GivenBase, mean: MeanFit) -> Pairs:
    """Pairs with the sensor's light, from curve and matrix fitted to the real pictures by pixels."""
    still = given.still
    start = {name: given.params[name] for name in still.init()} | {_MATRIX: _start(given, mean)}
    pairs, split = mean.objective.pairs, mean.objective.split
    model = build(still, start, {}, _freedom(), [])
    objective = PixelObjective.of(pairs, split)
    at = objective.at(model, np.zeros(len(model.coordinates)))
    at = fit(objective, at, model.base_indices, split.fit, steps=4).point
    objective = objective.robust(at)
    at = fit(objective, objective.at(model, at.z), model.base_indices, split.fit, steps=4).point
    fitted = model.moved(at.z).shared
    scene = _scene()
    own: Params = {name: fitted[name] for name in scene.init()}
    return pairs.relit(lambda light: jnp.asarray(render(scene, own, {}, light, None, Kept())))


def _start(given: GivenBase, mean: MeanFit) -> ColorMatrix:
    """Colour matrix of the plain base with the camera's own gains and matrix divided out."""
    plain = mean.model.shared
    wanted = np.asarray(plain["color_matrix"].matrix, float)
    for own in given.params.values():
        if isinstance(own, ColorMatrix) and own is not given.params[_MATRIX]:
            wanted = np.linalg.pinv(np.asarray(own.matrix, float), rcond=0.02) @ wanted
    for own in given.params.values():
        if isinstance(own, WhiteBalance):
            wanted = wanted / np.asarray(own.gains, float)[:, None]
    return ColorMatrix(matrix=np.asarray(np.clip(wanted, -4, 4), np.float32))
