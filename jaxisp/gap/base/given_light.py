"""A light refit of a given camera beside RAW+JPEG pairs: tone, colour matrix and demosaicker.

A camera was fitted to other pictures, under another loss. What a base absorbs anyway is moved to these pairs
before the camera is believed, so that an effect is not looked for in an error of tone.
"""

import dataclasses
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from jaxisp.domains import ENCODED
from jaxisp.gap.gauss_newton import fit
from jaxisp.gap.objective.pixels import PixelObjective
from jaxisp.gap.objective.protocol import Point
from jaxisp.gap.pairs.pairs import Pairs
from jaxisp.gap.simulator.effects import Move
from jaxisp.gap.simulator.model import KNOTS, Coordinate, Model, Variant
from jaxisp.pipeline import Chain, Node, Params, Stage, stage
from jaxisp.stages.choice import DEMOSAICKERS, Demosaicking, demosaicking

TONE, MATRIX = "refitted_tone", "refitted_matrix"
"""The nodes that are moved; a camera has neither."""
ABSORBED = ("tone_curve", "color_matrix", "white_balance")
_SPREAD = {MATRIX: 0.03, TONE: 0.015}
"""Standard deviation of what is believed of a move."""
_CHOSEN = 0.98
"""Share of the error that another demosaicker must leave to replace the camera's own."""


class Refitted(NamedTuple):
    """A camera after its light refit.

    Attributes:
        model: the camera, moved; tone and matrix stay free beside effects.
        choices: other demosaickers; none where the camera's own is not one of them.
        absorbed: share of the error that each effect of the refit absorbs.
        moved: what moved, for report.json.
    """

    model: Model
    choices: Sequence[Variant]
    absorbed: dict[str, float | None]
    moved: dict[str, Any]


def with_refit(nodes: Sequence[Node]) -> list[Node]:
    """A camera's nodes with a matrix before light is encoded, and a tone curve at the end.

    Args:
        nodes: mosaic to encoded sRGB, without a file's rounding or compression.
    """
    encoded = next(i for i, n in enumerate(nodes) if n.domain_out == ENCODED)
    last = nodes[-1]
    end = len(nodes) - (isinstance(last, Stage) and last.fn.__name__ in ("clip", "chroma_subsampling"))
    end = max(end, encoded + 1)
    matrix, tone = Stage(stage("color_matrix").fn, MATRIX), Stage(stage("spline_curve").fn, TONE)
    return [*nodes[:encoded], matrix, *nodes[encoded:end], tone, *nodes[end:]]


def freedom() -> list[Coordinate]:
    """What of a given camera is refitted, near where it is."""
    matrix = [
        Coordinate(MATRIX, Move("matrix", 0.02, -1, 1, (i, j), spread=_SPREAD[MATRIX]))
        for i in range(3)
        for j in range(3)
    ]
    tone = [
        Coordinate(TONE, Move("offsets", 0.02, -0.3, 0.3, (i,), spread=_SPREAD[TONE])) for i in range(KNOTS)
    ]
    return [*matrix, *tone]


def start(chain: Chain) -> Params:
    """Parameters of the refit's nodes at which the camera is itself."""
    own = chain.init()
    curve = dataclasses.replace(own[TONE], offsets=np.zeros(KNOTS, np.float32))
    return {MATRIX: dataclasses.replace(own[MATRIX], matrix=np.eye(3, dtype=np.float32)), TONE: curve}


def refitted(model: Model, pairs: Pairs, fit_on: Sequence[int]) -> Refitted:
    """Refit a camera on these pairs.

    Args:
        model: a camera with the nodes of `with_refit`, whose base coordinates are `freedom`.
        pairs: all of them.
        fit_on: indices of the fitted ones.
    """
    objective, own = PixelObjective.of(pairs).take(fit_on), model.take(fit_on)
    z = np.zeros(len(model.coordinates))
    objective = objective.robust(objective.at(own, z))
    first = objective.at(own, z)
    at = fit(objective, first, model.base_indices, steps=4).point
    found, before = _choices(model), _algorithm(model)
    if found:
        tried = [objective.at(own.chosen(choice.take(fit_on)), at.z) for choice in found]
        best = int(np.argmin([point.error for point in tried]))
        if tried[best].error < _CHOSEN * at.error:
            model, at = model.chosen(found[best]), tried[best]
    objective = objective.robust(at)
    at = fit(objective, objective.at(at.model, at.z), model.base_indices, steps=4).point
    end = model.moved(at.z)
    return Refitted(end, found, _absorbed(objective, at, end, model), _moved(end, model, before, first, at))


def _choices(model: Model) -> list[Variant]:
    if _algorithm(model) is None:
        return []
    name = _demosaicker(model).name
    return [
        Variant({name: Demosaicking(shares=shares)}, {})
        for shares in np.eye(len(DEMOSAICKERS), dtype=np.float32)
    ]


def _demosaicker(model: Model) -> Stage:
    return next(s for s in model.chain.stages() if s.fn is demosaicking)


def _algorithm(model: Model) -> str | None:
    """The name of the demosaicker; None where it is not one of those that can be chosen."""
    if not any(s.fn is demosaicking for s in model.chain.stages()):
        return None
    node = _demosaicker(model)
    shares = np.asarray(model.shared[node.name].shares, float)
    return list(DEMOSAICKERS)[int(shares.argmax())] if shares.max() > 0 else str(node.options["algorithm"])


def _absorbed(objective: PixelObjective, at: Point, end: Model, start: Model) -> dict[str, float | None]:
    """Share of the error that each absorbs: the other stays where it ended."""
    take = list(range(len(objective.target)))
    found: dict[str, float | None] = dict.fromkeys(ABSORBED)
    for name, node in (("tone_curve", TONE), ("color_matrix", MATRIX)):
        without = end.with_shared(end.shared | {node: start.shared[node]})
        error = objective.at(_taken(without, at.model), np.zeros(len(end.coordinates))).errors[take].mean()
        found[name] = max(0.0, float(error) - at.error) / max(float(error), 1e-12)
    return found


def _taken(model: Model, like: Model) -> Model:
    """The model for the pairs of another one."""
    return dataclasses.replace(model, per_pair=like.per_pair)


def _moved(end: Model, start: Model, algorithm: str | None, first: Point, at: Point) -> dict[str, Any]:
    """What moved by how much, and the errors of the fitted pairs before and after."""
    tone = 255 * np.abs(np.asarray(end.shared[TONE].offsets, float)).max()
    matrix = np.abs(np.asarray(end.shared[MATRIX].matrix, float) - np.eye(3)).max()
    return {
        "tone_steps": round(float(tone), 2),
        "matrix": round(float(matrix), 4),
        "demosaicking": [algorithm, _algorithm(end)],
        "error": [first.error, at.error],
    }
