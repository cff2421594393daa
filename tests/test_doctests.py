"""The examples in the docstrings of public names run as written, and every such name has one."""

import doctest
import importlib
import subprocess
import sys

import pytest

import jaxisp

MODULES = sorted({
    *jaxisp._HOME.values(), "jaxisp.errors", "jaxisp.io.images", "jaxisp.losses", "jaxisp.metrics",
    "jaxisp.models", "jaxisp.node", "jaxisp.params", "jaxisp.phase", "jaxisp.priors", "jaxisp.recipes",
    "jaxisp.registry", "jaxisp.samples.scenes", "jaxisp.testing",
})  # fmt: skip


def test_examples_run_as_written():
    # a process of its own: some set what holds for a whole process
    done = subprocess.run([sys.executable, __file__], capture_output=True, text=True)
    assert done.returncode == 0, done.stdout + done.stderr


@pytest.mark.parametrize("name", sorted(set(jaxisp._HOME) - {"STAGES"}))
def test_every_name_at_the_top_has_an_example(name):
    assert ">>> " in getattr(jaxisp, name).__doc__


@pytest.mark.parametrize("module", ["losses", "metrics"])
def test_every_function_has_an_example(module):
    where = importlib.import_module(f"jaxisp.{module}")
    public = {n: v for n, v in vars(where).items() if getattr(v, "__module__", "") == where.__name__}
    lacking = [n for n, v in public.items() if not n.startswith("_") and ">>> " not in (v.__doc__ or "")]
    assert not lacking


if __name__ == "__main__":
    failed = sum(doctest.testmod(importlib.import_module(module)).failed for module in MODULES)
    sys.exit(bool(failed))
