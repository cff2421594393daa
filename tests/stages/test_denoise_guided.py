"""The guided filter against its paper's equations, non-local means against loops."""

import jax
import numpy as np
import pytest
import scipy.ndimage as ndi
import skimage.data

from jaxisp.pipeline import run, stage
from jaxisp.stages.denoise.guided import GuidedFilter, guided_plane
from jaxisp.stages.denoise.nonlocal_means import NonlocalMeans, nonlocal_planes
from jaxisp.testing import smooth_image


def noisy(shape=(60, 71), std=0.03):
    plane = skimage.data.camera()[100 : 100 + shape[0], 200 : 200 + shape[1]] / 255.0
    return plane + np.random.default_rng(0).normal(0, std, shape)


@pytest.mark.parametrize(("radius", "edge"), [(2, 0.02), (4, 0.1)])
def test_guided_filter_is_the_papers(radius, edge, x64):
    guide, plane = noisy(), noisy(std=0.1)
    mean = lambda x: ndi.uniform_filter(x, 2 * radius + 1, mode="mirror")  # noqa: E731
    slope = (mean(guide * plane) - mean(guide) * mean(plane)) / (mean(guide**2) - mean(guide) ** 2 + edge**2)
    want = mean(slope) * guide + mean(mean(plane) - slope * mean(guide))
    np.testing.assert_allclose(
        jax.jit(guided_plane, static_argnums=3)(plane, guide, edge, radius), want, atol=1e-10
    )
    single = jax.jit(guided_plane, static_argnums=3)(np.float32(plane), np.float32(guide), edge, radius)
    np.testing.assert_allclose(single, want, atol=1e-5)


def test_nonlocal_means_in_loops(x64):
    plane, search, patch, likeness = noisy((11, 12)), 2, 1, 0.05
    wide = np.pad(plane, search + patch, mode="reflect")

    def around(y, x):
        y, x = y + search + patch, x + search + patch
        return wide[y - patch : y + patch + 1, x - patch : x + patch + 1]

    want = np.zeros_like(plane)
    for y, x in np.ndindex(*plane.shape):
        near = [(y + i, x + j) for i in range(-search, search + 1) for j in range(-search, search + 1)]
        weights = [np.exp(-np.mean((around(*q) - around(y, x)) ** 2) / likeness**2) for q in near]
        want[y, x] = np.average([around(*q)[patch, patch] for q in near], weights=weights)
    got = nonlocal_planes((plane,), plane, likeness, search, patch)[0]
    np.testing.assert_allclose(got, want, atol=1e-12)


def test_at_strength_0_nothing_is_changed():
    image = smooth_image((21, 34, 3)).astype(np.float32)
    off = GuidedFilter(strength=np.float32(0))
    np.testing.assert_array_equal(run(stage("guided_filter"), {"guided_filter": off}, image), image)
    none = NonlocalMeans(luma=np.float32(0), chroma=np.float32(0))
    kept = run(stage("nonlocal_means"), {"nonlocal_means": none}, image)
    np.testing.assert_allclose(kept, image, atol=3e-7)
