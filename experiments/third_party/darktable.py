"""darktable by its command line: a sidecar file whose history has one module over a plain one.

A sidecar holds each module's parameters as the bytes of a structure. Their order, from darktable 4.2, stands
at each module below.
"""

import os
import struct
import subprocess
import tempfile
from collections.abc import Mapping, Sequence
from pathlib import Path

from .switches import NONE, OUTSIDE, Settings, Switch

Module = tuple[int, bytes]
"""Version of the structure, and the structure."""
PROFILES: Mapping[str, Settings] = {
    "imx219": {"demosaic": 5, "quality": 92},
    "imx296": {"demosaic": 1, "quality": 95},
    "imx378": {"demosaic": 0, "quality": 90},
    "imx477": {"demosaic": 6, "quality": 93},
    "ov5647": {"demosaic": 5, "quality": 96},
    "checker": {"demosaic": 5, "quality": 94},
    "indoor": {"demosaic": 1, "quality": 92},
    "kissx4": {"demosaic": 5, "quality": 95},
    "outdoor": {"demosaic": 2, "quality": 93},
}
"""Each camera's demosaicker (0 PPG, 1 AMaZE, 2 VNG, 5 RCD, 6 LMMSE) and JPEG quality."""


def _floats(version: int, *values: float) -> Module:
    return version, struct.pack(f"<{len(values)}f", *values)


def _demosaic(method: int, smoothing: int = 0) -> Module:
    """green_eq, median_thrs, color_smoothing, method, lmmse_refine, dual_thrs."""
    return 4, struct.pack("<ifiiif", 0, 0.0, smoothing, method, 1, 0.2)


def _bilat(mode: int, highlights: float, shadows: float, detail: float) -> Module:
    """mode (0: bilateral grid, 1: local Laplacian), sigma_r, sigma_s, detail, midtone."""
    return 3, struct.pack("<iffff", mode, highlights, shadows, detail, 0.5)


def _grain(strength: float) -> Module:
    """channel (2: lightness), scale, strength, midtones_bias."""
    return 2, struct.pack("<ifff", 2, 400 / 213.2, strength, 100.0)


def _raw_denoise(threshold: float) -> Module:
    """threshold, then four channels of five places and of five strengths."""
    return 2, struct.pack("<41f", threshold, *[i / 4 for i in range(5)] * 4, *[0.5] * 20)


def _shadows(strength: float) -> Module:
    """order, radius, shadows, whitepoint, highlights, reserved, compress, colours of shadows and of
    highlights, flags, low_approximation, algorithm (1: bilateral)."""
    return 5, struct.pack("<i8fIfi", 0, 40, strength, 0, -strength, 0, 50, 100, 50, 127, 1e-6, 1)


def _vignette(brightness: float) -> Module:
    """scale, falloff_scale, brightness, saturation, centre x and y, autoratio, whratio, shape, dithering,
    unbound."""
    return 4, struct.pack("<6fiffii", 20.0, 90.0, brightness, 0.0, 0.0, 0.0, 1, 1.0, 1.0, 0, 1)


