"""Pairs of the reference phone and fits of them, made once."""

import dataclasses

import numpy as np
import pytest

from jaxisp.camera import develop
from jaxisp.fit import Example, fit_dataset, fit_examples
from jaxisp.io import open_dataset
from jaxisp.recipe import Recipe
from jaxisp.samples import PHONES, scene, write_pairs

SIZE = (128, 192)
PLAIN = {"demosaic": "demosaic_malvar", "median": "none"}


def example(folder) -> Example:
    pair = open_dataset(folder).pairs[0].load()
    return Example("astronaut", pair.raw, pair.picture, pair.jpeg)


@pytest.fixture(scope="session")
def folder(tmp_path_factory):
    folder = tmp_path_factory.mktemp("pairs")
    write_pairs(folder, PHONES["a"], {"astronaut": scene("astronaut", SIZE)})
    return folder


@pytest.fixture(scope="session")
def result(folder):
    return fit_dataset(folder, steps=10, **PLAIN)


@pytest.fixture(scope="session")
def own(folder, result):
    """The target is the fitted model's own rendering with other, known parameters."""
    given, camera = example(folder), result.camera
    chain = camera.chain.without("jpeg_tables")
    prior = {k: v for k, v in camera.prior.items() if k != "jpeg_tables"}
    prior["saturation"] = dataclasses.replace(prior["saturation"], amount=np.float32(1.3))
    prior["unsharp_mask"] = dataclasses.replace(prior["unsharp_mask"], amount=np.float32(1.0))
    truth = Recipe(chain, prior, meta=camera.meta)
    return truth, dataclasses.replace(given, picture=develop(given.raw, truth), jpeg=None)


@pytest.fixture(scope="session")
def refitted(own):
    return fit_examples([own[1]], steps=10, **PLAIN)
