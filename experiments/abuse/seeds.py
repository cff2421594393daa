"""Small sound files, by kind of reader: what the fuzzer starts from."""

import dataclasses
import io
import json
import struct
import tarfile
import zipfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import tifffile
from PIL import Image, ImageCms

from experiments.abuse import kept
from jaxisp.calibrate.noise import Calibrated, Figure, Noise
from jaxisp.io import FixVignetteRadial, GainMap, WarpRectilinear, write_dng
from jaxisp.io.jpeg import encode_jpeg
from jaxisp.io.opcodes import pack_opcodes
from jaxisp.recipes import RECIPES, mix
from jaxisp.train import TrainConfig

_MATRIX = np.array([[0.6461, -0.1164, -0.0857], [-0.3825, 1.1597, 0.2534], [-0.0416, 0.154, 0.6039]])
_DATASET = """camera = "Phone"
iso = 100
clean_encoding = "srgb"
[raw]
cfa = "GRBG"
black = [64, 65, 66, 70]
white = 1023.0
white_balance = [2.0, 1.0, 1.5]
[jpeg]
cropped = true
[a]
iso = 800
[a.raw]
black = 0.1
["a.f01"]
iso = 50
"""


@dataclasses.dataclass(frozen=True)
class Seed:
    """A file that its reader accepts."""

    kind: str  # of reader: see targets.READERS
    suffix: str
    data: bytes


def all_seeds(folder: Path) -> list[Seed]:
    """The seeds; `folder` is for files that are written on the way."""
    ours = [Seed(*found) for found in kept.seeds()]
    return [*_raws(folder), *_jpegs(), *_pictures(), *_arrays(), *_tomls(), *_others(), *ours]


def _pixels(height: int = 26, width: int = 38) -> np.ndarray:
    y, x = np.mgrid[:height, :width]
    waves = np.stack([128 + 100 * np.sin(x / (3 + c) + y / 5) for c in range(3)], -1)
    return np.clip(waves + np.random.default_rng(0).normal(0, 6, waves.shape), 0, 255).astype(np.uint8)


def _mosaic(height: int = 26, width: int = 38) -> np.ndarray:
    ramp = np.linspace(60, 1000, width)[None] + np.random.default_rng(1).normal(0, 10, (height, width))
    return np.clip(ramp, 40, 1023).astype(np.uint16)


def _raws(folder: Path) -> list[Seed]:
    gains = GainMap(np.ones((3, 4, 1), np.float32) * 1.5, (0, 0, 26, 38), (2, 2), (0.0, 0.0), (0.5, 0.33))
    lens = [FixVignetteRadial(np.full(5, 0.1), (0.5, 0.5)), WarpRectilinear(np.ones((3, 6)), (0.5, 0.5))]
    common = {"cfa": "RGGB", "black": (64, 65, 66, 70), "white": 1023, "color_matrix": _MATRIX}
    rich = {
        "noise_profile": np.array([[1e-3, 1e-6]]), "gain_map": [gains], "opcodes_3": lens,
        "active_area": (2, 2, 24, 36), "crop": (2, 2, 16, 30), "orientation": 6, "iso": 800,
    }  # fmt: skip
    found = []
    for name, options in (("plain", {}), ("rich", rich), ("preview", {"preview": encode_jpeg(_pixels())})):
        path = write_dng(folder / f"{name}.dng", _mosaic(), **common, **options)
        found += [Seed("raw", ".dng", path.read_bytes()), Seed("raw", ".nef", path.read_bytes())]
    found.append(Seed("raw", ".dng", _stated(folder, common)))
    return [*found, Seed("raw", ".dng", _lossless(folder)), Seed("opcodes", "", pack_opcodes([gains, *lens]))]


