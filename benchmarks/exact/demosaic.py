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
from jaxisp.cfa import PATTERNS, XTRANS, shifted
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
    yield from markesteijn_libraw()


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
    reference = f"rawpy {version('rawpy')}, LibRaw {'.'.join(map(str, rawpy.libraw_version))}"
    name = 'demosaic_ahd(variant="libraw", delta=1)'
    return Row(name, reference, ran, min(decibels[0]), 45.0, "dB", at_least=True)


def markesteijn_libraw() -> Iterator[Row]:
    """LibRaw has one pass where PPG is asked for, three where AHD is; it takes 512 x 512 pixels at least."""
    from benchmarks import ahd_libraw as libraw

    algorithms = {1: rawpy.DemosaicAlgorithm.PPG, 3: rawpy.DemosaicAlgorithm.AHD}
    agreement: dict[int, list[float]] = {1: [], 3: []}
    other: dict[int, list[float]] = {1: [], 3: []}
    truth: dict[str, list[float]] = {"ours 1": [], "ours 3": [], "LibRaw 1": [], "LibRaw 3": [], "linear": []}

    def decibels(a: np.ndarray, b: np.ndarray) -> float:
        return float(-10 * np.log10(np.mean((inside(a, libraw.BORDER) - inside(b, libraw.BORDER)) ** 2)))

    with tempfile.TemporaryDirectory() as folder:
        for i, (name, picture) in enumerate(libraw.pictures(512)):
            path = libraw.as_dng(Path(folder) / f"{name}.dng", picture, shifted(XTRANS, i, 2 * i))
            theirs = {passes: libraw.libraw(path, algorithm) for passes, algorithm in algorithms.items()}
            for passes, (found, mosaic, cfa, _) in theirs.items():
                ours = output("demosaic_markesteijn", mosaic, np.float32, cfa=cfa, passes=passes)
                agreement[passes].append(decibels(ours, found))
                other[4 - passes].append(decibels(ours, theirs[4 - passes][0]))
                truth[f"ours {passes}"].append(decibels(ours, picture))
                truth[f"LibRaw {passes}"].append(decibels(found, picture))
            linear = output("demosaic_normalized_convolution", mosaic, np.float32, cfa=cfa)
            truth["linear"].append(decibels(linear, picture))

    def span(of: list[float]) -> str:
        return f"{min(of):.1f} to {max(of):.1f}"

    reference = f"rawpy {version('rawpy')}, LibRaw {'.'.join(map(str, rawpy.libraw_version))}"
    for passes in algorithms:
        near = f"{span(agreement[passes])} dB, with passes={4 - passes} {span(other[passes])}"
        own, libraws = span(truth[f"ours {passes}"]), span(truth[f"LibRaw {passes}"])
        right = f"to the photographs {own}, LibRaw's {libraws}, linear interpolation {span(truth['linear'])}"
        where = f"three photographs as X-Trans DNG, in three phases, inside of {libraw.BORDER} px"
        stage = f"demosaic_markesteijn(passes={passes})"
        yield Row(
            stage, reference, f"{where}: {near}; {right}", min(agreement[passes]), 52.0, "dB", at_least=True
        )
