"""Pictures: clean photographs in, results out."""

import io
import warnings
from pathlib import Path
from typing import Any

import numpy as np
import tifffile
from PIL import Image

from jaxisp.checks import check_finite
from jaxisp.errors import InputError
from jaxisp.io.color_space import ColorSpace
from jaxisp.io.exif import exif_in, exif_of
from jaxisp.io.files import (
    IMAGE_SUFFIXES,
    PathLike,
    atomic_write,
    check_file,
    check_pixels,
    load_npy,
    read_bytes,
)
from jaxisp.io.icc import by_tables, profile_space
from jaxisp.io.jpeg import Jpeg, decode_jpeg, to_bytes, why_not
from jaxisp.io.orientation import orient
from jaxisp.io.png_color import color_chunks, png_space
from jaxisp.io.silence import silent_libraries
from jaxisp.io.stated_color import stated_space
from jaxisp.io.tags import quiet_tifffile

_MODES = {
    "1": "black and white", "L": "grayscale", "LA": "grayscale with alpha", "P": "a palette picture",
    "PA": "a palette picture",
    "I": "grayscale", "I;16": "16-bit grayscale", "I;16B": "16-bit grayscale", "F": "grayscale",
    "CMYK": "CMYK",
    "LAB": "CIELAB", "YCbCr": "Y'CbCr",
}  # fmt: skip


_LIGHT = -1.0, 64.0
"""What linear light may reach: noise below black, six stops above white."""


def read_image(path: PathLike, *, linear: bool = False) -> np.ndarray:
    """Read a clean photograph.

    Args:
        path: PNG (8 bits), JPEG, TIFF (8 or 16 bits, or float) or NPY (uint8, uint16, or float in [0, 1]),
            in colour and without transparency.
        linear: whether it holds linear light, whose floats may be below 0 and above 1.

    Returns:
        (H, W, 3) float32 in [0, 1] (unless it is linear), as encoded, upright, converted to sRGB where the
        file states another colour space: by a profile, in EXIF or TIFF tags, in the chunks of a PNG. Colours
        are cut to sRGB's gamut. Linear light is converted to sRGB's primaries.

    Raises:
        InputError: it cannot be read, is damaged, or is another kind of picture; it states a colour space
            that is not converted.
    """
    return read_with_header(path, linear=linear)[0]


def read_with_header(path: PathLike, *, linear: bool = False) -> tuple[np.ndarray, Jpeg | None]:
    """As `read_image`, and the file where it is a JPEG."""
    path = check_file(path)
    if path.suffix.lower() == ".npy":
        return _read_npy(path, linear), None
    return _decoded(path, read_bytes(path), linear)


def _decoded(path: Path, data: bytes, linear: bool = False) -> tuple[np.ndarray, Jpeg | None]:
    if data[:2] == b"\xff\xd8":
        file = decode_jpeg(data, str(path))
        return np.ascontiguousarray(file.upright), file
    return _read_lossless(path, data, linear), None


def _read_lossless(path: Path, data: bytes, linear: bool) -> np.ndarray:
    if data[:4] in (b"II*\0", b"MM\0*"):
        return _read_tiff(path, data, linear)
    if data[:8] == b"\x89PNG\r\n\x1a\n":
        return _read_png(path, data, linear)
    raise InputError(f"{path}: is not a picture jaxisp reads ({', '.join(IMAGE_SUFFIXES)}), or a damaged one")


def size_of(path: PathLike) -> tuple[int, int] | None:
    """Rows and columns that `read_image` would give, as the header says; None where it does not."""
    path = Path(path)
    try:
        check_file(path)
        if path.suffix.lower() == ".npy":
            shape = np.load(path, mmap_mode="r").shape
            return (shape[0], shape[1]) if len(shape) == 3 else None
        with silent_libraries(), warnings.catch_warnings():
            warnings.simplefilter("ignore")
            with Image.open(path) as picture:
                width, height = picture.size
                turned = exif_of(picture).orientation >= 5
    except Exception:  # parsers on arbitrary bytes; whoever reads the picture says what is wrong
        return None
    return (width, height) if turned else (height, width)


