"""The plain camera that is the base of clean+noisy pairs, and its free coordinates."""

import dataclasses
import itertools
from collections.abc import Sequence
from typing import Any

import numpy as np

from jaxisp.gap.base.palette import TYPICAL
from jaxisp.gap.simulator.choices import encoder_of
from jaxisp.gap.simulator.effects import Effect, Move
from jaxisp.gap.simulator.model import (
    COMPANDING,
    EXPANSION,
    MIXING,
    Coordinate,
    Model,
    build,
    plain_freedom,
)
from jaxisp.io.jpeg import Jpeg
from jaxisp.pipeline import Chain, Params, Stage, stage
from jaxisp.stages.balance import ColorMatrix, WhiteBalance
from jaxisp.stages.choice import HALVED, ChromaSubsampling
from jaxisp.stages.power import Gamma

NOISE = ("shot", "read", "red_gain", "blue_gain")
_USUAL_GAINS = {"red_gain": (1.9, 0.4), "blue_gain": (1.7, 0.4)}
"""Mean and spread of white-balance gains that sensors need in daylight and indoors."""
_REACH = {"offset": 0.006, "matrix": 0.06, "offsets": 0.05}
_FILE = "file_chroma"
BALANCES = ("to_raw", "early_balance", "later_balance")
_COMPANDED = (COMPANDING, EXPANSION)
_READOUT = ("noise_level", "row_noise", "column_noise", "correlated_noise", "heavy_tailed_noise",
            "hot_pixels", "adc_quantization")  # fmt: skip
"""Effects of the readout: they act on sensor values after shot noise and before white balance."""


@dataclasses.dataclass(frozen=True)
class Camera:
    """Discrete choices of the base, and start values of its fit.

    Attributes:
        file: a JPEG with the header to use; None if the pictures are not JPEGs.
        cfa: Bayer pattern.
        algorithm: of demosaicking.
        gains: white-balance gains of red and blue.
        late: whether white balance follows demosaicking.
        gamma: of the demosaicked values: 1 for linear values, 2 for square roots.
        share: share of a typical colour matrix from the sensor's primaries to those of the clean picture;
            start of the noise's fit.
    """

    file: Jpeg | None
    cfa: str = "RGGB"
    algorithm: str = "bilinear"
    gains: tuple[float, float] = (2.0, 1.6)
    late: bool = False
    gamma: float = 1.0
    share: float = 0.7

    def chain(self) -> tuple[Chain, Params]:
        """The chain from scene to picture, and its parameters.

        Its order: the sensor's primaries, mosaic, noise, demosaicking, white level, back to the clean
        picture's primaries, one matrix, sRGB encoding, one curve, the file's compression.
        """
        mosaic, late = stage("mosaic_white_balance", cfa=self.cfa), stage("white_balance")
        encoder, tables = encoder_of(self.file)
        demosaicking: list[Any] = [stage("demosaicking", cfa=self.cfa, algorithm=self.algorithm)]
        if self.gamma != 1:
            around = ("gamma_compression", "gamma_expansion")
            before, after = (Stage(stage(fn).fn, name) for fn, name in zip(around, _COMPANDED))
            demosaicking = [before, *demosaicking, after]
        nodes: list[Any] = [
            Stage(stage("color_matrix").fn, "primaries"),
            stage("mosaic", cfa=self.cfa),
            Stage(stage("black_level").fn, "black_level_offset"),
            stage("balanced_noise", cfa=self.cfa),
            Stage(mosaic.fn, BALANCES[0], mosaic.static),
            Stage(mosaic.fn, BALANCES[1], mosaic.static),
            *demosaicking,
            Stage(late.fn, BALANCES[2], late.static),
            stage("clip", name="white_level", low=-1.0),
            Stage(stage("color_matrix").fn, MIXING),
            stage("color_matrix"),
            stage("srgb_oetf"),
            Stage(stage("spline_curve").fn, "tone_curve"),
            stage("clip", name="display_range"),
            encoder,
        ]
        chain = Chain(tuple(nodes), "plain")
        params = chain.init() | balances(self.gains, self.late) | tables
        gamma = Gamma(gamma=np.float32(self.gamma))
        return chain, params | {name: gamma for name in _COMPANDED if name in params}

    def mean_model(self, params: Params) -> Model:
        """The model without noise; of the file's compression, only chroma sampling remains."""
        chain, own = self.chain()
        nodes = chain.without("balanced_noise", chain.nodes[-1].name).nodes
        shares = HALVED.get(self.file.subsampling) if self.file else None
        if shares:
            nodes = (*nodes, Stage(stage("chroma_subsampling").fn, _FILE))
            horizontal, vertical = map(np.float32, shares)
            own[_FILE] = ChromaSubsampling(horizontal=horizontal, vertical=vertical)
        still = Chain(nodes, "plain")
        names = set(still.init())
        own |= {name: value for name, value in params.items() if name not in (*BALANCES, *_COMPANDED)}
        own |= primaries(np.eye(3) + self.share * TYPICAL)
        own = {name: value for name, value in own.items() if name in names}
        return build(still, own, {}, plain_freedom(), [])

    def whole_model(self, mean: Model, effects: Sequence[Effect]) -> Model:
        """The noisy base with every effect, switched off; its mean is that of `mean` for any primaries."""
        chain, params = self.chain()
        shared = params | {name: value for name, value in mean.shared.items() if name != _FILE}
        free = (*noise_freedom(shared), *narrowed(plain_freedom()))
        model = build(chain, shared, {}, free, effects, keep_file=True)
        return dataclasses.replace(model, chain=read_out(model.chain, BALANCES[0]), tied=_tied)


