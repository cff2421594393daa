"""PSNR and SSIM on clean+noisy pairs, aligned and normalised as in the paper."""

import dataclasses
import functools
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from jaxisp.errors import InputError
from jaxisp.fit.align import Alignment, covered, estimate, same_scene, turned_place, warp
from jaxisp.io import open_dataset
from jaxisp.io.datasets import Loaded
from jaxisp.io.orientation import orient
from jaxisp.metrics import match_moments, psnr, ssim
from jaxisp.stages.transfer import srgb_eotf, srgb_oetf

_INTERPOLATION = 2  # px beyond which bicubic interpolation does not read
_AROUND = 64  # px around a crop that a denoiser may look at
_FIGURES = ("psnr_in", "ssim_in", "psnr", "ssim")

ALIGNED = "clean resampled onto the noisy picture: phase correlation, then sub-pixel shift and scale"
NORMALISED = "clean given the mean and standard deviation of what it is compared with, per channel"


@dataclasses.dataclass(frozen=True)
class AlignedPair:
    """A noisy picture with the clean one laid on it.

    Args:
        name: of the pair.
        noisy: (H, W, 3) encoded sRGB, what a denoiser gets.
        area: rows and columns of `noisy` that figures are taken over.
        clean: linear light, of `area`.
        aligned: whether it could be told where the clean picture lies; left where it was if not.
        shift_px: (dy, dx) of the clean picture.
    """

    name: str
    noisy: np.ndarray
    area: tuple[slice, slice]
    clean: np.ndarray
    aligned: bool
    shift_px: tuple[float, float]


def evaluate_dataset(
    denoise: Callable[[np.ndarray], np.ndarray],
    folder: str | Path,
    *,
    light: str = "linear",
    crop: int | None = None,
    tick: Callable[[int, int, str], Any] = lambda done, total, text: None,
) -> dict[str, Any]:
    """Measure a denoiser on the clean+noisy pairs of a folder.

    The clean picture is laid on the noisy one first, then for the input and the output each given their
    mean and standard deviation per channel (Jaroensri et al. 2019). SSIM has the Gaussian window.

    Args:
        denoise: (H, W, 3) encoded sRGB to the same.
        folder: a data set.
        light: what is compared, "linear" light as in the paper, or "encoded" sRGB.
        crop: side of the middle part that is used [px], for large pictures; aligning uses all.
        tick: called with (done, total, text).

    Returns:
        {"pairs": [{"name", "psnr_in", "ssim_in", "psnr", "ssim", "aligned", "shift_px"}], "mean",
        "aligned", "normalised", "light", "ssim", "failed"}; failed has (file, reason).

    Raises:
        InputError: no data set of such pairs, or none that can be read.
    """
    failed: list[tuple[str, str]] = []
    pairs = align_dataset(folder, crop=crop, failed=failed, tick=tick)
    result = evaluate_pairs(denoise, pairs, light=light)
    if not result["pairs"]:
        raise InputError(failed[0][1])
    return {**result, "failed": failed}


def align_dataset(
    folder: str | Path,
    *,
    crop: int | None = None,
    failed: list[tuple[str, str]] | None = None,
    tick: Callable[[int, int, str], Any] = lambda done, total, text: None,
) -> Iterator[AlignedPair]:
    """The clean+noisy pairs of a folder, aligned once: for those who measure several denoisers.

    Args:
        folder: a data set.
        crop: as in `evaluate_dataset`; 64 px around it are kept for the denoiser to look at.
        failed: is given (file, reason) of what could not be used.
        tick: called with (done, total, text).

    Raises:
        InputError: no data set of such pairs.
    """
    dataset = open_dataset(folder, kind="clean+noisy")
    failed = [] if failed is None else failed
    failed += [(str(path), f"{path}: {reason}") for path, reason in dataset.problems]
    for i, pair in enumerate(dataset.pairs):
        tick(i, len(dataset.pairs), pair.name)
        try:
            aligned = _aligned(pair.load(), crop)
        except InputError as error:
            failed.append((pair.name, str(error)))
            continue
        yield aligned
    tick(len(dataset.pairs), len(dataset.pairs), "")


