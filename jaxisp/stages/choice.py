"""Choices as numbers: demosaicking algorithms and chroma sampling of a pipeline that is compiled once."""

from collections.abc import Callable, Mapping
from functools import partial
from typing import Annotated

import jax
import jax.numpy as jnp
from jax import lax

from jaxisp.arrays.barriers import materialize, unknown_zeros
from jaxisp.arrays.extents import Extent, clamped_rows
from jaxisp.arrays.planes import interleaved, planes
from jaxisp.arrays.rows import as_rows, from_rows
from jaxisp.arrays.safe_math import round_through
from jaxisp.arrays.shares import weighted
from jaxisp.cfa import Bayer, Pattern, is_xtrans
from jaxisp.color import rgb_to_ycbcr_planes, ycbcr_to_rgb_planes
from jaxisp.domains import CameraRGB, EncodedRGB, Mosaic
from jaxisp.options import one_of
from jaxisp.params import Leaf, param, parameters
from jaxisp.pipeline import register
from jaxisp.stages.demosaic import (
    demosaic_ahd,
    demosaic_bilinear,
    demosaic_dcb,
    demosaic_edge_aware,
    demosaic_hamilton_adams,
    demosaic_hibbard,
    demosaic_lmmse,
    demosaic_malvar,
    demosaic_markesteijn,
    demosaic_menon,
    demosaic_normalized_convolution,
    demosaic_ppg,
    demosaic_rcd,
    demosaic_vng,
)
from jaxisp.stages.jpeg import Jpeg, Sampling, jpeg


def demosaic_ahd_libraw(image: Mosaic, *, cfa: Bayer = "RGGB") -> CameraRGB:
    """`demosaic_ahd` as LibRaw has it."""
    return demosaic_ahd(image, cfa=cfa, delta=1, variant="libraw")


DEMOSAICKERS: dict[str, Callable[..., jax.Array]] = {
    "bilinear": demosaic_bilinear,
    "malvar": demosaic_malvar,
    "hibbard": demosaic_hibbard,
    "ahd": demosaic_ahd,
    "menon": demosaic_menon,
    "hamilton-adams": demosaic_hamilton_adams,
    "vng": demosaic_vng,
    "edge-aware": demosaic_edge_aware,
    "ahd-libraw": demosaic_ahd_libraw,
    "rcd": demosaic_rcd,
    "ppg": demosaic_ppg,
    "dcb": demosaic_dcb,
    "lmmse": demosaic_lmmse,
}
"""Of Bayer mosaics."""
XTRANS_DEMOSAICKERS: dict[str, Callable[..., jax.Array]] = {
    "markesteijn": demosaic_markesteijn,
    "markesteijn-1": partial(demosaic_markesteijn, passes=1),
    "normalized-convolution": demosaic_normalized_convolution,
}
"""Of X-Trans mosaics."""


def demosaickers(cfa: str) -> Mapping[str, Callable[..., jax.Array]]:
    """The algorithms for a pattern."""
    return XTRANS_DEMOSAICKERS if is_xtrans(cfa) else DEMOSAICKERS


Algorithm = Annotated[str, one_of(*DEMOSAICKERS, *XTRANS_DEMOSAICKERS)]
ANY = "any"
Partner = Annotated[str, one_of(ANY, *DEMOSAICKERS)]
FARTHEST = 16
"""px that an algorithm for Bayer mosaics looks, at most."""


@parameters
class Demosaicking:
    """The share of each algorithm."""

    shares: Leaf = param((0.0,) * len(DEMOSAICKERS), (-0.5, 1.5), "1", doc=", ".join(DEMOSAICKERS))


@register(reach=lambda o: None if is_xtrans(o["cfa"]) else FARTHEST, symmetric=True)
def demosaicking(
    params: Demosaicking,
    image: Mosaic,
    *,
    cfa: Pattern = "RGGB",
    algorithm: Algorithm = "malvar",
    partner: Partner = ANY,
) -> CameraRGB:
    """Demosaick by one of several algorithms, or a mix, the choice being a parameter.

    `y = D(x) + sum_k share_k (D_k(x) - D(x))`. One whose share is 0 is not run (under `vmap`,
    and for gradients to the shares, all are). With a `partner` that one alone is mixed in.

    Args:
        params: the shares; on X-Trans the first three, in the order of `XTRANS_DEMOSAICKERS`.
        image: (H, W) linear light, any range.
        cfa: the Bayer or X-Trans pattern, row-major from the top-left.
        algorithm: D, which all shares 0 leave: one of `DEMOSAICKERS`, or of `XTRANS_DEMOSAICKERS`.
        partner: the one of `DEMOSAICKERS` whose share counts, so that no other is compiled; "any": all.

    Returns:
        (H, W, 3) camera RGB.

    Raises:
        ValueError: unknown pattern, or an algorithm or a partner that is not for it.

    Gradient: surrogate: exact to the shares; to the image that of the algorithms.

    Source: see the stages named.
    """
    known = demosaickers(cfa)
    for option, name in (("algorithm", algorithm), ("partner", partner)):
        if name not in known and (option, name) != ("partner", ANY):
            kind = "X-Trans" if is_xtrans(cfa) else "a Bayer pattern"
            raise ValueError(f"demosaicking: {option} {name!r} on {kind}, expected {', '.join(known)}")
    start = as_rows(known[algorithm](image, cfa=cfa))
    change = unknown_zeros(start.shape, start)
    for share, (name, run) in zip(params.shares, known.items()):
        if name == algorithm or partner not in (ANY, name):  # D less D, or not mixed in
            continue
        change = change + weighted(lambda m, s, run=run: as_rows(run(m, cfa=cfa)) - s, share, image, start)
    return from_rows(start + change, (*image.shape, 3))