def narrowed(free: Sequence[Coordinate]) -> list[Coordinate]:
    """Narrow the bounds around the mean that was fitted by pixels.

    With noise the optimum moves slightly. A few statistics must not move it far.
    """
    found = []
    for c in free:
        reach = _REACH[c.move.field]
        move = dataclasses.replace(c.move, low=-reach, high=reach, spread=reach / 3)
        found.append(dataclasses.replace(c, move=move))
    return found


def balances(gains: tuple[float, float], late: bool) -> Params:
    """White-balance parameters: undone before the sensor, applied before or (`late`) after demosaicking."""
    own, one = np.array([gains[0], 1, gains[1]], np.float32), np.ones(3, np.float32)
    order = (1 / own, one, own) if late else (1 / own, own, one)
    return {name: WhiteBalance(gains=g) for name, g in zip(BALANCES, order)}


def read_out(chain: Chain, after: str) -> Chain:
    """Move the effects of the readout to the place after this node, where the sensor is read."""
    wanted = [f"use_{name}" for name in _READOUT]
    moved = sorted((n for n in chain.nodes if n.name in wanted), key=lambda n: wanted.index(n.name))
    nodes = [n for n in chain.nodes if n.name not in wanted]
    at = 1 + [n.name for n in nodes].index(after)
    return Chain((*nodes[:at], *moved, *nodes[at:]), chain.name)


def noise_freedom(params: Params) -> list[Coordinate]:
    """Coordinates that the noise of the base depends on.

    They are its own parameters, within the bounds of the stage, and the off-diagonal entries of the matrix
    from the sensor's primaries.
    """
    found = []
    for field, least, most in zip(NOISE, (2e-5, 3e-4, 0.2, 0.2), (0.1, 0.2, 8.0, 8.0)):
        value = float(getattr(params["balanced_noise"], field))
        step = 0.25 * max(value, 4 * least)
        move = Move(field, step, min(0.0, least - value), most - value)
        if field in _USUAL_GAINS:
            usual, spread = _USUAL_GAINS[field]
            move = dataclasses.replace(move, usual=usual - value, spread=spread)
        found.append(Coordinate("balanced_noise", move))
    for i, j in itertools.permutations(range(3), 2):
        value = float(np.asarray(params[MIXING].matrix)[i, j])
        usual = Camera.share * TYPICAL[i, j] - value
        move = Move(
            "matrix", 0.05, min(-1.2 - value, 0.0), max(0.4 - value, 0.0), (i, j), usual=usual, spread=0.3
        )
        found.append(Coordinate(MIXING, move))
    return found


def primaries(mixing: Any) -> Params:
    """Colour matrices to a sensor's primaries and back.

    They are identifiable from demosaicking errors at edges and from the noise correlation between channels.

    Args:
        mixing: (3, 3) from the sensor's primaries; its diagonal is replaced so that white stays white.
    """
    found = np.array(mixing, np.float64)
    np.fill_diagonal(found, 0)
    np.fill_diagonal(found, 1 - found.sum(1))
    before = np.clip(np.linalg.pinv(found), -4, 4)
    both = {"primaries": before, MIXING: found}
    return {name: ColorMatrix(matrix=np.asarray(matrix, np.float32)) for name, matrix in both.items()}


def _tied(params: Params) -> Params:
    return params | primaries(params[MIXING].matrix)
