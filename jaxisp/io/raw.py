"""RAW files: the mosaic, and all that the file states about the camera that made it."""

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal

import numpy as np

from jaxisp.cfa import shifted
from jaxisp.checks import check_finite
from jaxisp.errors import InputError
from jaxisp.io import dng_color, dng_layout
from jaxisp.io import dng_facts as dng
from jaxisp.io import tags as tag
from jaxisp.io.calibration import (
    Calibration,
    camera_to_srgb,
    camera_to_srgb_d65,
    usable,
    white_xy,
)
from jaxisp.io.description import RawDescription
from jaxisp.io.files import PathLike, check_file, load_npy, steady
from jaxisp.io.libraw import (
    camera_crop,
    check_cells,
    check_mosaic,
    check_pattern,
    opened,
    visible_pattern,
    white_gains,
)
from jaxisp.io.opcodes import FixVignetteRadial, GainMap, Opcode, WarpRectilinear, shading_gain
from jaxisp.io.quad import Filters, binned, reduced, remosaicked
from jaxisp.io.settings import SettingsFile
from jaxisp.shown import brief

RAW_SUFFIXES = (
    ".dng", ".3fr", ".arw", ".cr2", ".cr3", ".crw", ".dcr", ".erf", ".fff", ".iiq", ".kdc", ".mef", ".mos",
    ".mrw", ".nef", ".nrw", ".orf", ".pef", ".raf", ".raw", ".rw2", ".rwl", ".sr2", ".srf", ".srw", ".x3f",
)  # fmt: skip
_FLIP_TO_EXIF = {0: 1, 3: 3, 5: 8, 6: 6}


@dataclass(frozen=True, repr=False)
class Raw:
    """A RAW picture, cut to the camera's own crop.

    Args:
        mosaic: (H, W) float32, linear; black is 0, white is 1. Negatives are kept, values may exceed 1.
        cfa: Bayer or X-Trans pattern of `mosaic` from its top-left.
        black: (4,) levels of 2x2 places row by row, in the file's units (means where they vary).
        white: saturation level in the file's units.
        white_balance: (3,) gains as shot, green 1; ones where the file states none. Not applied,
            unless `white_balanced`.
        calibration: the matrices the file states, or None.
        xyz_to_camera: (3, 3) for the light of the shot, or None.
        camera_to_srgb: (3, 3) for white-balanced camera RGB, rows sum to 1, or None.
        noise_profile: (3, 2) shot and read of R, G, B in `shot * x + read**2`, or None.
        opcodes_2, opcodes_3: lens shading for the mosaic and for the demosaicked picture, in order, not
            applied; `shading` evaluates them.
        warp: lens correction, not applied, or None.
        orientation: EXIF 1 to 8, not applied.
        active_area: top, left, bottom, right in the sensor's frame.
        crop: top, left, height, width of `mosaic` in the active area.
        baseline_exposure: gain [EV] that the file asks for when it is rendered, not applied.
        scale: rows and columns of the rendered picture for each of `mosaic`: (1, 1) where pixels are square.
        notes: a line on each thing that the file states and that is not applied, or not as it is stated.
    """

    __repr__ = brief

    path: Path
    mosaic: np.ndarray
    cfa: str
    black: np.ndarray
    white: float
    white_balance: np.ndarray
    active_area: tuple[int, int, int, int]
    crop: tuple[int, int, int, int]
    white_balanced: bool = False
    calibration: Calibration | None = None
    xyz_to_camera: np.ndarray | None = None
    camera_to_srgb: np.ndarray | None = None
    noise_profile: np.ndarray | None = None
    opcodes_2: tuple[Opcode, ...] = ()
    opcodes_3: tuple[Opcode, ...] = ()
    warp: WarpRectilinear | None = None
    orientation: int = 1
    iso: float | None = None
    exposure_time: float | None = None
    make: str = ""
    model: str = ""
    baseline_exposure: float = 0.0

    scale: tuple[float, float] = (1.0, 1.0)
    notes: tuple[str, ...] = ()

    @property
    def gain_map(self) -> tuple[GainMap, ...] | None:
        """The lens-shading maps of both lists, or None."""
        return tuple(o for o in self.opcodes_2 + self.opcodes_3 if isinstance(o, GainMap)) or None

    @property
    def vignette(self) -> FixVignetteRadial | None:
        """The first vignetting of both lists, or None."""
        both = self.opcodes_2 + self.opcodes_3
        return next((o for o in both if isinstance(o, FixVignetteRadial)), None)

    @property
    def shading(self) -> np.ndarray | None:
        """(H, W) float32 gain of `opcodes_2` and `opcodes_3` at every pixel of `mosaic`, or None."""
        if not (self.opcodes_2 or self.opcodes_3):
            return None
        return _shading(self, shifted(self.cfa, -self.crop[0], -self.crop[1]))


