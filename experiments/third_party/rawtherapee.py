"""RawTherapee by its command line: a processing profile of one switch over a plain one."""

import subprocess
import tempfile
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from .pictures import write_hald
from .switches import NONE, OUTSIDE, Settings, Switch

_NEUTRAL = {
    "Version": {"AppVersion": "5.9", "Version": "349"},
    "White Balance": {"Enabled": "true", "Setting": "Camera"},
    "Color Management": {
        "InputProfile": "(camera)",
        "OutputProfile": "RTv4_sRGB",
        "WorkingProfile": "ProPhoto",
    },
    "RAW Bayer": {
        "Method": "amaze",
        "Border": "4",
        "CcSteps": "0",
        "GreenEqThreshold": "0",
        "LineDenoise": "0",
    },
    "RAW": {"CA": "false", "HotPixelFilter": "false", "DeadPixelFilter": "false"},
}
PROFILES: Mapping[str, Settings] = {
    "imx219": {"RAW Bayer": {"Method": "amaze"}, "jpeg": (92, 3)},
    "imx296": {"RAW Bayer": {"Method": "rcd"}, "jpeg": (88, 2)},
    "imx378": {"RAW Bayer": {"Method": "lmmse"}, "jpeg": (95, 1)},
    "imx477": {"RAW Bayer": {"Method": "amaze"}, "Exposure": {"Contrast": "18"}, "jpeg": (90, 1)},
    "ov5647": {"RAW Bayer": {"Method": "dcb"}, "jpeg": (94, 3)},
    "checker": {"RAW Bayer": {"Method": "igv"}, "Exposure": {"Compensation": "0.4"}, "jpeg": (93, 3)},
    "indoor": {"RAW Bayer": {"Method": "amaze"}, "Exposure": {"Compensation": "0.8"}, "jpeg": (92, 3)},
    "kissx4": {"RAW Bayer": {"Method": "ahd"}, "jpeg": (90, 2)},
    "outdoor": {"RAW Bayer": {"Method": "vng4"}, "jpeg": (95, 3)},
}
"""What each camera's own pictures are developed with: its demosaicker, tone, JPEG quality and sampling
(1 for 4:2:0, 2 for 4:2:2, 3 for 4:4:4)."""


def _each(section: str, fixed: Mapping[str, object], field: str, values: Sequence[float]) -> list[Settings]:
    return [{section: {"Enabled": "true", **fixed, field: value}} for value in values]


def _noise(**changed: float) -> Settings:
    plain = {
        "Enabled": "true",
        "Luma": 0,
        "Ldetail": 50,
        "Chroma": 0,
        "Redchro": 0,
        "Bluechro": 0,
        "Method": "Lab",
        "LMethod": "SLI",
        "CMethod": "MAN",
        "C2Method": "MANU",
        "SMethod": "shal",
        "Median": "false",
        "Gamma": 1.7,
        "Passes": 1,
    }
    return {"Directional Pyramid Denoising": plain | changed}


def _bands(strength: float) -> Settings:
    bands = {f"Band{i}": round(v * strength) for i, v in enumerate((1.0, 0.7, 0.2, -0.4, -0.9))}
    return {"ToneEqualizer": {"Enabled": "true", **bands, "Regularization": 4}}


def _hues(strength: float) -> Settings:
    """Saturation of reds more and of blues less, as flat curves of control points state it."""
    points = [(0.0, 0.5 + strength), (0.33, 0.5), (0.66, 0.5 - strength), (0.83, 0.5)]
    curve = "1;" + "".join(f"{x};{y:.3f};0.35;0.35;" for x, y in points)
    return {"HSV Equalizer": {"Enabled": "true", "SCurve": curve, "HCurve": "0;", "VCurve": "0;"}}