SWITCHES: Mapping[str, Switch] = {
    # radius, amount, threshold
    "sharpen": Switch(
        "sharpening", [{"sharpen": _floats(1, 2.0, v, 0.5)} for v in (0.15, 0.3, 0.6, 1.1, 1.9)]
    ),
    "laplacian": Switch(
        "local_tone_mapping",
        [{"bilat": _bilat(1, 0.5, 0.5, v)} for v in (0.1, 0.2, 0.4, 0.8, 1.6)],
        ("sharpening",),
    ),
    "shadows_lifted": Switch(
        "local_tone_mapping", [{"bilat": _bilat(1, v, 2 - v, 0.0)} for v in (0.9, 0.75, 0.5, 0.3, 0.1)]
    ),
    "bilateral_grid": Switch(
        "local_tone_mapping",
        [{"bilat": _bilat(0, 20.0, 40.0, v)} for v in (0.1, 0.2, 0.4, 0.8, 1.5)],
        ("sharpening",),
    ),
    "shadows_highlights": Switch(
        "local_tone_mapping", [{"shadhi": _shadows(v)} for v in (8, 16, 30, 50, 90)]
    ),
    # amount
    "vibrance": Switch(
        "color_lut", [{"vibrance": _floats(2, v)} for v in (10, 20, 40, 70, 100)], ("saturation", NONE)
    ),
    # strength, bias
    "velvia": Switch(
        "color_lut", [{"velvia": _floats(2, v, 1.0)} for v in (6, 12, 25, 50, 90)], ("saturation", NONE)
    ),
    "grain": Switch("film_grain", [{"grain": _grain(v)} for v in (4, 8, 15, 30, 60)]),
    # strength, distance
    "haze": Switch(OUTSIDE, [{"hazeremoval": _floats(1, v, 0.2)} for v in (0.1, 0.2, 0.4, 0.6, 0.9)]),
    # size, saturation, brightness, amount
    "soften": Switch(OUTSIDE, [{"soften": _floats(1, 20.0, 100.0, 0.2, v)} for v in (4, 8, 15, 30, 60)]),
    # size, threshold, strength
    "bloom": Switch(
        OUTSIDE, [{"bloom": _floats(1, 15.0, 75.0, v)} for v in (5, 10, 18, 30, 50)], ("veiling_glare",)
    ),
    # radius, strength, luma, chroma
    "nonlocal_luma": Switch(
        "luma_denoising", [{"nlmeans": _floats(2, 2.0, v, 1.0, 0.0)} for v in (8, 20, 50, 120, 300)]
    ),
    "nonlocal_chroma": Switch(
        "chroma_denoising", [{"nlmeans": _floats(2, 2.0, v, 0.0, 1.0)} for v in (8, 20, 50, 120, 300)]
    ),
    # radius, reserved, red, green, blue
    "surface_blur": Switch(
        "luma_denoising",
        [{"bilateral": _floats(1, 4.0, 15.0, v, v, v)} for v in (0.002, 0.004, 0.008, 0.015, 0.03)],
        ("chroma_denoising",),
    ),
    "raw_denoise": Switch(
        "luma_denoising",
        [{"rawdenoise": _raw_denoise(v)} for v in (0.003, 0.006, 0.012, 0.025, 0.05)],
        ("chroma_denoising",),
    ),
    "vignette": Switch(
        "vignetting", [{"vignette": _vignette(v)} for v in (-0.08, -0.15, -0.28, -0.45, -0.75)]
    ),
    "colour_smoothing": Switch(
        "chroma_denoising", [{"smoothing": v} for v in (1, 2, 3, 4, 5)], ("demosaicking",)
    ),
    "demosaicker": Switch(NONE, [{"demosaic": v} for v in (0, 1, 2, 5, 6)], ("demosaicking",)),
    "quality": Switch(NONE, [{"quality": v} for v in (85, 70, 50)]),
}


def develop(raws: Sequence[Path], camera: str, settings: Settings, out: Path) -> list[Path]:
    """See `switches.Converter`."""
    own = {**PROFILES[camera], **settings}
    modules = {"demosaic": _demosaic(own["demosaic"], own.get("smoothing", 0))}
    modules |= {name: value for name, value in own.items() if isinstance(value, tuple)}
    with tempfile.TemporaryDirectory() as scratch:
        sidecar = Path(scratch) / "own.xmp"
        sidecar.write_text(_sidecar(modules))
        inputs = Path(scratch) / "raws"
        inputs.mkdir()
        for raw in raws:
            os.link(raw, inputs / raw.name)
        return _run(inputs, sidecar, own["quality"], out, Path(scratch))


def _sidecar(modules: Mapping[str, Module]) -> str:
    items = "".join(
        f'<rdf:li darktable:num="{i}" darktable:operation="{name}" darktable:enabled="1" '
        f'darktable:modversion="{version}" darktable:params="{data.hex()}" darktable:multi_name="" '
        'darktable:multi_priority="0"/>'
        for i, (name, (version, data)) in enumerate(modules.items())
    )
    return (
        '<?xml version="1.0" encoding="UTF-8"?><x:xmpmeta xmlns:x="adobe:ns:meta/">'
        '<rdf:RDF xmlns:rdf="http://www.w3.org/1999/02/22-rdf-syntax-ns#">'
        '<rdf:Description rdf:about="" xmlns:darktable="http://darktable.sf.net/" darktable:xmp_version="4" '
        f'darktable:auto_presets_applied="1" darktable:history_end="{len(modules)}" '
        'darktable:iop_order_version="2">'
        f"<darktable:history><rdf:Seq>{items}</rdf:Seq></darktable:history>"
        "</rdf:Description></rdf:RDF></x:xmpmeta>"
    )


def _run(raws: Path, sidecar: Path, quality: int, out: Path, scratch: Path) -> list[Path]:
    """All files of a folder."""
    out.mkdir(parents=True, exist_ok=True)
    written = [out / f"{raw.stem}.jpg" for raw in sorted(raws.iterdir())]
    for path in written:
        path.unlink(missing_ok=True)  # it would write beside it
    command = [
        "darktable-cli", str(raws), str(sidecar), str(out), "--out-ext", "jpg", "--hq", "1",
        "--apply-custom-presets", "0", "--core", "--library", ":memory:",
        "--configdir", str(scratch / "config"), "--cachedir", str(scratch / "cache"), "--disable-opencl",
        "--conf", f"plugins/imageio/format/jpeg/quality={quality}",
        "--conf", "plugins/darkroom/workflow=none",
    ]  # fmt: skip
    done = subprocess.run(command, capture_output=True, text=True, timeout=600)
    missing = [path.name for path in written if not path.exists()]
    if missing:
        raise RuntimeError(
            f"darktable-cli wrote no {', '.join(missing)}: {(done.stderr or done.stdout)[-400:]}"
        )
    return written
