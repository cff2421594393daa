"""What a denoiser is to give: the clean photograph, or what the same camera would show without noise."""

from collections.abc import Callable
from typing import Any

import jax
from jax.sharding import Mesh

from jaxisp.catalogue import group_of
from jaxisp.data.loader import degrader
from jaxisp.mixture import Degradation, Mixture
from jaxisp.recipe import Recipe
from jaxisp.recipes import RecipeLike, find_degradation

TARGETS = ("photo", "camera")
_OF_NOISE = ("noise", "denoise", "file")

Pairs = Callable[[jax.Array, Any], tuple[jax.Array, jax.Array]]
"""`(clean, indices) -> (noisy, target)`."""


def without_noise(recipe: RecipeLike) -> Degradation:
    """The recipe, or each of a mixture, less noise, denoising, compression and rounding.

    For the same key and index it draws what the recipe draws, and so gives the picture that the same camera
    would have taken: its sharpness, colour and tone.
    """
    found = find_degradation(recipe)
    if isinstance(found, Mixture):
        return Mixture({name: _less_noise(own) for name, own in found.recipes.items()}, found.shares)
    return _less_noise(found)


def _less_noise(recipe: Recipe) -> Recipe:
    names = [s.name for s in recipe.chain.stages() if group_of(s.fn.__name__) in _OF_NOISE]
    return recipe.without(*names) if names else recipe


def pair_maker(recipe: RecipeLike, key: jax.Array, target: str = "photo", mesh: Mesh | None = None) -> Pairs:
    """`(clean, indices) -> (noisy, target)`, each sample by its index alone.

    Args:
        recipe: takes and gives encoded sRGB.
        key: root of all draws.
        target: one of `TARGETS`: the clean picture, or what the recipe makes of it `without_noise`.
        mesh: devices over which the batch is spread.
    """
    degrade = degrader(recipe, key, mesh)
    aim = degrader(without_noise(recipe), key, mesh) if target == "camera" else lambda clean, indices: clean
    return lambda clean, indices: (degrade(clean, indices), aim(clean, indices))
