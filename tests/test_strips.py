"""Large frames in strips: the same picture, and how far each stage looks."""

import jax
import numpy as np
import pytest

from jaxisp.params import map_specs
from jaxisp.pipeline import Chain, Gate, Shuffle, run, signature, stage
from jaxisp.stages import STAGES
from jaxisp.strips import REACH, reach, run_in_strips
from jaxisp.testing import smooth_image

SMALL = {
    "bilateral": {"radius": 2, "chroma_radius": 3},
    "unsharp_mask": {"radius": 3},
    "optical_blur": {"radius": 3},
    "median": {"footprint": "5x5", "iterations": 2},
}
FAR = [stage(name, **SMALL.get(name, {})) for name in sorted(REACH) if reach(stage(name))]
NEAR = [name for name in sorted(REACH) if reach(stage(name)) == 0]


def middle(node):
    """Every parameter in the middle of its range, so that no stage is the identity."""
    return map_specs(
        lambda spec, _: np.full(spec.shape, 0.4 * spec.bounds[0] + 0.6 * spec.bounds[1], np.float32),
        node.init(),
    )


def image_for(node, rows, columns=22):
    shape = (rows, columns) if node.domain_in.channels == 1 else (rows, columns, 3)
    return smooth_image(shape, 1, -0.1, 1.1).astype(np.float32)


@pytest.mark.parametrize("node", FAR, ids=lambda node: node.name)
def test_a_stage_that_looks_around_is_the_same_in_strips(node):
    image = image_for(node, 159 if "jpeg" in node.name else 71)
    whole = run(node, middle(node), image)
    parts = run_in_strips(node, middle(node), image, rows=16)
    np.testing.assert_allclose(parts, whole, rtol=1e-6, atol=1e-6)


@pytest.mark.parametrize("name", NEAR)
def test_a_stage_that_looks_nowhere_is_the_same_in_halves(name):
    node = stage(name)
    image = image_for(node, 12)
    call = jax.jit(lambda x: node(middle(node), x))
    halves = np.concatenate([call(image[:6]), call(image[6:])])
    np.testing.assert_allclose(call(image), halves, rtol=1e-6, atol=1e-6)


def test_what_needs_the_whole_frame_has_no_reach():
    for name in ("vignetting", "auto_exposure", "wavelet_coring", "shot_read_noise", "resize"):
        assert reach(stage(name)) is None
    assert reach(stage("bilateral", chroma_cell=4)) is None
    assert set(REACH) <= set(STAGES)
    assert not any(signature(STAGES[name]).stochastic for name in REACH)


def test_no_option_is_new():
    """Where a stage gets an option, say in `REACH` whether it changes how far the stage looks."""
    options = {node.name: " ".join(sorted(node.options)) for node in FAR}
    jpeg = "column_phase row_phase subsampling"
    assert options == {
        "bilateral": "chroma_bins chroma_cell chroma_radius iterations radius",
        "color_difference_median": "passes",
        "demosaic_ahd": "cfa delta median_passes variant",
        "demosaic_bilinear": "cfa",
        "demosaic_edge_aware": "cfa",
        "demosaic_hamilton_adams": "cfa",
        "demosaic_hibbard": "cfa",
        "demosaic_malvar": "cfa",
        "demosaic_menon": "cfa refining",
        "demosaic_vng": "cfa",
        "jpeg": jpeg,
        "jpeg_file": "components converts subsampling",
        "jpeg_photoshop": "subsampling",
        "jpeg_tables": jpeg,
        "median": "chroma footprint iterations luma",
        "optical_blur": "radius",
        "unsharp_mask": "radius",
    }


def test_the_reach_of_compositions_adds_up():
    median = stage("median", footprint="5x5")
    sharper = stage("unsharp_mask", radius=3)
    assert reach(Chain((stage("demosaic_malvar"), median, stage("srgb_oetf")))) == 4
    assert reach(Shuffle((median, sharper))) == 5 and reach(Gate(sharper)) == 3
    assert reach(Chain((median, stage("vignetting")))) is None
    assert reach(stage("bilateral", radius=2, chroma_radius=4, iterations=2)) == 12


@pytest.mark.parametrize("height", [97, 110])
def test_a_camera_is_the_same_in_strips(height):
    """Position, statistics of the frame and noise included."""
    chain = Chain(
        (
            stage("mosaic_white_balance", cfa="GBRG"),
            stage("demosaic_ahd", cfa="GBRG"),
            stage("vignetting"),
            stage("auto_exposure"),
            Gate(stage("median")),
            stage("gaussian_noise"),
            stage("srgb_oetf"),
            stage("unsharp_mask", radius=3),
        )
    )
    image, key = image_for(chain, height), jax.random.key(1)
    whole = run(chain, chain.init(), image, key)
    np.testing.assert_allclose(run_in_strips(chain, chain.init(), image, key, rows=16), whole, atol=1e-6)


def test_a_small_frame_is_one_strip():
    node = stage("demosaic_hibbard")
    image = image_for(node, 9)
    np.testing.assert_array_equal(run_in_strips(node, {}, image), run(node, {}, image))


def test_noise_needs_a_key_and_one_program_serves_all_values():
    node = Chain((stage("clip"), stage("gaussian_noise")))
    image = image_for(node, 40)
    with pytest.raises(TypeError, match="pass key"):
        run_in_strips(node, node.init(), image)
    run_in_strips._clear_cache()
    for seed in range(2):
        run_in_strips(node, middle(node), image, jax.random.key(seed), rows=16)
    assert run_in_strips._cache_size() == 1
