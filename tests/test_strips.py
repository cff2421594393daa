"""Large frames in strips: the same picture, and how far each stage looks."""

import itertools
import subprocess
import sys

import jax
import numpy as np
import pytest

from jaxisp.cfa import XTRANS
from jaxisp.domains import RGB
from jaxisp.params import map_specs
from jaxisp.pipeline import (
    REGISTRY,
    Chain,
    Gate,
    Shuffle,
    compiled_in_strips,
    register,
    run,
    run_in_strips,
    stage,
)
from jaxisp.stages import STAGES
from jaxisp.testing import smooth_image

SMALL = {
    "anisotropic_blur": {"radius": 3},
    "bilateral": {"radius": 2, "chroma_radius": 3},
    "defocus": {"radius": 3},
    "demosaic_markesteijn": {"passes": 1},
    "demosaicking": {"algorithm": "bilinear", "partner": "dcb"},
    "isotropic_blur": {"radius": 3},
    "motion_blur": {"radius": 3},
    "unsharp_mask": {"radius": 3},
    "optical_blur": {"radius": 3},
    "median": {"footprint": "5x5", "iterations": 2},
    "richardson_lucy": {"iterations": 2, "radius": 2},
}
OPTIONS = {
    "bilateral": {"iterations": [1, 2]},
    "color_difference_median": {"passes": [1, 3]},
    "demosaic_ahd": {"delta": [1, 3], "median_passes": [0, 1], "variant": ["paper", "libraw"]},
    "demosaic_markesteijn": {"passes": [1, 3], "clipped": [True, False]},
    "demosaic_menon": {"refining": [True, False]},
    "demosaic_normalized_convolution": {"cfa": ["RGGB", XTRANS]},
    "demosaicking": {"algorithm": ["lmmse", "rcd"], "partner": ["dcb", "ahd-libraw"]},
    "guided_filter": {"radius": [1, 3]},
    "jpeg": {"subsampling": ["4:2:0", "4:4:4"], "row_phase": [0, 5]},
    "jpeg_file": {"subsampling": ["4:2:0"], "components": ["YCbCr", "RGB"], "converts": [True, False]},
    "jpeg_photoshop": {"subsampling": ["auto", "4:2:0"]},
    "jpeg_tables": {"subsampling": ["4:2:0"], "column_phase": [0, 11]},
    "median": {"footprint": ["cross", "5x5"], "iterations": [1, 3]},
    "nonlocal_means": {"search": [2, 4], "patch": [0, 2]},
    "richardson_lucy": {"iterations": [1, 3]},
}
"""Options that may change how far a stage looks; each combination is tried, in `make test` the ends."""

FAR = [stage(name, **SMALL.get(name, {})) for name in sorted(STAGES) if stage(name).reach]
NEAR = [stage(name) for name in sorted(STAGES) if stage(name).reach == 0]


def cases():
    for node in [*FAR, *NEAR]:
        options = OPTIONS.get(node.name, {})
        combinations = list(itertools.product(*options.values()))
        for values in combinations:
            tried = stage(node.name, **SMALL.get(node.name, {}) | dict(zip(options, values)))
            between = values not in (combinations[0], combinations[-1])
            yield pytest.param(tried, marks=[pytest.mark.slow] * between)


def middle(node):
    """Every parameter in the middle of its range, so that no stage is the identity."""
    return map_specs(
        lambda spec, _: np.full(spec.shape, 0.4 * spec.bounds[0] + 0.6 * spec.bounds[1], np.float32),
        node.init(),
    )


def image_for(node, rows, columns=22):
    shape = (rows, columns) if node.domain_in.channels == 1 else (rows, columns, 3)
    return smooth_image(shape, 1, -0.1, 1.1).astype(np.float32)


def frame(node):
    """An image of the size of most tests here, which share the stage's program: of five strips or two halves,
    and with pixels that are farther from all edges than the stage looks."""
    far = node.reach
    rows = 72 if far == 0 else max(2 * far + 40, 159 if "jpeg" in node.name else 71)
    return image_for(node, rows, 2 * far + 22)


@pytest.mark.parametrize("node", FAR, ids=lambda node: node.name)
def test_a_stage_that_looks_around_is_the_same_in_strips(node):
    image = frame(node)
    whole = run(node, middle(node), image)
    parts = run_in_strips(node, middle(node), image, rows=16)
    np.testing.assert_allclose(parts, whole, rtol=1e-6, atol=1e-6)