def _shading(raw: Raw, cell: str) -> np.ndarray:
    """Gain of every pixel of the mosaic; `cell` is the pattern of the active area."""
    top, left, bottom, right = raw.active_area
    gain = shading_gain(raw.opcodes_2, (bottom - top, right - left), raw.opcodes_3, cell)
    return _cut(gain, raw.crop)


@np.errstate(all="ignore")  # a damaged file's numbers may overflow: what comes of them is checked
def read_raw(
    path: PathLike, description: RawDescription | None = None, quad: Literal["bin", "remosaic"] = "bin"
) -> Raw:
    """Read a RAW file, or a mosaic in `NAME.raw.npy`.

    Args:
        path: any Bayer or X-Trans RAW that LibRaw opens, or a DNG whose filters cover 2x2 to 4x4 pixels each.
        description: overrides what the file states; by default `[raw]` of the dataset.toml beside it, and
            that of the file's own stem. A `.npy`, or a `.raw` without a header (which LibRaw knows by nothing
            but its size), must have one.
        quad: what becomes of such filters: the mean of each ("bin"), or a Bayer mosaic of full size
            ("remosaic").

    Raises:
        ValueError: another `quad`.
        InputError: it cannot be read, is damaged or truncated, or is neither a Bayer nor an X-Trans mosaic
            (monochrome, linear, Foveon).
    """
    if quad not in ("bin", "remosaic"):
        raise ValueError(f"read_raw: quad must be bin or remosaic, got {quad!r}")
    path = check_file(path)
    with steady(path):
        return _read(path, description, quad)


def _read(path: Path, description: RawDescription | None, quad: str) -> Raw:
    is_npy = path.suffix.lower() == ".npy"
    bare = is_npy or _is_headerless(path)
    if description is None:
        description = _described_beside(path, bare)
    if bare and description.cfa is None:
        raise InputError(f"{path}: states no colour filters, and [raw] in {description.source} has no cfa")
    if is_npy:
        return _read_npy(path, description)
    _check_magic(path)
    tags = tag.read_tags(path)
    if tags is None and path.suffix.lower() == ".dng":
        raise InputError(f"{path}: is not a DNG, or a damaged one (its TIFF tags cannot be read)")
    if tags is not None and (tags.is_dng or path.suffix.lower() == ".dng"):
        return _read_dng(path, tags, description, quad)
    return _read_other(path, tags, description)


def _is_headerless(path: Path) -> bool:
    """Whether it is a dump of pixels: `.raw` files of cameras begin as TIFF does."""
    with path.open("rb") as file:
        return path.suffix.lower() == ".raw" and file.read(2) not in (b"II", b"MM")


def _described_beside(path: Path, bare: bool) -> RawDescription:
    source = path.parent / "dataset.toml"
    if bare and not source.is_file():
        raise InputError(
            f"{path}: needs a dataset.toml beside it whose [raw] states the cfa, black and white"
        )
    name = path.name.lower()
    stem = path.name[: -len(".raw.npy")] if name.endswith(".raw.npy") else path.stem
    return SettingsFile(path.parent).of(stem).raw or RawDescription(source=str(source))


def _check_magic(path: Path) -> None:
    with path.open("rb") as file:
        head = file.read(8)
    for magic, name in ((b"\xff\xd8\xff", "JPEG"), (b"\x89PNG", "PNG"), (b"\x93NUMPY", "NumPy")):
        if head.startswith(magic):
            raise InputError(f"{path}: is a {name} file, expected a RAW file")


