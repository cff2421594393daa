"""Clean+noisy pairs: the base that is fitted, its mean by pixels and its noise by statistics."""

import dataclasses
from collections.abc import Sequence
from typing import Any

import jax.numpy as jnp
import numpy as np
from scipy.ndimage import gaussian_filter

from jaxisp.gap.effects import Effect, Move
from jaxisp.gap.model import Coordinate, Model, build, plain_freedom
from jaxisp.gap.noisy_prior import TYPICAL, plain_prior, typical_matrix
from jaxisp.gap.residual import Pairs, Problem, to_steps
from jaxisp.gap.solve import fit
from jaxisp.io.jpeg import Jpeg
from jaxisp.pipeline import Chain, Params, Stage, stage
from jaxisp.stages.balance import ColorMatrix, WhiteBalance
from jaxisp.stages.choice import DEMOSAICKERS, ChromaSubsampling
from jaxisp.stages.jpeg import JpegTables

_SHARES = (0.0, 0.35, 0.7, 1.05, 1.4)
_SOFTNESS = (0.0, 0.5, 0.8, 1.2, 1.8)  # px
_CHROMA = (0.0, 1.3)  # px
_CLEARLY_SOFT = 0.95  # of the error without: another demosaicker than all here gains 3 % by blur
_SETTLED = 0.01
_ALIKE = 3.0
"""By how much scenes may differ in how bright the picture is for its clean one and count as one exposure."""
NOISE = ("shot", "read", "red_gain", "blue_gain")
_REACH = {"offset": 0.006, "matrix": 0.06, "offsets": 0.05}
_FILE = "file_chroma"
_STORED = {"4:2:0": (1, 1), "4:2:2": (1, 0)}
"""Whether a file halves columns and rows of chroma."""
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
        encoder, tables = encoder_of(self.file)
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
            stage("clip", name="display_range"),
            encoder,
        ]
        chain = Chain(tuple(nodes), "plain")
        return chain, chain.init() | balances(self.gains, self.late) | tables

    def mean_model(self, params: Params) -> Model:
        """Without noise, and with no more of the file than its chroma sampling."""
        chain, own = self.chain()
        nodes = chain.without("balanced_noise", chain.nodes[-1].name).nodes
        shares = _STORED.get(self.file.subsampling) if self.file else None
        if shares:
            nodes = (*nodes, Stage(stage("chroma_subsampling").fn, _FILE))
            horizontal, vertical = map(np.float32, shares)
            own[_FILE] = ChromaSubsampling(horizontal=horizontal, vertical=vertical)
        still = Chain(nodes, "plain")
        names = set(still.init())
        own |= {name: value for name, value in params.items() if name not in _BALANCES}
        own |= primaries(own["color_matrix"].matrix @ own["primaries"].matrix, self.share)
        own = {name: value for name, value in own.items() if name in names}
        return build(still, own, {}, plain_freedom(), [])

    def whole_model(self, mean: Model, effects: Sequence[Effect]) -> Model:
        """The noisy base with every effect in it, off; its mean is that of `mean`."""
        chain, params = self.chain()
        shared = params | {name: value for name, value in mean.shared.items() if name != _FILE}
        free = (*noise_freedom(shared), *narrowed(plain_freedom()))
        model = build(chain, shared, {}, free, effects, keep_file=True)
        return dataclasses.replace(model, chain=read_out(model.chain, _BALANCES[0]))


def encoder_of(file: Jpeg | None) -> tuple[Stage, Params]:
    """What the file did to the picture, by its header; rounding where that says nothing."""
    if file is None or file.subsampling not in ("4:4:4", "4:2:2", "4:2:0"):
        return stage("rounding"), {}
    encoder = stage("jpeg_tables", subsampling=file.subsampling)
    luma, chroma = (np.asarray(t, np.float32) for t in (file.luma_table, file.chroma_table))
    return Stage(encoder.fn, "file", encoder.static), {
        "file": JpegTables(luma_table=luma, chroma_table=chroma)
    }


