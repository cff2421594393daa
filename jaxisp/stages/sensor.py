"""The sensor and its converter: mosaic, black and white level, crosstalk, clipping, quantisation."""

from typing import Annotated

import jax
import jax.numpy as jnp

from jaxisp import cfa as filters
from jaxisp.arrays.linear import linear_call, pointwise, scaled
from jaxisp.arrays.planes import planes
from jaxisp.arrays.safe_math import clip_through, round_through, straight_through
from jaxisp.arrays.stencils import edge_counts, pad
from jaxisp.cfa import Bayer, Pattern, check_bayer, rows_of_cell
from jaxisp.domains import Image, LinearRGB, Mosaic
from jaxisp.options import Share, below
from jaxisp.params import Leaf, param, parameters
from jaxisp.pipeline import register
from jaxisp.stages.demosaic.common import diagonal_sum, row_and_column_sums


@register(reach=0, block=rows_of_cell)
def mosaic(image: LinearRGB, *, cfa: Pattern = "RGGB") -> Mosaic:
    """Keep one colour at each photosite.

    `y = x_c`, with c the colour of the photosite in the pattern.

    Args:
        image: (H, W, 3) linear light, any range.
        cfa: the Bayer or X-Trans pattern, row-major from the top-left.

    Returns:
        (H, W) linear light.

    Raises:
        ValueError: unknown pattern.

    Gradient: exact.

    Source: Jaroensri et al. 2019, section 3; Bayer 1976 (US 3 971 065).
    """
    return filters.select(filters.masks((image.shape[0], image.shape[1]), cfa), *planes(image))


@parameters
class BlackLevel:
    """A pedestal."""

    offset: Leaf = param(0.0, (-0.25, 0.25), "level", doc="what is added to every value")


@register(reach=0)
def black_level(params: BlackLevel, image: Image) -> Image:
    """Add a constant: the pedestal of a converter, or what is left of a wrong black level.

    `y = x + offset`.

    Args:
        params: offset; 0 leaves the image as it is.
        image: (H, W) or (H, W, 3), any range.

    Returns:
        The same shape and domain, not clipped.

    Gradient: exact.

    Source: EMVA Standard 1288 (dark signal); DNG Specification 1.6 (BlackLevel).
    """
    return image + params.offset.astype(image.dtype)


@parameters
class Linearization:
    """Where black and white lie in the recorded numbers."""

    black: Leaf = param(
        (0.0, 0.0, 0.0, 0.0),
        (0.0, 0.25),
        "full scale",
        doc="level of black at the four places of the 2x2 cell, row by row",
    )
    white: Leaf = param(1.0, (0.3, 2.0), "full scale", log=True, doc="level of white")


@register(reach=0)
def linearization(params: Linearization, image: Mosaic) -> Mosaic:
    """Subtract the black level of each place of the 2x2 cell and put white at 1.

    `y = (x - black_p) / (white - black_p)`, p = 2 (row mod 2) + (column mod 2). Noise below black stays
    negative.

    Args:
        params: black, in the order of the places and not of their colours (for RGGB that is R, G, G, B),
            and white, in the unit of the image.
        image: (H, W) recorded numbers over the converter's full scale.

    Returns:
        (H, W) linear light, not clipped.

    Gradient: exact.

    Source: DNG Specification 1.6, chapter 5, "Mapping raw values to linear reference values".
    """
    odd_row = jax.lax.broadcasted_iota(jnp.int32, image.shape, 0) % 2 == 1
    odd_column = jax.lax.broadcasted_iota(jnp.int32, image.shape, 1) % 2 == 1

    def at_place(values: jax.Array) -> jax.Array:
        a, b, c, d = values.astype(image.dtype)
        return jnp.where(odd_row, jnp.where(odd_column, d, c), jnp.where(odd_column, b, a))

    return (image - at_place(params.black)) * at_place(1 / (params.white - params.black))


@parameters
class AdcQuantization:
    """Depth of the converter."""

    bits: Leaf = param(14.0, (2.0, 16.0), "bit", doc="rounded to a whole number")


@register(reach=0)
def adc_quantization(params: AdcQuantization, image: Image, *, legacy: bool = False) -> Image:
    """Round to the levels of an analogue-to-digital converter.

    `y = round(x L) / L`, `L = 2**bits - 1`, so that both 0 and 1 are levels. Not clipped: values outside
    [0, 1] are rounded to the same grid (`clip` goes before).

    Args:
        params: bits.
        image: (H, W) or (H, W, 3), any range; full scale at 1.
        legacy: `floor(x 2**bits) / 2**bits`, as the authors' code has it: half a step too dark, and 1 is
            a level of its own.

    Returns:
        The same shape and domain.

    Gradient: surrogate. 1 to the image; to the bits that of `round(x L) / L` with rounding passed
    through, `(x - y) / L` times the slope of L.

    Source: Jaroensri et al. 2019, section 3; Esser et al. 2020 (step-size gradient).
    """
    steps = round_through(jnp.exp2(round_through(params.bits))).astype(image.dtype)

    def quantized(x: jax.Array, steps: jax.Array) -> jax.Array:
        if legacy:
            return straight_through(jnp.floor(x * steps), x * steps) / steps
        top = steps - 1
        level = round_through(x * top)
        y = level / top
        # white as it is: a GPU's quotients are an ulp or two off
        return straight_through(jnp.where(level == top, 1, y), y)

    return pointwise(quantized, (image,), steps)


@parameters
class LevelSteps:
    """How far apart the levels are."""

    step: Leaf = param(0.0, (0.0, 0.25), "level", doc="distance of two levels; 0 is no rounding")


