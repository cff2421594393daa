"""The noise of the base, and where fits of effects start that this noise has imitated: it is taken back
there."""

from collections.abc import Sequence

import numpy as np

from jaxisp.gap.simulator.effects import EFFECTS
from jaxisp.gap.simulator.model import MIXING, Model
from jaxisp.pipeline import signature

Ladders = list[list[np.ndarray]]
"""Points to start from; along each list the base has more noise from point to point."""

_VARIANCE = {"noise_level": 1.0, "row_noise": 1.0, "column_noise": 1.0, "correlated_noise": 1.0,
             "heavy_tailed_noise": 1.0, "adc_quantization": 1 / 12}  # fmt: skip
"""What the square of an effect's strength adds to the variance in the dark."""
_TIMES = (0.2, 0.4, 0.8, 1.6, 3.2)
_LESS = (0.75, 0.5)
_MORE = (1.0, 2.0, 5.0, 12.0, 30.0)


def is_noisy(model: Model) -> bool:
    """Whether anything in the simulator is random."""
    return any(signature(s.fn).stochastic for s in model.chain.stages())


def noise_indices(model: Model) -> list[int]:
    """The coordinates of the base's own noise."""
    random = {s.name for s in model.chain.stages() if signature(s.fn).stochastic}
    return [i for i, c in enumerate(model.base) if c.node in random]


def informed_by_noise(model: Model) -> list[int]:
    """The coordinates of the base's own noise, and those of the sensor's primaries: how far the noise of
    channels is alike."""
    return [*noise_indices(model), *(i for i, c in enumerate(model.base) if c.node == MIXING)]


def placed(model: Model, z: np.ndarray, i: int, value: float) -> np.ndarray:
    """The point with coordinate i at a value, the base's read noise less by the variance that this adds."""
    moved = z.copy()
    moved[i] = value
    share = _VARIANCE.get(model.coordinates[i].node, 0.0)
    read = _index(model, "read", "std")
    if share and read is not None:
        start = _start(model, read)
        least = start + model.ranges[0, read]
        square = (start + z[read]) ** 2 + share * (z[i] ** 2 - value**2)
        moved[read] = np.clip(np.sqrt(max(square, least**2)), least, None) - start
    return moved


def starts(model: Model, z: np.ndarray, own: Sequence[int]) -> list[Ladders]:
    """Where the fit of an effect may begin, form by form: several strengths of a noise, with more or less of
    the base's own taken back; strong forms of what smooths noise, each with more of it; none for other
    effects, and where nothing is random."""
    coordinates = [model.coordinates[i] for i in own]
    if not own or coordinates[0].node not in EFFECTS or not is_noisy(model):
        return []
    effect = EFFECTS[coordinates[0].node]
    at_rest = [[z]]
    if effect.random:
        first = own[0]
        for times in _TIMES:
            value = float(np.clip(z[first] + times * coordinates[0].move.step, *model.ranges[:, first]))
            point = placed(model, z, first, value)
            at_rest += [[point], *([_with_noise(model, point, share)] for share in _LESS)]
    forms = []
    for form in effect.strong:
        change = {(m.field, m.index): value for m, value in zip(effect.moves, form)}
        point = z.copy()  # a simulator may have some of the moves open
        values = [change[c.move.field, c.move.index] for c in coordinates]
        point[own] = np.clip(values, *model.ranges[:, own])
        forms.append(_ladders(model, point))
    return [at_rest, *forms] if forms or len(at_rest) > 1 else []


def noisier(model: Model, z: np.ndarray, i: int) -> Ladders:
    """The point, and with more and more of the base's noise: the base has stood in for a filter of noise, as
    coordinate i may be unless it is a noise itself, by having less. The point alone where nothing is
    random."""
    node = model.coordinates[i].node
    plain = not is_noisy(model) or (node in EFFECTS and EFFECTS[node].random)
    return [[z]] if plain else _ladders(model, z)


def _ladders(model: Model, z: np.ndarray) -> Ladders:
    return [[_with_noise(model, place, share) for share in _MORE] for place in _places(model, z)]


def _places(model: Model, z: np.ndarray) -> list[np.ndarray]:
    """The point, and with gains and primaries as they usually are: what smooths colours has been imitated
    by others."""
    known = [i for i in informed_by_noise(model) if model.precisions[i] > 0]
    usual = z.copy()
    usual[known] = np.clip(model.usual, *model.ranges)[known]
    return [z, usual] if known else [z]


def _with_noise(model: Model, z: np.ndarray, share: float) -> np.ndarray:
    """The point with both noises of the base at a share of their variance."""
    moved = z.copy()
    for fields, of in ((("shot",), share), (("read", "std"), np.sqrt(share))):
        i = _index(model, *fields)
        if i is not None:
            start = _start(model, i)
            moved[i] = np.clip(of * (start + z[i]) - start, *model.ranges[:, i])
    return moved


def _index(model: Model, *fields: str) -> int | None:
    return next((i for i in noise_indices(model) if model.base[i].move.field in fields), None)


def _start(model: Model, i: int) -> float:
    c = model.base[i]
    return float(getattr(model.shared[c.node], c.move.field))
