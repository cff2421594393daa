"""What a network is to give: the camera's own picture without noise, drawn as the noisy one was."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxisp.pipeline import Chain, Gate, stage
from jaxisp.priors import Uniform
from jaxisp.recipe import Recipe
from jaxisp.recipes import RECIPES, mix
from jaxisp.stages.detail import UnsharpMask
from jaxisp.stages.noise import GaussianNoise
from jaxisp.stages.tone import SCurve
from jaxisp.testing import smooth_image
from jaxisp.train.target import pair_maker, without_noise

IMAGES = np.stack([smooth_image((24, 32, 3), i) for i in range(4)]).astype(np.float32)
KEY = jax.random.key(3)


def test_the_target_has_the_cameras_draws_and_no_noise():
    chain = Chain((stage("gaussian_noise"), stage("s_curve"), Gate(stage("median")), stage("jpeg")), "small")
    prior = {"s_curve": SCurve(strength=Uniform(0.1, 0.9)), "gaussian_noise": GaussianNoise(std=0.1)}
    recipe = Recipe(chain, prior)
    assert [s.name for s in without_noise(recipe).chain.stages()] == ["s_curve"]
    noisy, target = pair_maker(recipe, KEY, "camera")(jnp.asarray(IMAGES), np.arange(4) + 7)
    wanted, _, params = recipe.degrade(KEY, IMAGES, 7)
    np.testing.assert_array_equal(noisy, wanted)
    for image, curve, got in zip(IMAGES, params["s_curve"].strength, target):
        own = Recipe(Chain((stage("s_curve"),), "own"), {"s_curve": SCurve(strength=float(curve))})
        np.testing.assert_allclose(got, own.degrade(KEY, image[None])[0][0], atol=1e-6)


def test_the_target_of_a_mixture_is_that_of_each_images_recipe():
    soft = Chain((stage("s_curve"), stage("gaussian_noise")), "soft")
    mixture = mix({Recipe(soft, {"s_curve": SCurve(strength=0.8)}): 0.5, "awgn": 0.5})
    clean, at = jnp.asarray(np.tile(IMAGES, (3, 1, 1, 1))), np.arange(12)
    noisy, target = pair_maker(mixture, KEY, "camera")(clean, at)
    wanted, _, params = mixture.degrade(KEY, clean)
    np.testing.assert_array_equal(noisy, wanted)
    curved = Recipe(Chain((stage("s_curve"),), "own"), {"s_curve": SCurve(strength=0.8)}).degrade(KEY, clean)[
        0
    ]
    is_soft = np.asarray(params["recipe"] == 0)
    assert 0 < is_soft.sum() < 12
    np.testing.assert_allclose(target, np.where(is_soft[:, None, None, None], curved, clean), atol=2e-6)


def test_the_target_may_be_the_photograph():
    _, target = pair_maker(RECIPES["awgn"](), KEY)(jnp.asarray(IMAGES), np.arange(4))
    np.testing.assert_array_equal(target, IMAGES)


@pytest.mark.parametrize("name", ["awgn", "any-camera"])
def test_built_in_recipes_lose_their_noise_and_keep_their_optics(name):
    kept = [s.name for s in without_noise(RECIPES[name]()).chain.stages()]
    assert not {"gaussian_noise", "balanced_noise", "jpeg", "median", "bilateral", "rounding"} & set(kept)
    assert name == "awgn" or {"mosaic", "demosaicking", "unsharp_mask", "resampling", "wide_filter"} <= set(
        kept
    )


def test_a_recipe_without_noise_stays():
    recipe = Recipe(Chain((stage("unsharp_mask"),), "plain"), {"unsharp_mask": UnsharpMask()})
    assert without_noise(recipe) == recipe
