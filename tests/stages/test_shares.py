"""Families whose members' shares are the parameters: where a share is 0 its gradient is not."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxisp.cfa import XTRANS
from jaxisp.pipeline import run, stage
from jaxisp.stages.choice import DEMOSAICKERS, FARTHEST, Demosaicking
from jaxisp.stages.resampling import Rescaling
from jaxisp.stages.smoothing import ChromaDenoising, LumaDenoising, Sharpening

FAMILIES = [
    ("luma_denoising", LumaDenoising, "shares"),
    ("chroma_denoising", ChromaDenoising, "shares"),
    ("sharpening", Sharpening, "amounts"),
    ("sharpening", Sharpening, "deconvolution"),
    ("demosaicking", Demosaicking, "shares"),
    ("rescaling", Rescaling, "shares"),
]


# all gradients of `luma_denoising` are in the contract; of the other two mixes these alone are in `make test`
@pytest.mark.parametrize(
    ("name", "kind", "field"),
    [pytest.param(*f, marks=pytest.mark.slow) if f[0] == "luma_denoising" else f for f in FAMILIES],
)
def test_the_derivative_at_0_is_what_a_member_changes(name, kind, field, rng):
    """Pictures are linear in the shares, so that the step from 0 to 1 is the derivative anywhere."""
    size = (14, 18) if name == "demosaicking" else (14, 18, 3)
    image = jnp.asarray(rng.uniform(0.1, 0.9, size), jnp.float32)
    one = np.eye(len(getattr(kind(), field)), dtype=np.float32)
    off = 0 * one[0]
    node = stage(name)
    weights = rng.standard_normal((14, 18, 3)).astype(np.float32)

    def shot(shares):
        return run(node, {node.name: kind(**{field: shares})}, image)

    @jax.jit  # one program: compilation is what takes time
    def all_of_it(shares):
        _, push = jax.linearize(shot, shares)
        return shot(shares), jax.vmap(push, out_axes=-1)(one), jax.linear_transpose(push, shares)(weights)[0]

    still, slopes, back = (np.asarray(v) for v in all_of_it(off))
    changes = [np.asarray(all_of_it(member)[0]) - still for member in one]
    unmoved = sum(not change.any() for change in changes)
    assert unmoved == (name == "demosaicking")  # what all shares 0 leave is one of its members
    for k, change in enumerate(changes):
        np.testing.assert_allclose(slopes[..., k], change, atol=1e-5)
        assert back[k] == pytest.approx(float((weights * slopes[..., k]).sum()), rel=1e-3, abs=1e-3)


def test_with_a_partner_no_other_member_counts(rng):
    image = jnp.asarray(rng.uniform(0.1, 0.9, (14, 18)), jnp.float32)
    shares = np.full(len(DEMOSAICKERS), 0.3, np.float32)
    two = run(stage("demosaicking", partner="hibbard"), {"demosaicking": Demosaicking(shares=shares)}, image)
    malvar, hibbard = (np.asarray(DEMOSAICKERS[name](image)) for name in ("malvar", "hibbard"))
    np.testing.assert_allclose(two, 0.7 * malvar + 0.3 * hibbard, atol=1e-5)
    assert np.abs(hibbard - malvar).max() > 0.01


def test_a_mix_of_two_looks_as_far_as_the_farthest_of_all():
    named = {name.replace("-", "_"): name for name in DEMOSAICKERS}
    options = {"ahd_libraw": ("ahd", {"delta": 1, "variant": "libraw"})}
    reaches = []
    for name in named:
        own, given = options.get(name, (name, {}))
        reaches.append(stage(f"demosaic_{own}", **given).reach)
    assert stage("demosaicking", partner="rcd").reach == FARTHEST == max(reaches)
    assert stage("demosaicking").reach == FARTHEST
    assert stage("demosaicking", cfa=XTRANS, algorithm="markesteijn").reach is None
