"""Demosaicking against colour-demosaicing, the patent and papers in NumPy, and LibRaw."""

import tempfile
from collections.abc import Iterator
from importlib.metadata import version
from pathlib import Path
from typing import Any

import jax
import numpy as np
import rawpy

from benchmarks.exact.row import Row, largest
from jaxisp.cfa import PATTERNS
from jaxisp.testing import smooth_image
from tests.stages.test_demosaic import (
    PEERS,
    ahd_by_arrays,
    hibbard_by_loops,
    inside,
    mosaic_of,
    photograph,
    run,
)

SHAPES = ((29, 34), (64, 65), (101, 78))


def rows() -> Iterator[Row]:
    for name in PEERS:
        yield against_colour_demosaicing(name, np.float32)
        yield against_colour_demosaicing(name, np.float64)
    yield hibbard()
    yield ahd_paper()
    yield ahd_libraw()


def mosaics(cfa: str) -> Iterator[np.ndarray]:
    """Waves and a photograph in 12 bits, where ties between directions are ties in any precision."""
    for shape in SHAPES:
        yield np.round(4096 * smooth_image(shape)) / 4096
    yield mosaic_of(photograph(), cfa)


def output(name: str, mosaic: np.ndarray, dtype: Any, **static: Any) -> np.ndarray:
    with jax.enable_x64(dtype == np.float64):
        return run(name, mosaic.astype(dtype), **static)


def against_colour_demosaicing(name: str, dtype: Any) -> Row:
    reference, border = PEERS[name]
    worst = [
        largest(inside(output(name, mosaic, dtype, cfa=cfa), border), inside(reference(mosaic, cfa), border))
        for cfa in PATTERNS
        for mosaic in mosaics(cfa)
    ]
    precision = "single" if dtype == np.float32 else "double"
    ran = f"four CFAs, waves and a photograph, 29x34 to 160x160, {precision} precision, inside of {border} px"
    reference_name = f"colour-demosaicing {version('colour-demosaicing')}"
    return Row(name, reference_name, ran, max(worst), 1e-5)


def hibbard() -> Row:
    worst = []
    for cfa in PATTERNS:
        for mosaic in (smooth_image((29, 34)), mosaic_of(photograph(), cfa)[:61, :50]):
            want = hibbard_by_loops(mosaic, cfa)
            worst += [largest(output("demosaic_hibbard", mosaic, np.float32, cfa=cfa), want)]
    ran = "four CFAs, waves and a photograph, single precision, borders too"
    return Row("demosaic_hibbard", "the patent's equations in loops", ran, max(worst), 1e-6)


def ahd_paper() -> Row:
    worst = []
    for cfa in PATTERNS:
        for delta, passes in ((2, 0), (1, 0), (2, 3)):
            for mosaic in (smooth_image((29, 34)), 1.5 * smooth_image((41, 32), 1) - 0.2):
                options = {"cfa": cfa, "delta": delta, "median_passes": passes}
                got = output("demosaic_ahd", mosaic, np.float64, **options)
                worst.append(largest(got, ahd_by_arrays(mosaic, cfa, delta, passes)))
    ran = "four CFAs, delta 1 and 2, none or three medians, double precision, borders too"
    return Row("demosaic_ahd", "Hirakawa & Parks 2005 in NumPy", ran, max(worst), 1e-6)


def ahd_libraw() -> Row:
    """The variant that follows LibRaw must be near it; the default is the paper's rule, another algorithm."""
    from benchmarks import ahd_libraw as libraw

    variants: tuple[dict[str, Any], ...] = ({"variant": "libraw", "delta": 1}, {})
    decibels: list[list[float]] = [[], []]
    with tempfile.TemporaryDirectory() as folder:
        for path in libraw.photographs(Path(folder)):
            theirs, mosaic, cfa, _ = libraw.libraw(path)
            for found, static in zip(decibels, variants):
                error = inside(libraw.demosaic(mosaic, cfa, static) - theirs, libraw.BORDER)
                found.append(float(-10 * np.log10(np.mean(error**2))))
    variant, paper = (f"{min(of):.1f} to {max(of):.1f} dB" for of in decibels)
    where = f"three photographs as DNG, inside of {libraw.BORDER} px"
    ran = f"{where}: {variant}; the default, which is the paper's rule, reaches {paper}"
    reference = f"rawpy {rawpy.__version__}, LibRaw {'.'.join(map(str, rawpy.libraw_version))}"
    name = 'demosaic_ahd(variant="libraw", delta=1)'
    return Row(name, reference, ran, min(decibels[0]), 45.0, "dB", at_least=True)
