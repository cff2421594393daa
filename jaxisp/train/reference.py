"""The clean picture of a pair made a reference: its tone fixed to the noisy picture's, its channels in place.

Both are fitted between the clean and the noisy picture, so that they are the same for every denoiser.
"""

from typing import NamedTuple

import numpy as np
from numpy.polynomial import Legendre, Polynomial
from scipy.optimize import least_squares

from jaxisp.fit.align import PATCH
from jaxisp.fit.planes import blur, box
from jaxisp.fit.sampling import sample

_BLOCK = 4  # px over which the tone is compared: less sharpness than the clean picture's is not contrast lost
_BLOCKS = 10_000  # that are compared, at most
_STRIP = 2**20  # px that are toned at once
_SHAPES = 4  # of the curve
_RIDGE = 1e-3  # holds what a picture without colour or contrast does not tell
_MIDDLE = 512  # px of the longer side in which channels are compared
_MARGIN = 4  # px at the border that do not count
_FARTHEST = 4.0  # px; pictures that are aligned lie no farther apart
_LEAST = 0.1  # px; what is less than that is left as it is
_CHANCE = 12.5  # log likelihood that chance does not bring: five standard deviations

_END_TO_END = Polynomial([0, 1, -1])  # 0 at 0 and at 1: the gain is the matrix's
_BASIS = [
    _END_TO_END * Legendre.basis(k, domain=[0, 1]).convert(kind=Polynomial, domain=[-1, 1])
    for k in range(_SHAPES)
]


