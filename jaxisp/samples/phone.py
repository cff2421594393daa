"""A reference phone: takes scenes to RAW mosaics and JPEGs without any of the simulator's code.

What tests the simulator must not be made by it, so a whole camera is written here a second time, in NumPy, by
other formulas and algorithms where there is a choice. Only what writes files is imported, where it is used.
"""

import io
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image

from jaxisp.samples.phone_filters import DEMOSAICKERS, LUMA, color_filters, denoise, gaussian

_SRGB_TO_XYZ = np.array([[0.4124, 0.3576, 0.1805], [0.2126, 0.7152, 0.0722], [0.0193, 0.1192, 0.9505]])
_QUARTER_TURNS = {1: 0, 6: 1, 3: 2, 8: 3}  # counter-clockwise, from the upright picture to the stored one

Size = int | tuple[int, int] | None


@dataclass(frozen=True, kw_only=True)
class Phone:
    """One body. Levels are RAW counts; noise is a share of the RAW range at ISO 100.

    `illuminants` give the gain of red, green and blue that each light needs against daylight. `exposure` is
    the share of the RAW range that white reaches in green, `blur` the standard deviation of the lens's spot
    [px]. The stored picture is turned by `orientation` (EXIF 1, 3, 6 or 8).
    """

    model: str
    make: str = "Reference"
    cfa: str
    bits: int
    black: int
    white: int
    xyz_to_camera: tuple[tuple[float, float, float], ...]
    illuminants: Mapping[str, tuple[float, float, float]] = field(hash=False)
    illuminant: str = "daylight"
    iso: int
    shot: float
    read: float
    exposure: float
    blur: float
    vignetting: float = 0.0
    corrects_vignetting: bool = False
    demosaicking: str
    luma_denoising: str
    luma_strength: float
    chroma_sigma: float
    saturation: float
    gamma: float
    shoulder: float
    contrast: float
    sharpening: float
    sharpening_sigma: float
    quality: int
    subsampling: str
    orientation: int = 1

    @property
    def srgb_to_camera(self) -> np.ndarray:
        """Linear sRGB to balanced camera RGB: white stays white."""
        matrix = np.array(self.xyz_to_camera) @ _SRGB_TO_XYZ
        return matrix / matrix.sum(axis=1, keepdims=True)

    @property
    def gains(self) -> np.ndarray:
        """White balance as shot, green at 1."""
        neutral = (np.array(self.xyz_to_camera) @ _SRGB_TO_XYZ).sum(axis=1)
        gains = np.array(self.illuminants[self.illuminant]) / neutral
        return gains / gains[1]

    @property
    def noise_profile(self) -> np.ndarray:
        """(1, 2): S and O of the variance `S x + O`, x in [0, 1] above black."""
        return np.array([[self.shot * self.iso / 100, (self.read * self.iso / 100) ** 2]])


_LIGHTS = {"daylight": (1.0, 1.0, 1.0), "shade": (1.15, 1.0, 0.82), "tungsten": (0.58, 1.0, 1.75)}

PHONES = {
    "a": Phone(
        model="A", cfa="RGGB", bits=12, black=256, white=4095, iso=100, shot=1.5e-4, read=8e-4,
        exposure=0.9, blur=0.45,
        xyz_to_camera=((0.98, -0.34, -0.11), (-0.42, 1.24, 0.18), (-0.06, 0.18, 0.56)),
        illuminants=_LIGHTS,
        demosaicking="gradient", luma_denoising="bilateral", luma_strength=0.03, chroma_sigma=1.0,
        saturation=1.05, gamma=2.2, shoulder=3.0, contrast=0.3, sharpening=0.5, sharpening_sigma=1.0,
        quality=95, subsampling="4:4:4",
    ),
    "b": Phone(
        model="B", cfa="GBRG", bits=10, black=64, white=1023, iso=400, shot=9e-5, read=5e-4,
        exposure=0.75, blur=0.6,
        xyz_to_camera=((0.72, -0.21, -0.05), (-0.31, 1.1, 0.24), (-0.02, 0.14, 0.48)),
        illuminants=_LIGHTS, illuminant="tungsten", vignetting=0.12,
        demosaicking="bilinear", luma_denoising="wiener",
        luma_strength=0.018, chroma_sigma=2.0, saturation=1.15, gamma=2.0, shoulder=1.2, contrast=0.15,
        sharpening=0.9, sharpening_sigma=1.6, quality=88, subsampling="4:2:0",
    ),
    "c": Phone(
        model="C", cfa="BGGR", bits=14, black=1024, white=15871, iso=200, shot=6e-5, read=3e-4,
        exposure=1.1, blur=0.4,
        xyz_to_camera=((1.21, -0.55, -0.16), (-0.5, 1.36, 0.15), (-0.09, 0.23, 0.62)),
        illuminants=_LIGHTS, illuminant="shade", vignetting=0.25, corrects_vignetting=True,
        demosaicking="directional",
        luma_denoising="gaussian", luma_strength=0.45, chroma_sigma=0.7, saturation=0.9, gamma=2.4,
        shoulder=6.0, contrast=0.5, sharpening=0.35, sharpening_sigma=0.7, quality=92, subsampling="4:2:2",
        orientation=6,
    ),
}  # fmt: skip
"""Three bodies with nothing in common."""