def _stated(folder: Path, common: dict[str, Any]) -> bytes:
    """A DNG of quad Bayer that states as much as one can: three lights, interleaved rows, maps of colours."""
    thousandths = [
        tuple(v for m in (_MATRIX + 0.1 * i).ravel() for v in (int(1e3 * m), 1000)) for i in range(3)
    ]
    light = struct.pack("<H4I", 0, 4476, 10000, 4075, 10000)
    spectrum = struct.pack("<HI10I", 1, 3, 400, 1, 150, 1, 1, 2, 2, 2, 3, 2)
    tags = [
        (33421, 3, 2, (4, 4)), (33422, 1, 16, bytes([0, 0, 1, 1] * 2 + [1, 1, 2, 2] * 2)),
        *((code, 10, 9, m) for code, m in zip((50721, 50722, 52531), thousandths)),
        (50965, 10, 9, thousandths[0]), (50723, 10, 9, thousandths[1]),
        (50931, 2, 0, "ours"), (50932, 2, 0, "ours"),
        (50778, 3, 1, 255), (50779, 3, 1, 21), (52529, 3, 1, 255),
        (52533, 7, len(light), light), (52535, 7, len(spectrum), spectrum),
        (50715, 10, 38, (1, 2) * 38), (50716, 10, 26, (-1, 2) * 26), (50975, 4, 1, 2), (52547, 4, 1, 2),
        (50718, 5, 2, (2, 1, 1, 1)), (50712, 3, 1024, tuple(range(1024))), (50730, 10, 1, (1, 2)),
    ]  # fmt: skip
    maps = [GainMap(np.full((2, 2, 3), 1.5), (0, 0, 26, 38), planes=3)]
    path = write_dng(
        folder / "stated.dng",
        _mosaic(),
        **common | {"black": (64,)},
        opcodes_3=maps,
        extra_tags=tags,
        iso=102400,
    )
    return path.read_bytes()


def _lossless(folder: Path) -> bytes:
    """A DNG compressed as cameras do: lossless JPEG (1992), which LibRaw decodes itself."""
    import imagecodecs

    mosaic = _mosaic(32, 64)
    tags = [
        (33421, 3, 2, (2, 2), True), (33422, 1, 4, b"\0\1\1\2", True), (50706, 1, 4, b"\1\4\0\0", True),
        (50717, 4, 1, 1023, True),
        (50721, 10, 9, tuple(v for m in _MATRIX.ravel() for v in (int(1e4 * m), 10000)), True),
    ]  # fmt: skip
    with tifffile.TiffWriter(folder / "lossless.dng") as tif:
        tif.write(
            iter([imagecodecs.ljpeg_encode(mosaic, bitspersample=16)]), shape=mosaic.shape, dtype=np.uint16,
            compression=7, photometric=32803, rowsperstrip=len(mosaic), metadata=None, extratags=tags,
        )  # fmt: skip
    return (folder / "lossless.dng").read_bytes()


def _jpegs() -> list[Seed]:
    pixels = _pixels()
    odd = (
        ImageCms.ImageCmsProfile(ImageCms.createProfile("sRGB"))
        .tobytes()
        .replace(b"s\0R\0G\0B", b"x\0R\0G\0B")
    )
    files = [
        encode_jpeg(pixels, 90, "4:2:0", orientation=6, iso=400, make="A", model="B"),
        encode_jpeg(pixels, 30, "4:4:4"),
        _saved(pixels, "JPEG", progressive=True, quality=70),
        _saved(pixels, "JPEG", icc_profile=odd, subsampling=1, restart_marker_blocks=2),
        _saved(pixels, "JPEG", optimize=True),
        _saved(pixels, "MPO", save_all=True, append_images=[Image.fromarray(pixels[::-1])]),
    ]
    return [Seed("jpeg", ".jpg", data) for data in files]


def _saved(pixels: np.ndarray, kind: str, **options: object) -> bytes:
    out = io.BytesIO()
    Image.fromarray(pixels).save(out, kind, **options)
    return out.getvalue()


def _pictures() -> list[Seed]:
    pixels = _pixels()
    deep = pixels.astype(np.uint16) * 257
    found = [Seed("picture", ".png", _saved(pixels, "PNG")), Seed("picture", ".tif", _saved(pixels, "TIFF"))]
    found.append(Seed("picture", ".tif", _saved(pixels, "TIFF", compression="tiff_lzw")))
    for options in ({}, {"compression": "zlib"}, {"planarconfig": "separate"}, {"tile": (16, 16)}):
        out = io.BytesIO()
        array = np.moveaxis(deep, -1, 0) if "planarconfig" in options else deep
        tifffile.imwrite(out, array, photometric="rgb", **options)
        found.append(Seed("picture", ".tif", out.getvalue()))
    return found


