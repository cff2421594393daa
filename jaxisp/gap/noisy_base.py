"""Clean+noisy pairs: the base that is fitted, its mean by pixels and its noise by statistics."""

import dataclasses
from collections.abc import Sequence
from typing import Any

import jax.numpy as jnp
import numpy as np

from jaxisp.gap.effects import Effect, Move
from jaxisp.gap.model import Coordinate, Model, build, plain_freedom
from jaxisp.gap.residual import Pairs, Problem, start_matrix, to_steps
from jaxisp.gap.solve import fit
from jaxisp.io.jpeg import Jpeg
from jaxisp.pipeline import Chain, Params, Stage, stage
from jaxisp.stages.balance import ColorMatrix, WhiteBalance
from jaxisp.stages.choice import DEMOSAICKERS
from jaxisp.stages.jpeg import JpegTables

_TYPICAL = np.array([[0.6, -0.5, -0.1], [-0.25, 0.5, -0.25], [0.0, -0.6, 0.6]])
"""What a phone's colour matrix has beside the identity; its rows keep white."""
_SHARES = (0.0, 0.35, 0.7, 1.05, 1.4)
_NOISE = ("shot", "read", "red_gain", "blue_gain")
_REACH = {"offset": 0.006, "matrix": 0.06, "offsets": 0.05}
_BALANCES = ("to_raw", "early_balance", "later_balance")
_READOUT = ("noise_level", "row_noise", "column_noise", "correlated_noise", "heavy_tailed_noise",
            "hot_pixels", "adc_quantization")  # fmt: skip
"""Effects that act on what the sensor reads, shot noise and all, before white is balanced."""


@dataclasses.dataclass(frozen=True)
class Camera:
    """What the base has no number for.

    Attributes:
        file: whose header is believed.
        cfa: the colour filter array.
        algorithm: that demosaicks.
        gains: of red and blue.
        late: whether white is balanced after demosaicking.
        share: of a typical colour matrix, that takes the sensor's primaries to those of the clean picture.
    """

    file: Jpeg | None
    cfa: str = "RGGB"
    algorithm: str = "bilinear"
    gains: tuple[float, float] = (2.0, 1.6)
    late: bool = False
    share: float = 0.7

    def chain(self) -> tuple[Chain, Params]:
        """Scene to picture: mosaic, noise, demosaicking, white level, one matrix, sRGB, one curve, the
        file's compression."""
        mosaic, late = stage("mosaic_white_balance", cfa=self.cfa), stage("white_balance")
        encoder, tables = self._encoder()
        nodes: list[Any] = [
            Stage(stage("color_matrix").fn, "primaries"),
            stage("mosaic", cfa=self.cfa),
            Stage(stage("black_level").fn, "black_level_offset"),
            stage("balanced_noise", cfa=self.cfa),
            Stage(mosaic.fn, _BALANCES[0], mosaic.static),
            Stage(mosaic.fn, _BALANCES[1], mosaic.static),
            stage("demosaicking", cfa=self.cfa, algorithm=self.algorithm),
            Stage(late.fn, _BALANCES[2], late.static),
            stage("clip", name="white_level", low=-1.0),
            stage("color_matrix"),
            stage("srgb_oetf"),
            Stage(stage("spline_curve").fn, "tone_curve"),
            encoder,
        ]
        chain = Chain(tuple(nodes), "plain")
        return chain, chain.init() | _balances(self.gains, self.late) | tables

    def _encoder(self) -> tuple[Stage, Params]:
        if self.file is None or self.file.subsampling not in ("4:4:4", "4:2:2", "4:2:0"):
            return stage("rounding"), {}
        encoder = stage("jpeg_tables", subsampling=self.file.subsampling)
        luma, chroma = (np.asarray(t, np.float32) for t in (self.file.luma_table, self.file.chroma_table))
        return Stage(encoder.fn, "file", encoder.static), {
            "file": JpegTables(luma_table=luma, chroma_table=chroma)
        }

    def mean_model(self, params: Params) -> Model:
        """Without noise and file."""
        chain, own = self.chain()
        still = chain.without("balanced_noise", chain.nodes[-1].name)
        names = set(still.init())
        own |= {name: value for name, value in params.items() if name not in _BALANCES}
        own |= primaries(own["color_matrix"].matrix @ own["primaries"].matrix, self.share)
        own = {name: value for name, value in own.items() if name in names}
        return build(still, own, {}, plain_freedom(), [])

    def whole_model(self, mean: Model, effects: Sequence[Effect]) -> Model:
        """The noisy base with every effect in it, off; its mean is that of `mean`."""
        chain, params = self.chain()
        shared = params | mean.shared
        free = (*noise_freedom(shared), *_narrowed(plain_freedom()))
        model = build(chain, shared, {}, free, effects, keep_file=True)
        return dataclasses.replace(model, chain=_read_out(model.chain))


