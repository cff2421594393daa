"""One pair as it was read: its RAW developed plainly, and laid on the camera's picture."""

import dataclasses
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from jaxisp.camera import WHITE_BALANCE, params_for, shaded_mosaic
from jaxisp.encoder import no_encoder
from jaxisp.errors import InputError
from jaxisp.fit import model
from jaxisp.fit.align import Alignment, estimate, same_scene, turned_place
from jaxisp.fit.lens import Lens, radial
from jaxisp.fit.planes import SMALLEST
from jaxisp.io import Jpeg, Raw, orient
from jaxisp.io.orientation import INVERSE
from jaxisp.pipeline import Chain, run, stage
from jaxisp.recipe import Recipe
from jaxisp.shown import brief
from jaxisp.stages.transfer import srgb_oetf

FROM_FILE: dict[str, Any] = {"from_file": [WHITE_BALANCE]}
_SCALES = (0.8, 1.25)  # of the picture against the RAW; beyond, resizing would have to be modelled


@dataclasses.dataclass(frozen=True, repr=False)
class Example:
    """One pair as it was read: a RAW and the picture (H, W, 3) that the camera made of it, encoded sRGB
    in [0, 1], lying as the RAW does; `jpeg` is the file it was decoded from, where there is one."""

    __repr__ = brief

    name: str
    raw: Raw
    picture: np.ndarray
    jpeg: Jpeg | None = None


def balanced(raw: Raw) -> np.ndarray:
    """The mosaic with shading, as-shot white balance and the clip at white."""
    chain = Chain((stage("mosaic_white_balance", cfa=raw.cfa), stage("clip")), "balanced")
    params = params_for(Recipe(chain, chain.init(), meta=FROM_FILE), raw)
    return np.asarray(run(chain, params, jnp.asarray(shaded_mosaic(raw))))


def demosaicked(mosaic: np.ndarray, cfa: str, design: model.Design) -> jax.Array:
    """Camera RGB of a whole balanced mosaic."""
    return run(demosaicker(cfa, design), model.shares(design), jnp.asarray(mosaic))


def demosaicker(cfa: str, design: model.Design) -> Chain:
    return Chain(model.head(cfa, design).nodes[2:], "demosaic")


def align(example: Example) -> tuple[Example, Alignment, Lens, int, tuple[str, ...]]:
    """Where the RAW lies on the picture; a picture that was turned or mirrored is turned back.

    Raises:
        InputError: the two do not show the same scene, or are of very different sizes.
    """
    camera_rgb = demosaicked(balanced(example.raw), example.raw.cfa, model.Design("demosaic_bilinear"))
    bright = max(float(np.percentile(camera_rgb, 99)), 1e-6)
    guess = np.asarray(_encoded(np.asarray(camera_rgb) / np.float32(bright)))
    picture, notes = example.picture, []
    if min(*picture.shape[:2], *guess.shape[:2]) < SMALLEST:
        raise InputError(
            f"{example.name}: the JPEG has {picture.shape[1]}x{picture.shape[0]} px and the RAW "
            f"{guess.shape[1]}x{guess.shape[0]}; expected {SMALLEST} or more a side"
        )
    alignment = estimate(picture, guess)
    orientation = INVERSE[turned_place(picture, guess, alignment)[1]]
    if orientation != 1:
        picture, before = np.ascontiguousarray(orient(picture, orientation)), alignment
        alignment = estimate(picture, guess)
        notes.append(
            f"the JPEG was turned or mirrored against the RAW: turned back by EXIF orientation {orientation} "
            f"(correlation {float(alignment.correlation):.2f} against {float(before.correlation):.2f})"
        )
    if not same_scene(alignment, picture.shape, guess.shape):
        reason = f"do not show the same scene (correlation {float(alignment.correlation):.2f} at best)"
        if picture.shape[:2] != guess.shape[:2]:
            sizes = [f"{shape[1]}x{shape[0]} px" for shape in (picture.shape, guess.shape)]
            reason += (
                f", or the JPEG, of {sizes[0]} beside a RAW of {sizes[1]}, is a part that was resized; a fit "
                f"needs {_SCALES[0]} to {_SCALES[1]} of its size"
            )
        raise InputError(f"{example.name}: the RAW and the JPEG {reason}")
    scales = 1 / float(alignment.scale_y), 1 / float(alignment.scale_x)
    if min(scales) < _SCALES[0] or max(scales) > _SCALES[1]:
        raise InputError(
            f"{example.name}: the JPEG is {scales[0]:.2f} times as high and {scales[1]:.2f} times as wide as "
            f"the RAW; a fit needs a full-size JPEG ({_SCALES[0]} to {_SCALES[1]})"
        )
    # a turned picture is not on its encoder's grid any more
    jpeg = example.jpeg if orientation == 1 else None
    alignment, k1 = radial(picture, guess, alignment)
    why = jpeg and no_encoder(jpeg)
    if why:
        notes.append(f"what its JPEG encoder did is not modelled: {why}")
    if example.raw.notes:
        notes.append(f"RAW: {'; '.join(example.raw.notes)}")
    example = dataclasses.replace(example, picture=picture, jpeg=jpeg)
    return example, alignment, Lens(k1), orientation, tuple(notes)


@jax.jit
def _encoded(linear: jax.Array) -> jax.Array:
    return srgb_oetf(jnp.clip(linear, 0, 1))