def _read_dng(path: Path, tags: tag.DngTags, description: RawDescription, quad: str) -> Raw:
    notes: list[str] = []
    tell = notes.append
    dng_layout.check_dng(tags, path, tell)
    for code in tags.unread:
        tell(f"tag {code} states a value that is not in the file: it is left out")
    area = dng_layout.active_area(tags, path)
    active = area[2] - area[0], area[3] - area[1]
    crop = dng_layout.default_crop(tags, active, path, tell)
    with opened(path) as raw:
        check_mosaic(raw, path)
        if raw.raw_image.shape != (tags.raw[tag.HEIGHT], tags.raw[tag.WIDTH]):
            raise InputError(f"{path}: LibRaw reads another picture of it than its tags describe")
        dng_layout.check_decoded(raw.raw_image, tags, path)
        pixels = dng_layout.in_place(raw.raw_image, tags, path)
        levels = _cut(pixels[area[0] : area[2], area[1] : area[3]], crop).astype(np.float32)
        as_shot = white_gains(raw.camera_whitebalance)
    calibration = dng_color.calibration(tags, tell)
    neutral = dng_color.neutral(tags, calibration, as_shot, tell)
    filters = dng_layout.color_filters(tags, path)
    black, white = dng.black_levels(tags, active, path, tell), dng.white_level(tags, path, tell)
    if white / 2 < black.max() < white:
        tell(f"its BlackLevel of {black.max():g} leaves less than half of its WhiteLevel of {white:g}")
    raw_picture = Raw(
        path=path,
        mosaic=levels,
        cfa=filters.after(crop[0], crop[1]).cfa,
        black=_cut(black, crop),
        white=white,
        white_balance=1 / neutral,
        active_area=area,
        crop=crop,
        noise_profile=dng.noise_profile(tags, tell),
        baseline_exposure=dng.baseline_exposure(tags, tell),
        scale=dng.default_scale(tags, tell),
        **dng.lens(tags, path, tell),
        **dng.header(tags),
    )
    dng.tell_unused(tags, tell)
    if calibration is not None:
        raw_picture = _calibrated(raw_picture, calibration, neutral)
    raw_picture = _finish(raw_picture, description, float(black.max()))
    if filters.size > 1:
        raw_picture = _made_bayer(raw_picture, filters, quad, tell)
    return replace(raw_picture, notes=tuple(notes))


def _made_bayer(raw: Raw, filters: Filters, quad: str, tell: dng_color.Tell) -> Raw:
    """A picture whose `filters`, those of its active area, cover several pixels each, as a Bayer mosaic.

    Shading is corrected before: pixels of a filter, and of its neighbours, are compared. GainMaps for single
    pixels of a filter stay corrected; of the others the mosaic keeps the shading, as other files do.
    """
    n, crop = filters.size, raw.crop[:2]
    own = filters.after(*crop)._replace(cfa=raw.cfa)  # which a description may state otherwise
    filters = own.after(-crop[0], -crop[1])
    kept = tuple(
        tuple(o for o in opcodes if not isinstance(o, GainMap) or o.pitch == (1, 1))
        for opcodes in (raw.opcodes_2, raw.opcodes_3)
    )
    shaded = raw.opcodes_2 or raw.opcodes_3
    gain = _shading(raw, filters.cell) if shaded else np.float32(1)
    corrected = replace(raw, mosaic=raw.mosaic * gain, opcodes_2=kept[0], opcodes_3=kept[1])
    if quad == "remosaic":
        gains = np.ones(3) if raw.white_balanced else raw.white_balance
        mosaic, cfa = remosaicked(corrected.mosaic, own, gains)
        tell(f"its filters cover {n} x {n} pixels: made a Bayer mosaic of full size")
        made = replace(corrected, mosaic=mosaic, cfa=cfa)
    else:
        made = _binned(corrected, filters)
        tell(f"its filters cover {n} x {n} pixels: their means are taken")
    # as if this mosaic were the file's: what is corrected of its shading is corrected later
    return made if made.shading is None else replace(made, mosaic=made.mosaic / made.shading)


