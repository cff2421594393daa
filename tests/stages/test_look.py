"""Local tone mapping against its formula in float64, with SciPy's Gaussian."""

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter

from jaxisp.pipeline import run, stage
from jaxisp.stages.look import LocalToneMapping
from tests.conftest import smooth_image

LUMA = np.array([0.299, 0.587, 0.114])


def mapped(image, **params):
    node = stage("local_tone_mapping")
    return np.asarray(run(node, {node.name: LocalToneMapping(**params)}, image.astype(np.float32)))


def wanted(image, compression, detail, sigma, edges):
    def mean(plane):
        return gaussian_filter(plane, sigma, mode="nearest")

    y = image @ LUMA
    even, log = np.log2(np.maximum(mean(y), 0.004)), np.log2(np.maximum(y, 0.004))
    variance = mean((log - mean(log)) ** 2)
    share = variance / (variance + 1)
    kept = mean(share) * log + mean((1 - share) * mean(log))
    surround = even + edges * (kept - even)
    gain = 2 ** (-compression * (surround - surround.mean()))
    return image * gain[..., None] + (detail * (y - mean(y)))[..., None]


@pytest.mark.parametrize("edges", [0, 0.4, 1])
@pytest.mark.parametrize("sigma", [6, 14])
def test_local_tone_mapping_is_its_formula(sigma, edges):
    image = np.stack([smooth_image((128, 160), seed) for seed in range(3)], -1) ** 2
    image[:, 80:] *= 0.05
    params = {"compression": 0.3, "detail": 0.2, "sigma": sigma, "edges": edges}
    out, want = mapped(image, **params), wanted(image, **params)
    inner = np.s_[24:-24, 24:-24]  # its means are of 4x4 blocks, borders of which differ
    error, change = (np.sqrt(np.mean((out - a)[inner] ** 2)) for a in (want, image))
    assert error < 0.01 * change


def test_an_edge_of_several_stops_has_less_of_a_halo_beside_an_edge_aware_surround():
    image = np.full((96, 128, 3), 0.8)
    image[:, 64:] = 0.01
    even, aware = (mapped(image, compression=0.4, edges=e)[48, :, 1] for e in (0, 1))
    halo = [np.ptp(np.log2(out[40:64])) + np.ptp(np.log2(out[64:88])) for out in (even, aware)]
    assert halo[1] < 0.5 * halo[0]


def test_it_is_the_identity_at_zero():
    image = np.random.default_rng(0).random((40, 44, 3)).astype(np.float32)
    np.testing.assert_array_equal(mapped(image, edges=1, sigma=5), image)
