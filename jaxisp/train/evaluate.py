"""PSNR and SSIM on clean+noisy pairs, aligned and normalised as in the paper, and with the tone fixed."""

import dataclasses
import functools
from collections.abc import Callable, Hashable, Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, Literal

import jax
import jax.numpy as jnp
import numpy as np

from jaxisp.errors import InputError
from jaxisp.fit.align import Alignment, covered, estimate, same_scene, turned_place, warp
from jaxisp.io import open_dataset
from jaxisp.io.datasets import Loaded
from jaxisp.io.orientation import orient
from jaxisp.metrics import match_moments, psnr, ssim
from jaxisp.process.memory import forget_beyond
from jaxisp.stages.transfer import srgb_eotf, srgb_oetf
from jaxisp.train.classical import METHODS, Classical
from jaxisp.train.reference import channel_shifts, fit_tone

Align = Literal["channels", "whole"]
Denoise = Callable[[np.ndarray], np.ndarray]

_INTERPOLATION = 2  # px beyond which bicubic interpolation does not read
_AROUND = 64  # px around a crop that a denoiser may look at
_FIGURES = tuple(
    f"{name}{suffix}" for suffix in ("_in", "") for name in ("psnr", "ssim", "psnr_fixed", "ssim_fixed")
)

ALIGNED = {
    "whole": "clean resampled onto the noisy picture: phase correlation, then sub-pixel shift and scale",
    "channels": "clean resampled onto the noisy picture: phase correlation, then sub-pixel shift and scale, "
    "then each channel where its place differs",
}
NORMALISED = "clean given the mean and standard deviation of what it is compared with, per channel"
FIXED = "clean given the noisy picture's colour and tone, once a pair, by a matrix and one smooth curve"


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
        channel_shift_px: (dy, dx) of each of its channels beyond that.
        aligned_by: "channels", "refined" (all channels alike) or "whole"; see `channel_shifts`.
    """

    name: str
    noisy: np.ndarray
    area: tuple[slice, slice]
    clean: np.ndarray
    aligned: bool
    shift_px: tuple[float, float]
    channel_shift_px: tuple[tuple[float, float], ...] = ((0.0, 0.0),) * 3
    aligned_by: str = "whole"

    @functools.cached_property
    def toned(self) -> np.ndarray:
        """The clean picture in the noisy one's colour and tone, encoded sRGB, of `area`."""
        return fit_tone(self.clean, self.noisy[self.area])(self.clean).astype(np.float32)


def evaluate_dataset(
    denoise: Denoise | None,
    folder: str | Path,
    *,
    methods: Sequence[Classical] = (),
    light: str = "linear",
    crop: int | None = None,
    align: Align = "channels",
    tick: Callable[[int, int, str], Any] = lambda done, total, text: None,
) -> dict[str, Any]:
    """Measure a denoiser on the clean+noisy pairs of a folder.

    The clean picture is laid on the noisy one first, then for the input and the output each given their
    mean and standard deviation per channel (Jaroensri et al. 2019). That follows the output: one that has
    lost contrast is compared with a clean picture that has lost as much. So there are figures against a clean
    picture of a fixed tone too, fitted to the noisy picture and the same for every denoiser.
    SSIM has the Gaussian window.

    Args:
        denoise: (H, W, 3) encoded sRGB to the same; None leaves the noisy picture as it is.
        folder: a data set.
        methods: classical denoisers that are measured on the same pairs.
        light: what is compared, "linear" light as in the paper, or "encoded" sRGB.
        crop: side of the middle part that is used [px], for large pictures; aligning uses all.
        align: "channels" reads each channel of the clean picture at its own place where these differ,
            "whole" does not, as in the paper.
        tick: called with (done, total, text).

    Returns:
        {"pairs": [{"name", "psnr_in", "ssim_in", "psnr", "ssim", "psnr_fixed_in", "ssim_fixed_in",
        "psnr_fixed", "ssim_fixed", "aligned", "shift_px", "channel_shift_px", "aligned_by"}], "mean",
        "aligned", "normalised", "fixed", "light", "ssim", "failed"}; failed has (file, reason). With methods
        also {"methods": [{"name", "title", "strength", "unit", "chosen_on", "pairs", "mean"}]}, whose pairs
        have a "strength" each; that of the method is their mean.

    Raises:
        InputError: no data set of such pairs, or none that can be read.
    """
    failed: list[tuple[str, str]] = []
    denoisers: dict[str, Denoise] = {m.name: m for m in methods}
    rows: list[dict[str, dict[str, Any]]] = []
    for pair in align_dataset(folder, crop=crop, align=align, failed=failed, tick=tick):
        rows.append(_evaluate({"": denoise or (lambda noisy: noisy), **denoisers}, pair, light))
        for method in methods:
            rows[-1][method.name]["strength"] = method.strength(pair.noisy)
    if not rows:
        raise InputError(failed[0][1])
    result = {**_summary([row[""] for row in rows], light, align), "failed": failed}
    if methods:
        result["methods"] = [_of_method(m, [row[m.name] for row in rows]) for m in methods]
    return result


