"""Memory that is freed is kept: in processes of their own, as a setting cannot be taken back."""

import os
import platform
import subprocess
import sys

import numpy as np
import pytest

from jaxisp.process import memory

PROGRAM = """
import resource, sys
from jaxisp.process.memory import keep_freed
if sys.argv[1] == "keep":
    assert keep_freed()
import jax, jax.numpy as jnp
frame = jnp.ones((3000, 3000))  # 36 MB
reverse = jax.jit(lambda x: x[::-1] + 1)
def faults():
    before = resource.getrusage(resource.RUSAGE_SELF).ru_minflt
    reverse(frame).block_until_ready()
    return resource.getrusage(resource.RUSAGE_SELF).ru_minflt - before
# blocks are cut and joined for some calls, until one fits
print(sorted([faults() for _ in range(40)][20:])[10])
"""


def faults(how: str) -> int:
    env = {k: v for k, v in os.environ.items() if k != "GLIBC_TUNABLES" and not k.startswith("MALLOC_")}
    call = [sys.executable, "-c", PROGRAM, how]
    run = subprocess.run(call, capture_output=True, text=True, check=True, env=env)
    return int(run.stdout)


@pytest.mark.skipif(platform.libc_ver()[0] != "glibc", reason="glibc's")
def test_large_blocks_are_not_taken_from_the_system_again():
    assert 4 * faults("keep") < faults("leave")  # some thousands, or some tens of huge pages


def test_without_glibc_nothing_is_changed(monkeypatch):
    monkeypatch.setattr(platform, "libc_ver", lambda: ("", ""))
    assert not memory.keep_freed()


MANY_SIZES = """
import jax, jax.numpy as jnp
from jaxisp.process.memory import forget_compiled
@jax.jit
def program(x):
    for _ in range(12):
        x = jnp.sort(x) @ x
    return x
def held():
    return int(open("/proc/self/statm").read().split()[1])
def compiled(sizes):
    before = held()
    for n in sizes:
        program(jnp.ones((n, n))).block_until_ready()
    return held() - before
compiled([2, 3])
grown = compiled(range(4, 14))
before = held()
forget_compiled()
print((before - held()) / grown)
"""


@pytest.mark.skipif(platform.libc_ver()[0] != "glibc", reason="glibc's")
def test_what_programs_held_is_given_back():
    run = subprocess.run([sys.executable, "-c", MANY_SIZES], capture_output=True, text=True, check=True)
    assert float(run.stdout) > 0.7


def test_a_function_keeps_its_programs_where_all_is_forgotten():
    traced = []

    def twice(x):
        traced.append(x.shape)
        return 2 * x

    programs, sizes = memory.Programs(twice), range(1, memory.MOST_SIZES + 1)
    for _ in range(2):  # no size is compiled again
        for n in sizes:
            np.testing.assert_array_equal(programs(np.ones(n, np.float32)), 2)
    assert traced == [(n,) for n in sizes]
    programs(np.ones(n + 1, np.float32))
    programs(np.ones(1, np.float32))
    assert traced[n:] == [(n + 1,), (1,)]


def test_programs_are_forgotten_after_some_sizes(monkeypatch):
    forgotten = []
    monkeypatch.setattr(memory, "forget_compiled", lambda: forgotten.append(1))
    sizes = set()
    for _ in range(3):
        for size in range(memory.MOST_SIZES):  # so many come again and again
            memory.forget_beyond(sizes, size)
    assert not forgotten
    memory.forget_beyond(sizes, "another")
    assert len(forgotten) == 1 and sizes == {"another"}
