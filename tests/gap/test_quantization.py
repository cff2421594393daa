"""What the sensor read, seen through matrix and tone curve: its levels are found again."""

import jax.numpy as jnp
import numpy as np
import pytest

from jaxisp.color import rgb_to_ycbcr_planes
from jaxisp.gap.features.quantization import FREQUENCIES, cosine, quantization, quantization_part
from jaxisp.stages.balance import ColorMatrix
from jaxisp.stages.look import SplineCurve
from jaxisp.stages.sensor import LevelSteps, level_steps

SHAPE, CORNER, GAINS = (90, 103), 3, (2.0, 1.5)
MATRIX = np.array([[1.5, -0.4, -0.1], [-0.2, 1.4, -0.2], [0.0, -0.4, 1.4]], np.float32)
CURVE = np.linspace(0, 0.1, 12, dtype=np.float32)


def picture(read):
    """(h, w, 3) Y'CbCr steps of camera RGB that is balanced, matrixed, encoded and bent, in NumPy."""
    linear = (read * [GAINS[0], 1, GAINS[1]]) @ MATRIX.T
    encoded = np.where(
        linear <= 0.0031308, 12.92 * linear, 1.055 * np.maximum(linear, 0) ** (1 / 2.4) - 0.055
    )
    fine = np.linspace(0, 1, 4001)
    nodes = np.concatenate([CURVE[:1], CURVE, CURVE[-1:]])
    u = 11 * fine[:, None] - np.arange(-1, 13)
    a = np.abs(u)
    splines = np.where(a < 1, 2 / 3 - a**2 + a**3 / 2, np.where(a < 2, (2 - a) ** 3 / 6, 0))
    bent = encoded + np.interp(encoded, fine, splines @ nodes)
    return np.stack(rgb_to_ycbcr_planes(*jnp.moveaxis(jnp.asarray(bent, jnp.float32), -1, 0)), -1) * 255


@pytest.mark.parametrize("cfa", ["RGGB", "GBRG"])
def test_a_comb_is_found_at_its_step_and_not_without(cfa):
    shared = {
        "tone_curve": SplineCurve(offsets=CURVE),
        "color_matrix": ColorMatrix(matrix=np.eye(3, dtype=np.float32)),
        "mixing": ColorMatrix(matrix=MATRIX),
    }
    seen = quantization(shared, cfa, GAINS, SHAPE, CORNER)
    rng = np.random.default_rng(5)
    read = 0.06 + 0.012 * rng.normal(size=(*SHAPE, 3))
    k = 9
    step = 1 / FREQUENCIES[k]
    values = {}
    for name, light in (("plain", read), ("comb", step * np.rint(read / step))):
        y = jnp.moveaxis(jnp.asarray(picture(light), jnp.float32), -1, 0)
        ((names, found),) = quantization_part(y, jnp.full_like(y, 60.0), jnp.ones(SHAPE), seen).items()
        values[name] = dict(zip(names, np.asarray(found).tolist(), strict=True))
    assert values["comb"][f"code intensity dark{k:02d}"] > 0.95
    assert abs(values["plain"][f"code intensity dark{k:02d}"]) < 0.1
    assert values["comb"][f"code intensity dark{k - 2:02d}"] < 0.5


def test_levels_are_apart_by_the_step_and_none_is_no_rounding():
    image = jnp.linspace(-0.2, 1.3, 70).reshape(7, 10)
    np.testing.assert_array_equal(level_steps(LevelSteps(step=jnp.float32(0)), image), image)
    found = np.asarray(level_steps(LevelSteps(step=jnp.float32(0.07)), image)) / 0.07
    np.testing.assert_allclose(found, np.rint(np.asarray(image) / 0.07), atol=1e-4)


def test_the_cosine_is_one():
    turns = np.random.default_rng(1).uniform(-300, 300, 10_000).astype(np.float32)
    turns = np.concatenate([turns, np.arange(-8, 8, dtype=np.float32) / 4])
    np.testing.assert_allclose(cosine(jnp.asarray(turns)), np.cos(2 * np.pi * turns.astype(float)), atol=1e-6)
