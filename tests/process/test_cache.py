"""Compiled programs on disk: where, when, and that the next process finds them."""

import os
import subprocess
import sys

import pytest

from jaxisp.process.cache import SWITCH, cache_folder

PROGRAM = """
import sys
from jaxisp.process.cache import keep_compiled
folder = keep_compiled()
import jax, jax.numpy as jnp
jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.0)
hits = []
jax.monitoring.register_event_listener(lambda event, **_: hits.append("cache_hits" in event))
jax.jit(lambda x: jnp.sin(x) @ x)(jnp.ones((8, 8)))
print(folder, sum(hits))
"""


def run_program(**environment):
    done = subprocess.run(
        [sys.executable, "-c", PROGRAM], capture_output=True, text=True, env={**clean(), **environment}
    )
    assert done.returncode == 0 and "Error reading" not in done.stderr, done.stderr
    folder, hits = done.stdout.split()
    return folder, int(hits)


def clean():
    return {k: v for k, v in os.environ.items() if k not in (SWITCH, "JAX_COMPILATION_CACHE_DIR")}


def test_the_folder_is_the_users_own(monkeypatch, tmp_path):
    monkeypatch.delenv(SWITCH, raising=False)
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    found = cache_folder()
    assert found.parent == tmp_path / "jaxisp" and found == cache_folder()
    monkeypatch.setenv("XDG_CACHE_HOME", "relative")
    monkeypatch.setenv("HOME", str(tmp_path / "home"))
    assert cache_folder() == tmp_path / "home/.cache/jaxisp" / found.name
    monkeypatch.setenv(SWITCH, str(tmp_path / "mine"))
    assert cache_folder() == tmp_path / "mine" / found.name


@pytest.mark.parametrize("text", ["off", "OFF", "0", "no"])
def test_the_switch(monkeypatch, text):
    monkeypatch.setenv(SWITCH, text)
    assert cache_folder() is None


def test_the_next_process_does_not_compile_again(tmp_path):
    folder, hits = run_program(XDG_CACHE_HOME=str(tmp_path))
    assert hits == 0 and list(tmp_path.rglob("*-cache"))
    again, hits = run_program(XDG_CACHE_HOME=str(tmp_path))
    assert again == folder and hits > 0
    for kept in tmp_path.rglob("*-cache"):  # as a process that was killed, or a full disk, leaves one
        os.truncate(kept, kept.stat().st_size // 2)
    assert run_program(XDG_CACHE_HOME=str(tmp_path))[0] == folder
    theirs = str(tmp_path / "theirs")
    assert run_program(XDG_CACHE_HOME=str(tmp_path), JAX_COMPILATION_CACHE_DIR=theirs)[0] == theirs
    assert run_program(XDG_CACHE_HOME="/dev/null") == ("None", 0)  # nothing can be written there: no error