def read_as_stored(path: PathLike) -> tuple[np.ndarray, dict[str, bytes]]:
    """Read a photograph in its own colour space, for a copy of the file with other pixels.

    Returns:
        (H, W, 3) float32 in [0, 1], and what `write_png` takes to go with them: "exif" and "icc", where the
        file has them. Pictures of more than 8 bits, and those whose colour space is stated otherwise, come as
        `read_image` gives them, without either.

    Raises:
        InputError: what `read_image` raises.
    """
    path = check_file(path)
    if path.suffix.lower() == ".npy":
        return read_image(path), {}
    data = read_bytes(path)
    image = _decoded(path, data)[0]
    with silent_libraries(), warnings.catch_warnings():
        warnings.simplefilter("ignore")
        with Image.open(io.BytesIO(data)) as picture:
            info, stored = picture.info, picture.mode == "RGB" and picture.format in ("JPEG", "MPO", "PNG")
            if not stored or (picture.format == "PNG" and {"gamma", "chromaticity"} & set(info)):
                return image, {}
            pixels = np.asarray(picture, np.float32) / 255
    kept = {"exif": info.get("exif"), "icc": info.get("icc_profile")}
    return pixels, {name: value for name, value in kept.items() if value}


def write_png(
    path: PathLike, image: np.ndarray, *, exif: bytes | None = None, icc: bytes | None = None
) -> None:
    """Write an (H, W, 3) encoded float image in [0, 1] (cut there, rounded to 8 bits), or a uint8 one.

    Args:
        path: of the file, written whole or not at all.
        image: the pixels.
        exif: a block of EXIF to go with them.
        icc: a colour profile that they are in.

    Raises:
        InputError: NaN in the image, or the file cannot be written.

    Example:
        >>> import numpy as np, tempfile
        >>> with tempfile.TemporaryDirectory() as folder:
        ...     write_png(f"{folder}/grey.png", np.full((4, 6, 3), 0.5, np.float32))
        ...     read_image(f"{folder}/grey.png").shape
        (4, 6, 3)
    """
    pixels = to_bytes(image, str(path))
    with atomic_write(path) as file:
        Image.fromarray(pixels).save(file, "PNG", exif=exif or b"", icc_profile=icc)


def _read_png(path: Path, data: bytes, linear: bool) -> np.ndarray:
    if len(data) > 24 and data[12:16] == b"IHDR" and data[24] == 16:
        raise InputError(f"{path}: is a 16-bit PNG, expected 8 bits (or a 16-bit TIFF)")
    picture = _opened(path, data, "PNG")
    pixels, exif = _rgb(picture, path), exif_of(picture)
    try:
        space, icc = png_space(color_chunks(data))
    except ValueError as error:
        raise InputError(f"{path}: states its colours by {error}") from error
    if space is None and icc is None:
        space = stated_space(exif.color, str(path), linear=linear)
    return _upright(_in_srgb(pixels, space, icc, path, linear), exif.orientation)


def _opened(path: Path, data: bytes, kind: str) -> Any:
    """An 8-bit file through Pillow, which reads deeper ones as 8-bit without a word: check before."""
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            picture = Image.open(io.BytesIO(data), formats=(kind,))
            check_pixels(*picture.size, len(data), str(path))
            picture.load()
    except InputError:
        raise
    except Image.DecompressionBombError as error:
        raise InputError(f"{path}: says it is larger than any camera's picture; it is damaged") from error
    except Exception as error:  # a parser on arbitrary bytes: any error means the same
        raise InputError(f"{path}: is a damaged or truncated {kind} ({why_not(error)})") from error
    return picture


def _in_srgb(
    pixels: np.ndarray, space: ColorSpace | None, icc: bytes | None, path: Path, linear: bool
) -> np.ndarray:
    """(H, W, 3) float32 in sRGB of pixels in the colour space of a file, stated or by its profile.

    Linear light is brought to sRGB's primaries, whatever curve the profile has.
    """
    if icc is not None:
        space = profile_space(icc, str(path))
        if space is None and (linear or pixels.dtype != np.uint8):
            raise InputError(
                f"{path}: has a colour profile made of tables, which is applied to encoded 8-bit pictures "
                "alone; expected one of a matrix and curves, or sRGB"
            )
        if space is None:
            pixels = by_tables(pixels, icc, str(path))
    whole = pixels.dtype in (np.uint8, np.uint16)
    if space is None or space.is_srgb or not whole:
        pixels = _to_unit(pixels, path, str(pixels.dtype), linear)
    return pixels if space is None or space.is_srgb else space.srgb(pixels, linear=linear)