def beyond(node):
    """The pixels that change, of a few trials, though all that changed in the image is out of reach."""
    far, rng, params = node.reach, np.random.default_rng(0), middle(node)
    image = frame(node)
    was = np.asarray(run(node, params, image))
    found = 0
    for _ in range(6):
        row, column = (int(rng.integers(far, n - far)) for n in image.shape[:2])
        kept = np.zeros(image.shape[:2], bool)
        kept[row - far : row + far + 1, column - far : column + far + 1] = True
        other = np.where(kept if image.ndim == 2 else kept[..., None], image, rng.uniform(size=image.shape))
        now = np.asarray(run(node, params, other.astype(np.float32)))
        found += int((now[row, column] != was[row, column]).any())
    return found


@pytest.mark.parametrize("node", list(cases()), ids=lambda node: f"{node.name} {dict(node.static)}")
def test_a_stage_looks_no_farther_than_its_reach(node):
    """All that is out of a pixel's reach is replaced by noise: the pixel keeps its bits."""
    assert not beyond(node)


def test_every_option_that_may_change_a_reach_is_tried():
    """Where a stage gets an option, try it above, or say here that it does not matter."""
    without = {
        "cfa",
        "in_14_bits",
        "chroma_bins",
        "chroma_cell",
        "luma",
        "chroma",
        "row_phase",
        "column_phase",
    }
    for node in FAR:
        tried = {*OPTIONS.get(node.name, {}), *SMALL.get(node.name, {})}
        assert set(node.options) - without <= tried, node.name


def test_a_wrong_reach_fails():
    """The check above sees a stage that says that it looks less far than it does."""
    try:

        @register(reach=1)
        def looks_two_rows_up(image: RGB) -> RGB:
            return image + 0.5 * jax.numpy.roll(image, 2, axis=0)

        assert beyond(stage(looks_two_rows_up))
    finally:
        del REGISTRY["looks_two_rows_up"]


@pytest.mark.parametrize("node", NEAR, ids=lambda node: node.name)
def test_a_stage_that_looks_nowhere_is_the_same_in_halves(node):
    image, params = frame(node), middle(node)
    halves = np.concatenate([run(node, params, half) for half in (image[:36], image[36:])])
    np.testing.assert_allclose(run(node, params, image), halves, rtol=1e-6, atol=1e-6)


def test_what_needs_the_whole_frame_has_no_reach():
    for name in ("vignetting", "auto_exposure", "wavelet_coring", "shot_read_noise", "resize"):
        assert stage(name).reach is None
    assert stage("bilateral", chroma_cell=4).reach is None


def test_a_function_has_the_reach_it_was_registered_with():
    """Not that of a stage of its name: a stage of one's own has none unless it says so."""

    def clip(image: RGB) -> RGB:
        return image / image.max()

    def grain(image: RGB, *, key: jax.Array) -> RGB:
        return image + jax.random.normal(key, image.shape)

    assert stage("clip").reach == 0 and stage(clip).reach is None
    with pytest.raises(TypeError, match="grain: noise depends on a pixel's position"):
        register(reach=0)(grain)
    assert "grain" not in REGISTRY


COMPILED = """
import hashlib
{imports}
import jax, numpy as np
from jaxisp.pipeline import Chain, run, stage
chain = Chain((stage("demosaic_malvar"), stage("optical_blur", radius=3), stage("srgb_oetf")))
mosaic = np.random.default_rng(0).uniform(size=(600, 512)).astype(np.float32)
text = jax.jit(lambda x: chain(chain.init(), x)).lower(mosaic).as_text()
bits = np.asarray(run(chain, chain.init(), mosaic)).tobytes()
print("while" in text, *(hashlib.sha256(x).hexdigest() for x in (text.encode(), bits)))
"""


def test_what_is_compiled_does_not_depend_on_what_was_imported():
    """A large frame is run in strips, by one program."""
    said = set()
    for imports in ("", "import jaxisp.gap, jaxisp.camera, jaxisp.cli.develop"):
        code = COMPILED.format(imports=imports)
        done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
        assert done.returncode == 0, done.stderr
        said.add(done.stdout)
    assert len(said) == 1 and said.pop().startswith("True")


def test_the_reach_of_compositions_adds_up():
    median = stage("median", footprint="5x5")
    sharper = stage("unsharp_mask", radius=3)
    assert Chain((stage("demosaic_malvar"), median, stage("srgb_oetf"))).reach == 4
    assert Shuffle((median, sharper)).reach == 5 and Gate(sharper).reach == 3
    assert Chain((median, stage("vignetting"))).reach is None
    assert stage("bilateral", radius=2, chroma_radius=4, iterations=2).reach == 12


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
    compiled_in_strips._clear_cache()
    for seed in range(2):
        run_in_strips(node, middle(node), image, jax.random.key(seed), rows=16)
    assert compiled_in_strips._cache_size() == 1
