"""Colour spaces of files: primaries and tone curves, and the way from there to sRGB."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property, partial

import numpy as np

from jaxisp.color import linear_to_srgb, srgb_to_linear
from jaxisp.colorimetry import bradford, primaries_to_xyz

Curve = Callable[[np.ndarray], np.ndarray]
"""Encoded values in [0, 1] to linear light."""

D65 = (0.3127, 0.3290)
SRGB_PRIMARIES = (0.64, 0.33), (0.30, 0.60), (0.15, 0.06)
_SRGB_TO_XYZ = primaries_to_xyz(SRGB_PRIMARIES, D65)
"""Not the standard's four digits: profiles are made of the primaries, and greys are to stay grey."""
_AT_ONCE = 1 << 20  # px of a picture, for the memory
_ALIKE = 1 / 255  # what counts as sRGB is nearer to it than this, everywhere


@dataclass(frozen=True, eq=False)
class ColorSpace:
    """Red, green and blue light that add up.

    Args:
        to_srgb: (3, 3) from its linear RGB to linear sRGB.
        curves: of its red, green and blue.
    """

    to_srgb: np.ndarray
    curves: tuple[Curve, Curve, Curve]

    @cached_property
    def is_srgb(self) -> bool:
        """Whether no colour differs from sRGB's by a step of 8 bits, whatever its name is."""
        steps = np.linspace(0, 1, 9)
        colors = np.stack(np.meshgrid(steps, steps, steps), -1).reshape(-1, 3)
        greys = np.repeat(np.arange(256)[:, None] / 255, 3, 1)
        both = np.concatenate([colors, greys])[None]
        return bool(np.abs(self.srgb(both) - both).max() < _ALIKE)

    def srgb(self, pixels: np.ndarray, *, linear: bool = False) -> np.ndarray:
        """Pixels in sRGB.

        Args:
            pixels: (H, W, 3) as the file holds them: unsigned integers up to their largest value, or floats.
            linear: they hold linear light of its primaries, and so does what is returned.

        Returns:
            (H, W, 3) float32: encoded and cut to sRGB's gamut, or linear and not cut.
        """
        out = np.empty(pixels.shape, np.float32)
        matrix = self.to_srgb.T.astype(np.float32)
        codes = np.iinfo(pixels.dtype).max if pixels.dtype.kind == "u" else 0
        rows = max(_AT_ONCE // max(pixels.shape[1], 1), 1)
        if linear:
            for top in range(0, len(pixels), rows):
                part = pixels[top : top + rows].astype(np.float32)
                out[top : top + rows] = (part / np.float32(codes) if codes else part) @ matrix
            return out
        tables = [c(np.arange(codes + 1) / codes).astype(np.float32) for c in self.curves] if codes else []
        for top in range(0, len(pixels), rows):
            part = pixels[top : top + rows]
            if codes:
                light = np.stack([table[part[..., i]] for i, table in enumerate(tables)], -1)
            else:
                light = np.stack([curve(part[..., i]) for i, curve in enumerate(self.curves)], -1)
            cut = np.clip(light.astype(np.float32) @ matrix, 0, 1)
            out[top : top + rows] = linear_to_srgb(cut)
        return out

    @cached_property
    def curve_table(self) -> np.ndarray | None:
        """(511,) linear light of 8-bit codes and half-way between; None where the channels differ or light
        does not rise."""
        tables = np.stack([curve(np.linspace(0, 1, 511)) for curve in self.curves])
        rises = (np.diff(tables[0]) >= 0).all() and tables[0, 0] < tables[0, -1]
        return tables[0] if np.ptp(tables, axis=0).max() < 1e-6 and rises else None


def gamma(exponent: float) -> Curve:
    """Light as a power of the value."""
    return partial(_power, exponent)


def _power(exponent: float, x: np.ndarray) -> np.ndarray:
    return np.clip(x, 0, 1) ** exponent


def sampled(values: np.ndarray, x: np.ndarray) -> np.ndarray:
    """Light of a table whose values are evenly spaced from 0 to 1, linear between them."""
    return np.interp(x, np.linspace(0, 1, len(values)), values)


def rec709(x: np.ndarray) -> np.ndarray:
    """The inverse of Rec. 709's (and Rec. 2020's) camera curve."""
    return np.where(x < 4.5 * 0.018054, x / 4.5, ((np.maximum(x, 0) + 0.0992968) / 1.0992968) ** (1 / 0.45))


def of_primaries(
    primaries: Sequence[Sequence[float]], curve: Curve, white: Sequence[float] = D65
) -> ColorSpace:
    """A space of chromaticities (x, y) of red, green and blue and of white, which becomes sRGB's (Bradford).

    Raises:
        ValueError: they span no space.
    """
    given = np.array([*primaries, white], np.float64)
    if not (np.isfinite(given).all() and (given >= 0).all() and (given[:, 1] > 0).all()):
        raise ValueError("chromaticities that no light has")
    (a, b), (c, d) = given[1] - given[0], given[2] - given[0]
    if abs(a * d - b * c) < 1e-4:
        raise ValueError("primaries that lie on a line")
    to_xyz = primaries_to_xyz(given[:3], given[3])
    return of_xyz(to_xyz, (curve, curve, curve))


def of_xyz(
    to_xyz: np.ndarray, curves: tuple[Curve, Curve, Curve], white: np.ndarray | None = None
) -> ColorSpace:
    """A space by its matrix to CIE XYZ, under a white that becomes sRGB's: that of (1, 1, 1) unless given."""
    white = to_xyz.sum(axis=1) if white is None else white
    adapted = bradford(white, _SRGB_TO_XYZ.sum(axis=1)) @ to_xyz
    return ColorSpace(np.linalg.solve(_SRGB_TO_XYZ, adapted), curves)


SRGB = of_primaries(SRGB_PRIMARIES, srgb_to_linear)
ADOBE_RGB = of_primaries(((0.64, 0.33), (0.21, 0.71), (0.15, 0.06)), gamma(563 / 256))
"""Adobe RGB (1998), whose gamma is 2 51/256."""
