"""Defective photosites: hot and dead pixels, and their correction."""

import jax
import jax.numpy as jnp
from jax import lax

from jaxisp.arrays.safe_math import straight_through
from jaxisp.cfa import Bayer, check_bayer
from jaxisp.domains import Mosaic
from jaxisp.params import Leaf, param, parameters
from jaxisp.pipeline import register
from jaxisp.stages.denoise.median import median_plane
from jaxisp.stages.noise import pattern_key


@parameters
class HotPixels:
    """How many, and what they read."""

    density: Leaf = param(0.0005, (0.0, 0.1), "1", doc="share of the photosites")
    level: Leaf = param(1.0, (0.1, 2.0), "level", doc="what the hottest photosite reads")
    spread: Leaf = param(0.0, (0.0, 1.0), "1", doc="share of it that the others may read less")
    dead: Leaf = param(0.0, (0.0, 1.0), "1", doc="share of them that read nothing instead")


@register
def hot_pixels(params: HotPixels, image: Mosaic, *, key: jax.Array, sensor: int | None = None) -> Mosaic:
    """Set photosites at random places to a high level at least, each to its own, and some of them to none.

    `y = max(x, level (1 - spread (v - dead) / (1 - dead))) where u < density else x`, but 0 where v < dead
    too; u and v uniform on [0, 1) per photosite: more density keeps the places that are hot already. A hot
    site collects what leaks into it beside its light: it reads no less than that.

    Args:
        params: density, level, spread and dead.
        image: (H, W) linear light, any range.
        key: draws the places.
        sensor: a serial number that fixes the places whatever the key; None draws them from the key.

    Returns:
        (H, W) linear light.

    Gradient: surrogate for the density (that of the expected image, `y - x` at every photosite); exact to
    the level, the spread and the image; to `dead` only by what it makes of the levels of the others.

    Source: Jaroensri et al. 2019, section 3 (defects).
    """
    key = pattern_key(key, sensor, "hot_pixels")
    v = jax.random.uniform(jax.random.fold_in(key, 1), image.shape, image.dtype)
    place = (v - params.dead) / jnp.maximum(1 - params.dead, 1e-6)
    high = jnp.maximum(params.level * (1 - params.spread * place), image)
    level = jnp.where(v < params.dead, 0, high)
    return _stuck(image, key, params.density, level)


@parameters
class DeadPixels:
    """How many, and what they read."""

    density: Leaf = param(0.0005, (0.0, 0.1), "1", doc="share of the photosites")
    level: Leaf = param(0.0, (-0.1, 0.1), "level", doc="what a dead photosite reads")


@register
def dead_pixels(params: DeadPixels, image: Mosaic, *, key: jax.Array, sensor: int | None = None) -> Mosaic:
    """Set photosites at random places to a low level.

    `y = level where u < density else x`, u uniform on [0, 1) per photosite.

    Args:
        params: density and level.
        image: (H, W) linear light, any range.
        key: draws the places.
        sensor: a serial number that fixes the places whatever the key; None draws them from the key.

    Returns:
        (H, W) linear light.

    Gradient: surrogate for the density (that of the expected image, `level - x` at every photosite);
    exact to the level and the image.

    Source: Jaroensri et al. 2019, section 3 (defects).
    """
    return _stuck(image, pattern_key(key, sensor, "dead_pixels"), params.density, params.level)


def _stuck(image: jax.Array, key: jax.Array, density: jax.Array, level: jax.Array) -> jax.Array:
    chosen = jax.random.uniform(key, image.shape, image.dtype) < density
    moved = level.astype(image.dtype) - image
    exact = jnp.where(chosen, level.astype(image.dtype), image)
    # zero in value; its gradient to the density is that of the mean over all draws
    expected = straight_through(jnp.zeros_like(density), density).astype(image.dtype)
    return exact + expected * lax.stop_gradient(moved)


@parameters
class DefectCorrection:
    """What counts as a defect."""

    threshold: Leaf = param(0.2, (0.0, 1.0), "level", doc="distance from the median that is left alone")


@register
def defect_correction(params: DefectCorrection, image: Mosaic, *, cfa: Bayer = "RGGB") -> Mosaic:
    """Replace photosites that stand out among their neighbours of the same colour.

    `y = m where |x - m| > threshold else x`, m the median of the 3x3 same-colour photosites two pixels
    apart, the photosite itself included; the two greens are kept apart, so that any Bayer pattern does.

    Args:
        params: threshold, in the unit of the image.
        image: (H, W) linear light, any range.
        cfa: the Bayer pattern, row-major from the top-left.

    Returns:
        (H, W) linear light. Borders are reflected, which keeps the phase of the pattern.

    Raises:
        ValueError: cfa is not a Bayer pattern: in X-Trans the same colour is not two pixels away.

    Gradient: surrogate for the choice (a logistic gate 5 % of the threshold wide); that of the median is
    exact: it goes to the neighbour that is the median, shared among equals.

    Source: Jaroensri et al. 2019, section 3; Paeth 1990 and Smith 1996 (median of 9 by comparisons).
    """
    check_bayer(cfa)
    middle = median_plane(image, "3x3", 2)
    excess = jnp.abs(image - middle) - params.threshold
    soft = jax.nn.sigmoid(excess / (0.05 * params.threshold + 1e-4))
    gate = straight_through((excess > 0).astype(image.dtype), soft)
    return straight_through(jnp.where(excess > 0, middle, image), image + gate * (middle - image))
