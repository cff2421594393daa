"""The encoder that the header of a JPEG file states, as a stage."""

import numpy as np

from jaxisp.io import Jpeg
from jaxisp.jpeg.codec import SAMPLING
from jaxisp.pipeline import Params, Stage, stage
from jaxisp.stages.jpeg import JpegTables
from jaxisp.stages.jpeg_file import JpegFile

ENCODER = "jpeg_tables"
"""The name of the node, whatever its stage: cameras and priors go by it."""


def encoder_of(file: Jpeg | None, name: str = ENCODER) -> tuple[Stage, Params] | None:
    """What the encoder of a file did to the picture, as far as its header tells.

    Args:
        file: it, or None where the picture comes from no JPEG.
        name: of the node.

    Returns:
        A stage and its parameters, which are set and not fitted; None where there is no file or `no_encoder`
        says why its encoder is not modelled.
    """
    if file is None or no_encoder(file) is not None:
        return None
    tables = np.asarray(file.tables, np.float32)
    ordinary = file.color_space == "YCbCr" and (tables[1] == tables[2]).all() and tables.max() <= 255
    if ordinary:
        encoder = stage("jpeg_tables", name=name, subsampling=file.subsampling)
        return encoder, {name: JpegTables(luma_table=tables[0], chroma_table=tables[1])}
    options = {"subsampling": file.subsampling, "components": file.color_space, "converts": False}
    return stage("jpeg_file", name=name, **options), {name: JpegFile(tables=tables)}


def no_encoder(file: Jpeg) -> str | None:
    """Why the encoder of a file is not modelled, in words; None where it is."""
    if file.subsampling not in SAMPLING:
        return f"its chroma sampling {file.subsampling} is not one of {', '.join(SAMPLING)}"
    return None
