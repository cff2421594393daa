"""Pictures as files store them."""

import numpy as np

from jaxisp.io import Jpeg
from jaxisp.pipeline import run, stage
from jaxisp.stages.jpeg import JpegTables


def as_stored(picture: np.ndarray, file: Jpeg | None) -> np.ndarray:
    """(H, W, 3) encoded, as a file with this one's header would have it; rounded where that says nothing."""
    if file is None or file.subsampling not in ("4:4:4", "4:2:2", "4:2:0"):
        return np.round(255 * picture) / 255
    luma, chroma = (np.asarray(t, np.float32) for t in (file.luma_table, file.chroma_table))
    encoder = stage("jpeg_tables", subsampling=file.subsampling)
    return np.asarray(run(encoder, {encoder.name: JpegTables(luma_table=luma, chroma_table=chroma)}, picture))
