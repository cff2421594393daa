"""LibRaw by the options of its Python binding; pictures are encoded by OpenCV."""

from collections.abc import Mapping, Sequence
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import rawpy

from .switches import NONE, Settings, Switch

_D = rawpy.DemosaicAlgorithm
_PATIENCE = 60.0  # s for a picture that takes a fraction of one: its denoising may hang
_PLAIN: dict[str, Any] = {
    "use_camera_wb": True,
    "no_auto_bright": True,
    "adjust_maximum_thr": 0.0,
    "output_color": rawpy.ColorSpace.sRGB,
}
PROFILES: Mapping[str, Settings] = {
    "imx219": {"demosaic_algorithm": _D.AHD, "jpeg": (92, "4:4:4")},
    "imx296": {"demosaic_algorithm": _D.DCB, "jpeg": (95, "4:2:0")},
    "imx378": {"demosaic_algorithm": _D.AHD, "gamma": (2.222, 4.5), "jpeg": (90, "4:2:2")},
    "imx477": {"demosaic_algorithm": _D.DHT, "jpeg": (93, "4:4:4")},
    "ov5647": {"demosaic_algorithm": _D.AHD, "bright": 1.2, "jpeg": (94, "4:4:4")},
    "checker": {"demosaic_algorithm": _D.AHD, "bright": 1.4, "jpeg": (95, "4:4:4")},
    "indoor": {"demosaic_algorithm": _D.AHD, "bright": 2.0, "jpeg": (92, "4:4:4")},
    "kissx4": {"demosaic_algorithm": _D.PPG, "jpeg": (93, "4:2:2")},
    "outdoor": {"demosaic_algorithm": _D.VNG, "jpeg": (95, "4:4:4")},
}
SWITCHES: Mapping[str, Switch] = {
    "medians": Switch(
        "chroma_denoising", [{"median_filter_passes": v} for v in (1, 2, 3, 5, 8)], ("demosaicking",)
    ),
    "impulses": Switch(
        "chroma_denoising",
        [
            {"fbdd_noise_reduction": v}
            for v in (rawpy.FBDDNoiseReductionMode.Light, rawpy.FBDDNoiseReductionMode.Full)
        ],
        ("luma_denoising",),
    ),
    "lateral_colour": Switch(
        "lateral_chromatic_aberration",
        [{"chromatic_aberration": (1 + v, 1 - 0.7 * v)} for v in (0.0006, 0.0012, 0.0025, 0.005, 0.009)],
    ),
    "saturation_level": Switch("highlight_clipping", [{"clipped": v} for v in (0.9, 0.8, 0.7, 0.6, 0.45)]),
    "black": Switch(NONE, [{"lower_black": v} for v in (0.005, 0.01, 0.02)], ("black_level_offset",)),
    "demosaicker": Switch(
        NONE,
        [{"demosaic_algorithm": v} for v in (_D.LINEAR, _D.VNG, _D.PPG, _D.DCB, _D.AAHD)],
        ("demosaicking",),
    ),
    "enhanced": Switch(
        NONE,
        [{"demosaic_algorithm": _D.DCB, "dcb_iterations": v, "dcb_enhance": True} for v in (1, 2, 4)],
        ("demosaicking",),
    ),
    "lost_header": Switch(
        "jpeg_quantization", [{"lossless": q} for q in (90, 80, 68, 55, 40)], ("double_compression",)
    ),
    "quality": Switch(NONE, [{"jpeg": (q, "4:2:0")} for q in (85, 70, 50)]),
}


def develop(raws: Sequence[Path], camera: str, settings: Settings, out: Path) -> list[Path]:
    """See `switches.Converter`."""
    own = {**PROFILES[camera], **settings}
    quality, sampling = own.pop("jpeg")
    if "lossless" in own:
        quality, sampling = own.pop("lossless"), "4:4:4"
    out.mkdir(parents=True, exist_ok=True)
    written = []
    with get_context("spawn").Pool(1) as child:
        for raw in raws:
            pixels = child.apply_async(_developed, (str(raw), own)).get(_PATIENCE)
            factor = getattr(cv2, f"IMWRITE_JPEG_SAMPLING_FACTOR_{sampling.replace(':', '')}")
            options = [cv2.IMWRITE_JPEG_QUALITY, quality, cv2.IMWRITE_JPEG_SAMPLING_FACTOR, factor]
            written.append(out / f"{raw.stem}.jpg")
            written[-1].write_bytes(
                cv2.imencode(".jpg", np.ascontiguousarray(pixels[..., ::-1]), options)[1].tobytes()
            )
    return written


def _developed(path: str, settings: dict[str, Any]) -> np.ndarray:
    with rawpy.imread(path) as opened:
        if "clipped" in settings:  # a share of the range from black on
            black, white = float(np.mean(opened.black_level_per_channel)), float(opened.white_level)
            settings["user_sat"] = round(black + settings.pop("clipped") * (white - black))
        if "lower_black" in settings:
            black, white = float(np.mean(opened.black_level_per_channel)), float(opened.white_level)
            settings["user_black"] = round(black - settings.pop("lower_black") * (white - black))
        return opened.postprocess(**_PLAIN | settings)