class Tone(NamedTuple):
    """A camera's colour and tone: `encoded = curve(srgb_oetf(matrix @ [clean, 1]))`, with one curve.

    Args:
        matrix: (3, 4), linear light of the clean picture and an offset to that of the camera.
        weights: of the curve, `u + u (1 - u) p(u)` where p has the degree 3.
        low: least encoded value that the camera shows.
        high: largest.
    """

    matrix: np.ndarray
    weights: np.ndarray
    low: float
    high: float

    def __call__(self, clean: np.ndarray) -> np.ndarray:
        """(H, W, 3) linear light to encoded sRGB, strip by strip: frames are large."""
        strips = np.array_split(clean, -(-clean[..., 0].size // _STRIP))
        return np.concatenate([self.values_and_slopes(strip)[0] for strip in strips if strip.size])

    def values_and_slopes(self, clean: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Encoded values, and their derivative to `matrix @ [clean, 1]`; both (..., 3)."""
        light = clean @ self.matrix[:, :3].T + self.matrix[:, 3]
        encoded, slope = _encoded(light)
        curve = _curve(self.weights)
        values = curve(encoded)
        inside = (values > self.low) & (values < self.high)
        return np.clip(values, self.low, self.high), np.where(inside, curve.deriv()(encoded) * slope, 0)


def fit_tone(clean: np.ndarray, noisy: np.ndarray) -> Tone:
    """The tone that brings a clean picture nearest to a noisy one, by least squares over means of 4x4 px.

    Means take most of the noise off, and do not take a softer picture for one of less contrast.

    Args:
        clean: (H, W, 3) linear light of any exposure, at least 4x4 px.
        noisy: (H, W, 3) encoded sRGB, aligned with it.
    """
    x, shown = _blocks(clean), _blocks(noisy)
    y = shown.mean(axis=1)
    limits = float(noisy.min()), float(noisy.max())
    gain = _decoded(shown).mean(axis=(0, 1)) / np.maximum(x.mean(axis=(0, 1)), 1e-6)
    start = np.concatenate([np.hstack([np.diag(gain), np.zeros((3, 1))]).ravel(), np.zeros(_SHAPES)])
    scale = np.concatenate([np.repeat(np.maximum(np.abs(gain), 1e-6), 4), np.ones(_SHAPES)])
    hold = _RIDGE * np.sqrt(y.size) / scale

    def residual(p: np.ndarray) -> np.ndarray:
        values = Tone(p[:12].reshape(3, 4), p[12:], *limits)(x).mean(axis=1)
        return np.concatenate([(values - y).ravel(), hold * (p - start)])

    def jacobian(p: np.ndarray) -> np.ndarray:
        tone = Tone(p[:12].reshape(3, 4), p[12:], *limits)
        slopes = tone.values_and_slopes(x)[1] / x.shape[1]
        terms = np.concatenate([x, np.ones((*x.shape[:2], 1))], axis=-1)
        out = np.zeros((len(x), 3, 12 + _SHAPES))
        for c in range(3):
            out[:, c, 4 * c : 4 * c + 4] = np.einsum("nk,nkj->nj", slopes[..., c], terms)
        encoded = _encoded(x @ tone.matrix[:, :3].T + tone.matrix[:, 3])[0]
        for k, shape in enumerate(_BASIS):
            out[..., 12 + k] = np.where(slopes != 0, shape(encoded), 0).mean(axis=1)
        return np.vstack([out.reshape(-1, out.shape[-1]), np.diag(hold)])

    found = least_squares(residual, start, jacobian, method="lm", x_scale=scale, max_nfev=100).x
    return Tone(found[:12].reshape(3, 4), found[12:], *limits)


def channel_shifts(clean: np.ndarray, noisy: np.ndarray) -> tuple[np.ndarray, str]:
    """Where each channel of a clean picture lies on a noisy one, beyond an alignment of the whole.

    Gauss-Newton on a noisy channel less a curve of the clean one, between about 3 and 20 px: first one shift
    for all channels, then one for each. A shift counts where it is 0.1 px or more and brings the two nearer
    than chance does. The curve is of that channel alone: in a JPEG all channels have the fine detail of luma,
    and a mix of the other two would stand in for a channel that lies wrong.

    Args:
        clean: (H, W, 3) linear light, aligned with the noisy picture as a whole.
        noisy: (H, W, 3) encoded sRGB.

    Returns:
        (3, 2) shifts [px], (dy, dx) at which each channel is to be read, and how they were found: "channels",
        "refined" (the same for all three) or "whole" (zeros).
    """
    clean, noisy = (_middle(image).astype(np.float64) for image in (clean, noisy))
    shifts, how = np.zeros((3, 2)), "whole"
    if min(noisy.shape[:2]) < 4 * _MARGIN:
        return shifts, how
    white = np.maximum(np.quantile(clean, 0.99, axis=(0, 1)), 1e-6)
    clean = _encoded(clean / white)[0]  # even noise and edges, dark and bright
    pairs = [(clean[..., c], _band(noisy[..., c]).ravel()) for c in range(3)]

    common = _descend(pairs, shifts[0])
    if _counts(pairs, shifts[0], common):
        shifts, how = np.tile(common, (3, 1)), "refined"
    for c, pair in enumerate(pairs):
        own = _descend([pair], shifts[c])
        if _counts([pair], shifts[c], own):
            shifts[c], how = own, "channels"
    return shifts, how


_Pair = tuple[np.ndarray, np.ndarray]  # a clean plane, a noisy one's band as a vector


def _counts(pairs: list[_Pair], before: np.ndarray, after: np.ndarray) -> bool:
    if np.abs(after - before).max() < _LEAST or np.abs(after).max() > _FARTHEST:
        return False
    # channels of one JPEG share most of their noise: their mean says what one of them does
    gain = np.mean([np.log(_linear(*p, before)[2] / _linear(*p, after)[2]) for p in pairs])
    return bool(0.5 * pairs[0][0].size / PATCH * gain > _CHANCE)


def _descend(pairs: list[_Pair], shift: np.ndarray, steps: int = 15) -> np.ndarray:
    """A shift of all pairs moved until it stays."""
    for _ in range(steps):
        normal, right = np.zeros((2, 2)), np.zeros(2)
        for plane, wanted in pairs:
            columns, residual, left = _linear(plane, wanted, shift)
            normal += columns.T @ columns / left
            right += columns.T @ residual / left
        normal += 1e-6 * (np.trace(normal) + 1e-12) * np.eye(2)  # no edges, no shift
        change = np.linalg.solve(normal, right)
        change *= min(1.0, 0.5 / max(np.abs(change).max(), 1e-9))
        shift = shift + change
        if np.abs(change).max() < 0.005:
            break
    return shift


def _linear(plane: np.ndarray, wanted: np.ndarray, shift: np.ndarray) -> tuple[np.ndarray, np.ndarray, float]:
    """What the shift changes (N, 2), the residual (N,) and its power, where the best cubic curve is used."""
    moved = _shifted(plane, shift)
    basis = np.stack([_band(moved**k).ravel() for k in (1, 2, 3)], axis=-1)
    weights = np.linalg.lstsq(basis, wanted, rcond=1e-6)[0]
    residual = wanted - basis @ weights
    slope = weights[0] + 2 * weights[1] * moved + 3 * weights[2] * moved**2
    columns = np.stack([_band(slope * edge).ravel() for edge in np.gradient(moved)], axis=-1)
    columns = columns - basis @ np.linalg.lstsq(basis, columns, rcond=1e-6)[0]
    return columns, residual, float((residual**2).mean()) + 1e-12


def _shifted(plane: np.ndarray, shift: np.ndarray) -> np.ndarray:
    for axis in (0, 1):
        plane = sample(np, plane, np.arange(plane.shape[axis]) + shift[axis], axis)
    return plane


def _band(plane: np.ndarray) -> np.ndarray:
    """Without noise of the finest kind and without what varies widely, the border cut off."""
    return (blur(plane) - box(plane, 8))[_MARGIN:-_MARGIN, _MARGIN:-_MARGIN]


def _middle(image: np.ndarray) -> np.ndarray:
    top, left = (max(0, (n - _MIDDLE) // 2) for n in image.shape[:2])
    return image[top : top + _MIDDLE, left : left + _MIDDLE]


def _blocks(image: np.ndarray) -> np.ndarray:
    """(n, 16, 3), evenly thinned out."""
    h, w = (n // _BLOCK for n in image.shape[:2])
    tiles = image[: h * _BLOCK, : w * _BLOCK].reshape(h, _BLOCK, w, _BLOCK, 3).swapaxes(1, 2)
    tiles = tiles.reshape(h * w, _BLOCK**2, 3)
    return tiles[:: -(-len(tiles) // _BLOCKS)].astype(np.float64)


def _curve(weights: np.ndarray) -> Polynomial:
    return sum((w * shape for w, shape in zip(weights, _BASIS)), Polynomial([0, 1]))


def _encoded(light: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """sRGB's encoding and its slope; its line goes on below black."""
    power = np.maximum(light, 0.0031308) ** (1 / 2.4)
    line = light <= 0.0031308
    slope = 1.055 / 2.4 * power / np.maximum(light, 0.0031308)
    return np.where(line, 12.92 * light, 1.055 * power - 0.055), np.where(line, 12.92, slope)


def _decoded(encoded: np.ndarray) -> np.ndarray:
    return np.where(encoded <= 0.04045, encoded / 12.92, ((np.maximum(encoded, 0) + 0.055) / 1.055) ** 2.4)
