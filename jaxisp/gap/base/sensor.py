"""Search for the sensor and the demosaicker that fit noisy pictures best."""

import dataclasses
from collections.abc import Sequence

import jax.numpy as jnp
import numpy as np
from scipy.ndimage import gaussian_filter

from jaxisp.gap.base.plain_clean import Camera
from jaxisp.gap.objective.pixels import PixelObjective
from jaxisp.gap.pairs.pairs import Pairs
from jaxisp.gap.parallel import parallel_map
from jaxisp.gap.simulator.model import ROOTED
from jaxisp.pipeline import Params

_SHARES = (0.0, 0.35, 0.7, 1.05, 1.4)
_SOFTNESS = (0.0, 0.5, 0.8, 1.2, 1.8)  # px
# not those of converters: under noise and a soft lens DCB passes for Malvar's filters
_DEMOSAICKERS = ("bilinear", "malvar", "hibbard", "ahd", "menon", "hamilton-adams", "vng", "edge-aware")
_CHROMA = 1.3  # px
_CLEARLY_SOFT = 0.95  # ratio of errors with and without blur; an unknown demosaicker alone gains 3 % by blur
_CLEARLY_SMOOTH = 0.998  # likewise for smooth chroma; a camera without it loses a tenth


@dataclasses.dataclass(frozen=True)
class _View:
    """Pictures to fit, with an assumed blur of the lens and of chroma.

    Attributes:
        pairs: the fitted pairs, their light blurred by the lens.
        chroma: standard deviation [px] of the blur of the model's chroma.
    """

    pairs: Pairs
    chroma: float = 0.0

    def error(self, camera: Camera, params: Params) -> float:
        """Mean squared error over all channels, in squared 8-bit steps."""
        objective, model = PixelObjective.of(self.pairs), camera.mean_model(params)
        current = objective.picture(model, np.zeros(len(model.coordinates)))
        if self.chroma:
            smooth = gaussian_filter(current[..., 1:], (0, self.chroma, self.chroma, 0))
            current = np.concatenate([current[..., :1], smooth], -1)
        residual = (objective.target - current) * objective.weight
        return float(objective.mean_squares(residual).mean())


@dataclasses.dataclass(frozen=True)
class _Found:
    """The best camera under one view.

    Attributes:
        view: the assumed blur.
        camera: the best camera.
        error: its error.
        linear: error of the best camera that demosaicks linear values.
    """

    view: _View
    camera: Camera
    error: float
    linear: float


def find_sensor(
    camera: Camera, params: Params, pairs: Pairs, fit_on: Sequence[int], any_pattern: bool
) -> Camera:
    """Find the Bayer pattern, demosaicker, order of white balance and primaries that fit the pictures best.

    Blur of the lens and smooth chroma are fitted along. They hide demosaicking errors at edges, and the
    softest demosaicker would imitate them. Square roots imitate smooth chroma, so smoothness is decided on
    linear values.

    Args:
        camera: the start of the search.
        params: parameters of the noise-free base.
        pairs: all pairs.
        fit_on: indices of the fitted pairs.
        any_pattern: whether the Bayer pattern is searched too.
    """
    pairs = pairs.take(fit_on)
    plain, smooth = (_through(chroma, camera, params, pairs, any_pattern) for chroma in (0.0, _CHROMA))
    found = smooth if smooth.linear <= _CLEARLY_SMOOTH * plain.linear else plain
    choices = [dataclasses.replace(found.camera, share=share) for share in _SHARES]
    return _refined(_nearest(choices, params, found.view), params, found.view)


def _through(chroma: float, camera: Camera, params: Params, pairs: Pairs, any_pattern: bool) -> _Found:
    """The best camera for this blur of chroma; the lens is soft only if that clearly lowers the error."""
    found: list[_Found] = []
    for sigma in _SOFTNESS:
        view = _View(_softened(pairs, sigma), chroma)
        own = _with_pattern(camera, params, view) if any_pattern else camera
        linear = _with_demosaicking(own, params, view)
        own = _on_roots(linear, params, view)
        found.append(_Found(view, own, view.error(own, params), view.error(linear, params)))
        if len(found) > 1 and found[-1].error > found[-2].error:
            break  # the error is assumed to have one minimum along the blur
    best = min(found, key=lambda f: f.error)
    return best if best.error <= _CLEARLY_SOFT * found[0].error else found[0]


