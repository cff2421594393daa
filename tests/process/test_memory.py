"""Memory that is freed is kept: in processes of their own, as a setting cannot be taken back."""

import os
import platform
import subprocess
import sys

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