@register
def level_steps(params: LevelSteps, image: Mosaic) -> Mosaic:
    """Round to levels that are evenly apart, any number of them to white.

    `y = step round(x / step)`; `adc_quantization` is this for a whole number of bits.

    Args:
        params: step.
        image: (H, W) linear light, any range.

    Returns:
        (H, W) linear light; the image itself where step is 0.

    Gradient: surrogate. Rounding is passed through, so that it is 1 to the image, and to the step that of
        `step round(x / step)` with it: `(y - x) / step`.

    Source: Widrow & Kollar 2008, "Quantization Noise".
    """
    step = params.step.astype(image.dtype)
    safe = jnp.where(step > 1e-6, step, 1)
    levels = jax.lax.stop_gradient(jnp.round(image / safe) - image / safe)
    return jnp.where(step > 1e-6, image + levels * step, image)


@parameters
class Clip:
    """Where the sensor saturates."""

    white: Leaf = param(1.0, (0.3, 2.0), "level", log=True, doc="larger values become this")


@register(reach=0)
def clip(params: Clip, image: Image, *, low: Annotated[float, below(0.3)] = 0.0, leak: Share = 0.0) -> Image:
    """Clip to the range that the sensor or the file can hold.

    `y = min(max(x, low), white)`.

    Args:
        params: white.
        image: (H, W) or (H, W, 3), any range.
        low: smaller values become this; minus the pedestal where that has been subtracted.
        leak: gradient to clipped pixels, in [0, 1], so that a fitter can leave a clipped region.

    Returns:
        The same shape and domain, within [low, white].

    Raises:
        ValueError: leak outside [0, 1], or low not below the lowest white (0.3).

    Gradient: exact where leak is 0; else the surrogate `leak + (1 - leak) * exact` to the image, and
    `(1 - leak) * exact` to white.

    Source: Jaroensri et al. 2019, section 3; Foi et al. 2008, "Practical Poissonian-Gaussian noise
    modeling and fitting for single-image raw-data" (clipping).
    """
    if not (0 <= leak <= 1 and low < 0.3):
        raise ValueError(f"clip: leak {leak} is outside [0, 1], or low {low} is not below 0.3")
    return pointwise(lambda x, white: clip_through(x, low, white, leak), (image,), params.white)


@parameters
class GreenImbalance:
    """Difference between the two greens."""

    difference: Leaf = param(
        0.02, (-0.2, 0.2), "1", doc="gain of green in red's rows less that of green in blue's rows"
    )


@register(reach=0)
def green_imbalance(params: GreenImbalance, image: Mosaic, *, cfa: Bayer = "RGGB") -> Mosaic:
    """Give the two greens different gains.

    `y = x (1 + difference / 2)` at greens in red's rows, `x (1 - difference / 2)` at those in blue's rows;
    red and blue stay. The mean gain of green is 1.

    Args:
        params: difference; 0 leaves the mosaic as it is, the opposite sign undoes it to first order.
        image: (H, W) linear light, black level subtracted, any range.
        cfa: the Bayer pattern, row-major from the top-left.

    Returns:
        (H, W) linear light.

    Raises:
        ValueError: cfa is not a Bayer pattern: X-Trans has no such two greens.

    Gradient: exact.

    Source: DNG Specification 1.6 (BayerGreenSplit).
    """
    check_bayer(cfa)
    _, green, _ = filters.masks((image.shape[0], image.shape[1]), cfa)
    in_red_rows = jax.lax.broadcasted_iota(jnp.int32, image.shape, 0) % 2 == filters.site(cfa, "R")[0]
    half = (0.5 * params.difference).astype(image.dtype)
    return image * jnp.where(green, 1 + jnp.where(in_red_rows, half, -half), 1)


@parameters
class Crosstalk:
    """Shares of a photosite's light that its neighbours get."""

    horizontal: Leaf = param(
        0.03, (-0.1, 0.3), "1", doc="share that goes left and right, half to each; below 0 undoes it"
    )
    vertical: Leaf = param(0.03, (-0.1, 0.3), "1", doc="share that goes up and down")
    diagonal: Leaf = param(0.01, (-0.1, 0.3), "1", doc="share that goes to the four diagonal neighbours")


@register
def crosstalk(params: Crosstalk, image: Mosaic) -> Mosaic:
    """Leak light between neighbouring photosites, whatever their colours: it blurs and desaturates.

    `y = x + horizontal (mean of left and right - x) + vertical (mean of up and down - x)
    + diagonal (mean of the corners - x)`: a 3x3 kernel of sum 1, so no light is lost inside the frame and
    a flat field stays as it is.

    Args:
        params: the three shares; all 0 leaves the mosaic as it is.
        image: (H, W) linear light, before white balance, any range.

    Returns:
        (H, W) linear light. Borders are reflected, which keeps the phase of a Bayer pattern.

    Gradient: exact.

    Source: Hirakawa 2008, "Cross-talk explained".
    """
    means = linear_call(lambda _, x: _means(x), lambda _, y: _collected(y), (), image)
    shares = (p.astype(image.dtype) for p in (params.horizontal, params.vertical, params.diagonal))
    return image + sum(scaled(share, mean - image) for share, mean in zip(shares, means))


def _means(image: jax.Array) -> tuple[jax.Array, ...]:
    """Those of the neighbours in the row, in the column and on the diagonals."""
    padded = pad(image, 1)
    row, column = row_and_column_sums(padded, 1)
    return 0.5 * row, 0.5 * column, 0.25 * diagonal_sum(padded, 1)


def _collected(cotangents: tuple[jax.Array, ...]) -> jax.Array:
    """The transpose of `_means`: as each is symmetric, the same means, edges weighted."""
    counts = edge_counts(cotangents[0].shape, cotangents[0].dtype)
    means = [_means(counts * c)[i] for i, c in enumerate(cotangents)]
    return (means[0] + means[1] + means[2]) / counts