def _binned(raw: Raw, filters: Filters) -> Raw:
    """The mean of each filter."""
    own, n = filters.after(*raw.crop[:2]), filters.size
    mosaic = binned(raw.mosaic, own)
    if min(mosaic.shape) < 2:
        raise InputError(f"{raw.path}: has fewer than 2 x 2 filters of {n} x {n} pixels")
    top, left, bottom, right = raw.active_area
    height, width = (bottom - top - filters.start[0]) // n, (right - left - filters.start[1]) // n
    first = [(cut + new - old) // n for cut, new, old in zip(raw.crop, own.start, filters.start)]
    noise = raw.noise_profile
    return replace(
        raw,
        mosaic=mosaic,
        cfa=own.cfa,
        active_area=(top // n, left // n, top // n + height, left // n + width),
        crop=(*first, *mosaic.shape),
        noise_profile=None if noise is None else noise / (n * n, n),
        opcodes_2=tuple(reduced(o, filters) for o in raw.opcodes_2),
        opcodes_3=tuple(reduced(o, filters) for o in raw.opcodes_3),
    )


def _calibrated(raw: Raw, calibration: Calibration, neutral: np.ndarray) -> Raw:
    """With the colour matrices for the light of the shot."""
    try:
        matrix = calibration.at(white_xy(calibration, neutral))[0]
        to_srgb = camera_to_srgb(calibration, neutral)
    except np.linalg.LinAlgError as error:
        raise InputError(f"{raw.path}: has colour matrices that cannot be inverted") from error
    check_finite(f"{raw.path}: its colour matrix", to_srgb)
    return replace(raw, calibration=calibration, xyz_to_camera=matrix, camera_to_srgb=to_srgb)


def _read_other(path: Path, tags: tag.DngTags | None, description: RawDescription) -> Raw:
    with opened(path) as raw:
        cfa, sizes = check_pattern(raw, path), raw.sizes
        crop = camera_crop(sizes)
        levels = _cut(raw.raw_image_visible, crop).astype(np.float32)
        cell = np.roll(visible_pattern(raw), (-crop[0], -crop[1]), (0, 1))
        black = np.array(raw.black_level_per_channel, np.float32)[cell]
        rgb = [raw.color_desc.decode().index(name) for name in "RGB"]
        matrix = np.array(raw.rgb_xyz_matrix, np.float64)[rgb]
        raw_picture = Raw(
            path=path,
            mosaic=levels,
            cfa=shifted(cfa, crop[0], crop[1]),
            black=black,
            white=float(raw.white_level),
            white_balance=white_gains(raw.camera_whitebalance),
            active_area=(
                sizes.top_margin,
                sizes.left_margin,
                sizes.top_margin + sizes.height,
                sizes.left_margin + sizes.width,
            ),
            crop=crop,
            orientation=_FLIP_TO_EXIF.get(sizes.flip, 1),
            iso=float(raw.other.iso_speed) or None,
        )
    if tags is not None:
        raw_picture = replace(raw_picture, **{k: v for k, v in dng.header(tags).items() if v})
    if usable(matrix) and not _is_headerless(path):
        raw_picture = replace(raw_picture, xyz_to_camera=matrix, camera_to_srgb=camera_to_srgb_d65(matrix))
    return _finish(raw_picture, description)


def _read_npy(path: Path, description: RawDescription) -> Raw:
    mosaic = load_npy(path)
    if mosaic.ndim == 4 and mosaic.shape[:2] == (1, 1):
        mosaic = mosaic[0, 0]
    if mosaic.ndim != 2 or min(mosaic.shape) < 2 or mosaic.dtype.kind not in "uif":
        raise InputError(
            f"{path}: holds {mosaic.dtype} {mosaic.shape}, expected a mosaic (H, W) or (1, 1, H, W)"
        )
    assert description.cfa is not None
    integers = mosaic.dtype.kind in "ui"
    raw = Raw(
        path=path,
        mosaic=mosaic.astype(np.float32),
        cfa=description.cfa,
        black=np.zeros((2, 2), np.float32),
        white=float(np.iinfo(mosaic.dtype).max) if integers else 1.0,
        white_balance=np.ones(3),
        active_area=(0, 0, *mosaic.shape),
        crop=(0, 0, *mosaic.shape),
        white_balanced=description.white_balanced,
    )
    return _finish(raw, description)


def _finish(raw: Raw, description: RawDescription, largest: float | None = None) -> Raw:
    """Apply the description, subtract black, scale white to 1. `raw.black` is a cell or a plane so far.

    All pixels have one scale, that of the `largest` black of the sensor: equal light stays equal.

    Source: Digital Negative specification 1.7.1, chapter 5.
    """
    black = raw.black
    if description.black is not None:
        black = np.broadcast_to(description.black, 4).reshape(2, 2).astype(np.float32)
    if largest is None or description.black is not None:
        largest = float(black.max())
    white = raw.white if description.white is None else description.white
    if not np.float32(largest) < np.float32(white):
        raise InputError(
            f"{raw.path}: has a white level of {white:g} that is not above its black of {largest:g}"
        )
    out, scale = raw.mosaic, np.float32(white) - np.float32(largest)
    n = 6 if black.shape == (6, 6) else 2
    for y, x in np.ndindex(n, n):
        out[y::n, x::n] = (out[y::n, x::n] - black[y::n, x::n]) / scale
    check_finite(str(raw.path), out)
    cfa = description.cfa or raw.cfa
    check_cells(out.shape, cfa, raw.path)
    balance = raw.white_balance if description.white_balance is None else description.white_balance
    return replace(
        raw,
        cfa=cfa,
        black=np.array([black[y::2, x::2].mean(dtype=np.float64) for y in (0, 1) for x in (0, 1)]),
        white=float(white),
        white_balance=balance / balance[1],
        white_balanced=description.white_balanced,
    )


def _cut(array: np.ndarray, crop: tuple[int, int, int, int]) -> np.ndarray:
    top, left, height, width = crop
    return array[top : top + height, left : left + width]
