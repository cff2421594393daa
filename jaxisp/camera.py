"""Cameras: pipelines from a mosaic to a picture, and developing RAW files with them.

A camera is a recipe with constants. What a RAW file states itself (CFA, as-shot white balance,
colour matrix) is set from the file when the camera is applied to it.
"""

import dataclasses
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from jaxisp.cfa import is_xtrans, size
from jaxisp.errors import InputError, short
from jaxisp.io import Raw, orient
from jaxisp.node import Around
from jaxisp.pipeline import Chain, Node, Row, Stage, run_in_strips, signature, stage
from jaxisp.priors import is_distribution
from jaxisp.recipe import Recipe, check_traces
from jaxisp.recipes import RecipeLike, find_recipe
from jaxisp.stages.balance import ColorMatrix, WhiteBalance
from jaxisp.stages.optics import Exposure
from jaxisp.stages.sensor import Clip

__all__ = [
    "develop", "exposure_for_highlights", "high_percentile", "params_for", "shaded_mosaic", "standard_camera",
    "with_cfa",
]  # fmt: skip
__dir__ = __all__.copy  # what an editor completes

WHITE_BALANCE = "mosaic_white_balance"
EXPOSURE = "exposure"
COLOR_MATRIX = "color_matrix"
DISPLAY = "display_range"
FROM_FILE = (WhiteBalance, Exposure, ColorMatrix)
"""Parameters that may be taken from a RAW file."""


def standard_camera(demosaic: str = "demosaic_ahd") -> Recipe:
    """A plain camera: white balance, highlights clipped to white, demosaicking, exposure for the
    brightest 1 %, the file's colour matrix, sRGB. No denoising and no sharpening."""
    demosaicker = stage(demosaic)
    nodes = (
        stage(WHITE_BALANCE, cfa=demosaicker.options["cfa"]),
        stage("clip"),
        demosaicker,
        stage(EXPOSURE),
        stage(COLOR_MATRIX),
        stage("srgb_oetf"),
        stage("rounding"),
    )
    chain = Chain(nodes, "standard")
    meta = {"from_file": [WHITE_BALANCE, EXPOSURE, COLOR_MATRIX]}
    return Recipe(chain, {}, "a plain rendering, as a RAW converter starts from", meta)


def with_cfa(node: Node, cfa: str) -> Node:
    """The pipeline with every stage that has a `cfa` option set to that pattern.

    Raises:
        InputError: a stage does not work on it.
    """
    if isinstance(node, Stage):
        options = dict(node.static)
        if "cfa" not in dict(signature(node.fn).static):
            return node
        return stage(node.fn, name=node.name, **{**options, "cfa": cfa})
    if isinstance(node, Around):
        return dataclasses.replace(node, node=with_cfa(node.node, cfa))
    assert isinstance(node, Row)
    return dataclasses.replace(node, nodes=tuple(with_cfa(n, cfa) for n in node.nodes))


def shaded_mosaic(raw: Raw) -> np.ndarray:
    """(H, W) mosaic with the file's own lens shading, maps and vignetting, corrected, where it states any."""
    return raw.mosaic if raw.shading is None else raw.mosaic * raw.shading


def params_for(camera: RecipeLike, raw: Raw) -> dict[str, Any]:
    """The camera's parameters, with what the file states itself set from the file.

    The camera's `meta["from_file"]` lists the stages: white balances, exposures, colour matrices.
    """
    camera = find_recipe(camera)
    params = dict(camera.prior)
    for name in camera.meta.get("from_file", []):
        own = params.get(name)
        if isinstance(own, WhiteBalance):
            gains = np.ones(3) if raw.white_balanced else np.asarray(raw.white_balance)
            params[name] = WhiteBalance(gains=np.asarray(gains, np.float32))
        elif isinstance(own, Exposure):
            params[name] = Exposure(exposure_ev=np.float32(exposure_for_highlights(raw)))
        elif isinstance(own, ColorMatrix) and raw.camera_to_srgb is not None:
            params[name] = ColorMatrix(matrix=np.asarray(raw.camera_to_srgb, np.float32))
    return params