def _softened(pairs: Pairs, sigma: float) -> Pairs:
    light = gaussian_filter(np.asarray(pairs.light), (0, sigma, sigma, 0))
    return dataclasses.replace(pairs, light=jnp.asarray(light, jnp.float32))


def _refined(camera: Camera, params: Params, view: _View) -> Camera:
    """Refine the gains and the share of the primaries beyond the grids that they were chosen from."""
    for step in (0.16, 0.08):
        red, blue = camera.gains
        gains = [(red * (1 + i * step), blue * (1 + j * step)) for i in (0, -1, 1) for j in (0, -1, 1)]
        if camera.late:
            choices = [dataclasses.replace(camera, gains=g) for g in gains]
            camera = _nearest(choices, params, view)
        choices = [dataclasses.replace(camera, share=camera.share + i * step) for i in (0, -1, 1)]
        camera = _nearest(choices, params, view)
    return camera


def _with_pattern(camera: Camera, params: Params, view: _View) -> Camera:
    """Choose the Bayer pattern by its demosaicking errors; a pattern is RGGB on shifted pictures."""
    moves = [(0, 0), (0, 1), (1, 0), (1, 1)]
    choices = [dataclasses.replace(camera, algorithm=name) for name in ("bilinear", "malvar")]
    turned = [dataclasses.replace(view, pairs=_rolled(view.pairs, move)) for move in moves]
    errors = [min(own.error(c, params) for c in choices) for own in turned]
    down, across = moves[int(np.argmin(errors))]
    pattern = ("RGGB"[(a + down) % 2 * 2 + (b + across) % 2] for a in (0, 1) for b in (0, 1))
    return dataclasses.replace(camera, cfa="".join(pattern))


def _with_demosaicking(camera: Camera, params: Params, view: _View) -> Camera:
    """Choose the algorithm on linear values, the order of white balance, and the gains."""
    choices = [
        dataclasses.replace(camera, algorithm=name, late=late)
        for name in _DEMOSAICKERS
        for late in (False, True)
    ]
    return _with_gains(_nearest(choices, params, view), params, view)


def _on_roots(camera: Camera, params: Params, view: _View) -> Camera:
    """The camera, or the same algorithm on square roots if that is clearly better."""
    rooted = [dataclasses.replace(camera, gamma=2.0, late=late) for late in (False, True)]
    nearest = _with_gains(_nearest(rooted, params, view), params, view)
    closer = view.error(nearest, params) <= ROOTED * view.error(camera, params)
    return nearest if closer else camera


def _with_gains(camera: Camera, params: Params, view: _View) -> Camera:
    if not camera.late:
        return camera
    grid = [(red, blue) for red in (1.6, 2.0, 2.5) for blue in (1.3, 1.6, 2.0)]
    return _nearest([dataclasses.replace(camera, gains=g) for g in grid], params, view)


def _rolled(pairs: Pairs, move: tuple[int, int]) -> Pairs:
    """Shift pairs so that the first photosite of another pattern lies on a red one of the model."""
    turn = [np.roll(np.asarray(a), move, (1, 2)) for a in (pairs.light, pairs.pictures, pairs.mask)]
    return Pairs(pairs.names, jnp.asarray(turn[0]), turn[1], turn[2])


def _nearest(choices: Sequence[Camera], params: Params, view: _View) -> Camera:
    """The first camera with the least error, within a relative tolerance of 1e-6."""
    errors = np.array(parallel_map(lambda choice: view.error(choice, params), choices))
    return choices[int(np.argmax(errors <= errors.min() * (1 + 1e-6)))]
