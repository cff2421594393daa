"""Shared test images and settings. Devices are forced to 8 so that sharding is tested on any machine."""

import gc
import os
from importlib.metadata import version
from pathlib import Path

from jaxisp.process.environment import one_blas_thread
from jaxisp.process.memory import forget_compiled
from tests.programs import kept_programs, share_contexts

os.environ["XLA_FLAGS"] = os.environ.get("XLA_FLAGS", "") + " --xla_force_host_platform_device_count=8"
# XLA cuts a program in parts to compile them on all cores; the workers use these already
os.environ["XLA_FLAGS"] += " --xla_cpu_parallel_codegen_split_count=1"
if os.environ.get("JAXISP_TESTS_QUICK"):
    # Most programs of tests run once, on small pictures: like this they compile in a third of the time.
    # Tests that run much, or that depend on the code that users run, are marked `optimised`.
    os.environ["JAX_DISABLE_MOST_OPTIMIZATIONS"] = "1"
    if version("jaxlib").startswith("0.10."):  # others may not know it, and would stop
        os.environ["XLA_FLAGS"] += " --xla_cpu_use_fusion_emitters=false"
os.environ.setdefault("JAX_PLATFORMS", "cpu")
if "PYTEST_XDIST_WORKER" in os.environ:  # the workers use the cores: threads of BLAS wait, and busily
    one_blas_thread()

os.environ.setdefault("TF_CPP_MIN_LOG_LEVEL", "3")  # as `jaxisp.process.environment` has it
if "JAX_COMPILATION_CACHE_DIR" not in os.environ:
    os.environ["JAX_COMPILATION_CACHE_DIR"] = str(kept_programs())  # xdist's workers inherit it
    os.environ["JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS"] = "0"  # a plain call compiles each operation

import jax
import numpy as np
import pytest
from hypothesis import settings

from jaxisp.cli import common
from jaxisp.gap import parallel

if version("jaxlib").startswith("0.10."):  # in others a private name may be another
    share_contexts()

settings.register_profile("ci", deadline=None, max_examples=20, derandomize=True)
settings.load_profile("ci")
# tracing makes millions of small objects that stay: a sixth of the time; `room` looks through all of them
gc.set_threshold(200_000, 20, 100_000)

if "PYTEST_XDIST_WORKER" in os.environ:
    parallel.MOST = 1  # the workers use the cores


_LONGEST = ("fit", "test_devices", "test_clean_noisy", "test_diagnose", "test_palette", "test_doctests")
"""Files and folders that take half a minute and more, longest first: one that begins last is waited for."""


@pytest.hookimpl(tryfirst=True)
def pytest_collection_modifyitems(items):
    """With `--dist loadgroup` a file's tests stay on one worker, and so do all of the fitter: one fit."""

    def place(item):
        folder = item.path.parent
        return folder if folder.name == "fit" else item.path

    for item in items:
        item.add_marker(pytest.mark.xdist_group(str(place(item).relative_to(item.config.rootpath))))
    last = len(_LONGEST)
    items.sort(key=lambda item: _LONGEST.index(n) if (n := place(item).stem) in _LONGEST else last)


def pytest_collection_finish(session):
    """Ungrouped, each worker would make what a file's tests share."""
    if session.config.getoption("loadgroup", False) and any("@" not in item.nodeid for item in session.items):
        raise pytest.UsageError("pytest-xdist does not group tests with this version of pytest")


@pytest.fixture(scope="module", autouse=True)
def room():
    """A worker that fills a quarter of the machine forgets its programs: seldom, since they are made anew."""
    yield
    status = Path("/proc/self/statm")  # in pages
    if status.exists() and int(status.read_text().split()[1]) > os.sysconf("SC_PHYS_PAGES") / 4:
        forget_compiled()


@pytest.fixture(autouse=True)
def no_progress(monkeypatch):
    """A loaded machine takes longer than a command stays silent: errors are counted in lines."""
    monkeypatch.setattr(common, "QUIET", 1e6)


@pytest.fixture
def rng() -> np.random.Generator:
    return np.random.default_rng(0)


@pytest.fixture
def x64():
    """Run the test in double precision."""
    with jax.enable_x64(True):
        yield