def align_dataset(
    folder: str | Path,
    *,
    crop: int | None = None,
    align: Align = "channels",
    failed: list[tuple[str, str]] | None = None,
    tick: Callable[[int, int, str], Any] = lambda done, total, text: None,
) -> Iterator[AlignedPair]:
    """The clean+noisy pairs of a folder, aligned once: for those who measure several denoisers.

    After some sizes the programs of all are forgotten, those of others in the process too: see
    `forget_compiled`.

    Args:
        folder: a data set.
        crop: as in `evaluate_dataset`; 64 px around it are kept for the denoiser to look at.
        align: as in `evaluate_dataset`.
        failed: is given (file, reason) of what could not be used.
        tick: called with (done, total, text).

    Raises:
        InputError: no data set of such pairs.
    """
    dataset = open_dataset(folder, kind="clean+noisy")
    failed = [] if failed is None else failed
    failed += [(str(path), f"{path}: {reason}") for path, reason in dataset.problems]
    sizes: set[Hashable] = set()
    for i, pair in enumerate(dataset.pairs):
        tick(i, len(dataset.pairs), pair.name)
        try:
            loaded = pair.load()
            assert loaded.clean is not None, "a clean+noisy pair has one"
            forget_beyond(sizes, (loaded.picture.shape, loaded.clean.shape))
            aligned = _aligned(loaded, crop, align)
        except InputError as error:
            failed.append((pair.name, str(error)))
            continue
        yield aligned
    tick(len(dataset.pairs), len(dataset.pairs), "")


def evaluate_pairs(
    denoise: Denoise, pairs: Iterable[AlignedPair], *, light: str = "linear"
) -> dict[str, Any]:
    """As `evaluate_dataset`, on pairs that are aligned already; without "failed"."""
    rows = [_evaluate({"": denoise}, pair, light)[""] for pair in pairs]
    align = "whole" if all(row["aligned_by"] == "whole" for row in rows) else "channels"
    return _summary(rows, light, align)


def _summary(rows: list[dict[str, Any]], light: str, align: str) -> dict[str, Any]:
    return {
        "pairs": rows,
        "mean": _mean(rows),
        "aligned": ALIGNED[align],
        "normalised": NORMALISED,
        "fixed": FIXED,
        "light": light,
        "ssim": "gaussian window, sigma 1.5",
    }


def _of_method(method: Classical, rows: list[dict[str, Any]]) -> dict[str, Any]:
    return {
        "name": method.name,
        "title": METHODS[method.name].title,
        "strength": float(np.mean([row["strength"] for row in rows])),
        "unit": METHODS[method.name].unit,
        "chosen_on": "given" if method.fixed is not None else METHODS[method.name].chosen_on,
        "pairs": rows,
        "mean": _mean(rows),
    }


def _mean(rows: list[dict[str, Any]]) -> dict[str, float]:
    return {name: float(np.mean([row[name] for row in rows])) for name in _FIGURES} if rows else {}


