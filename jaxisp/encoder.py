"""The encoder that the header of a JPEG file states, as a stage."""

import numpy as np

from jaxisp.io import Jpeg
from jaxisp.io.color_space import ColorSpace
from jaxisp.jpeg.codec import SAMPLING
from jaxisp.params import specs
from jaxisp.pipeline import Params, Stage, run, stage
from jaxisp.stages.jpeg import JpegTables
from jaxisp.stages.jpeg_file import JpegFile

ENCODER = "jpeg_tables"
"""The name of the node, whatever its stage: cameras and priors go by it."""
_MOST = specs(JpegFile)["to_file"].bounds[1]
_WRAP, _LARGEST = 8192, 2048
"""libjpeg-turbo holds 8 times a step in 16 bits, so that it divides by a step modulo the first. Steps above
the second leave no coefficient in any case."""


def encoder_of(
    file: Jpeg | None, name: str = ENCODER, *, original: np.ndarray | None = None
) -> tuple[Stage, Params] | None:
    """What the encoder of a file did to the picture, as far as its header tells.

    Args:
        file: it, or None where the picture comes from no JPEG.
        name: of the node.
        original: (H, W, 3) encoded sRGB that the file was made of, where it is known: of two ways to convert
            colours, between which a header does not tell, that is taken which comes nearer to the file.

    Returns:
        A stage and its parameters, which are set and not fitted; None where there is no file or `no_encoder`
        says why its encoder is not modelled.
    """
    if file is None or no_encoder(file) is not None:
        return None
    tables = np.asarray(file.tables, np.float32)
    two = (tables[1] == tables[2]).all() and tables.max() <= 255
    if two and file.color_space == "YCbCr" and not file.converted:
        encoder = stage("jpeg_tables", name=name, subsampling=file.subsampling)
        return encoder, {name: JpegTables(luma_table=tables[0], chroma_table=tables[1])}
    options = {
        "subsampling": file.subsampling, "components": file.color_space, "converts": file.converted,
    }  # fmt: skip
    params = JpegFile(tables=tables)
    if file.space is not None:
        to_file, from_file = (np.asarray(m, np.float32) for m in _matrices(file.space))
        curve = np.asarray(file.space.curve_table, np.float32)
        params = JpegFile(tables=tables, curve=curve, to_file=to_file, from_file=from_file)
    likelier = file.icc is not None  # who states colours in EXIF has seldom a colour management of 14 bits
    ways = [stage("jpeg_file", name=name, in_14_bits=held, **options) for held in (likelier, not likelier)]
    if original is not None and file.space is not None and original.shape == file.pixels.shape:
        ways.sort(key=lambda way: _distance(way, {name: params}, original, file))
    return ways[0], {name: params}


def _distance(encoder: Stage, params: Params, original: np.ndarray, file: Jpeg) -> float:
    """Mean magnitude of what is left between a picture that is encoded so and the file."""
    return float(np.abs(np.asarray(run(encoder, params, original)) - file.image).mean())


def no_encoder(file: Jpeg) -> str | None:
    """Why the encoder of a file is not modelled, in words; None where it is."""
    if file.subsampling not in SAMPLING:
        return f"its chroma sampling {file.subsampling} is not one of {', '.join(SAMPLING)}"
    steps = np.asarray(file.tables)
    if wrapped := steps[(steps >= _WRAP) & (steps % _WRAP <= _LARGEST)].tolist():
        return f"encoders divide by another step than {wrapped[0]:g}, which its tables state"
    if file.converted and file.space is None:
        return "its colour profile is made of tables"
    if file.space is not None and file.space.curve_table is None:
        return "the curves of its colour profile differ from channel to channel, or do not rise"
    if file.space is not None and np.abs(_matrices(file.space)).max() > _MOST:
        return "the primaries of its colour profile are far from sRGB's"
    return None


def _matrices(space: ColorSpace) -> np.ndarray:
    """(2, 3, 3): linear sRGB to the space's linear RGB, and the way back."""
    return np.stack([np.linalg.inv(space.to_srgb), space.to_srgb])