def _narrowed(free: Sequence[Coordinate]) -> list[Coordinate]:
    """Bounds about where the mean was fitted by pixels: beside noise the best is a little elsewhere, and a
    few statistics must not take it far."""
    found = []
    for c in free:
        reach = _REACH[c.move.field]
        found.append(dataclasses.replace(c, move=dataclasses.replace(c.move, low=-reach, high=reach)))
    return found


def _balances(gains: tuple[float, float], late: bool) -> Params:
    """From balanced light to what the sensor reads, and back before demosaicking or after."""
    own, one = np.array([gains[0], 1, gains[1]], np.float32), np.ones(3, np.float32)
    order = (1 / own, one, own) if late else (1 / own, own, one)
    return {name: WhiteBalance(gains=g) for name, g in zip(_BALANCES, order)}


def _read_out(chain: Chain) -> Chain:
    """The chain with the effects of the readout where the sensor is read."""
    wanted = [f"use_{name}" for name in _READOUT]
    moved = sorted((n for n in chain.nodes if n.name in wanted), key=lambda n: wanted.index(n.name))
    nodes = [n for n in chain.nodes if n.name not in wanted]
    at = 1 + [n.name for n in nodes].index(_BALANCES[0])
    return Chain((*nodes[:at], *moved, *nodes[at:]), chain.name)


def fit_mean(
    file: Jpeg | None, pairs: Pairs, fit_on: Sequence[int], cfa: str | None
) -> tuple[Camera, Problem]:
    """The noise-free base whose pictures are nearest to the noisy ones, pixel by pixel.

    Returns:
        the camera, its colour filter array found unless it is given, and the problem at the best point.
    """
    camera = Camera(file, cfa or "RGGB")
    matrix = start_matrix(np.asarray(pairs.light), pairs.pictures, pairs.mask)
    start: Params = {"color_matrix": ColorMatrix(matrix=np.asarray(np.clip(matrix, -4, 4), np.float32))}
    problem = Problem(camera.mean_model(start), pairs)
    for steps in (3, 1, 2):
        fit(problem, problem.model.base_indices, fit_on, steps=steps)
        problem.pairs = pairs = _exposed(problem)
        problem.move_to(problem.z)
    fitted = problem.model.moved(problem.z).shared
    if cfa is None:
        camera = _with_pattern(camera, fitted, pairs, fit_on)
    camera = _with_demosaicking(camera, fitted, pairs, fit_on)
    choices = [dataclasses.replace(camera, share=share) for share in _SHARES]
    camera = _refined(_nearest(choices, fitted, pairs, fit_on), fitted, pairs, fit_on)
    problem = Problem(camera.mean_model(fitted), pairs)
    problem.weigh(problem.robust_weights())
    fit(problem, problem.model.base_indices, fit_on, steps=4)
    return camera, problem


def _refined(camera: Camera, params: Params, pairs: Pairs, fit_on: Sequence[int]) -> Camera:
    """Gains and share of the primaries nearer than the grids that they were chosen from."""
    for step in (0.16, 0.08):
        red, blue = camera.gains
        gains = [(red * (1 + i * step), blue * (1 + j * step)) for i in (0, -1, 1) for j in (0, -1, 1)]
        if camera.late:
            choices = [dataclasses.replace(camera, gains=g) for g in gains]
            camera = _nearest(choices, params, pairs, fit_on)
        choices = [dataclasses.replace(camera, share=camera.share + i * step) for i in (0, -1, 1)]
        camera = _nearest(choices, params, pairs, fit_on)
    return camera


def _exposed(problem: Problem) -> Pairs:
    """The pairs with each scene's light scaled to the exposure that its own picture shows."""
    pairs, probe = problem.pairs, 1.05
    brighter = problem.model.render(problem.z, pairs.light * probe)[problem.inner]
    change = (to_steps(brighter) - problem.current) * problem.weight / (probe - 1)
    gain = 1 + (change * problem.residual).sum((1, 2, 3)) / ((change**2).sum((1, 2, 3)) + 1e-9)
    gain = np.clip(gain / np.exp(np.log(np.clip(gain, 0.5, 2)).mean()), 0.5, 2).astype(np.float32)
    return dataclasses.replace(pairs, light=pairs.light * gain[:, None, None, None])


