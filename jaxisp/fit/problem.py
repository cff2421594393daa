"""What a fit's program is given and what it returns."""

from typing import Any, NamedTuple

import numpy as np

from jaxisp.fit import model
from jaxisp.fit.sharing import CAMERA, IMAGE, Layout
from jaxisp.pipeline import Params, Stage

GEOMETRY = ("shift_y", "shift_x", "scale_y", "scale_x")
UNITS = (1.0, 1.0, 1e-3, 1e-3)
"""Of the geometry on the real line: px, and a thousandth."""
STEP = 3e-3  # of a difference, on the real line; px for the geometry
STEP_DISTORTION = 0.2  # of that, for distortion: a step moves the corner by a small share of a pixel


class Normal(NamedTuple):
    """One chunk at a place: its normal equations, and the sums for the noise statistics with their slopes.

    Args:
        matrix, vector: (columns, columns) and (columns,) of the robust residual.
        scores: (cells, columns) what the pixels of each cell of colour give to `vector`.
        loss: its sum.
        weight: how many pixels.
        sums, slopes: for the statistics, and (columns, m) how they move.
        jacobian: (columns, N) of the plain residual.
        chord: (columns,) the gradient of the loss with the Jacobian that was given.
        render: the tiles, before the encoder.
    """

    matrix: Any
    vector: Any
    scores: Any
    loss: Any
    weight: Any
    sums: Any
    slopes: Any
    jacobian: Any
    chord: Any
    render: Any


class Given(NamedTuple):
    """What is known while one pair is fitted.

    Args:
        fixed: the parameters that do not move (and, for the rest, their classes).
        median: index in `model.MEDIANS`.
        geometry: (4,) shift [px] and scale in y and x that the alignment found.
        bends: whether the lens is rendered.
        encodes: whether what is compared went through the file's own JPEG encoder.
        encoder: that encoder's parameters; empty where there is none.
        moving: (columns,) which parameters move; the derivative of the others is 0.
    """

    fixed: Params
    median: Any
    geometry: Any
    bends: Any
    encodes: Any
    encoder: Params
    moving: Any


class Problem(NamedTuple):
    """The static part: where denoising is, which parameters move, the encoder, what is inserted. Hashable.

    Demosaicking is done before, and the size of the median is traced: all designs share one compile.
    Its parameters are traced.
    """

    place: str
    layout: Layout
    encoder: Stage | None = None
    inserted: tuple[model.Inserted, ...] = ()

    @property
    def columns(self) -> list[tuple[str, str]]:
        """(stage, field) of each column: the camera's, the image's, then the geometry."""
        names = self.layout.names
        return [*names[CAMERA], *names[IMAGE], *(("geometry", g) for g in GEOMETRY)]

    @property
    def before(self) -> tuple[list[int], list[int]]:
        """The columns that change where the tiles are read, and those that change what denoising gives."""
        before, after = model.around_median(self.place)
        warp = {"geometry", *model.LENS}
        denoise = {*warp, "vignetting", "median", *before.names(), *after.names()}
        which = [[i for i, (own, _) in enumerate(self.columns) if own in some] for some in (warp, denoise)]
        return which[0], which[1]

    def moving(self, bends: bool, median: bool) -> np.ndarray:
        """Which columns can change the picture."""
        still = (() if bends else model.LENS) + (() if median else ("median",))
        return np.asarray([stage not in still for stage, _ in self.columns])

    @property
    def steps(self) -> np.ndarray:
        """Of the difference along each column."""
        distorts = [stage == "geometric_distortion" for stage, _ in self.columns]
        return np.where(distorts, STEP * STEP_DISTORTION, STEP).astype(np.float32)