def narrowed(free: Sequence[Coordinate]) -> list[Coordinate]:
    """Bounds about where the mean was fitted by pixels: beside noise the best is a little elsewhere, and a
    few statistics must not take it far."""
    found = []
    for c in free:
        reach = _REACH[c.move.field]
        found.append(dataclasses.replace(c, move=dataclasses.replace(c.move, low=-reach, high=reach)))
    return found


def balances(gains: tuple[float, float], late: bool) -> Params:
    """From balanced light to what the sensor reads, and back before demosaicking or after."""
    own, one = np.array([gains[0], 1, gains[1]], np.float32), np.ones(3, np.float32)
    order = (1 / own, one, own) if late else (1 / own, own, one)
    return {name: WhiteBalance(gains=g) for name, g in zip(_BALANCES, order)}


def read_out(chain: Chain, after: str) -> Chain:
    """The chain with the effects of the readout where the sensor is read: after this node."""
    wanted = [f"use_{name}" for name in _READOUT]
    moved = sorted((n for n in chain.nodes if n.name in wanted), key=lambda n: wanted.index(n.name))
    nodes = [n for n in chain.nodes if n.name not in wanted]
    at = 1 + [n.name for n in nodes].index(after)
    return Chain((*nodes[:at], *moved, *nodes[at:]), chain.name)


def fit_mean(
    file: Jpeg | None, pairs: Pairs, fit_on: Sequence[int], cfa: str | None
) -> tuple[Camera, Problem]:
    """The noise-free base whose pictures are nearest to the noisy ones, pixel by pixel.

    Returns:
        the camera, its colour filter array found unless it is given, and the problem at the best point.
    """
    camera = Camera(file, cfa or "RGGB")
    pairs = _scaled(pairs)
    gains = _gains(pairs, fit_on)
    start: Params = {"color_matrix": ColorMatrix(matrix=np.float32(np.clip(typical_matrix(gains), -4, 4)))}
    problem = Problem(camera.mean_model(start), pairs)
    for steps in (5, 1, 1, 1, 1, 2):
        _fit(problem, fit_on, gains, steps)
        problem.pairs, change = _exposed(problem)
        pairs = problem.pairs
        problem.move_to(problem.z)
        if change < _SETTLED and steps == 1:
            break
    _fit(problem, fit_on, gains, 2)
    fitted = problem.model.moved(problem.z).shared
    camera = _structured(camera, fitted, pairs, fit_on, cfa is None)
    problem = Problem(camera.mean_model(fitted), pairs)
    problem.weigh(problem.robust_weights())
    _fit(problem, fit_on, gains, 4)
    return camera, problem


def _fit(problem: Problem, fit_on: Sequence[int], gains: np.ndarray, steps: int) -> None:
    prior = plain_prior(problem, gains, fit_on)
    fit(problem, problem.model.base_indices, fit_on, steps=steps, prior=prior)


def _gains(pairs: Pairs, fit_on: Sequence[int]) -> np.ndarray:
    """(3,) how bright the fitted pictures are in linear light for their clean ones, channel by channel."""
    which = list(fit_on)
    own, light = pairs.mask[which][..., None], np.asarray(pairs.light, np.float64)[which]
    return (_linear(pairs.pictures[which]) * own).sum((0, 1, 2)) / np.maximum(
        (light * own).sum((0, 1, 2)), 1e-9
    )


def _linear(pictures: np.ndarray) -> np.ndarray:
    pictures = np.clip(pictures, 0, 1).astype(np.float64)
    return np.where(pictures <= 0.04045, pictures / 12.92, ((pictures + 0.055) / 1.055) ** 2.4)