def _with_pattern(camera: Camera, params: Params, pairs: Pairs, fit_on: Sequence[int]) -> Camera:
    """The Bayer pattern whose demosaicking errors the pictures have: RGGB on pictures that are moved."""
    moves = [(0, 0), (0, 1), (1, 0), (1, 1)]
    choices = [dataclasses.replace(camera, algorithm=name) for name in ("bilinear", "malvar")]
    rolled = [_rolled(pairs, move) for move in moves]
    errors = [min(_error(c, params, turned, fit_on) for c in choices) for turned in rolled]
    down, across = moves[int(np.argmin(errors))]
    pattern = ("RGGB"[(a + down) % 2 * 2 + (b + across) % 2] for a in (0, 1) for b in (0, 1))
    return dataclasses.replace(camera, cfa="".join(pattern))


def _with_demosaicking(camera: Camera, params: Params, pairs: Pairs, fit_on: Sequence[int]) -> Camera:
    """The algorithm, and whether white is balanced before or after it, and then about by how much."""
    choices = [
        dataclasses.replace(camera, algorithm=name, late=late)
        for name in DEMOSAICKERS
        for late in (False, True)
    ]
    camera = _nearest(choices, params, pairs, fit_on)
    if not camera.late:
        return camera
    grid = [(red, blue) for red in (1.6, 2.0, 2.5) for blue in (1.3, 1.6, 2.0)]
    return _nearest([dataclasses.replace(camera, gains=g) for g in grid], params, pairs, fit_on)


def _rolled(pairs: Pairs, move: tuple[int, int]) -> Pairs:
    """Moved so that another pattern's first photosite is where the model has a red one."""
    turn = [np.roll(np.asarray(a), move, (1, 2)) for a in (pairs.light, pairs.pictures, pairs.mask)]
    return Pairs(pairs.names, jnp.asarray(turn[0]), turn[1], turn[2])


def _nearest(choices: Sequence[Camera], params: Params, pairs: Pairs, fit_on: Sequence[int]) -> Camera:
    """The first of those whose error is the least but for a hair."""
    errors = np.array([_error(c, params, pairs, fit_on) for c in choices])
    return choices[int(np.argmax(errors <= errors.min() * (1 + 1e-6)))]


def _error(camera: Camera, params: Params, pairs: Pairs, fit_on: Sequence[int]) -> float:
    problem = Problem(camera.mean_model(params), pairs)
    return float(problem.errors(problem.z)[list(fit_on)].mean())


def noise_freedom(params: Params) -> list[Coordinate]:
    """The noise of the base, each number free to shrink to its least and to grow as its stage allows."""
    found = []
    for field, least, most in zip(_NOISE, (2e-5, 3e-4, 0.2, 0.2), (0.1, 0.2, 8.0, 8.0)):
        value = float(getattr(params["balanced_noise"], field))
        step = 0.25 * max(value, 4 * least)
        found.append(Coordinate("balanced_noise", Move(field, step, min(0.0, least - value), most - value)))
    return found


def primaries(matrix: Any, share: float) -> Params:
    """The scene seen in a sensor's primaries, and the matrix that undoes that and then does its own.

    How the two share what the clean picture's colours need is told by what demosaicking does at edges.
    """
    mixing = np.eye(3) + share * _TYPICAL
    before, after = np.linalg.inv(mixing), np.asarray(matrix) @ mixing
    return {
        "primaries": ColorMatrix(matrix=np.asarray(np.clip(before, -4, 4), np.float32)),
        "color_matrix": ColorMatrix(matrix=np.asarray(np.clip(after, -4, 4), np.float32)),
    }


def fit_noise(problem: Any, fit_on: Sequence[int]) -> None:
    """The noise that explains the statistics best, then all that is free in the base. Leaves the problem at
    z = 0 of the model that is found."""
    _settle(problem, list(range(len(_NOISE))), fit_on, steps=5)
    problem.set_unit()
    _settle(problem, problem.model.base_indices, fit_on, steps=3, keep=True)


def _settle(problem: Any, which: list[int], fit_on: Sequence[int], steps: int, keep: bool = False) -> None:
    """Fit, and make where that ends the model's z = 0; `keep` works with the columns of the start."""
    problem.compute(which)
    fit(problem, which, fit_on, steps=steps, fresh=[] if keep else None)
    problem.model = rebased(problem.model, problem.z)
    problem.move_to(np.zeros(len(problem.z)))


def rebased(model: Model, z: np.ndarray) -> Model:
    """The model with the base's z put into its parameters, the bounds of its noise moved along; where white
    is balanced first, its gains are those that the noise shows."""
    moved = model.moved(z)
    if np.allclose(moved.shared["later_balance"].gains, 1):
        noise = moved.shared["balanced_noise"]
        gains = [float(np.clip(g, 0.5, 4)) for g in (noise.red_gain, noise.blue_gain)]
        moved = dataclasses.replace(moved, shared=moved.shared | _balances((gains[0], gains[1]), late=False))
    base = (*noise_freedom(moved.shared), *model.base[len(_NOISE) :])
    return dataclasses.replace(moved, base=base)
