"""LibRaw as the camera: its switches are the effects, its plain development the camera that lacks nothing.

The sensors are the study's own; what follows them nobody here wrote. A base takes up tone and colour itself,
and it may have LibRaw's demosaicker.
"""

import tempfile
from collections.abc import Mapping
from dataclasses import dataclass, field
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import numpy as np
import rawpy
import tifffile

from .bodies import BODIES, Body
from .camera import Shot, before_body, compressed, expose
from .scenes import scenes as scene_set
from .shoot import description

_SRGB_TO_XYZ = np.array(
    [[0.4124564, 0.3575761, 0.1804375], [0.2126729, 0.7151522, 0.0721750], [0.0193339, 0.1191920, 0.9503041]]
)
_PATIENCE = 60.0  # seconds for a picture that takes a fraction of one
_DEMOSAICKER = rawpy.DemosaicAlgorithm


@dataclass(frozen=True)
class Switch:
    """Arguments of `postprocess`, and which first causes are right, or "none"."""

    settings: dict[str, Any] = field(default_factory=dict)
    right: tuple[str, ...] = ("none",)


_PLAIN: dict[str, Any] = {
    "use_camera_wb": True,
    "no_auto_bright": True,
    "adjust_maximum_thr": 0.0,  # else white is what the brightest pixel has, picture by picture
    "output_color": rawpy.ColorSpace.sRGB,
}
SWITCHES = {
    "plain": Switch(),
    "linear": Switch({"demosaic_algorithm": _DEMOSAICKER.LINEAR}, ("demosaicking", "none")),
    "vng": Switch({"demosaic_algorithm": _DEMOSAICKER.VNG}, ("demosaicking", "none")),
    "ppg": Switch({"demosaic_algorithm": _DEMOSAICKER.PPG}, ("demosaicking", "none")),
    "dcb": Switch({"demosaic_algorithm": _DEMOSAICKER.DCB}, ("demosaicking", "none")),
    "medians": Switch({"median_filter_passes": 3}, ("chroma_denoising",)),
    "fbdd": Switch(
        {"fbdd_noise_reduction": rawpy.FBDDNoiseReductionMode.Full}, ("chroma_denoising", "luma_denoising")
    ),
    "wavelets": Switch({"noise_thr": 300.0}, ("luma_denoising", "chroma_denoising")),
    "blended_highlights": Switch({"highlight_mode": rawpy.HighlightMode.Blend}, ("highlight_clipping",)),
    "rebuilt_highlights": Switch(
        {"highlight_mode": rawpy.HighlightMode.ReconstructDefault}, ("highlight_clipping",)
    ),
    "lateral_colour": Switch({"chromatic_aberration": (1.004, 0.996)}, ("lateral_chromatic_aberration",)),
    "brightness": Switch({"bright": 1.3}),
    "curve": Switch({"gamma": (1.8, 6.0)}),
    "primaries": Switch({"output_color": rawpy.ColorSpace.Adobe}),
}


def write(
    folder: Path, body: str, effects: Mapping[str, int], kind: str, scenes: str, size: int, count: int
) -> None:
    """Write RAW+JPEG pairs whose pictures LibRaw made with the switches that `effects` names."""
    (name,) = effects
    chosen = BODIES[body]
    for scene, picture in scene_set(scenes, size, count).items():
        raw = expose(before_body(picture, chosen), Shot(chosen, kind, (), scene))
        np.save(folder / f"{scene}.raw.npy", raw)
        pixels = _in_a_child(raw, chosen, SWITCHES[name].settings)
        (folder / f"{scene}.jpg").write_bytes(compressed(pixels, chosen.quality, "4:4:4"))
    (folder / "dataset.toml").write_text(description(chosen, kind))


def _in_a_child(raw: np.ndarray, body: Body, settings: Mapping[str, Any]) -> np.ndarray:
    """LibRaw may crash or hang where it denoises (rawpy 0.28 does): then this raises TimeoutError."""
    with get_context("spawn").Pool(1) as child:
        pixels: np.ndarray = child.apply_async(developed, (raw, body.name, dict(settings))).get(_PATIENCE)
        return pixels


def developed(raw: np.ndarray, body: str, settings: Mapping[str, Any]) -> np.ndarray:
    """The picture in 8 bits that LibRaw makes, (H, W, 3)."""
    with tempfile.NamedTemporaryFile(suffix=".dng") as file:
        _save_dng(file.name, raw, BODIES[body])
        with rawpy.imread(file.name) as opened:
            return opened.postprocess(**_PLAIN | dict(settings))


def _save_dng(path: str, raw: np.ndarray, body: Body) -> None:
    """The least that a DNG must state."""
    gains = np.array(body.gains)
    from_xyz = np.linalg.inv(_SRGB_TO_XYZ @ body.matrix @ np.diag(gains))
    tags = [
        (50706, 1, 4, bytes((1, 4, 0, 0))),
        (50708, 2, 0, f"withheld {body.name}"),
        (33421, 3, 2, (2, 2)),
        (33422, 1, 4, bytes("RGB".index(c) for c in body.cfa)),
        (50714, 3, 1, int(body.black)),
        (50717, 3, 1, int(body.white)),
        (50721, 10, 9, _fractions(from_xyz)),
        (50728, 5, 3, _fractions(1 / gains)),
        (50778, 3, 1, 21),
    ]
    tifffile.imwrite(
        path, raw, photometric="cfa", subfiletype=0, metadata=None, software=None,
        extratags=[(*tag, True) for tag in tags],
    )  # fmt: skip


def _fractions(values: np.ndarray) -> tuple[int, ...]:
    return tuple(int(n) for v in np.ravel(values) for n in (round(1e6 * v), 10**6))
