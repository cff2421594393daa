"""What a camera does to its pictures beyond its model, where it is known: a picture that is added.

A reference picture of the same RAW tells it pixel by pixel. Effects that act on pictures then act on the
reference itself; those of the mosaic act before, and what the model lacks is added to what they make. What a
reference's file did to it comes after the effects: another picture of the scene had a file of its own.
"""

import jax.numpy as jnp
import numpy as np

from jaxisp.domains import EncodedRGB
from jaxisp.params import Leaf, param, parameters
from jaxisp.pipeline import Chain, Params, Stage, stage

REMAINDER, PICTURE_LIGHT, FILE_NOISE = "remainder", "picture_light", "file_noise"
"""The node that adds it, the one after it, from which on the picture is in linear light, and the one that
adds what the file did."""
_ENCODED = "picture_encoded"


@parameters
class Remainder:
    """The picture that is added."""

    added: Leaf = param(0.0, (-1.0, 1.0), "1", doc="(H, W, 3), encoded")


def add_remainder(params: Remainder, image: EncodedRGB) -> EncodedRGB:
    """Add a picture.

    Args:
        params: the picture, (H, W, 3), or a number.
        image: (H, W, 3) encoded.

    Returns:
        (H, W, 3) encoded.
    """
    return image + jnp.asarray(params.added, image.dtype)


def with_remainder(
    chain: Chain, count: int, shape: tuple[int, int], *, of_file: bool = False
) -> tuple[Chain, Params]:
    """A chain that ends with the picture that is added, still nothing, and with light and back.

    Args:
        chain: mosaic to encoded sRGB, without a file's compression.
        count: of pictures.
        shape: height and width of each.
        of_file: whether what the file did is added apart.

    Returns:
        the chain; the parameters of each picture.
    """
    last = (Stage(add_remainder, FILE_NOISE),) if of_file else ()
    nodes = (Stage(add_remainder, REMAINDER), *through_light(), *last)
    added = Remainder(added=np.zeros((count, *shape, 3), np.float32))
    return Chain((*chain.nodes, *nodes), chain.name), dict.fromkeys(
        [REMAINDER, *(n.name for n in last)], added
    )


def through_light() -> tuple[Stage, Stage]:
    """Two nodes that do nothing together: effects of light go between them."""
    return stage("srgb_eotf", name=PICTURE_LIGHT), stage("srgb_oetf", name=_ENCODED)
