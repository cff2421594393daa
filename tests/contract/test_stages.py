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


EACH = [
    # a plain call compiles a hundred operations one by one
    pytest.param(check, marks=pytest.mark.slow) if check == "plain_call_agrees" else check
    for check in CHECKS
]


@pytest.mark.parametrize("check", EACH)
@pytest.mark.parametrize("name", sorted(STAGES), scope="module")
def test_stage(name, check):
    CHECKS[check](subject(name))