@dataclasses.dataclass(frozen=True)
class _View:
    """The pictures, and through what the model's own are looked at.

    Attributes:
        pairs: their light as soft as it is taken to be.
        fit_on: those that count.
        chroma: standard deviation [px] by which the model's chroma is smoothed.
    """

    pairs: Pairs
    fit_on: Sequence[int]
    chroma: float = 0.0

    def error(self, camera: Camera, params: Params) -> float:
        """Mean square over these pairs, all channels together."""
        problem, which = Problem(camera.mean_model(params), self.pairs), list(self.fit_on)
        if not self.chroma:
            return float(problem.errors(problem.z)[which].mean())
        current = problem.current[which]
        smooth = gaussian_filter(current[..., 1:], (0, self.chroma, self.chroma, 0))
        current = np.concatenate([current[..., :1], smooth], -1)
        square = ((problem.target[which] - current) * problem.weight[which]) ** 2
        return float((square.sum((1, 2, 3), dtype=np.float64) / problem.counts[which]).mean())


def _structured(
    camera: Camera, params: Params, pairs: Pairs, fit_on: Sequence[int], any_pattern: bool
) -> Camera:
    """Pattern, demosaicker, order and primaries that are nearest to the pictures, through a lens as soft and
    with chroma as smooth as it takes: blur that the base lacks, and filters or files that smooth chroma, hide
    what they do at edges, and the softest would stand in for it.
    """
    found = []
    for chroma in _CHROMA:
        for sigma in _SOFTNESS:
            view = _View(_softened(pairs, sigma), fit_on, chroma)
            own = _with_pattern(camera, params, view) if any_pattern else camera
            own = _with_demosaicking(own, params, view)
            found.append((view.error(own, params), chroma, sigma, own))
    kept = found[0]
    for smooth in _CHROMA:  # each lens must be worth it beside those before
        best = min((f for f in found if f[1] == smooth), key=lambda f: f[:3])
        kept = best if best[0] <= _CLEARLY_SOFT * kept[0] else kept
    _, chroma, sigma, camera = kept
    view = _View(_softened(pairs, sigma), fit_on, chroma)
    choices = [dataclasses.replace(camera, share=share) for share in _SHARES]
    return _refined(_nearest(choices, params, view), params, view)


def _softened(pairs: Pairs, sigma: float) -> Pairs:
    light = gaussian_filter(np.asarray(pairs.light), (0, sigma, sigma, 0))
    return dataclasses.replace(pairs, light=jnp.asarray(light, jnp.float32))


def _refined(camera: Camera, params: Params, view: _View) -> Camera:
    """Gains and share of the primaries nearer than the grids that they were chosen from."""
    for step in (0.16, 0.08):
        red, blue = camera.gains
        gains = [(red * (1 + i * step), blue * (1 + j * step)) for i in (0, -1, 1) for j in (0, -1, 1)]
        if camera.late:
            choices = [dataclasses.replace(camera, gains=g) for g in gains]
            camera = _nearest(choices, params, view)
        choices = [dataclasses.replace(camera, share=camera.share + i * step) for i in (0, -1, 1)]
        camera = _nearest(choices, params, view)
    return camera


def _scaled(pairs: Pairs) -> Pairs:
    """The pairs with each scene's light as bright on average as its picture in linear light: a clean picture
    may be of another exposure, tens of times as dark."""
    light, own = np.asarray(pairs.light, np.float64), pairs.mask[..., None]
    ratio = (_linear(pairs.pictures) * own).sum((1, 2, 3)) / np.maximum((light * own).sum((1, 2, 3)), 1e-9)
    if ratio.max() < _ALIKE * ratio.min():  # one exposure: its curve tells a little of what is clipped
        ratio = np.full_like(ratio, 1.0 if 1 / _ALIKE < ratio.mean() < _ALIKE else ratio.mean())
    return dataclasses.replace(pairs, light=pairs.light * ratio.astype(np.float32)[:, None, None, None])