def _evaluate(denoisers: Mapping[str, Denoise], pair: AlignedPair, light: str) -> dict[str, dict[str, Any]]:
    """Figures of each denoiser on a pair."""
    placed = {
        "aligned": pair.aligned,
        "shift_px": list(pair.shift_px),
        "channel_shift_px": [list(shift) for shift in pair.channel_shift_px],
        "aligned_by": pair.aligned_by,
    }
    before = _figures(pair, pair.noisy, light, "_in")
    return {
        name: {"name": pair.name, **before, **_figures(pair, denoise(pair.noisy), light, ""), **placed}
        for name, denoise in denoisers.items()
    }


def _figures(pair: AlignedPair, picture: np.ndarray, light: str, suffix: str) -> dict[str, float]:
    clean, toned, shown = (jnp.asarray(image) for image in (pair.clean, pair.toned, picture[pair.area]))
    values = (float(value) for value in _compare(clean, toned, shown, light))
    return dict(zip((f"{name}{suffix}" for name in ("psnr", "ssim", "psnr_fixed", "ssim_fixed")), values))


def _aligned(pair: Loaded, crop: int | None, align: Align) -> AlignedPair:
    clean, noisy = pair.clean, pair.picture
    assert clean is not None, "a clean+noisy pair has one"
    linear = srgb_eotf(jnp.asarray(clean)) if pair.settings.clean_encoding == "srgb" else jnp.asarray(clean)
    linear, place, trusted = _align(pair.name, noisy, linear)
    area = _area(pair.name, [place], linear.shape, noisy.shape, crop)
    laid = np.asarray(_laid(linear, place, noisy.shape, area))
    shifts, how = np.zeros((3, 2)), "whole"
    if align == "channels" and trusted:
        shifts, how = channel_shifts(laid, noisy[area])
    if how != "whole":
        places = [_moved(place, shift) for shift in shifts]
        area = _area(pair.name, places, linear.shape, noisy.shape, crop)
        planes = [_laid(linear[..., c], p, noisy.shape, area) for c, p in enumerate(places)]
        laid = np.stack([np.asarray(plane) for plane in planes], axis=-1)
    if crop:
        noisy, area = _around(noisy, area)
    shift = (round(float(place.dy), 3), round(float(place.dx), 3))
    each = tuple((round(float(dy), 3), round(float(dx), 3)) for dy, dx in shifts)
    return AlignedPair(pair.name, noisy, area, laid, trusted, shift, each, how)


def _moved(place: Alignment, shift: np.ndarray) -> Alignment:
    """Where a channel lies that is to be read `shift` px of the noisy picture farther on."""
    dy, dx = place.dy + place.scale_y * shift[0], place.dx + place.scale_x * shift[1]
    return place._replace(dy=float(dy), dx=float(dx))


def _area(
    name: str, places: Sequence[Alignment], shape: Any, noisy_shape: Any, crop: int | None
) -> tuple[slice, slice]:
    inside = np.all([np.asarray(covered(place, shape, noisy_shape)) for place in places], axis=0)
    area = _rectangle(inside, crop)
    if min(s.stop - s.start for s in area) < 16:
        raise InputError(f"{name}: the clean picture covers too little of the noisy one")
    return area


def _laid(image: jax.Array, place: Alignment, shape: Any, area: tuple[slice, slice]) -> jax.Array:
    """The rows and columns of `warp(image, place, shape)` that `area` says."""
    sizes = [s.stop - s.start for s in area]
    middle = [s.start + (n - 1) / 2 - (whole - 1) / 2 for s, n, whole in zip(area, sizes, shape)]
    dy, dx = place.dy + place.scale_y * middle[0], place.dx + place.scale_x * middle[1]
    return warp(image, place._replace(dy=float(dy), dx=float(dx)), (sizes[0], sizes[1]))


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
def _compare(clean: jax.Array, toned: jax.Array, picture: jax.Array, light: str) -> tuple[jax.Array, ...]:
    """PSNR and SSIM with matched moments, then with the fixed tone; clean is linear, the others encoded."""
    if light == "linear":
        picture, toned = srgb_eotf(picture), srgb_eotf(toned)
    else:
        clean = srgb_oetf(clean)
    matched = match_moments(clean, picture)
    return tuple(measure(other, picture) for other in (matched, toned) for measure in (psnr, ssim))
