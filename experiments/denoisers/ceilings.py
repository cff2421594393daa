"""What a denoiser without fault would reach: the clean picture as the camera would have shown it."""

import jax.numpy as jnp
import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from experiments.denoisers.pairs import to_linear
from jaxisp.stages.transfer import srgb_oetf
from jaxisp.train import AlignedPair

_REACH = 3  # px
_TILE = 32


def in_camera_tone(pair: AlignedPair) -> np.ndarray:
    """The clean picture in the tone of the noisy one: a rising curve for each channel, through means of bins.

    A denoiser that removed all noise and nothing else would give this. What it falls short of is tone.
    """
    picture, noisy = pair.noisy.copy(), to_linear(pair.noisy[pair.area])
    toned = np.stack([_toned(pair.clean[..., c], noisy[..., c]) for c in range(3)], axis=-1)
    picture[pair.area] = np.asarray(srgb_oetf(jnp.asarray(np.clip(toned, 0, 1), jnp.float32)))
    return picture


def _toned(clean: np.ndarray, noisy: np.ndarray, bins: int = 40) -> np.ndarray:
    order = np.array_split(np.argsort(clean, axis=None), bins)
    x, y = ([plane.ravel()[i].mean() for i in order] for plane in (clean, noisy))
    return np.interp(clean, x, np.maximum.accumulate(y))


def in_camera_sharpness(pair: AlignedPair) -> np.ndarray:
    """That picture as sharp as the noisy one: each channel through the 7x7 filter that comes nearest to it.

    What it falls short of is detail that the camera took, as far as a filter takes it, which no denoiser
    brings back. Filters are fitted on one half of a checkerboard of tiles and applied to the other.
    """
    picture = in_camera_tone(pair)
    toned, noisy = picture[pair.area].astype(np.float64), pair.noisy[pair.area]
    h, w = toned.shape[:2]
    even = np.add.outer(np.arange(h) // _TILE, np.arange(w) // _TILE) % 2 == 0
    side, softened = 2 * _REACH + 1, np.empty_like(toned)
    for c in range(3):
        padded = np.pad(toned[..., c], _REACH, mode="reflect")
        near = sliding_window_view(padded, (side, side)).reshape(h, w, -1)
        near = np.concatenate([near, np.ones((h, w, 1))], axis=-1)
        for fitted in (even, ~even):
            x, y = near[fitted], noisy[..., c][fitted]
            taps = np.linalg.solve(x.T @ x + 1e-3 * np.eye(x.shape[1]), x.T @ y)
            softened[..., c][~fitted] = near[~fitted] @ taps
    picture[pair.area] = np.clip(softened, 0, 1)
    return picture
