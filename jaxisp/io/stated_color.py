"""Colours that TIFF and EXIF tags state by numbers: primaries, white, and a curve."""

from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np

from jaxisp.errors import InputError
from jaxisp.io.color_space import (
    ADOBE_RGB,
    D65,
    SRGB_PRIMARIES,
    ColorSpace,
    Curve,
    gamma,
    of_primaries,
    sampled,
)

_SAME = 0.005  # of a chromaticity: some write two digits
_GAMMAS = 0.1, 10.0
_LARGEST = 65535
_PLAIN_RANGE = (0, _LARGEST) * 3


@dataclass(frozen=True)
class StatedColor:
    """What a TIFF directory and EXIF state, tags as they were read; None of what they do not state.

    Args:
        adobe_rgb, srgb: whether EXIF names that space.
        primaries: x, y of red, green and blue (tag 319); white: x, y (318).
        gamma: EXIF's, an exponent.
        transfer: a table of linear light, or three (tag 301); transfer_range: its black and white (342).
        levels: codes of black and white of each component (tag 532, ReferenceBlackWhite).
    """

    adobe_rgb: bool = False
    srgb: bool = False
    primaries: Any = None
    white: Any = None
    gamma: Any = None
    transfer: Any = None
    transfer_range: Any = None
    levels: Any = None

    def space(self, codes: int | None = 256, linear: bool = False) -> ColorSpace | None:
        """The colour space of pixels; None where sRGB or nothing is stated.

        A space that is named counts before its numbers. The white is D65 where none is stated. Gamma counts
        before a table.

        Args:
            codes: how many a pixel can have, None of floats.
            linear: the pixels are known to hold linear light, whatever curve is stated.

        Raises:
            ValueError: what is stated is damaged, or is not enough to compute with; in words.

        Source: TIFF 6.0, section 20; EXIF 2.32, 4.6.4 (WhitePoint, PrimaryChromaticities, TransferFunction)
        and 4.6.5 (ColorSpace, Gamma).
        """
        if self.adobe_rgb:
            return ADOBE_RGB
        if self.srgb:
            return None
        if self.levels is not None and codes is not None:
            _check_levels(_numbers(self.levels, 6, "ReferenceBlackWhite (tag 532)"), codes)
        white: Any = D65 if self.white is None else _numbers(self.white, 2, "WhitePoint (tag 318)")
        corners: Any = SRGB_PRIMARIES
        if self.primaries is not None:
            corners = _numbers(self.primaries, 6, "PrimaryChromaticities (tag 319)").reshape(3, 2)
        usual = _near(white, D65) and _near(corners, SRGB_PRIMARIES)
        curves = (gamma(1.0),) * 3 if linear else self._curves(codes)
        if curves is None:
            if usual:
                return None
            raise ValueError("primaries or a white other than sRGB's, and no tone curve")
        if self.primaries is None and not usual:
            raise ValueError("a white other than D65 (tag 318), and no primaries")
        own = (SRGB_PRIMARIES, D65) if usual else (corners, white)
        return ColorSpace(of_primaries(own[0], curves[0], own[1]).to_srgb, curves)

    def _curves(self, codes: int | None) -> tuple[Curve, Curve, Curve] | None:
        if self.gamma is not None:
            exponent = float(_numbers(self.gamma, 1, "Gamma")[0])
            if not _GAMMAS[0] <= exponent <= _GAMMAS[1]:
                raise ValueError(f"a Gamma of {exponent:g}, expected {_GAMMAS[0]:g} to {_GAMMAS[1]:g}")
            return (gamma(exponent),) * 3
        if self.transfer is None:
            return None
        if codes is None:
            raise ValueError("a TransferFunction (tag 301) for pixels that are floats")
        table = np.ravel(np.asarray(self.transfer, np.float64))
        if table.size not in (codes, 3 * codes):
            raise ValueError(
                f"a TransferFunction (tag 301) of {table.size} values, expected {codes} or {3 * codes}"
            )
        if self.transfer_range is not None and tuple(np.ravel(self.transfer_range)) != _PLAIN_RANGE:
            raise ValueError("a TransferRange (tag 342) other than 0 to 65535")
        columns = table.reshape(-1, codes) / _LARGEST
        if not (columns[:, 0] < columns[:, -1]).all():
            raise ValueError("a TransferFunction (tag 301) that does not rise from black to white")
        red, green, blue = (partial(sampled, own) for own in np.broadcast_to(columns, (3, codes)))
        return red, green, blue


NOTHING = StatedColor()


def stated_space(
    stated: StatedColor, name: str, codes: int | None = 256, linear: bool = False
) -> ColorSpace | None:
    """`stated.space` of a file; InputError names it."""
    try:
        return stated.space(codes, linear)
    except ValueError as error:
        raise InputError(
            f"{name}: states its colours by {error}; expected sRGB, a profile, or primaries and a curve"
        ) from error


def _numbers(value: Any, count: int, name: str) -> np.ndarray:
    try:
        numbers = np.array([float(v) for v in np.atleast_1d(np.asarray(value, object)).ravel()])
    except (TypeError, ValueError, ZeroDivisionError) as error:
        raise ValueError(f"a damaged {name}") from error
    if numbers.size != count or not np.isfinite(numbers).all():
        raise ValueError(f"a damaged {name}")
    return numbers


def _check_levels(levels: np.ndarray, codes: int) -> None:
    """The whole range of RGB, or of luma and chroma whose zero is in the middle."""
    black, white = levels[0::2], levels[1::2]
    if not ((white == codes - 1).all() and black[0] == 0 and np.isin(black, (0, codes // 2)).all()):
        raise ValueError("a ReferenceBlackWhite (tag 532) other than the whole range")


def _near(given: Any, known: Any) -> bool:
    return bool(np.abs(np.ravel(given) - np.ravel(known)).max() <= _SAME)
