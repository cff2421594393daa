"""The orthogonal two-dimensional wavelet transform of an (H, W) plane, any size."""

import functools

import jax
import jax.numpy as jnp
from jax import lax

from jaxisp.arrays.barriers import materialize
from jaxisp.arrays.linear import linear_call
from jaxisp.arrays.stencils import pad

Bands = tuple[jax.Array, jax.Array, jax.Array, jax.Array]
"""Approximation, then horizontal, vertical and diagonal detail: low or high along (rows, columns) as
(low, low), (high, low), (low, high), (high, high)."""

# fmt: off
SCALING: dict[str, tuple[float, ...]] = {
    "haar": (0.707106781186548, 0.707106781186548),
    "db2": (0.482962913144534, 0.836516303737808, 0.224143868042013, -0.12940952255126),
    "db3": (
        0.332670552950083, 0.806891509311092, 0.459877502118492, -0.135011020010255, -0.0854412738820267,
        0.0352262918857095,
    ),
    "db4": (
        0.230377813308897, 0.714846570552916, 0.630880767929859, -0.0279837694168597, -0.187034811719093,
        0.0308413818355607, 0.0328830116668852, -0.010597401785069,
    ),
    "sym4": (
        0.0322231006040514, -0.0126039672620313, -0.0992195435766333, 0.297857795605306, 0.803738751805132,
        0.497618667632775, -0.0296355276460026, -0.0757657147895022,
    ),
    "sym8": (
        0.00188995033276769, -0.000302920514724139, -0.0149522583370622, 0.00380875201389451,
        0.0491371796737302, -0.0272190299171033, -0.0519458381078819, 0.36444189483618, 0.777185751699627,
        0.481359651259053, -0.0612733590678107, -0.143294238351273, 0.00760748732497675, 0.031695087811526,
        -0.000542132331800027, -0.003382415951005,
    ),
}
# fmt: on
"""Scaling filters, factored from Daubechies' half-band polynomial (Daubechies 1992, chapters 6 and 8)."""


def analyse(plane: jax.Array, wavelet: str) -> Bands:
    """One level of the transform, `pywt.dwt2(plane, wavelet, mode="symmetric")`.

    Args:
        plane: (H, W).
        wavelet: a name in `SCALING`.

    Returns:
        Four bands of ((H + L - 1) // 2, (W + L - 1) // 2), where L is the length of the filter.

    Gradient: exact, in both modes.
    """
    length = len(SCALING[wavelet])
    # an odd size gets one more on the right
    rows, columns = ((length - 2, length - 2 + n % 2) for n in plane.shape)
    return _down(pad(plane, (rows, columns), "symmetric", whole=True), wavelet)


def synthesise(bands: Bands, shape: tuple[int, ...], wavelet: str) -> jax.Array:
    """The inverse of `analyse` for a plane of that shape. Gradient: exact, in both modes."""
    height, width = shape
    return _up(bands, wavelet)[:height, :width]


# Filtering with decimation, and its transpose where that reads no border, each with the other as its
# gradient, so that both are read as slices.


def _down(plane: jax.Array, wavelet: str) -> Bands:
    def pulled_back(_: None, bands: Bands) -> jax.Array:
        half = len(SCALING[wavelet]) // 2 - 1
        around = [(half, half)] * 2
        return _synthesis(jax.tree.map(lambda x: jnp.pad(x, around), bands), wavelet)

    return linear_call(lambda _, x: _analysis(x, wavelet), pulled_back, None, plane)


def _up(bands: Bands, wavelet: str) -> jax.Array:
    def pulled_back(_: None, plane: jax.Array) -> Bands:
        border = len(SCALING[wavelet]) - 2
        return _analysis(jnp.pad(plane, border), wavelet)

    return linear_call(lambda _, x: _synthesis(x, wavelet), pulled_back, None, bands)


def _analysis(plane: jax.Array, wavelet: str) -> Bands:
    low, high = materialize(_down_axis(plane, 0, wavelet))
    (ll, lh), (hl, hh) = _down_axis(low, 1, wavelet), _down_axis(high, 1, wavelet)
    return ll, hl, lh, hh


def _synthesis(bands: Bands, wavelet: str) -> jax.Array:
    ll, hl, lh, hh = bands
    low, high = materialize((_up_axis(ll, lh, 1, wavelet), _up_axis(hl, hh, 1, wavelet)))
    return _up_axis(low, high, 0, wavelet)


def _down_axis(plane: jax.Array, axis: int, wavelet: str) -> tuple[jax.Array, jax.Array]:
    """Low and high bands, `band[k] = sum_m filter[m - 2k] plane[m]`."""
    low, high = _filters(wavelet)
    even, odd = (lax.slice_in_dim(plane, phase, None, 2, axis) for phase in (0, 1))
    count = even.shape[axis] - len(low) // 2 + 1

    def band(taps: tuple[float, ...]) -> jax.Array:
        terms = [
            taps[2 * j + phase] * lax.slice_in_dim(half, j, j + count, axis=axis)
            for j in range(len(taps) // 2)
            for phase, half in enumerate((even, odd))
        ]
        return functools.reduce(jnp.add, terms)

    return band(low), band(high)


def _up_axis(low: jax.Array, high: jax.Array, axis: int, wavelet: str) -> jax.Array:
    """The transpose of `_down_axis`, without two less than the length of the filter at either end."""
    filters, half = _filters(wavelet), len(SCALING[wavelet]) // 2
    count = low.shape[axis] - half + 1

    def phase(first: int) -> jax.Array:
        terms = [
            taps[2 * j + first] * lax.slice_in_dim(x, half - 1 - j, half - 1 - j + count, axis=axis)
            for taps, x in zip(filters, (low, high))
            for j in range(half)
        ]
        return functools.reduce(jnp.add, terms)

    both = jnp.stack([phase(0), phase(1)], axis=axis + 1)
    return both.reshape(*(2 * count if a == axis else n for a, n in enumerate(low.shape)))


def _filters(wavelet: str) -> tuple[tuple[float, ...], tuple[float, ...]]:
    """Low-pass and high-pass, each the other's quadrature mirror."""
    low = SCALING[wavelet]
    return low, tuple((-1) ** k * c for k, c in enumerate(low[::-1]))
