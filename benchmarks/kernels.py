"""What a call's kernels take by the clock of the device they run on."""

import tempfile
from collections import Counter
from collections.abc import Callable
from pathlib import Path
from typing import Any

import jax

CALLS = 4


def kernels(call: Callable[[], Any]) -> list[dict[str, Any]]:
    """Of each kernel how often it runs in a call and how long all that takes, longest first.

    On a GPU they are what the card ran; on a CPU, where a kernel runs on several threads, what JAX started.
    """
    jax.block_until_ready(call())
    with tempfile.TemporaryDirectory() as folder:
        with jax.profiler.trace(folder):
            for _ in range(CALLS):
                jax.block_until_ready(call())
        trace = next(Path(folder).rglob("*.xplane.pb"))
        planes = list(jax.profiler.ProfileData.from_file(str(trace)).planes)
    times, spent = Counter[str](), Counter[str]()
    on_gpu = any("/device:GPU" in plane.name for plane in planes)
    for plane in planes:
        for line in plane.lines:
            if on_gpu and not ("/device:GPU" in plane.name and line.name.startswith("Stream")):
                continue
            for event in line.events:
                if on_gpu or any(key == "hlo_op" for key, _ in event.stats):
                    name = event.name.split("(")[0]
                    times[name] += 1
                    spent[name] += event.duration_ns
    return [
        {"kernel": name, "times": times[name] / CALLS, "ms": round(ns / CALLS / 1e6, 4)}
        for name, ns in spent.most_common()
    ]