def _arrays() -> list[Seed]:
    found = []
    for kind, array in (("picture", _pixels()), ("picture", _pixels() / 255), ("mosaic", _mosaic())):
        out = io.BytesIO()
        np.save(out, array)
        found.append(Seed(kind, ".npy", out.getvalue()))
    return found


def _tomls() -> list[Seed]:
    import tomli_w

    config = dataclasses.asdict(TrainConfig(clean=("photos",), recipe="phone", model_options={"depth": 3}))
    recipes = [Seed("recipe", ".toml", make().to_toml().encode()) for make in RECIPES.values()]
    config_text = tomli_w.dumps(config).encode()
    return [*recipes, Seed("settings", ".toml", _DATASET.encode()), Seed("config", ".toml", config_text)]


def _others() -> list[Seed]:
    arrays = io.BytesIO()
    np.savez(
        arrays, about=np.asarray('{"model": "fast", "options": {}}'), weights=np.ones((3, 2), np.float32)
    )
    profile = ImageCms.ImageCmsProfile(ImageCms.createProfile("sRGB")).tobytes()
    figures = {"shot": Figure(1e-3, 1e-5), "read": Figure(2e-3, 1e-5), "tail": Figure(0.1, 0.01)}
    noise = [
        Noise(iso, figures, 64.0, 1023.0, "RGGB", (Figure(1e-3, 1e-5),) * 4, (1e-3, 1e-6), (4, 4))
        for iso in (100.0, 800.0)
    ]
    return [
        Seed("noise", ".toml", Calibrated("Phone", tuple(noise), ("a note",)).to_toml().encode()),
        Seed("mixture", ".toml", mix({"phone": 0.5, "awgn": 0.5}).to_toml().encode()),
        Seed("network", ".npz", arrays.getvalue()),
        Seed("profile", ".icc", profile),
        *(Seed("archive", f".{kind}", data) for kind, data in _archives()),
        Seed("sums", ".json", json.dumps({"https://a/b": f"md5:{'0' * 32}"}).encode()),
        *(Seed("report", ".json", json.dumps(report).encode()) for report in _reports()),
    ]


def _reports() -> Iterator[dict[str, Any]]:
    """Of a fit, of an evaluation and of a diagnosis, as far as they are compared."""
    figures = {"psnr": 31.0, "ssim": 0.9}
    pair = {"name": "a", "psnr_in": 25.0, "psnr": 31.0, "held_out_psnr": 30.0, "held_out_ssim": 0.9}
    yield {"pairs": [pair], "held_out": {**figures, "how": "tiles"}, "seconds": 2.5}
    yield {"pairs": [pair], "mean": figures, "normalised": "as measured", "light": "linear"}
    yield {
        "verdict": "effect", "gap": {"metric": "m", "before": 2.0, "after": 1.0, "floor": 0.5},
        "kind": "raw+jpeg", "causes": [{"effect": "prnu"}], "unexplained": {"share": 0.1}, "seconds": 3.0,
        "ranking": [{"effect": "prnu", "closed": 0.5}], "where": [{"axis": "row", "share": 0.2}],
    }  # fmt: skip


def _archives() -> Iterator[tuple[str, bytes]]:
    """What fetch may meet: each compression, folders, a long name, a link, other headers."""
    for method in (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED, zipfile.ZIP_BZIP2, zipfile.ZIP_LZMA):
        out = io.BytesIO()
        with zipfile.ZipFile(out, "w", method) as file:
            file.writestr("a/b.txt", b"b" * 60)
            file.writestr("c.txt", b"c")
        yield "zip", out.getvalue()
    for way, form in (("w", tarfile.GNU_FORMAT), ("w:gz", tarfile.PAX_FORMAT), ("w:bz2", 1), ("w:xz", 2)):
        out = io.BytesIO()
        with tarfile.open(fileobj=out, mode=way, format=form) as file:
            for name in ("a/b.txt", "c" * 120, "é.txt"):
                info = tarfile.TarInfo(name)
                info.size = 9
                file.addfile(info, io.BytesIO(b"d" * 9))
        yield "tar", out.getvalue()
