"""How far each demosaicking stage looks, for working on a large frame in strips of rows."""

from typing import Any

from jaxisp.stages.demosaic import (
    ahd,
    bilinear,
    edge_aware,
    hamilton_adams,
    hibbard,
    malvar,
    markesteijn,
    menon,
    normalized_convolution,
    vng,
)

_MODULES = (bilinear, edge_aware, hamilton_adams, hibbard, malvar, menon, vng)
_REACH = {f"demosaic_{m.__name__.rpartition('.')[2]}": m.REACH for m in _MODULES}


def reach(name: str, **static: Any) -> int:
    """How far from a pixel the result of a demosaicking stage depends on the mosaic [px].

    Args:
        name: a stage, such as "demosaic_ahd".
        static: its options; those that do not change the reach are ignored.
    """
    if name == "demosaic_ahd":
        return ahd.reach(static.get("delta", 2), static.get("median_passes", 0))
    if name == "demosaic_markesteijn":
        return markesteijn.reach(static.get("passes", 3))
    if name == "demosaic_normalized_convolution":
        return normalized_convolution.reach(static.get("cfa", "RGGB"))
    return _REACH[name]