def shoot(
    scene: np.ndarray, phone: Phone, seed: int | tuple[int, ...]
) -> tuple[np.ndarray, np.ndarray, dict[str, Any]]:
    """Take one picture.

    Args:
        scene: (H, W, 3) linear sRGB, upright; 1 is white.
        phone: the body.
        seed: of the noise.

    Returns:
        (H', W') uint16 mosaic and (H', W', 3) uint8 decoded JPEG as stored, and what the header says, by the
        names of `jaxisp.io.dng.write_dng`.
    """
    mosaic = _expose(np.rot90(scene, _QUARTER_TURNS[phone.orientation]), phone, seed)
    return mosaic, np.asarray(Image.open(io.BytesIO(_jpeg(mosaic, phone)))), _header(phone)


def write_pairs(
    folder: str | Path,
    phone: Phone,
    scenes: Mapping[str, np.ndarray] | Iterable[np.ndarray],
    seed: int = 0,
    size: Size = None,
) -> list[str]:
    """Write NAME.dng and NAME.jpg of each scene into `folder`; return the names.

    Args:
        folder: made where it is missing.
        phone: the body.
        scenes: linear scenes by name; names are scene0, scene1, ... where they have none.
        seed: of the noise; each scene's is drawn apart.
        size: the middle of each scene that is taken: (rows, columns) or one number; None is all of it.
    """
    from jaxisp.io.dng import write_dng

    named = _named(scenes)
    for index, (name, scene) in enumerate(named.items()):
        upright = np.rot90(_middle(scene, size), _QUARTER_TURNS[phone.orientation])
        mosaic = _expose(upright, phone, (seed, index))
        _write(Path(folder) / f"{name}.jpg", _jpeg(mosaic, phone))
        write_dng(Path(folder) / f"{name}.dng", mosaic, **_header(phone))
    return list(named)


def write_clean_noisy(
    folder: str | Path,
    phone: Phone,
    scenes: Mapping[str, np.ndarray] | Iterable[np.ndarray],
    seed: int = 0,
    size: Size = None,
) -> list[str]:
    """Write NAME.clean.png, the scene in 8-bit sRGB, and NAME.jpg, the phone's; see `write_pairs`."""
    named = _named(scenes)
    for index, (name, scene) in enumerate(named.items()):
        clean = np.clip(_middle(scene, size), 0, 1)
        encoded = np.where(clean <= 0.0031308, 12.92 * clean, 1.055 * clean ** (1 / 2.4) - 0.055)
        picture = io.BytesIO()
        Image.fromarray(_to_bytes(encoded)).save(picture, "PNG")
        mosaic = _expose(np.rot90(clean, _QUARTER_TURNS[phone.orientation]), phone, (seed, index))
        _write(Path(folder) / f"{name}.clean.png", picture.getvalue())
        _write(Path(folder) / f"{name}.jpg", _jpeg(mosaic, phone))
    return list(named)


