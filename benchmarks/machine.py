"""The machine that a benchmark ran on: what it is, how busy it was, and what it can do at best."""

import importlib.metadata
import os
import platform
import sys
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from jaxisp.process import cores

LIBRARIES = (
    "jax", "jaxlib", "numpy", "opencv-python-headless", "pillow", "scipy", "scikit-image", "PyWavelets",
    "colour-science", "colour-demosaicing", "rawpy", "torch", "kornia", "albumentationsx",
)  # fmt: skip
COPY_SIZES = {"batch": 2_500_000, "1 MP": 12_000_000, "12 MP": 144_000_000}
"""Bytes of the array that is copied, by the size of a case: small ones stay in the caches."""


def machine() -> dict[str, Any]:
    """Processor, cores, threads and versions, as they stand now."""
    return {
        "backend": jax.default_backend(),
        "device": jax.devices()[0].device_kind,
        "processor": processor(),
        "cores": cores.available(),
        "system": f"{platform.system()} {platform.machine()}",
        "python": platform.python_version(),
        "threads": threads(),
        "versions": versions(),
    }


def processor() -> str:
    """The model's name as the kernel gives it."""
    cpuinfo = Path("/proc/cpuinfo")
    lines = cpuinfo.read_text().splitlines() if cpuinfo.exists() else []
    names = [line.split(":", 1)[1].strip() for line in lines if line.startswith("model name")]
    return names[0] if names else platform.processor() or platform.machine()


def versions() -> dict[str, str]:
    """By library; "not installed" where it is not."""
    return {name: _version(name) for name in LIBRARIES}


def _version(name: str) -> str:
    try:
        return importlib.metadata.version(name)
    except importlib.metadata.PackageNotFoundError:
        return "not installed"


def threads() -> dict[str, Any]:
    """How many threads the peers that are imported use, and what the environment says of it."""
    found: dict[str, Any] = {k: v for k, v in os.environ.items() if k in ("XLA_FLAGS", "OMP_NUM_THREADS")}
    set_threads(None)
    if (cv2 := sys.modules.get("cv2")) is not None:
        found["opencv"] = cv2.getNumThreads()
    if (torch := sys.modules.get("torch")) is not None:
        found["torch"] = torch.get_num_threads()
    return found


def set_threads(count: int | None) -> None:
    """Let OpenCV and torch use that many threads; None: one a core."""
    if (cv2 := sys.modules.get("cv2")) is not None:
        cv2.setNumThreads(-1 if count is None else count)
    if (torch := sys.modules.get("torch")) is not None:
        torch.set_num_threads(count or os.cpu_count() or 1)


def load() -> float:
    """Mean number of running processes over the last minute."""
    return round(os.getloadavg()[0], 2)


def best_seconds(call: Callable[[], Any], repeats: int = 7) -> float:
    """The shortest of some runs, after one that does not count."""
    jax.block_until_ready(call())
    times = []
    for _ in range(repeats):
        clock = time.perf_counter()
        jax.block_until_ready(call())
        times.append(time.perf_counter() - clock)
    return min(times)


def limits() -> dict[str, Any]:
    """What this machine reaches: bytes/s of a copy (by size of case) and flop/s of a matrix product."""
    return {
        "copy_gb_per_s": {size: round(copy_bandwidth(n) / 1e9, 1) for size, n in COPY_SIZES.items()},
        "peak_gflop_per_s": round(peak() / 1e9, 1),
    }


def copy_bandwidth(size: int) -> float:
    """Bytes read and written per second: the better of NumPy's copy on all cores and a JAX one."""
    source, cores = np.ones(size // 4, np.float32), os.cpu_count() or 1
    target = np.empty_like(source)
    with ThreadPoolExecutor(cores) as pool:
        parts = list(zip(np.array_split(target, cores), np.array_split(source, cores)))

        def copy() -> None:
            list(pool.map(lambda part: np.copyto(*part), parts))

        times = [best_seconds(copy), best_seconds(lambda: np.copyto(target, source))]
    on_device, scale = jax.device_put(source), jax.jit(lambda x: 2.0 * x)
    times.append(best_seconds(lambda: scale(on_device)))
    return 2 * source.nbytes / min(times)


def peak(side: int = 2048) -> float:
    """Flops per second of a float32 matrix product."""
    a = jnp.ones((side, side), jnp.float32)
    product = jax.jit(jnp.matmul)
    return 2 * side**3 / best_seconds(lambda: product(a, a), 5)
