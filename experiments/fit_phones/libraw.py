"""Pairs developed by LibRaw with settings that the fitter is not told."""

import tempfile
from concurrent.futures import ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from functools import partial
from multiprocessing import active_children, get_context
from pathlib import Path
from typing import Any

import numpy as np
import rawpy

from experiments.fit_phones.common import SEED, Cases, Run, fitted, short
from jaxisp.color import XYZ_TO_SRGB
from jaxisp.io import write_dng, write_png
from jaxisp.samples import PHONES, scene, scene_names, shoot

MOST_SECONDS = 120
DRAWS = 4  # of settings for each file
FRAME = "ColorCheckerRAW_1920x1080_12bit_BGGR"
"""A sensor's words without a header, of which its origin says: black about 200. It saturates at 4092."""
ALGORITHMS = ("LINEAR", "VNG", "PPG", "AHD", "DCB")


def runs(data: Path | None) -> dict[str, Run]:
    raws = sorted((data / "raw").glob("*.dng")) if data else []
    frame = data / "raw" / f"{FRAME}.raw" if data else None
    frames = {FRAME: partial(libraw_on_frame, frame, 200)} if frame and frame.exists() else {}
    return (
        frames
        | {
            f"{path.stem}{f' {draw + 1}' * (draw > 0)}": partial(against_libraw, path, i + 10 * draw)
            for i, path in enumerate(raws)
            for draw in range(DRAWS)
        }
        | {f"phone_{name}": partial(libraw_on_phone, name, 100 + i) for i, name in enumerate(PHONES)}
    )


def libraw_on_phone(name: str, seed: int) -> dict[str, Any]:
    mosaic, _, header = shoot(scene(scene_names()["abc".index(name)], 288), PHONES[name], SEED)
    header["orientation"] = 1
    with tempfile.TemporaryDirectory() as temporary:
        path = Path(temporary) / f"phone_{name}.dng"
        write_dng(path, mosaic, **header)
        return against_libraw(path, seed)


def libraw_on_frame(path: Path, seed: int) -> dict[str, Any]:
    with tempfile.TemporaryDirectory() as temporary:
        return against_libraw(framed_dng(path, Path(temporary) / "frame.dng"), seed)


def framed_dng(path: Path, dng: Path) -> Path:
    """The frame as a DNG."""
    return grey_dng(np.fromfile(path, "<u2").reshape(1080, 1920), "BGGR", 200, 4092, dng)


def grey_dng(mosaic: np.ndarray, cfa: str, black: int, white: int, dng: Path) -> Path:
    """A sensor's words as a DNG of a camera that sees sRGB's primaries, balanced to grey on the whole."""
    light = [mosaic[i // 2 :: 2, i % 2 :: 2].astype(float).mean() - black for i in range(4)]
    red, green, blue = (np.mean([v for v, c in zip(light, cfa) if c == color]) for color in "RGB")
    write_dng(
        dng, mosaic, cfa=cfa, black=(black,), white=white, color_matrix=XYZ_TO_SRGB,
        as_shot_neutral=(red / green, 1.0, blue / green),
    )  # fmt: skip
    return dng


def against_libraw(path: Path, seed: int) -> dict[str, Any]:
    """A pair developed by LibRaw with settings that are drawn, not told."""
    settings, picture = against(path, seed)
    with tempfile.TemporaryDirectory() as temporary:
        folder = Path(temporary)
        (folder / path.name).write_bytes(path.read_bytes())
        write_png(folder / f"{path.stem}.png", picture)
        return {"settings": settings, **short(fitted(f"libraw-{path.stem}", folder))}


def against(path: Path, seed: int) -> tuple[dict[str, Any], np.ndarray]:
    """The settings, and the picture (H, W, 3) in [0, 1]."""
    rng = np.random.default_rng((SEED, seed))
    gamma = [(2.222, 4.5), (2.4, 12.92), (1.8, 6.0)][rng.integers(3)]
    settings: dict[str, Any] = {
        "demosaic_algorithm": ALGORITHMS[rng.integers(len(ALGORITHMS))],
        "gamma": gamma,
        "bright": float(rng.uniform(0.8, 1.5)),
        "median_filter_passes": int(rng.integers(0, 3)),
        "noise_thr": float(rng.choice([0, 100, 300])),
    }
    picture = in_a_child(path, settings)
    if picture is None:  # that of rawpy 0.28 corrupts its memory wherever it denoises
        settings |= {"crashed_at": settings["noise_thr"], "noise_thr": 0.0}
        picture = in_a_child(path, settings)
    assert picture is not None, "LibRaw crashed without denoising"
    return settings, picture.astype(np.float32) / 255


def developed_alike(path: Path, settings: dict[str, Any]) -> np.ndarray:
    """Another file of that camera with the settings that `against` found usable: (H, W, 3) in [0, 1]."""
    picture = in_a_child(path, settings)
    assert picture is not None, "LibRaw crashed with settings that it took before"
    return picture.astype(np.float32) / 255


def in_a_child(path: Path, settings: dict[str, Any]) -> np.ndarray | None:
    """LibRaw's picture; None where it crashed, or does not end."""
    with ProcessPoolExecutor(1, get_context("spawn")) as child:
        try:
            return child.submit(by_libraw, path, settings).result(MOST_SECONDS)
        except BrokenProcessPool:
            return None
        except TimeoutError:  # what corrupts its memory can have it wait for itself
            for process in active_children():
                process.kill()
            return None


def by_libraw(path: Path, settings: dict[str, Any]) -> np.ndarray:
    own = {k: v for k, v in settings.items() if k not in ("demosaic_algorithm", "crashed_at")}
    with rawpy.imread(str(path)) as raw:
        return raw.postprocess(
            **own,
            demosaic_algorithm=getattr(rawpy.DemosaicAlgorithm, settings["demosaic_algorithm"]),
            use_camera_wb=True,
            no_auto_bright=True,
            output_color=rawpy.ColorSpace.sRGB,
            user_flip=0,
        )


def page(cases: Cases) -> list[str]:
    lines = [
        "## LibRaw with settings the fitter is not told",
        "",
        "| file | LibRaw's settings | held out [dB / SSIM] | chosen |",
        "| --- | --- | --- | --- |",
    ]
    for name, r in cases.items():
        s = r["settings"]
        text = (
            f"{s['demosaic_algorithm']}, gamma {s['gamma'][0]:g} / {s['gamma'][1]:g}, "
            f"bright {s['bright']:.2f}, "
            f"{s['median_filter_passes']} medians, noise threshold {s['noise_thr']:g}"
        )
        if "crashed_at" in s:
            text += f" (LibRaw crashed with {s['crashed_at']:g})"
        lines.append(
            f"| {name} | {text} | {r['held_out_psnr']:.2f} / {r['held_out_ssim']:.4f} | {r['design']} |"
        )
    return lines
