"""JPEG files: the pixels, and what the encoder did to them as the file itself states it."""

import io
import struct
import warnings
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from PIL import Image, ImageCms, UnidentifiedImageError

from jaxisp.errors import InputError
from jaxisp.io.files import PathLike, atomic_write, check_pixels, read_bytes
from jaxisp.io.jpeg_frame import Frame, frame_header
from jaxisp.io.orientation import orient
from jaxisp.jpeg.tables import quality_tables

_UNSUPPORTED = {0xC3: "lossless", 0xC5: "hierarchical", 0xC6: "hierarchical", 0xC7: "hierarchical",
                0xCB: "lossless"}  # fmt: skip
_ORIENTATION, _MAKE, _MODEL, _EXIF_IFD, _ISO = 274, 271, 272, 34665, 34855


@dataclass(frozen=True)
class Jpeg:
    """A decoded JPEG file.

    Args:
        pixels: (H, W, 3) uint8 as stored, before `orientation`; sRGB where there was a profile.
        luma_table, chroma_table: (8, 8) quantisation steps, rows are vertical frequencies.
        subsampling: "4:4:4", "4:2:2", "4:2:0", "4:4:0", "4:1:1", "4:1:0", or the factors as "2x2,1x1,...".
        orientation: EXIF 1 to 8.
        icc: the colour profile as it stands in the file, or None.
        converted: whether the pixels were converted from `icc` to sRGB.
        color_space: "YCbCr", or "RGB" where the file stores it without a luma.
    """

    pixels: np.ndarray
    luma_table: np.ndarray
    chroma_table: np.ndarray
    subsampling: str
    orientation: int
    icc: bytes | None
    converted: bool
    color_space: str
    iso: float | None
    make: str
    model: str

    @property
    def image(self) -> np.ndarray:
        """(H, W, 3) float32 in [0, 1], as stored."""
        return self.pixels.astype(np.float32) / np.float32(255)

    @property
    def upright(self) -> np.ndarray:
        """`image` turned as its orientation asks."""
        return orient(self.image, self.orientation)

    @property
    def quality(self) -> int:
        """The libjpeg quality, 1 to 100, whose tables are nearest to the file's."""
        tables = np.stack([self.luma_table, self.chroma_table])
        return 1 + int(np.argmin([np.abs(np.stack(quality_tables(q)) - tables).sum() for q in range(1, 101)]))


def read_jpeg(path: PathLike, *, to_srgb: bool = True) -> Jpeg:
    """Read a JPEG file.

    Args:
        path: the file.
        to_srgb: convert pixels with another colour profile to sRGB (relative colorimetric).

    Raises:
        InputError: it is missing, empty, truncated, no JPEG, grayscale, CMYK, or not 8 bits deep.
    """
    return decode_jpeg(read_bytes(path), str(path), to_srgb=to_srgb)


def decode_jpeg(data: bytes, name: str, *, to_srgb: bool = True) -> Jpeg:
    """`read_jpeg` for bytes; `name` stands in errors."""
    if data[:3] != b"\xff\xd8\xff":
        raise InputError(f"{name}: is not a JPEG file")
    try:
        frame = frame_header(data)
    except (ValueError, struct.error) as error:
        raise InputError(f"{name}: is a damaged or truncated JPEG ({error})") from error
    _check_frame(frame, name)
    check_pixels(frame.width, frame.height, len(data), name)
    picture, pixels = _decode(data, name)
    icc = picture.info.get("icc_profile")
    converted = False
    if icc and to_srgb:
        pixels, converted = profile_to_srgb(pixels, icc, name)
    luma, chroma = _tables(picture, name)
    exif = _exif(picture)
    return Jpeg(
        pixels=pixels,
        luma_table=luma,
        chroma_table=chroma,
        subsampling=frame.subsampling,
        icc=icc,
        converted=converted,
        color_space=_color_space(frame, picture),
        **exif,
    )


def _check_frame(frame: Frame, name: str) -> None:
    if frame.marker in _UNSUPPORTED:
        raise InputError(
            f"{name}: is a {_UNSUPPORTED[frame.marker]} JPEG, expected a baseline or progressive one"
        )
    if frame.precision != 8:
        raise InputError(f"{name}: is a {frame.precision}-bit JPEG, expected 8 bits")
    if len(frame.sampling) == 1:
        raise InputError(f"{name}: is a grayscale JPEG, expected colour")
    if len(frame.sampling) == 4:
        raise InputError(f"{name}: is a CMYK JPEG, expected RGB (Y'CbCr)")
    if len(frame.sampling) != 3:
        raise InputError(f"{name}: is a JPEG of {len(frame.sampling)} components, expected 3")


def _decode(data: bytes, name: str) -> tuple[Any, np.ndarray]:
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # Pillow's notes on odd EXIF and on large pictures
            picture = Image.open(io.BytesIO(data), formats=("JPEG",))  # MPO too
            picture.load()
    except Image.DecompressionBombError as error:
        raise InputError(f"{name}: says it is larger than any camera's picture; it is damaged") from error
    except (OSError, ValueError, SyntaxError, struct.error, MemoryError) as error:
        raise InputError(f"{name}: is a damaged or truncated JPEG ({why_not(error)})") from error
    if picture.mode != "RGB":
        raise InputError(f"{name}: is a {picture.mode} JPEG, expected RGB")
    return picture, np.asarray(picture)


def why_not(error: Exception) -> str:
    """What Pillow says, without the address of the object that it was given."""
    return "its header cannot be read" if isinstance(error, UnidentifiedImageError) else str(error)


