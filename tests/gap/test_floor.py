"""The floor of RAW+JPEG pairs, held to what a known camera leaves of files that Pillow wrote."""

import dataclasses
import io

import jax.numpy as jnp
import numpy as np
import pytest
from PIL import Image

from jaxisp.gap.objective.pixels import PixelObjective
from jaxisp.gap.pairs.pairs import INNER, Pairs, to_rgb
from jaxisp.gap.simulator.effects import EFFECTS
from jaxisp.gap.simulator.model import build, plain_camera
from jaxisp.io.jpeg import decode_jpeg
from jaxisp.stages.choice import ChromaSubsampling
from tests.gap.scenes import scenes

SAMPLINGS = ("4:4:4", "4:2:2", "4:2:0")


def stored(picture, quality, sampling):
    """An encoded picture (H, W, 3) as Pillow's file of it has it."""
    data = io.BytesIO()
    Image.fromarray(np.rint(255 * picture).clip(0, 255).astype(np.uint8)).save(
        data, "jpeg", quality=quality, subsampling=SAMPLINGS.index(sampling)
    )
    return decode_jpeg(data.getvalue(), "a")


def mosaics(rng, count):
    """(count, H, W) in linear light, RGGB."""
    light = to_rgb(scenes(rng, count, (96, 112))).clip(0, 1) ** 2.2
    seen = light[..., 1].copy()
    seen[:, ::2, ::2], seen[:, 1::2, 1::2] = light[:, ::2, ::2, 0], light[:, 1::2, 1::2, 2]
    return jnp.asarray(seen + 0.004 * rng.standard_normal(seen.shape), jnp.float32)


def known(quality, sampling, effect=None, amount=0.0):
    """A camera with one effect whose files are given; the objective, weighed at the camera without it; the
    camera's own point, and its files."""
    chain, params = plain_camera("RGGB", subsampling=sampling)
    model = build(chain, params, {}, [], [] if effect is None else [EFFECTS[effect]])
    light = mosaics(np.random.default_rng(3), 2)
    z = np.zeros(len(model.coordinates))
    true = z.copy()
    true[:1] = amount
    before = model
    if "chroma_subsampling" in model.shared:
        whole = ChromaSubsampling(horizontal=np.float32(0), vertical=np.float32(0))
        before = model.with_shared(model.shared | {"chroma_subsampling": whole})
    files = [stored(p, quality, sampling) for p in before.render(true, light)]
    pictures = np.stack([f.image for f in files]).astype(np.float32)
    pairs = Pairs(("a", "b"), light, pictures, np.ones(light.shape, bool))
    objective = PixelObjective.of(pairs)
    objective = objective.robust(objective.at(model, z))
    return objective, objective.at(model, true), files


@pytest.mark.parametrize("sampling", SAMPLINGS)
@pytest.mark.parametrize("quality", [80, 95])
def test_the_floor_is_what_the_right_camera_leaves(quality, sampling):
    """In luma and in chroma: a file samples the chroma of what the camera made, not of what was sampled."""
    objective, at, files = known(quality, sampling)
    floor = objective.floor_difference(at, files)
    left = objective.target - at.shown[0]
    np.testing.assert_allclose((floor**2).mean((0, 1, 2)), (left**2).mean((0, 1, 2)), rtol=0.02)
    np.testing.assert_allclose(objective.floor_errors(at, floor), at.errors, rtol=0.02)


@pytest.mark.parametrize(("effect", "amount"), [("sharpening", 2.0), ("luma_denoising", 0.9)])
def test_pixels_count_as_without_the_effect(effect, amount):
    """Weights come from the base's residual, in the floor as in the gap."""
    objective, at, files = known(90, "4:2:0", effect, amount)
    floor = objective.floor_difference(at, files)
    found = objective.floor_errors(at, floor)
    np.testing.assert_allclose(found, at.errors, rtol=0.002)
    own = dataclasses.replace(objective, begun=at.shown[0]).floor_errors(at, floor)
    assert (np.abs(own - at.errors) > 2 * np.abs(found - at.errors)).all()


def test_masked_pixels_are_no_part_of_the_floor():
    objective, at, files = known(90, "4:4:4")
    half = np.zeros_like(objective.pairs.mask)
    half[:, :, :56] = True
    masked = dataclasses.replace(objective, pairs=dataclasses.replace(objective.pairs, mask=half), begun=None)
    floor = objective.floor_difference(at, files)
    inside = (floor**2).sum(-1)[half[INNER]].reshape(len(floor), -1).mean(1)
    np.testing.assert_allclose(masked.floor_errors(at, floor), inside, rtol=1e-5)


@pytest.mark.parametrize("sampling", ["4:2:2", "4:2:0"])
def test_files_sample_what_effects_have_made(sampling):
    """Chroma that an effect sharpens is not as fine as the file's samples allow."""
    effects = [EFFECTS[n] for n in ("color_lut", "chroma_denoising", "sharpening", "double_compression")]
    chain, params = plain_camera("RGGB", subsampling=sampling)
    names = [n.name for n in build(chain, params, {}, [], effects).chain.nodes]
    assert names[-1] == "chroma_subsampling"
    assert names.index("tone_curve") < names.index("use_color_lut")
