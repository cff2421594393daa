"""JPEG files: the pixels, and what the encoder did to them as the file itself states it."""

import io
import struct
import warnings
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from PIL import Image, UnidentifiedImageError

from jaxisp.errors import InputError
from jaxisp.io.color_space import ColorSpace
from jaxisp.io.exif import exif_of, new_exif
from jaxisp.io.files import PathLike, atomic_write, check_pixels, read_bytes
from jaxisp.io.icc import by_tables, profile_space
from jaxisp.io.jpeg_frame import Frame, color_profile, frame_header, quantization
from jaxisp.io.orientation import orient
from jaxisp.io.silence import silent_libraries
from jaxisp.io.stated_color import StatedColor, stated_space
from jaxisp.jpeg.tables import quality_tables
from jaxisp.shown import brief

_UNSUPPORTED = {0xC3: "lossless", 0xC5: "hierarchical", 0xC6: "hierarchical", 0xC7: "hierarchical",
                0xCB: "lossless"}  # fmt: skip


@dataclass(frozen=True, repr=False)
class Jpeg:
    """A decoded JPEG file.

    Args:
        pixels: (H, W, 3) uint8 as stored, before `orientation`; sRGB where there was a profile.
        tables: (3, 8, 8) quantisation steps of the components, rows are vertical frequencies.
        subsampling: "4:4:4", "4:2:2", "4:2:0", "4:4:0", "4:1:1", "4:1:0", or the factors as "2x2,1x1,...".
        orientation: EXIF 1 to 8.
        icc: the colour profile as it stands in the file, or None.
        converted: whether the pixels were converted to sRGB, from `icc` or what else the file states.
        color_space: "YCbCr", or "RGB" where the file stores it without a luma.
        iso: None where it is not stated.
        space: what the pixels were converted from; None of sRGB, and of profiles made of tables.
    """

    __repr__ = brief

    pixels: np.ndarray
    tables: np.ndarray
    subsampling: str
    orientation: int
    icc: bytes | None
    converted: bool
    color_space: str
    iso: float | None
    make: str
    model: str
    space: ColorSpace | None = None

    @property
    def luma_table(self) -> np.ndarray:
        """(8, 8) the first component's."""
        return self.tables[0]

    @property
    def chroma_table(self) -> np.ndarray:
        """(8, 8) the second component's; the third may have another."""
        return self.tables[1]

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
        to_srgb: convert pixels of another colour space, stated by a profile or by EXIF, to sRGB (relative
            colorimetric, cut to its gamut).

    Raises:
        InputError: it is missing, empty, truncated, no JPEG, grayscale, CMYK, or not 8 bits deep; its profile
            or what its EXIF states of its colours cannot be used.
    """
    return decode_jpeg(read_bytes(path), str(path), to_srgb=to_srgb)


def decode_jpeg(data: bytes, name: str, *, to_srgb: bool = True) -> Jpeg:
    """`read_jpeg` for bytes; `name` stands in errors."""
    if data[:3] != b"\xff\xd8\xff":
        raise InputError(f"{name}: is not a JPEG file")
    try:
        # Pillow passes over profiles after the frame header and those that lack a part, and over later tables
        frame, icc = frame_header(data), color_profile(data)
    except (ValueError, struct.error) as error:
        raise InputError(f"{name}: is a damaged or truncated JPEG ({error})") from error
    _check_frame(frame, name)
    check_pixels(frame.width, frame.height, len(data), name)
    picture, pixels = _decode(data, name)
    exif, converted, space = exif_of(picture), False, None
    if to_srgb:
        pixels, converted, space = _in_srgb(pixels, icc, exif.color, name)
    return Jpeg(
        pixels=pixels,
        tables=_tables(data, frame, name),
        subsampling=frame.subsampling,
        icc=icc,
        converted=converted,
        color_space=_color_space(frame, picture),
        orientation=exif.orientation,
        iso=exif.iso,
        make=exif.make,
        model=exif.model,
        space=space,
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
    except Exception as error:  # a parser on arbitrary bytes: any error means the same
        raise InputError(f"{name}: is a damaged or truncated JPEG ({why_not(error)})") from error
    if picture.mode != "RGB":
        raise InputError(f"{name}: is a {picture.mode} JPEG, expected RGB")
    return picture, np.asarray(picture)


def why_not(error: Exception) -> str:
    """What Pillow says where it means to say it, without the address of the object that it was given."""
    said = isinstance(error, (OSError, ValueError, SyntaxError)) and str(error)
    return said if said and not isinstance(error, UnidentifiedImageError) else "a part of it cannot be read"


def _tables(data: bytes, frame: Frame, name: str) -> np.ndarray:
    try:
        tables = quantization(data, frame)
    except ValueError as error:
        raise InputError(f"{name}: is a damaged JPEG ({error})") from error
    if tables.min() < 1:
        raise InputError(
            f"{name}: is a damaged JPEG (a quantisation step of {tables.min()}, expected 1 or more)"
        )
    return tables


def _color_space(frame: Frame, picture: Any) -> str:
    """As libjpeg decides: by a JFIF marker, which means Y'CbCr; else by Adobe's; else by the components."""
    transform = picture.info.get("adobe_transform")
    if "jfif" in picture.info:
        return "YCbCr"
    return "RGB" if transform == 0 or (transform is None and bytes(frame.ids) == b"RGB") else "YCbCr"


def _in_srgb(
    pixels: np.ndarray, icc: bytes | None, stated: StatedColor, name: str
) -> tuple[np.ndarray, bool, ColorSpace | None]:
    """Pixels in sRGB, whether they had to be changed, and from which space where that is no table."""
    space = profile_space(icc, name) if icc else stated_space(stated, name)
    if space is None and icc:
        return by_tables(pixels, icc, name), True, None
    if space is None or space.is_srgb:
        return pixels, False, None
    found = space.srgb(pixels)
    np.rint(np.multiply(found, 255, out=found), out=found)
    return found.astype(np.uint8), True, space


def write_jpeg(
    path: PathLike,
    image: np.ndarray,
    *,
    quality: int = 90,
    subsampling: str = "4:2:0",
    qtables: Sequence[np.ndarray] | None = None,
    orientation: int = 1,
    iso: float | None = None,
    make: str = "",
    model: str = "",
) -> None:
    """Write an 8-bit JPEG with libjpeg.

    Args:
        path: the file; it is replaced as a whole.
        image: (H, W, 3) uint8, or encoded float in [0, 1] that is rounded.
        quality: 1 to 100, for libjpeg's own tables.
        subsampling: "4:4:4", "4:2:2" or "4:2:0".
        qtables: luma and chroma (8, 8) tables in place of those, or one for each component; steps from 1 to
            65535.
        orientation, iso, make, model: for the EXIF.

    Raises:
        InputError: NaN in the image, an ISO over 4294967295, or the file cannot be written.
    """
    pixels = to_bytes(image, str(path))
    about: dict[str, Any] = {"orientation": orientation, "iso": iso, "make": make, "model": model}
    try:
        data = encode_jpeg(pixels, quality, subsampling, qtables, **about)
    except InputError as error:
        raise InputError(f"{path}: not written: {error}") from error
    with atomic_write(path) as file:
        file.write(data)


def encode_jpeg(
    pixels: np.ndarray,
    quality: int = 90,
    subsampling: str = "4:2:0",
    qtables: Sequence[np.ndarray] | None = None,
    *,
    orientation: int = 1,
    iso: float | None = None,
    make: str = "",
    model: str = "",
) -> bytes:
    """The bytes of a JPEG of (H, W, 3) uint8 pixels; see `write_jpeg`."""
    if subsampling not in ("4:4:4", "4:2:2", "4:2:0"):
        raise ValueError(f"subsampling {subsampling!r} is not one of 4:4:4, 4:2:2, 4:2:0")
    exif = new_exif(orientation, iso, make, model)
    options: dict[str, Any] = {"quality": quality, "subsampling": subsampling, "exif": exif}
    if qtables is not None:
        options["qtables"] = [np.asarray(t).astype(int).ravel().tolist() for t in qtables]
        del options["quality"]
    out = io.BytesIO()
    with silent_libraries():  # libjpeg's word on steps over 255
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