_USM = {"Contrast": 20, "Method": "usm", "Radius": 0.5, "Threshold": "20;80;2000;1200;", "OnlyEdges": "false"}
_LINEAR = _USM | {"Contrast": 0, "Radius": 1.0, "Threshold": "0;0;2000;2000;"}
_RL = {"Contrast": 10, "Method": "rld", "DeconvRadius": 0.75, "DeconvDamping": 0, "DeconvIterations": 30}
_CAPTURE = {
    "Contrast": 10,
    "AutoContrast": "false",
    "AutoRadius": "false",
    "DeconvRadiusOffset": 0,
    "DeconvIterCheck": "true",
    "DeconvIterations": 20,
}
SWITCHES: Mapping[str, Switch] = {
    "usm": Switch("sharpening", _each("Sharpening", _USM, "Amount", (80, 150, 250, 450, 800))),
    "usm_linear": Switch("sharpening", _each("Sharpening", _LINEAR, "Amount", (20, 40, 80, 150, 300))),
    "deconvolution": Switch("sharpening", _each("Sharpening", _RL, "DeconvAmount", (15, 30, 50, 75, 100))),
    "capture": Switch(
        "sharpening", _each("PostDemosaicSharpening", _CAPTURE, "DeconvRadius", (0.42, 0.5, 0.6, 0.75, 0.95))
    ),
    "edges": Switch(
        "sharpening",
        _each("SharpenEdge", {"Passes": 2, "ThreeChannels": "false"}, "Strength", (10, 20, 35, 55, 80)),
    ),
    "microcontrast": Switch(
        "sharpening",
        _each(
            "SharpenMicro",
            {"Matrix": "false", "Contrast": 10, "Uniformity": 5},
            "Strength",
            (8, 15, 30, 50, 80),
        ),
        ("local_tone_mapping",),
    ),
    "detail_levels": Switch(
        "sharpening",
        [
            {
                "Directional Pyramid Equalizer": {
                    "Enabled": "true",
                    "cbdlMethod": "aft",
                    "Mult0": v,
                    "Mult1": v,
                    "Threshold": 0.05,
                }
            }
            for v in (1.1, 1.2, 1.4, 1.7, 2.2)
        ],
        ("local_tone_mapping",),
    ),
    "luma_noise": Switch("luma_denoising", [_noise(Luma=v) for v in (10, 20, 35, 55, 80)]),
    "chroma_noise": Switch("chroma_denoising", [_noise(Chroma=v) for v in (4, 8, 16, 35, 70)]),
    "impulse": Switch(
        "luma_denoising",
        _each("Impulse Denoising", {}, "Threshold", (30, 50, 65, 80, 95)),
        ("chroma_denoising",),
    ),
    "false_colour": Switch(
        "chroma_denoising", [{"RAW Bayer": {"CcSteps": v}} for v in (1, 2, 3, 4, 5)], ("demosaicking",)
    ),
    "defringe": Switch(
        "chroma_denoising", _each("Defringing", {"Threshold": 3}, "Radius", (1.0, 1.5, 2.0, 3.0, 4.5))
    ),
    "local_contrast": Switch(
        "local_tone_mapping",
        _each(
            "Local Contrast",
            {"Radius": 40, "Darkness": 1, "Lightness": 1},
            "Amount",
            (0.1, 0.2, 0.35, 0.6, 1.0),
        ),
    ),
    "shadows": Switch(
        "local_tone_mapping",
        _each(
            "Shadows & Highlights",
            {"Highlights": 0, "Radius": 30, "Lab": "false"},
            "Shadows",
            (10, 20, 40, 65, 95),
        ),
    ),
    "tone_equaliser": Switch(
        "local_tone_mapping", [_bands(v) for v in (10, 20, 40, 65, 95)], ("tone_curve", NONE)
    ),
    "compression": Switch(
        "local_tone_mapping",
        _each("FattalToneMapping", {"Threshold": 30, "Anchor": 50}, "Amount", (5, 12, 25, 45, 80)),
    ),
    "edge_preserving": Switch(
        "local_tone_mapping",
        _each(
            "EPD",
            {"Gamma": 1, "EdgeStopping": 1.4, "Scale": 0.3, "ReweightingIterates": 0},
            "Strength",
            (0.05, 0.1, 0.2, 0.4, 0.8),
        ),
    ),
    "dehaze": Switch(
        OUTSIDE, _each("Dehaze", {"Depth": 25, "Saturation": 50}, "Strength", (10, 25, 45, 70, 100))
    ),
    "gradient": Switch(
        OUTSIDE,
        _each(
            "Gradient",
            {"Degree": 30, "Feather": 60, "CenterX": 0, "CenterY": 0},
            "Strength",
            (0.1, 0.2, 0.4, 0.7, 1.2),
        ),
    ),
    "saturation": Switch(
        "saturation",
        [{"Exposure": {"Saturation": v}} for v in (8, 16, 30, 50, 85)],
        ("color_lut", "color_matrix", NONE),
    ),
    "vibrance": Switch(
        "color_lut",
        [
            {"Vibrance": {"Enabled": "true", "Pastels": v, "Saturated": v // 2, "PSThreshold": "0;75;"}}
            for v in (10, 20, 40, 65, 95)
        ],
        ("saturation", NONE),
    ),
    "hues": Switch("color_lut", [_hues(v) for v in (0.05, 0.1, 0.18, 0.3, 0.45)], ("saturation",)),
    "film": Switch(
        "color_lut", [{"Film Simulation": {"Enabled": "true", "Strength": v}} for v in (10, 20, 40, 65, 100)]
    ),
    "resize": Switch("resampling", [{"resize": v} for v in (0.95, 0.87, 0.78, 0.66, 0.5)], ("optical_blur",)),
    "distortion": Switch(
        "geometric_distortion", [{"Distortion": {"Amount": v}} for v in (0.002, 0.005, 0.012, 0.03, 0.07)]
    ),
    "lateral_colour": Switch(
        "lateral_chromatic_aberration",
        [{"CACorrection": {"Red": v, "Blue": -0.7 * v}} for v in (0.0004, 0.0008, 0.0015, 0.0028, 0.0048)],
    ),
    "vignetting": Switch(
        "vignetting",
        [
            {"Vignetting Correction": {"Amount": v, "Radius": 50, "Strength": 1, "CenterX": 0, "CenterY": 0}}
            for v in (6, 12, 25, 45, 75)
        ],
    ),
    "lost_header": Switch(
        "jpeg_quantization", [{"lossless": q} for q in (90, 80, 68, 55, 40)], ("double_compression",)
    ),
    "quality": Switch(NONE, [{"jpeg": (q, 1)} for q in (85, 70, 50)]),
    "contrast": Switch(
        NONE, [{"Exposure": {"Contrast": v, "Compensation": 0.2}} for v in (10, 25, 45)], ("tone_curve",)
    ),
    "warmth": Switch(
        NONE,
        [{"White Balance": {"Setting": "Custom", "Temperature": t, "Green": 1.03}} for t in (4300, 6500)],
        ("white_balance",),
    ),
    "demosaicker": Switch(
        NONE,
        [{"RAW Bayer": {"Method": m}} for m in ("fast", "hphd", "eahd", "rcdvng4", "dcbvng4")],
        ("demosaicking",),
    ),
}


def develop(raws: Sequence[Path], camera: str, settings: Settings, out: Path) -> list[Path]:
    """See `switches.Converter`."""
    merged: dict[str, dict[str, object]] = {}
    for part in (_NEUTRAL, PROFILES[camera], settings):
        for name, values in part.items():
            if isinstance(values, Mapping):
                merged[name] = {**merged.get(name, {}), **values}
    with tempfile.TemporaryDirectory() as scratch:
        if "Film Simulation" in merged:
            merged["Film Simulation"]["ClutFilename"] = str(write_hald(Path(scratch) / "film.png"))
        quality, sampling = settings.get("jpeg", PROFILES[camera]["jpeg"])
        jpeg = [f"-j{settings.get('lossless', quality)}", f"-js{3 if 'lossless' in settings else sampling}"]
        if "resize" not in settings:
            return _run(raws, _profile(merged, Path(scratch) / "own.pp3"), jpeg, out)
        return _resized(raws, merged, float(settings["resize"]), jpeg, Path(scratch), out)


def _resized(
    raws: Sequence[Path],
    merged: Mapping[str, Mapping[str, object]],
    scale: float,
    jpeg: list[str],
    scratch: Path,
    out: Path,
) -> list[Path]:
    """Smaller by a scale, and back to the size that it had: that of the RAW less what is cut off."""
    resize = {"Enabled": "true", "AppliesTo": "Full image", "Method": "Lanczos", "AllowUpscaling": "true"}
    down = {**merged, "Resize": {**resize, "Scale": scale, "DataSpecified": 0}}
    small = _run(raws, _profile(down, scratch / "down.pp3"), ["-t", "-b16"], scratch / "small")
    side = _side(raws[0]) - 2 * int(str(merged["RAW Bayer"]["Border"]))
    up = {
        "Version": _NEUTRAL["Version"],
        "Resize": {**resize, "DataSpecified": 3, "Width": side, "Height": side},
    }
    return _run(small, _profile(up, scratch / "up.pp3"), jpeg, out)


def _side(raw: Path) -> int:
    from jaxisp.io import read_raw

    return int(np.max(read_raw(raw).mosaic.shape))


def _profile(sections: Mapping[str, Mapping[str, object]], path: Path) -> Path:
    text = (
        "\n".join([f"[{name}]", *(f"{k}={v}" for k, v in own.items()), ""]) for name, own in sections.items()
    )
    path.write_text("\n".join(text))
    return path


def _run(files: Sequence[Path], profile: Path, output: list[str], out: Path) -> list[Path]:
    out.mkdir(parents=True, exist_ok=True)
    command = [
        "rawtherapee-cli",
        "-q",
        "-Y",
        "-o",
        str(out),
        "-p",
        str(profile),
        *output,
        "-c",
        *map(str, files),
    ]
    done = subprocess.run(command, capture_output=True, text=True, timeout=600)
    suffix = ".jpg" if output[0].startswith("-j") else ".tif"
    written = [out / f"{path.stem}{suffix}" for path in files]
    missing = [path.name for path in written if not path.exists()]
    if missing:
        raise RuntimeError(
            f"rawtherapee-cli wrote no {', '.join(missing)}: {done.stderr[-400:] or done.stdout[-400:]}"
        )
    return written
