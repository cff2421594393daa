"""Power spectrum and autocorrelation of residuals, for the page of a diagnosis.

RAW+JPEG pairs show the residual. Two draws of noise never agree pixel by pixel, so clean+noisy pairs compare
the noise of real pictures with the noise of simulated pictures.
"""

from typing import NamedTuple

import numpy as np

LAGS = 4  # px, largest lag of the autocorrelation
_BINS = 24


class Spread(NamedTuple):
    """Radial power spectrum and autocorrelation of a residual.

    Attributes:
        frequency: (F,) cycles per pixel, increasing, 0 to 0.5.
        energy: (F,) power averaged over directions, squared 8-bit steps. White noise has its variance here.
        correlation: (9, 9) autocorrelation at lags of -4 to 4 rows and columns; 1 in the middle.
    """

    frequency: np.ndarray
    energy: np.ndarray
    correlation: np.ndarray


def spreads(residual: np.ndarray, weight: np.ndarray) -> dict[str, Spread]:
    """Spectra of luma ("luma"), and of Cb and Cr together ("chroma").

    Args:
        residual: (N, h, w, 3) Y'CbCr in 8-bit steps.
        weight: (N, h, w) square root of each pixel's weight; 0 where the pixel is masked.
    """
    both = np.concatenate([residual[..., 1], residual[..., 2]])
    return {
        "luma": spread(residual[..., 0], weight),
        "chroma": spread(both, np.concatenate([weight, weight])),
    }


def spread(residual: np.ndarray, weight: np.ndarray) -> Spread:
    """Spectrum of planes (N, h, w) in 8-bit steps; `weight` (N, h, w) as in `spreads`.

    The weighted mean of each plane is subtracted first.
    """
    counted = weight.astype(np.float64)
    mass = np.maximum((counted**2).sum((1, 2), keepdims=True), 1e-9)
    known = np.where(counted > 0, residual, 0.0)
    mean = (known * counted**2).sum((1, 2), keepdims=True) / mass
    planes = (known - mean) * counted
    return Spread(*_spectrum(planes, counted), _correlation(planes, counted))


def _spectrum(planes: np.ndarray, counted: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Frequencies (F,) and powers (F,) of planes (N, h, w) that are already weighted."""
    height, width = planes.shape[1:]
    # the taper removes the jump between opposite borders, which would spread over all frequencies
    taper = np.outer(np.hanning(height + 2)[1:-1], np.hanning(width + 2)[1:-1])
    power = np.zeros((height, width // 2 + 1))
    for plane in planes:
        power += np.abs(np.fft.rfft2(plane * taper)) ** 2
    power /= max(float(((counted * taper) ** 2).sum()), 1e-9)
    radius = np.hypot(np.fft.fftfreq(height)[:, None], np.fft.rfftfreq(width))
    which = np.ceil(2 * _BINS * radius).astype(int).ravel()  # 0 is the mean, which was subtracted
    sums = [np.bincount(which, v.ravel(), _BINS + 1)[1 : _BINS + 1] for v in (power, np.ones_like(power))]
    filled = sums[1] > 0
    return ((np.arange(_BINS) + 0.5) / (2 * _BINS))[filled], sums[0][filled] / sums[1][filled]


def _correlation(planes: np.ndarray, counted: np.ndarray) -> np.ndarray:
    """Autocorrelation (9, 9) over all weighted planes (N, h, w); 0 if all of them are 0."""
    found = np.zeros((2 * LAGS + 1, 2 * LAGS + 1))
    variance = _product(planes, 0, 0) / max(_product(counted, 0, 0), 1e-9)
    for down in range(LAGS + 1):
        for right in range(-LAGS, LAGS + 1):
            value = _product(planes, down, right) / max(_product(counted, down, right), 1e-9)
            value /= max(variance, 1e-12)
            found[LAGS + down, LAGS + right] = found[LAGS - down, LAGS - right] = value
    return found


def _product(planes: np.ndarray, down: int, right: int) -> float:
    """Sum of products of pixels and their neighbours, `down` rows and `right` columns away."""
    height, width = planes.shape[1:]
    first = planes[:, : height - down, max(-right, 0) : width - max(right, 0)]
    other = planes[:, down:, max(right, 0) : width + min(right, 0)]
    return float(np.einsum("nhw,nhw->", first, other))