def exposure_for_highlights(raw: Raw) -> float:
    """The exposure [EV, 0 to 5] that brings the 99th percentile of the brightest balanced colour to white,
    and at least the baseline exposure that the file states."""
    gains = np.ones(3) if raw.white_balanced else raw.white_balance
    mosaic = shaded_mosaic(raw)
    n = size(raw.cfa)
    brightest = max(
        gains["RGB".index(color)] * high_percentile(mosaic[i // n :: n, i % n :: n], 99)
        for i, color in enumerate(raw.cfa)
    )
    # a gain of the file's own before this one would be undone by it as far as highlights are below white
    return max(float(np.clip(-np.log2(max(brightest, 1e-9)), 0, 5)), raw.baseline_exposure)


def high_percentile(plane: np.ndarray, percent: float) -> float:
    """`np.percentile` of a large (H, W) plane, in a third of the time for a percentile near 100."""
    # whatever is below the percentile before it, among some of the pixels, need not be sorted
    high = plane[plane >= np.percentile(plane[::9, ::7], percent - 1)]
    place = percent / 100 * (plane.size - 1) - (plane.size - high.size)
    if place < 0:
        return float(np.percentile(plane, percent))
    low, part = int(place), place - int(place)
    ranks = low, min(low + 1, high.size - 1)
    below, above = np.partition(high, ranks)[list(ranks)]
    return float(below + part * (above - below))


def develop(raw: Raw, camera: RecipeLike | None = None, key: jax.Array | None = None) -> np.ndarray:
    """Render a RAW file. The lens shading that it states is corrected; what it states of distortion is not.
    Pixels that are not square are made so.

    Large frames are rendered in strips of rows, as far as the camera's stages allow it.

    Args:
        raw: what `jaxisp.io.read_raw` read.
        camera: a pipeline from a mosaic to encoded sRGB, as a recipe, a chain or a TOML file;
            `standard_camera()` unless given, which demosaicks X-Trans after Markesteijn.
        key: for a camera that draws noise.

    Returns:
        (H, W, 3) float32 encoded sRGB in [0, 1], turned upright.

    Raises:
        InputError: the camera does not turn a mosaic into encoded sRGB, draws some of its parameters, or does
            not work on this pattern.
    """
    if not hasattr(raw, "cfa"):
        raise TypeError(f"develop takes what jaxisp.io.read_raw(PATH) reads, got {short(raw)}")
    xtrans = is_xtrans(raw.cfa)
    if camera is None:
        camera = standard_camera("demosaic_markesteijn" if xtrans else "demosaic_ahd")
    camera = find_recipe(camera)
    try:
        chain = with_cfa(camera.chain, raw.cfa)
    except InputError as error:
        raise InputError(f"{raw.path}: camera {camera.name!r} cannot render it: {error}") from None
    if (chain.domain_in.name, chain.domain_out.name) != ("mosaic", "encoded sRGB"):
        raise InputError(
            f"camera {camera.name!r} turns {chain.domain_in.name} into {chain.domain_out.name}; "
            "developing needs mosaic into encoded sRGB"
        )
    if xtrans:  # an algorithm named by an option shows that it does not fit only when it is traced
        check_traces(dataclasses.replace(camera, chain=Chain((chain,), chain.name)))
    for name, own in camera.prior.items():
        if any(map(is_distribution, jax.tree.leaves(own, is_leaf=is_distribution))):
            raise InputError(f"camera {camera.name!r}: {name} is drawn at random; developing needs numbers")
    whole = Chain((chain, stage("clip", name=DISPLAY)), chain.name)
    params = {**params_for(camera, raw), DISPLAY: Clip()}
    picture = run_in_strips(whole, params, shaded_mosaic(raw), key)
    if raw.scale != (1, 1):
        height, width = (max(1, round(n * by)) for n, by in zip(raw.mosaic.shape, raw.scale))
        picture = jnp.clip(jax.image.resize(picture, (height, width, 3), "cubic"), 0, 1)
    return orient(np.asarray(picture), raw.orientation)