def _upright(image: np.ndarray, orientation: int) -> np.ndarray:
    return np.ascontiguousarray(orient(image, orientation))


def _rgb(picture: Any, path: Path) -> np.ndarray:
    if picture.mode == "RGB" and "transparency" not in picture.info:
        return np.asarray(picture)
    if picture.mode == "RGBA":
        pixels = np.asarray(picture)
        if (pixels[..., 3] == 255).all():
            return pixels[..., :3]
    if picture.mode in ("RGBA", "RGB"):
        raise InputError(f"{path}: is partly transparent, expected an opaque RGB picture")
    raise InputError(f"{path}: is {_MODES.get(picture.mode, picture.mode)}, expected an RGB picture")


_PROFILE = 34675


def _read_tiff(path: Path, data: bytes, linear: bool) -> np.ndarray:
    try:
        with quiet_tifffile(), tifffile.TiffFile(io.BytesIO(data)) as tif:
            page: Any = tif.pages[0]
            kind, bits, samples = page.dtype, page.bitspersample, page.samplesperpixel
            photometric, deep = int(page.photometric), page.dtype is not None and page.dtype.itemsize > 1
            icc = page.tags[_PROFILE].value if _PROFILE in page.tags else None
            whole = kind is not None and bits == 8 * kind.itemsize
            wanted = deep and whole and photometric == 2 and samples == 3 and len(page.shape) == 3
            if wanted:
                check_pixels(
                    page.imagewidth, page.imagelength, len(data), str(path), bytes_each=3 * kind.itemsize
                )
            pixels = page.asarray() if wanted else None
    except InputError:
        raise
    except Exception as error:  # a parser on arbitrary bytes: any error means the same
        raise InputError(
            f"{path}: is a damaged or truncated TIFF, or compressed in a way not read here"
        ) from error
    exif = exif_in(data)
    orientation = exif.orientation
    if not deep and bits == 8:
        with silent_libraries():  # libtiff says of damaged files what it finds
            picture = _opened(path, data, "TIFF")
        pixels, orientation = _rgb(picture, path), exif_of(picture).orientation  # 1: Pillow turns a TIFF
    elif pixels is not None and page.planarconfig == 2:
        pixels = np.moveaxis(pixels, 0, -1)
    if pixels is None:
        raise InputError(
            f"{path}: is a TIFF of {samples} samples of {bits} bits, expected RGB of 8 or 16 bits"
        )
    if pixels.shape[-1] != 3 or 0 in pixels.shape:
        raise InputError(f"{path}: is a TIFF of shape {pixels.shape}, expected (H, W, 3)")
    if icc is not None and not isinstance(icc, bytes):
        raise InputError(f"{path}: has a damaged colour profile (tag {_PROFILE} holds no bytes)")
    codes = np.iinfo(pixels.dtype).max + 1 if pixels.dtype.kind == "u" else None
    space = None if icc else stated_space(exif.color, str(path), codes, linear)
    return _upright(_in_srgb(pixels, space, icc or None, path, linear), orientation)


def _read_npy(path: Path, linear: bool) -> np.ndarray:
    array = load_npy(path)
    if array.ndim != 3 or array.shape[2] != 3 or 0 in array.shape:
        raise InputError(f"{path}: has shape {array.shape}, expected (H, W, 3)")
    return _to_unit(array, path, str(array.dtype), linear)


def _to_unit(array: np.ndarray, path: Path, kind: str, linear: bool) -> np.ndarray:
    """Integers divided by their largest value; floats checked to lie in [0, 1], linear light about there."""
    if array.dtype in (np.uint8, np.uint16):
        return array.astype(np.float32) / np.float32(np.iinfo(array.dtype).max)
    if array.dtype.kind != "f":
        raise InputError(f"{path}: holds {kind}, expected uint8, uint16 or float")
    check_finite(str(path), array)
    low, high = float(array.min()), float(array.max())
    least, most = _LIGHT if linear else (-1e-6, 1 + 1e-6)
    if low < least or high > most:
        wanted = "linear light whose white is 1" if linear else "[0, 1]"
        raise InputError(f"{path}: holds values from {low:g} to {high:g}, expected {wanted}")
    return array.astype(np.float32) if linear else np.clip(array, 0, 1).astype(np.float32)