@parameters
class ChromaSubsampling:
    """How coarsely chroma is stored."""

    horizontal: Leaf = param(1.0, (0.0, 1.0), "share", doc="0 is full resolution, 1 halves the columns")
    vertical: Leaf = param(1.0, (0.0, 1.0), "share", doc="0 is full resolution, 1 halves the rows")
    sampled: Leaf = param(0.0, (0.0, 1.0), "share", doc="0 stores averages of two, 1 the first of two")
    repeated: Leaf = param(0.0, (0.0, 1.0), "share", doc="0 restores by interpolation, 1 by repetition")


HALVED = {"4:2:0": (1.0, 1.0), "4:2:2": (1.0, 0.0)}
"""By the chroma sampling of a file, `horizontal` and `vertical` of `ChromaSubsampling`; none is 4:4:4."""


@register
def chroma_subsampling(
    params: ChromaSubsampling, image: EncodedRGB, *, extent: Extent | None = None
) -> EncodedRGB:
    """Halve the resolution of chroma and restore the size: averages of two, back by linear interpolation.

    `C' = C + share (U(D(C)) - C)`, columns first and then rows; D averages pairs from the left and from
    the top, U weighs 3/4 and 1/4. 1 and 1 is 4:2:0, 1 and 0 is 4:2:2. Plain code takes the first of each
    pair for D, and repeats it for U: `sampled` and `repeated` mix that in.

    Args:
        params: the shares.
        image: (H, W, 3) encoded, any range.
        extent: of the picture, where the image is a larger frame.

    Returns:
        (H, W, 3) encoded, not rounded.

    Gradient: exact.

    Source: ITU-T T.81 (1992); libjpeg's h2v1 and h2v2 filters.
    """
    y, *chroma = rgb_to_ycbcr_planes(*planes(image))
    forms = params.sampled, params.repeated
    width, height = (None, None) if extent is None else (extent.width, extent.height)
    across = (_halved(materialize(c.T), params.horizontal, *forms, width) for c in chroma)
    cb, cr = (materialize(_halved(materialize(c.T), params.vertical, *forms, height)) for c in across)
    return interleaved(ycbcr_to_rgb_planes(y, cb, cr))


def _halved(
    plane: jax.Array, share: jax.Array, sampled: jax.Array, repeated: jax.Array, size: jax.Array | None
) -> jax.Array:
    """Along the rows, `size` of them the picture's: every second of a column is a vector, of a row not."""
    height = plane.shape[0]
    even = jnp.pad(plane, ((0, height % 2), (0, 0)), mode="edge")
    if size is not None:
        even = clamped_rows(even, size)
    first, second = even[::2], even[1::2]
    small = first + 0.5 * (1 - sampled) * (second - first)
    if size is not None:
        small = clamped_rows(small, (size + 1) // 2)
    tall = jnp.pad(small, ((1, 1), (0, 0)), mode="edge")
    far = 0.25 * (1 - repeated)
    above, below = (small + far * (tall[s : s + len(small)] - small) for s in (0, 2))
    restored = jnp.stack([above, below], 1).reshape(even.shape)[:height]
    return plane + share * (restored - plane)


@parameters
class EarlierCompression:
    """A JPEG that the picture went through before, and where its blocks began."""

    quality: Leaf = param(70.0, (5.0, 100.0), "quality", doc="libjpeg's, rounded")
    row: Leaf = param(0.0, (0.0, 7.0), "px", doc="rows by which its 8x8 grid is moved down, rounded")
    column: Leaf = param(0.0, (0.0, 7.0), "px", doc="columns by which its grid is moved right, rounded")


@register
def earlier_compression(
    params: EarlierCompression,
    image: EncodedRGB,
    *,
    extent: Extent | None = None,
    subsampling: Sampling = "4:4:4",
) -> EncodedRGB:
    """Compress the picture on an 8x8 grid that need not start at its corner.

    The picture is rolled so that the grid does start there, compressed by `jpeg`, and rolled back: blocks
    that cross the border hold both sides of the picture.

    Args:
        params: quality and the place of the grid.
        image: (H, W, 3) in [0, 1].
        extent: of the picture, where the image is a larger frame.
        subsampling: "4:4:4", "4:2:2" or "4:2:0".

    Returns:
        (H, W, 3) in [0, 1], multiples of 1/255.

    Gradient: none to the place; else surrogate, as that of `jpeg`.

    Source: ITU-T T.81 (1992).
    """
    row, column = (jnp.round(lax.stop_gradient(v)).astype(jnp.int32) for v in (params.row, params.column))
    moved = _rolled(image, (row, column), extent)
    moved = jpeg(Jpeg(quality=round_through(params.quality)), moved, extent=extent, subsampling=subsampling)
    return _rolled(moved, (-row, -column), extent)


def _rolled(image: jax.Array, by: tuple[jax.Array, jax.Array], extent: Extent | None) -> jax.Array:
    """The picture up and to the left, what leaves it there coming in at its end."""
    if extent is None:
        return jnp.roll(image, jnp.stack([-n for n in by]), (0, 1))
    for axis, (step, size) in enumerate(zip(by, extent)):
        place = (lax.iota(jnp.int32, image.shape[axis]) + step) % size
        image = jnp.take(image, place, axis, mode="clip")
    return image
