"""Camera bodies: what each sensor and its processing are when nothing is withheld.

A body is black level, gains, one matrix, one tone curve, a demosaicker and Poisson-plus-read noise, then an
encoder. The bodies differ in all of it, in the order of operations and in what they do at the border.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import numpy as np

from .curves import (
    arc_tangent,
    beta_share,
    broadcast_with_lifted_shadows,
    broadcast_with_s,
    compressed_then_srgb,
    error_of_root,
    extended_reinhard,
    film_density,
    filmic,
    half_displaced_root,
    half_logarithmic,
    hybrid_log,
    hyperbolic_sine,
    hyperbolic_tangent,
    lightness,
    piecewise,
    power_from_an_offset,
    power_with_s,
    quarter_sine,
    ratio_of_powers,
    saturating,
    srgb_with_contrast,
    srgb_with_shoulder,
    steep_in_the_middle,
    toe_and_power,
    two_powers,
    white_point_then_broadcast,
)

Curve = Callable[[np.ndarray], np.ndarray]


@dataclass(frozen=True)
class Noise:
    """Electrons at white, read noise in electrons, and the shape of the read noise."""

    full_well: float
    read: float
    reach: float = 0.0  # correlation between neighbours, Gaussian sigma in pixels
    freedom: float = np.inf  # Student's degrees of freedom


@dataclass(frozen=True)
class Body:
    name: str
    cfa: str
    bits: int
    black: float
    gains: tuple[float, float, float]
    matrix: np.ndarray = field(repr=False)  # balanced camera colours to linear sRGB
    curve: Curve = field(repr=False)
    demosaicker: str
    other_demosaicker: str
    quality: int
    sampling: str = "4:4:4"
    encoder: str = "pillow"
    order: str = "balance-first"  # or "balance-last": gains after demosaicking
    border: str = "reflect"
    exposure: float = 0.9  # share of the RAW range that the scene's white fills in green
    spot: float = 0.5  # lens and pixel aperture, Gaussian sigma in pixels; part of the scene it is shown
    luma_share: float = 0.0  # share of the tone curve that acts on luma rather than on each channel
    intermediate_bits: int = 16
    sign: int = 1  # which way effects with two directions go
    bright: Noise = Noise(12000.0, 3.0)
    dim: Noise = Noise(1500.0, 8.0)
    seeds: str = ""  # whose name its draws come from, where that is not its own: it was run under that
    standing: tuple[str, ...] = ()  # what a simulator without this body's demosaicker misses from the start

    @property
    def white(self) -> float:
        return float(2**self.bits - 1)

    def noise(self, kind: str) -> Noise:
        return self.bright if kind == "raw+jpeg" else self.dim


def _matrix(*rows: tuple[float, float, float]) -> np.ndarray:
    matrix = np.array(rows)
    return matrix / matrix.sum(axis=1, keepdims=True)


def _by_name(bodies: Sequence[Body]) -> dict[str, Body]:
    found = {body.name: body for body in bodies}
    if len(found) < len(bodies):
        raise ValueError("two bodies have one name")
    return found


BODIES = _by_name(
    (
        Body(
            "alder", "RGGB", 10, 64.0, (1.9, 1.0, 1.6),
            _matrix((1.5, -0.4, -0.1), (-0.2, 1.4, -0.2), (0.0, -0.4, 1.4)),
            power_with_s, "bilinear", "hamilton-adams", 95,
        ),
        Body(
            "birch", "BGGR", 12, 256.0, (2.2, 1.0, 1.4),
            _matrix((1.7, -0.6, -0.1), (-0.25, 1.5, -0.25), (0.05, -0.55, 1.5)),
            srgb_with_shoulder, "malvar", "bilinear", 93,
            encoder="opencv", order="balance-last", border="cells", sign=-1, exposure=0.8, spot=0.45,
        ),
        Body(
            "cedar", "GRBG", 14, 512.0, (1.7, 1.0, 2.0),
            _matrix((1.4, -0.25, -0.15), (-0.3, 1.6, -0.3), (-0.05, -0.3, 1.35)),
            filmic, "edge-aware", "bilinear", 92, sampling="4:2:0", border="own",
            bright=Noise(20000.0, 4.0), dim=Noise(2200.0, 10.0), standing=("demosaicking",),
        ),
        Body(
            "dogwood", "GBRG", 12, 128.0, (2.0, 1.0, 1.8),
            _matrix((1.6, -0.5, -0.1), (-0.15, 1.3, -0.15), (0.0, -0.5, 1.5)),
            piecewise, "variable-gradients", "malvar", 94, sampling="4:2:2", encoder="opencv",
            order="balance-first", sign=-1, intermediate_bits=14, spot=0.55,
            bright=Noise(9000.0, 2.0), dim=Noise(1200.0, 6.0), standing=("demosaicking",),
        ),
        Body(
            "elder", "RGGB", 12, 200.0, (1.8, 1.0, 1.7),
            _matrix((1.55, -0.4, -0.15), (-0.2, 1.45, -0.25), (0.02, -0.42, 1.4)),
            broadcast_with_s, "hamilton-adams", "malvar", 96, order="balance-last", exposure=0.85,
            luma_share=0.04, sign=-1, bright=Noise(15000.0, 5.0), dim=Noise(1800.0, 12.0),
        ),
        Body(
            "fir", "GRBG", 12, 240.0, (2.1, 1.0, 1.5),
            _matrix((1.45, -0.3, -0.15), (-0.25, 1.5, -0.25), (0.0, -0.5, 1.5)),
            power_from_an_offset, "malvar", "hamilton-adams", 91, sampling="4:2:0", encoder="opencv",
            order="balance-last", exposure=0.95, spot=0.6, dim=Noise(1000.0, 7.0),
        ),
        Body(
            "ginkgo", "BGGR", 14, 1024.0, (1.6, 1.0, 2.2),
            _matrix((1.6, -0.45, -0.15), (-0.2, 1.35, -0.15), (-0.05, -0.4, 1.45)),
            half_logarithmic, "hamilton-adams", "bilinear", 97, border="cells", exposure=0.85,
            luma_share=0.03, bright=Noise(18000.0, 3.5), dim=Noise(2500.0, 9.0),
        ),
        Body(
            "hazel", "GBRG", 10, 60.0, (2.3, 1.0, 1.5),
            _matrix((1.65, -0.55, -0.1), (-0.2, 1.45, -0.25), (0.03, -0.48, 1.45)),
            srgb_with_contrast, "bilinear", "malvar", 93, sampling="4:2:2", border="own", sign=-1,
            intermediate_bits=12, spot=0.5, bright=Noise(10000.0, 4.0), dim=Noise(1600.0, 9.0),
        ),
        Body(
            "juniper", "RGGB", 12, 160.0, (2.0, 1.0, 1.9),
            _matrix((1.5, -0.35, -0.15), (-0.2, 1.4, -0.2), (-0.02, -0.5, 1.52)),
            hybrid_log, "malvar", "bilinear", 94, sampling="4:2:0", order="balance-last",
            exposure=0.9, spot=0.5, sign=-1, bright=Noise(14000.0, 4.0), dim=Noise(1400.0, 8.0),
        ),
        Body(
            "katsura", "GBRG", 14, 400.0, (1.8, 1.0, 1.5),
            _matrix((1.6, -0.5, -0.1), (-0.28, 1.5, -0.22), (0.02, -0.4, 1.38)),
            compressed_then_srgb, "hamilton-adams", "malvar", 96, encoder="opencv", border="cells",
            exposure=0.8, spot=0.55, bright=Noise(16000.0, 3.0), dim=Noise(2000.0, 11.0),
        ),
        Body(
            "larch", "BGGR", 10, 80.0, (2.2, 1.0, 1.7),
            _matrix((1.45, -0.3, -0.15), (-0.18, 1.36, -0.18), (0.0, -0.46, 1.46)),
            toe_and_power, "bilinear", "hamilton-adams", 92, sampling="4:2:2", border="own",
            intermediate_bits=13, exposure=0.92, spot=0.5, luma_share=0.02,
            bright=Noise(11000.0, 3.0), dim=Noise(1300.0, 7.0),
        ),
        Body(
            "maple", "GRBG", 12, 300.0, (1.7, 1.0, 2.1),
            _matrix((1.55, -0.45, -0.1), (-0.22, 1.42, -0.2), (0.03, -0.53, 1.5)),
            saturating, "variable-gradients", "bilinear", 95, encoder="opencv", order="balance-last",
            exposure=0.85, spot=0.5, sign=-1, bright=Noise(13000.0, 2.5), dim=Noise(1700.0, 8.0),
            standing=("demosaicking",),
        ),
        Body(
            "nutmeg", "RGGB", 14, 600.0, (2.1, 1.0, 1.4),
            _matrix((1.48, -0.33, -0.15), (-0.24, 1.5, -0.26), (0.01, -0.45, 1.44)),
            broadcast_with_lifted_shadows, "malvar", "hamilton-adams", 93, sampling="4:2:2",
            border="cells", exposure=0.9, spot=0.55, luma_share=0.03, intermediate_bits=14,
            bright=Noise(17000.0, 5.0), dim=Noise(1900.0, 10.0),
        ),
        # drawn by np.random.default_rng(20261123) but for the curves
        Body(
            "oak", "GBRG", 10, 27.0, (1.56, 1.0, 1.73),
            _matrix((1.7, -0.41, -0.29), (-0.3, 1.36, -0.06), (-0.47, -0.03, 1.49)),
            ratio_of_powers, "bilinear", "hamilton-adams", 97, sampling="4:2:2", encoder="opencv",
            order="balance-last", border="own", exposure=0.92, spot=0.52, luma_share=0.05,
            intermediate_bits=12, sign=-1, bright=Noise(19000.0, 2.4), dim=Noise(1100.0, 8.0),
        ),
        Body(
            "poplar", "GBRG", 14, 304.0, (2.33, 1.0, 1.41),
            _matrix((1.78, -0.55, -0.24), (-0.16, 1.29, -0.13), (-0.31, -0.07, 1.38)),
            white_point_then_broadcast, "hamilton-adams", "malvar", 93, sampling="4:2:0",
            order="balance-last", border="own", exposure=0.81, spot=0.48, luma_share=0.05,
            intermediate_bits=14, bright=Noise(19000.0, 3.6), dim=Noise(2100.0, 9.0),
        ),
        Body(
            "rowan", "BGGR", 14, 256.0, (1.86, 1.0, 1.43),
            _matrix((1.55, -0.39, -0.16), (-0.16, 1.35, -0.19), (-0.04, -0.13, 1.17)),
            arc_tangent, "malvar", "bilinear", 94, order="balance-last", exposure=0.81, spot=0.47,
            luma_share=0.03, intermediate_bits=14, bright=Noise(14000.0, 3.7), dim=Noise(2200.0, 10.0),
        ),
        # by np.random.default_rng(20261124)
        Body(
            "spruce", "RGGB", 14, 1114.0, (1.63, 1.0, 1.64),
            _matrix((1.79, -0.34, -0.45), (-0.48, 1.73, -0.25), (-0.44, -0.4, 1.84)),
            hyperbolic_sine, "hamilton-adams", "malvar", 92, sampling="4:2:2", encoder="opencv",
            exposure=0.86, spot=0.57, luma_share=0.04, bright=Noise(14000.0, 2.3), dim=Noise(1700.0, 7.0),
        ),
        Body(
            "tamarack", "RGGB", 14, 497.0, (2.14, 1.0, 1.53),
            _matrix((1.43, -0.39, -0.04), (-0.45, 1.56, -0.11), (-0.17, -0.32, 1.49)),
            half_displaced_root, "edge-aware", "malvar", 94, sampling="4:2:2", encoder="opencv",
            border="own", exposure=0.85, spot=0.52, bright=Noise(13000.0, 4.5), dim=Noise(1300.0, 7.0),
            standing=("demosaicking",),
        ),
        Body(
            "walnut", "GBRG", 14, 913.0, (2.1, 1.0, 1.94),
            _matrix((1.93, -0.52, -0.41), (-0.05, 1.1, -0.05), (-0.33, -0.52, 1.85)),
            hyperbolic_tangent, "bilinear", "hamilton-adams", 94, sampling="4:2:2", border="cells",
            exposure=0.8, spot=0.59, luma_share=0.02, intermediate_bits=14, sign=-1,
            bright=Noise(13000.0, 4.3), dim=Noise(1000.0, 8.0),
        ),
        # by np.random.default_rng(20261125)
        Body(
            "yew", "BGGR", 12, 90.0, (2.12, 1.0, 1.56),
            _matrix((1.33, -0.04, -0.29), (-0.44, 1.88, -0.44), (-0.12, -0.04, 1.16)),
            two_powers, "malvar", "hamilton-adams", 94, sampling="4:2:0", order="balance-last",
            border="own", exposure=0.88, spot=0.45, luma_share=0.03, intermediate_bits=12, sign=-1,
            bright=Noise(10000.0, 2.1), dim=Noise(2200.0, 7.0),
        ),
        Body(
            "zelkova", "BGGR", 10, 66.0, (1.91, 1.0, 1.67),
            _matrix((1.58, -0.36, -0.22), (-0.45, 1.63, -0.18), (-0.47, -0.28, 1.75)),
            quarter_sine, "variable-gradients", "hamilton-adams", 94, encoder="opencv",
            order="balance-last", border="cells", exposure=0.85, spot=0.52, luma_share=0.02,
            intermediate_bits=12, sign=-1, bright=Noise(19000.0, 3.8), dim=Noise(1600.0, 10.0),
            standing=("demosaicking",),
        ),
        # by np.random.default_rng(2026112425)
        Body(
            "acacia", "GRBG", 14, 711.0, (2.31, 1.0, 2.07),
            _matrix((1.37, -0.25, -0.46), (-0.12, 1.2, -0.4), (-0.21, -0.19, 1.38)),
            extended_reinhard, "malvar", "bilinear", 93, encoder="opencv", order="balance-last",
            exposure=0.83, spot=0.58, luma_share=0.02, intermediate_bits=14,
            bright=Noise(18000.0, 2.5), dim=Noise(1600.0, 7.0),
        ),
        Body(
            "banyan", "BGGR", 12, 106.0, (1.67, 1.0, 1.78),
            _matrix((1.43, -0.06, -0.47), (-0.13, 1.69, -0.09), (-0.08, -0.45, 1.52)),
            steep_in_the_middle, "variable-gradients", "bilinear", 96, sampling="4:2:0", encoder="opencv",
            order="balance-last", border="own", exposure=0.83, spot=0.56, luma_share=0.03, sign=-1,
            bright=Noise(19000.0, 2.5), dim=Noise(1400.0, 9.0), standing=("demosaicking",),
        ),
        # by np.random.default_rng(20261126)
        Body(
            "catalpa", "RGGB", 14, 267.0, (1.92, 1.0, 1.59),
            _matrix((1.88, -0.26, -0.2), (-0.2, 1.66, -0.23), (-0.43, -0.29, 1.75)),
            lightness, "malvar", "bilinear", 94, exposure=0.88, spot=0.48, luma_share=0.03, sign=-1,
            bright=Noise(10000.0, 3.3), dim=Noise(1600.0, 9.0),
        ),
        Body(
            "durian", "GRBG", 12, 139.0, (1.94, 1.0, 2.03),
            _matrix((1.45, -0.38, -0.24), (-0.4, 1.29, -0.13), (-0.05, -0.15, 1.3)),
            film_density, "variable-gradients", "bilinear", 94, sampling="4:2:0", border="own",
            exposure=0.82, spot=0.56, luma_share=0.02, intermediate_bits=14,
            bright=Noise(14000.0, 2.1), dim=Noise(1700.0, 8.4), standing=("demosaicking",),
        ),
        # by np.random.default_rng(20261127)
        Body(
            "elm", "GRBG", 14, 228.0, (1.94, 1.0, 1.62),
            _matrix((1.6, -0.47, -0.13), (-0.33, 1.71, -0.38), (-0.22, -0.28, 1.5)),
            beta_share, "malvar", "bilinear", 93, encoder="opencv", order="balance-last",
            exposure=0.85, spot=0.48, luma_share=0.04, intermediate_bits=14,
            bright=Noise(16000.0, 3.7), dim=Noise(2100.0, 7.5), seeds="elder",
        ),
        Body(
            "fig", "GRBG", 14, 593.0, (2.07, 1.0, 1.47),
            _matrix((1.37, -0.3, -0.07), (-0.08, 1.53, -0.45), (-0.2, -0.12, 1.32)),
            error_of_root, "bilinear", "variable-gradients", 92, sampling="4:2:0", order="balance-last",
            exposure=0.84, spot=0.57, luma_share=0.01, intermediate_bits=14,
            bright=Noise(15000.0, 4.2), dim=Noise(2200.0, 7.6),
        ),
    )
)  # fmt: skip
LATER = (
    "juniper",
    "katsura",
    "larch",
    "maple",
    "nutmeg",
    "oak",
    "poplar",
    "rowan",
    "spruce",
    "tamarack",
    "walnut",
    "yew",
    "zelkova",
    "acacia",
    "banyan",
    "catalpa",
    "durian",
    "elm",
    "fig",
)
"""Bodies that came last: what they were diagnosed with was settled before (docs/diagnosis.md)."""