def _expose(scene: np.ndarray, phone: Phone, seed: int | tuple[int, ...]) -> np.ndarray:
    """Lens, colour filters, photons, read noise, converter."""
    rng = np.random.default_rng(seed)
    sharp = scene * _shading(scene.shape, phone)[..., None] @ phone.srgb_to_camera.T
    light = np.clip(np.stack([gaussian(sharp[..., c], phone.blur) for c in range(3)], -1), 0, None)
    seen = (phone.exposure * light / phone.gains * color_filters(scene.shape, phone.cfa)).sum(-1)
    shot, variance = phone.noise_profile[0]
    collected = np.minimum(rng.poisson(seen / shot) * shot, 1)  # the well is full at the white level
    signal = collected + rng.normal(0, np.sqrt(variance), seen.shape)
    counts = np.rint(phone.black + signal * (phone.white - phone.black))
    return np.clip(counts, 0, 2**phone.bits - 1).astype(np.uint16)


def _jpeg(mosaic: np.ndarray, phone: Phone) -> bytes:
    """The file that the phone makes of its RAW."""
    raw = (mosaic.astype(float) - phone.black) / (phone.white - phone.black)
    if phone.corrects_vignetting:
        raw = raw / _shading(mosaic.shape, phone)
    filters = color_filters(mosaic.shape, phone.cfa)
    balanced = np.minimum(raw * (filters * phone.gains).sum(-1), 1.0)
    camera = DEMOSAICKERS[phone.demosaicking](balanced, filters)
    camera = denoise(camera, phone.luma_denoising, phone.luma_strength, phone.chroma_sigma)
    linear = camera @ np.linalg.inv(phone.srgb_to_camera).T / min(phone.exposure, 1.0)
    gray = linear @ _SRGB_TO_XYZ[1][:, None]
    toned = _tone(np.clip(gray + phone.saturation * (linear - gray), 0, 1), phone)
    luma = toned @ LUMA
    halo = phone.sharpening * (luma - gaussian(luma, phone.sharpening_sigma))
    exif = Image.Exif()
    exif[0x010F], exif[0x0110], exif[0x0112] = phone.make, phone.model, phone.orientation
    file = io.BytesIO()
    Image.fromarray(_to_bytes(toned + halo[..., None])).save(
        file, "JPEG", quality=phone.quality, subsampling=phone.subsampling, exif=exif
    )
    return file.getvalue()


def _header(phone: Phone) -> dict[str, Any]:
    return {
        "cfa": phone.cfa,
        "black": (phone.black,),
        "white": phone.white,
        "color_matrix": np.array(phone.xyz_to_camera),
        "as_shot_neutral": tuple(1 / phone.gains),
        "iso": phone.iso,
        "orientation": phone.orientation,
        "noise_profile": phone.noise_profile,
        "make": phone.make,
        "model": phone.model,
    }


def _tone(linear: np.ndarray, phone: Phone) -> np.ndarray:
    """A rational shoulder, a power, and a sine-shaped rise of contrast."""
    lifted = linear * (1 + phone.shoulder) / (linear + phone.shoulder)
    encoded = lifted ** (1 / phone.gamma)
    return encoded - phone.contrast * np.sin(2 * np.pi * encoded) / (2 * np.pi)


def _shading(shape: tuple[int, ...], phone: Phone) -> np.ndarray:
    """What the lens lets through, 1 in the middle and (1 - vignetting) squared in the corners."""
    y, x = (np.linspace(-1, 1, n) for n in shape[:2])
    return (1 - phone.vignetting * (y[:, None] ** 2 + x**2) / 2) ** 2


def _to_bytes(encoded: np.ndarray) -> np.ndarray:
    return np.rint(255 * np.clip(encoded, 0, 1)).astype(np.uint8)


def _named(scenes: Mapping[str, np.ndarray] | Iterable[np.ndarray]) -> dict[str, np.ndarray]:
    if isinstance(scenes, Mapping):
        return dict(scenes)
    return {f"scene{i}": scene for i, scene in enumerate(scenes)}


def _middle(scene: np.ndarray, size: Size) -> np.ndarray:
    """The middle of a scene, or ValueError where it is not that large."""
    rows, columns = scene.shape[:2]
    height, width = (rows, columns) if size is None else (size, size) if isinstance(size, int) else size
    if height > rows or width > columns:
        raise ValueError(f"scene of {rows}x{columns} px is smaller than {height}x{width}")
    top, left = (rows - height) // 2, (columns - width) // 2
    return scene[top : top + height, left : left + width]


def _write(path: Path, content: bytes) -> None:
    from jaxisp.io.files import atomic_write, output_folder

    output_folder(path.parent)
    with atomic_write(path) as file:
        file.write(content)
