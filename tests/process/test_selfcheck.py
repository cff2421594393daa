"""The check of the backend: it passes here, it would not pass a wrong sum, and it may be skipped."""

import jax
import jax.numpy as jnp
import pytest

from jaxisp.process import selfcheck

pytestmark = pytest.mark.optimised


@pytest.fixture(autouse=True)
def unchecked(monkeypatch):
    monkeypatch.delenv(selfcheck.SKIP, raising=False)
    selfcheck._check.cache_clear()
    yield
    selfcheck._check.cache_clear()


def wrong(weights, stack):
    """What jaxlib 0.10.2 is like: right on small planes, and off by a term on large ones."""
    return (weights[:, None] * stack)[1:].sum(0) if stack.shape[-1] > 107 else None


def test_this_backend_passes():
    assert selfcheck.measured_error() < 1e-6
    selfcheck.check_backend()


def test_a_wrong_sum_is_refused_and_says_what_to_do(monkeypatch):
    monkeypatch.setattr(selfcheck, "_weighted_sum", wrong)
    for _ in range(2):  # a refusal is not forgotten
        with pytest.raises(RuntimeError, match="jaxlib") as refused:
            selfcheck.check_backend()
    for part in (jax.lib.__version__, "cpu", "relative error", "0.10.1", "XLA_FLAGS=", selfcheck.SKIP):
        assert part in str(refused.value)


def test_nan_is_refused(monkeypatch):
    monkeypatch.setattr(selfcheck, "_weighted_sum", lambda w, q: jnp.nan * q[0])
    with pytest.raises(RuntimeError, match="nan"):
        selfcheck.check_backend()


def test_it_may_be_skipped(monkeypatch):
    monkeypatch.setattr(selfcheck, "_weighted_sum", wrong)
    monkeypatch.setenv(selfcheck.SKIP, "1")
    selfcheck.check_backend()


@pytest.mark.parametrize("transform", [jax.jit, jax.vmap, jax.grad, lambda f: jax.jit(jax.vmap(f))])
def test_it_runs_while_something_is_traced(transform, monkeypatch):
    def checked(x):
        selfcheck.check_backend()
        return x * 2

    transform(checked)(jnp.ones(3) if transform is not jax.grad else 1.0)
    assert selfcheck._check.cache_info().currsize == 1
    monkeypatch.setattr(selfcheck, "_weighted_sum", wrong)
    selfcheck._check.cache_clear()
    with pytest.raises(RuntimeError, match="jaxlib"):
        transform(lambda x: checked(x) + 1)(jnp.ones(3) if transform is not jax.grad else 1.0)


def test_it_runs_once():
    calls = selfcheck._check.cache_info().misses
    for _ in range(3):
        selfcheck.check_backend()
    assert selfcheck._check.cache_info().misses == calls + 1