def _tables(picture: Any, name: str) -> tuple[np.ndarray, np.ndarray]:
    try:
        luma, chroma = (picture.quantization[picture.layer[i][3]] for i in (0, 1))
    except (KeyError, IndexError) as error:
        raise InputError(f"{name}: is a damaged JPEG (a quantisation table is missing)") from error
    return np.array(luma).reshape(8, 8), np.array(chroma).reshape(8, 8)


def _color_space(frame: Frame, picture: Any) -> str:
    transform = picture.info.get("adobe_transform")
    return "RGB" if transform == 0 or (transform is None and bytes(frame.ids) == b"RGB") else "YCbCr"


def _exif(picture: Any) -> dict[str, Any]:
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            exif = picture.getexif()
            inner = exif.get_ifd(_EXIF_IFD)
    except Exception:  # damaged EXIF costs the picture nothing
        exif, inner = {}, {}
    iso = inner.get(_ISO)
    iso = iso[0] if isinstance(iso, tuple) and iso else iso
    return {
        "orientation": orientation_of(exif),
        "iso": float(iso) if isinstance(iso, (int, float)) and iso > 0 else None,
        "make": _text(exif.get(_MAKE)),
        "model": _text(exif.get(_MODEL)),
    }


def orientation_of(exif: Any) -> int:
    """EXIF orientation, 1 where there is none or it is not 1 to 8."""
    value = exif.get(_ORIENTATION)
    return value if isinstance(value, int) and 1 <= value <= 8 else 1


def _text(value: Any) -> str:
    return value.replace("\0", " ").strip() if isinstance(value, str) else ""


def profile_to_srgb(pixels: np.ndarray, icc: bytes, name: str) -> tuple[np.ndarray, bool]:
    """(H, W, 3) uint8 pixels in sRGB, and whether they had to be changed."""
    try:
        profile = ImageCms.getOpenProfile(io.BytesIO(icc))
        if "srgb" in ImageCms.getProfileDescription(profile).lower():
            return pixels, False
        transform = ImageCms.buildTransform(
            profile, ImageCms.createProfile("sRGB"), "RGB", "RGB", ImageCms.Intent.RELATIVE_COLORIMETRIC
        )
        out = ImageCms.applyTransform(Image.fromarray(pixels), transform)
    except (ImageCms.PyCMSError, OSError, ValueError) as error:
        raise InputError(f"{name}: has a colour profile that cannot be used ({error})") from error
    return np.asarray(out), True


def write_jpeg(
    path: PathLike,
    image: np.ndarray,
    *,
    quality: int = 90,
    subsampling: str = "4:2:0",
    qtables: Sequence[np.ndarray] | None = None,
    orientation: int = 1,
    iso: int | None = None,
    make: str = "",
    model: str = "",
) -> None:
    """Write an 8-bit JPEG with libjpeg.

    Args:
        path: the file; it is replaced as a whole.
        image: (H, W, 3) uint8, or encoded float in [0, 1] that is rounded.
        quality: 1 to 100, for libjpeg's own tables.
        subsampling: "4:4:4", "4:2:2" or "4:2:0".
        qtables: luma and chroma (8, 8) tables in place of those.
        orientation, iso, make, model: for the EXIF.

    Raises:
        InputError: NaN in the image, or the file cannot be written.
    """
    data = encode_jpeg(
        to_bytes(image, str(path)),
        quality,
        subsampling,
        qtables,
        orientation=orientation,
        iso=iso,
        make=make,
        model=model,
    )
    with atomic_write(path) as file:
        file.write(data)


def encode_jpeg(
    pixels: np.ndarray,
    quality: int = 90,
    subsampling: str = "4:2:0",
    qtables: Sequence[np.ndarray] | None = None,
    *,
    orientation: int = 1,
    iso: int | None = None,
    make: str = "",
    model: str = "",
) -> bytes:
    """The bytes of a JPEG of (H, W, 3) uint8 pixels; see `write_jpeg`."""
    if subsampling not in ("4:4:4", "4:2:2", "4:2:0"):
        raise ValueError(f"subsampling {subsampling!r} is not one of 4:4:4, 4:2:2, 4:2:0")
    exif = Image.Exif()
    values = {_ORIENTATION: orientation, _MAKE: make, _MODEL: model}
    exif.update({code: value for code, value in values.items() if value})
    if iso:
        exif.get_ifd(_EXIF_IFD)[_ISO] = int(iso)
    options: dict[str, Any] = {"quality": quality, "subsampling": subsampling, "exif": exif}
    if qtables is not None:
        options["qtables"] = [np.asarray(t).astype(int).ravel().tolist() for t in qtables]
        del options["quality"]
    out = io.BytesIO()
    Image.fromarray(pixels).save(out, "JPEG", **options)
    return out.getvalue()


def to_bytes(image: np.ndarray, name: str) -> np.ndarray:
    """(H, W, 3) uint8 of an encoded image: levels outside [0, 1] are cut, the rest rounded to 255ths."""
    image = np.asarray(image)
    if image.ndim != 3 or image.shape[2] != 3 or 0 in image.shape:
        raise ValueError(f"expected an (H, W, 3) image, got shape {image.shape}")
    if image.dtype == np.uint8:
        return np.ascontiguousarray(image)
    if not np.isfinite(image).all():
        raise InputError(f"{name}: not written: the image holds NaN or infinite values")
    return np.rint(np.clip(image, 0, 1) * 255).astype(np.uint8)