def evaluate_pairs(
    denoise: Callable[[np.ndarray], np.ndarray], pairs: Iterable[AlignedPair], *, light: str = "linear"
) -> dict[str, Any]:
    """As `evaluate_dataset`, on pairs that are aligned already; without "failed"."""
    rows = [_evaluate(denoise, pair, light) for pair in pairs]
    return {
        "pairs": rows,
        "mean": {name: float(np.mean([row[name] for row in rows])) for name in _FIGURES} if rows else {},
        "aligned": ALIGNED,
        "normalised": NORMALISED,
        "light": light,
        "ssim": "gaussian window, sigma 1.5",
    }


def _evaluate(denoise: Any, pair: AlignedPair, light: str) -> dict[str, Any]:
    figures: dict[str, float] = {}
    for suffix, picture in (("_in", pair.noisy), ("", denoise(pair.noisy))):
        values = _compare(jnp.asarray(pair.clean), jnp.asarray(picture[pair.area]), light)
        figures |= {f"psnr{suffix}": float(values[0]), f"ssim{suffix}": float(values[1])}
    return {"name": pair.name, **figures, "aligned": pair.aligned, "shift_px": list(pair.shift_px)}


def _aligned(pair: Loaded, crop: int | None) -> AlignedPair:
    clean, noisy = pair.clean, pair.picture
    assert clean is not None, "a clean+noisy pair has one"
    linear = srgb_eotf(jnp.asarray(clean)) if pair.settings.clean_encoding == "srgb" else jnp.asarray(clean)
    linear, place, trusted = _align(pair.name, noisy, linear)
    area = _rectangle(np.asarray(covered(place, linear.shape, noisy.shape)), crop)
    if min(s.stop - s.start for s in area) < 16:
        raise InputError(f"{pair.name}: the clean picture covers too little of the noisy one")
    laid = np.asarray(warp(linear, place, noisy.shape)[area])
    if crop:
        noisy, area = _around(noisy, area)
    shift = (round(float(place.dy), 3), round(float(place.dx), 3))
    return AlignedPair(pair.name, noisy, area, laid, trusted, shift)


def _around(noisy: np.ndarray, area: tuple[slice, slice]) -> tuple[np.ndarray, tuple[slice, slice]]:
    """The picture cut to an area and what is near it, and where the area lies in that."""
    tops = [max(0, s.start - _AROUND) for s in area]
    rows, columns = (slice(top, s.stop + _AROUND) for top, s in zip(tops, area))
    inner = [slice(s.start - top, s.stop - top) for top, s in zip(tops, area)]
    return np.ascontiguousarray(noisy[rows, columns]), (inner[0], inner[1])


def _align(name: str, noisy: np.ndarray, linear: jax.Array) -> tuple[jax.Array, Alignment, bool]:
    """The clean picture, turned as the noisy one where it is not, and where it lies; left as it is where that
    cannot be told."""
    encoded = np.asarray(srgb_oetf(linear))
    try:
        place, orientation = turned_place(noisy, encoded, estimate(noisy, encoded))
    except ValueError as error:
        raise InputError(f"{name}: {error}") from None
    linear = jnp.asarray(orient(np.asarray(linear), orientation))
    if same_scene(place, min(noisy.shape, encoded.shape)):
        return linear, place, True
    return linear, Alignment(correlation=place.correlation), False


def _rectangle(inside: np.ndarray, crop: int | None) -> tuple[slice, slice]:
    """The rows and columns that the clean picture covers, its border left out; the middle of them."""
    found = []
    for axis in (1, 0):
        index = np.flatnonzero(inside.any(axis=axis))
        if not index.size:
            return slice(0, 0), slice(0, 0)
        first, last = int(index[0]), int(index[-1]) + 1
        size = inside.shape[1 - axis]
        first += _INTERPOLATION if first > 0 else 0
        last -= _INTERPOLATION if last < size else 0
        if crop and last - first > crop:
            first += (last - first - crop) // 2
            last = first + crop
        found.append(slice(first, last))
    return found[0], found[1]


@functools.partial(jax.jit, static_argnames="light")
def _compare(clean: jax.Array, picture: jax.Array, light: str) -> tuple[jax.Array, jax.Array]:
    """PSNR and SSIM; clean is linear, the picture encoded."""
    if light == "linear":
        picture = srgb_eotf(picture)
    else:
        clean = srgb_oetf(clean)
    matched = match_moments(clean, picture)
    return psnr(matched, picture), ssim(matched, picture)
