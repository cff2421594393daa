"""What a benchmark times: our call beside its peers' on the same data."""

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any


@dataclass(frozen=True)
class Peer:
    """Another library's way to the same result.

    Attributes:
        name: the library and, where it matters, its function or dtype.
        call: runs it once on the case's data and returns its output, a NumPy array if it is to be compared.
        goal: the least share of its time over ours that is aimed at, so above 1 is to be faster; None where
            no goal is set.
        agrees: turns (ours, theirs) into one line that says how the outputs agree ("PSNR 61.2 dB
            inside"); None where the algorithms differ by design and only the time is compared.
        threads: how many threads OpenCV and torch may use for it; None for as many as there are cores.
    """

    name: str
    call: Callable[[], Any]
    goal: float | None = None
    agrees: Callable[[Any, Any], str] | None = None
    threads: int | None = None


@dataclass(frozen=True)
class Case:
    """One row: a stage at one size.

    Attributes:
        stage: name of the row.
        size: "batch" (32 images of 80x80), "256x256" (32 images), "1 MP" or "12 MP".
        ours: runs our call once; the harness waits for its result. JAX's caches are cleared before its
            first call, which is reported as compile time and memory.
        peers: in the order of the table.
        gradient: our gradient to image and parameters, or None where it is not asked for.
        bytes_moved, flops: the least that the algorithm has to move and compute, for the floor.
        gradient_goal: how many times the forward's time the gradient may take.
        images: of a call, where images a second are to be told.
    """

    stage: str
    size: str
    ours: Callable[[], Any]
    peers: tuple[Peer, ...] = ()
    gradient: Callable[[], Any] | None = None
    bytes_moved: float = 0.0
    flops: float = 0.0
    notes: str = field(default="", compare=False)
    gradient_goal: float = 6.0
    images: int = 0