def _exposed(problem: Problem) -> tuple[Pairs, float]:
    """The pairs with each scene's light scaled to the exposure that its own picture shows, channel by channel
    (white is balanced for each scene), and the largest change that this was."""
    pairs, probe = problem.pairs, 1.05
    columns = []
    for gains in 1 + (probe - 1) * np.eye(3, dtype=np.float32):
        brighter = to_steps(problem.model.render(problem.z, pairs.light * gains)[problem.inner])
        columns.append((brighter - problem.current) * problem.weight / (probe - 1))
    stacked = np.stack(columns, 1).reshape(len(pairs.names), 3, -1)
    gram = np.einsum("nip,njp->nij", stacked, stacked, dtype=np.float64)
    slope = np.einsum("nip,np->ni", stacked, problem.residual.reshape(len(stacked), -1), dtype=np.float64)
    damping = 1e-3 * np.trace(gram, axis1=1, axis2=2)[:, None, None] * np.eye(3) + 1e-9
    gain = np.clip(1 + np.linalg.solve(gram + damping, slope[..., None])[..., 0], 0.5, 2)
    gain = np.clip(gain / np.exp(np.log(gain).mean(0)), 0.5, 2).astype(np.float32)
    moved = dataclasses.replace(pairs, light=pairs.light * gain[:, None, None, :])
    return moved, float(np.abs(gain - 1).max())


def _with_pattern(camera: Camera, params: Params, view: _View) -> Camera:
    """The Bayer pattern whose demosaicking errors the pictures have: RGGB on pictures that are moved."""
    moves = [(0, 0), (0, 1), (1, 0), (1, 1)]
    choices = [dataclasses.replace(camera, algorithm=name) for name in ("bilinear", "malvar")]
    turned = [dataclasses.replace(view, pairs=_rolled(view.pairs, move)) for move in moves]
    errors = [min(own.error(c, params) for c in choices) for own in turned]
    down, across = moves[int(np.argmin(errors))]
    pattern = ("RGGB"[(a + down) % 2 * 2 + (b + across) % 2] for a in (0, 1) for b in (0, 1))
    return dataclasses.replace(camera, cfa="".join(pattern))


def _with_demosaicking(camera: Camera, params: Params, view: _View) -> Camera:
    """The algorithm, and whether white is balanced before or after it, and then about by how much."""
    choices = [
        dataclasses.replace(camera, algorithm=name, late=late)
        for name in DEMOSAICKERS
        for late in (False, True)
    ]
    camera = _nearest(choices, params, view)
    if not camera.late:
        return camera
    grid = [(red, blue) for red in (1.6, 2.0, 2.5) for blue in (1.3, 1.6, 2.0)]
    return _nearest([dataclasses.replace(camera, gains=g) for g in grid], params, view)


def _rolled(pairs: Pairs, move: tuple[int, int]) -> Pairs:
    """Moved so that another pattern's first photosite is where the model has a red one."""
    turn = [np.roll(np.asarray(a), move, (1, 2)) for a in (pairs.light, pairs.pictures, pairs.mask)]
    return Pairs(pairs.names, jnp.asarray(turn[0]), turn[1], turn[2])


def _nearest(choices: Sequence[Camera], params: Params, view: _View) -> Camera:
    """The first of those whose error is the least but for a hair."""
    errors = np.array([view.error(c, params) for c in choices])
    return choices[int(np.argmax(errors <= errors.min() * (1 + 1e-6)))]


def noise_freedom(params: Params) -> list[Coordinate]:
    """The noise of the base, each number free to shrink to its least and to grow as its stage allows."""
    found = []
    for field, least, most in zip(NOISE, (2e-5, 3e-4, 0.2, 0.2), (0.1, 0.2, 8.0, 8.0)):
        value = float(getattr(params["balanced_noise"], field))
        step = 0.25 * max(value, 4 * least)
        found.append(Coordinate("balanced_noise", Move(field, step, min(0.0, least - value), most - value)))
    return found


def primaries(matrix: Any, share: float) -> Params:
    """The scene seen in a sensor's primaries, and the matrix that undoes that and then does its own.

    How the two share what the clean picture's colours need is told by what demosaicking does at edges.
    """
    mixing = np.eye(3) + share * TYPICAL
    before, after = np.linalg.inv(mixing), np.asarray(matrix) @ mixing
    return {
        "primaries": ColorMatrix(matrix=np.asarray(np.clip(before, -4, 4), np.float32)),
        "color_matrix": ColorMatrix(matrix=np.asarray(np.clip(after, -4, 4), np.float32)),
    }
