"""What every registered stage must do. A stage that is added gets all of this."""

import functools

import jax
import pytest

from jaxisp.pipeline import stage
from jaxisp.stages import STAGES
from jaxisp.testing import CHECKS, Subject

# all checks of a stage one after another, on one worker: they share its programs
subject = functools.cache(lambda name: Subject(stage(name)))


@pytest.fixture(autouse=True)
def no_implicit_promotion():
    """All checks run so; `numeric_modes` then shares their traces."""
    with jax.numpy_dtype_promotion("strict"), jax.numpy_rank_promotion("raise"):
        yield


MIXES = {"chroma_denoising", "demosaicking"}
"""Sums of filters and of demosaickers by shares: programs of everything at once, a fifth of all the time."""
BY_PARTS = {
    "gradient_is_finite", "gradient_gives_the_value", "gradient_reaches_parameters", "gradient_is_exact",
    "products_are_precise", "numeric_modes", "batch_agrees",
}  # fmt: skip
"""What a mix has of its parts, which go through it as stages of their own or in `luma_denoising`, and of
`weighted`: `test_shares` holds the derivative to every share, forwards, backwards and under `vmap`, to it."""


def marks(name: str, check: str) -> list[pytest.MarkDecorator]:
    # a plain call compiles a hundred operations one by one
    late = check == "plain_call_agrees" or (name in MIXES and check in BY_PARTS)
    return [pytest.mark.slow] if late else []


@pytest.mark.parametrize(
    ("name", "check"),
    [
        pytest.param(name, check, marks=marks(name, check), id=f"{name}-{check}")
        for name in sorted(STAGES)
        for check in CHECKS
    ],
)
def test_stage(name, check):
    CHECKS[check](subject(name))
