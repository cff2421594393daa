"""Which programs are compiled: held to what JAX itself counts."""

import jax
import jax.numpy as jnp
import pytest

from jaxisp.process.programs import compile_times


def test_each_program_is_listed_once_and_whole():
    def named(x):
        return jnp.sin(x) @ x

    program, small, large = jax.jit(named), jnp.ones((3, 3)), jnp.ones((4, 4))
    with compile_times() as programs:
        program(small)
        program(small)
        program(large)
    assert [p.name for p in programs] == ["named", "named"] and program._cache_size() == 2
    for p in programs:
        assert min(p.trace_s, p.lower_s, p.compile_s) > 0
        assert p.seconds == pytest.approx(p.trace_s + p.lower_s + p.compile_s)
        assert str(p).endswith(f"compile {p.compile_s:.2f})")
    program(jnp.ones((5, 5)))  # after it, nothing is noted
    assert len(programs) == 2
