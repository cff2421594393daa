"""The camera that is fitted: what is computed once for a RAW, and what the gradient moves."""

from typing import Any

import numpy as np

from jaxisp.io import Jpeg
from jaxisp.pipeline import Chain, Params, stage
from jaxisp.stages.jpeg import JpegTables

ZONES = 7
"""Control points of the tone curve, beside a gamma for its overall bend."""


def head(cfa: str, demosaic: str) -> Chain:
    """Mosaic to camera RGB: nothing in it is fitted, so it runs once a picture."""
    nodes = (stage("mosaic_white_balance", cfa=cfa), stage("clip"), stage(demosaic, cfa=cfa))
    return Chain(nodes, "raw_to_camera_rgb")


def tail() -> Chain:
    """Camera RGB to encoded sRGB: exposure and colour, denoising in encoded light as phones do it,
    tone, saturation, sharpening, 8 bits."""
    names = (
        "exposure",
        "color_matrix",
        "srgb_oetf",
        "bilateral",
        "median",
        "gamma_compression",
        "zone_curve",
        "saturation",
        "unsharp_mask",
        "rounding",
    )
    options: dict[str, dict[str, Any]] = {
        "median": {"footprint": "cross"},
        "zone_curve": {"on": "channels"},
        "unsharp_mask": {"radius": 6},
    }
    return Chain(tuple(stage(name, **options.get(name, {})) for name in names), "camera_rgb_to_picture")


def with_jpeg(chain: Chain, jpeg: Jpeg | None) -> tuple[Chain, Params]:
    """The chain with the JPEG encoder that wrote `jpeg` at its end, and its parameters: the file's own
    tables, which are set and not fitted. No encoder where there is no file or its sampling is a rare one."""
    if jpeg is None or jpeg.subsampling not in ("4:4:4", "4:2:2", "4:2:0"):
        return chain, {}
    encoder = stage("jpeg_tables", subsampling=jpeg.subsampling)
    tables = [np.asarray(t, np.float32) for t in (jpeg.luma_table, jpeg.chroma_table)]
    params = {encoder.name: JpegTables(luma_table=tables[0], chroma_table=tables[1])}
    return Chain((*chain.nodes, encoder), chain.name), params


def camera(cfa: str, demosaic: str) -> Chain:
    """The whole: `jaxisp.camera.develop` runs it on a RAW."""
    return Chain((*head(cfa, demosaic).nodes, *tail().nodes), "fitted")
