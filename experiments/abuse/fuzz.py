"""Damaged files for every reader: each must be accepted, or refused with one clean error.

    python -m experiments.abuse.fuzz --minutes 30 --out fuzz.json
    python -m experiments.abuse.fuzz --kind raw --only 4711 --keep out.dng   # one input again

Readers run in processes of their own with a limit on memory and on time an input, so that a crash, a hang
or a file that asks for all the memory is caught and counted. Input i is the same in every run.
"""

import argparse
import collections
import json
import os
import resource
import select
import signal
import subprocess
import sys
import tempfile
import traceback
import warnings
from pathlib import Path
from typing import IO, Any

import numpy as np

from experiments.abuse.limits import MEMORY, SECONDS, SHARES, file_name
from experiments.abuse.mutate import mutate
from experiments.abuse.seeds import Seed, all_seeds


def make_input(seeds: list[Seed], kind: str, index: int) -> tuple[Seed, bytes]:
    """Input `index` of a kind of reader."""
    rng = np.random.default_rng((index, *kind.encode()))
    own = [seed for seed in seeds if seed.kind == kind]
    seed = own[int(rng.integers(len(own)))]
    return seed, mutate(seed.data, [s.data for s in own], rng)


def work(kind: str, start: int) -> None:
    """Read inputs from `start` on for ever; a line each on standard output."""
    out, errors = os.fdopen(os.dup(1), "w", buffering=1), os.fdopen(os.dup(2), "w")
    with tempfile.TemporaryDirectory(dir=_memory_folder()) as folder:
        os.dup2(os.open(f"{folder}/printed", os.O_CREAT | os.O_WRONLY), 1)
        os.dup2(1, 2)  # what libraries print is none of ours
        try:
            _read_for_ever(kind, start, folder, out)
        except BaseException:
            traceback.print_exc(file=errors)
            raise


def _read_for_ever(kind: str, index: int, folder: str, out: IO[str]) -> None:
    from experiments.abuse.targets import outcome

    seeds = all_seeds(Path(folder))
    for seed in (s for s in seeds if s.kind == kind):  # loads all that is loaded at first use
        found = outcome(kind, _write(folder, kind, seed, seed.data))
        if found != "accepted":
            out.write(json.dumps([-1, seed.suffix, f"sound file: {found}", 0]) + "\n")
    warnings.filterwarnings("error", category=RuntimeWarning, module="jaxisp")  # would be a second line
    resource.setrlimit(resource.RLIMIT_AS, (_mapped() + MEMORY,) * 2)
    while True:
        seed, data = make_input(seeds, kind, index)
        path = _write(folder, kind, seed, data)
        out.write(json.dumps([index, seed.suffix, outcome(kind, path), _peak()]) + "\n")
        os.truncate(f"{folder}/printed", 0)
        index += 1


def _write(folder: str, kind: str, seed: Seed, data: bytes) -> Path:
    path = Path(folder) / file_name(kind, seed.suffix)
    path.write_bytes(data)
    return path


def _memory_folder() -> str | None:
    return "/dev/shm" if os.access("/dev/shm", os.W_OK) else None


def _mapped() -> int:
    return int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize()


def _peak() -> int:
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024


class Worker:
    """A process that reads inputs of one kind, started again after the input that ends it."""

    def __init__(self, kind: str, start: int) -> None:
        self.kind, self.next, self.buffer = kind, start, b""
        self.counts: collections.Counter[str] = collections.Counter()
        self.findings: dict[str, dict[str, Any]] = {}
        self.base, self.peak, self.hungriest, self.seconds = 0, 0, start, 0.0

    def begin(self) -> None:
        command = [sys.executable, "-m", "experiments.abuse.fuzz", "--work", self.kind, str(self.next)]
        self.errors = tempfile.TemporaryFile()  # noqa: SIM115 (as long as the process)
        self.process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=self.errors)
        self.buffer, self.warm, self.ended = b"", False, False
        self.clock, self.spent, self.idle = 0.0, 0.0, 0

    def run(self, seconds: float) -> None:
        """Read inputs for some time of the processor, the start of the process apart."""
        self.begin()
        end = self.seconds + seconds
        try:
            while self.seconds < end:
                if self._lines():
                    self._clock()
                elif self.ended or self._busy():
                    self._died()
        finally:
            self.process.kill()
            self.process.wait()

    def _clock(self) -> float:
        """Seconds that the process has computed since its first input, which are added up."""
        now = self._computed()
        used = now - self.clock if self.warm and self.clock else 0.0
        self.clock = now if self.warm else 0.0
        self.seconds += used
        return used

    def _computed(self) -> float:
        fields = Path(f"/proc/{self.process.pid}/stat").read_text().rpartition(")")[2].split()
        return sum(map(int, fields[11:13])) / os.sysconf("SC_CLK_TCK")

    def _busy(self) -> bool:
        """Whether it has computed all the while: a process that was stopped from outside does not hang."""
        used = self._clock()
        self.spent += used
        self.idle = 0 if used > 0.01 else self.idle + 1
        return self.warm and (self.spent > SECONDS or self.idle > 60)

    def _lines(self) -> bool:
        """Take in the lines that there are; False where none came for a while, or the process ended."""
        stream = self.process.stdout
        assert stream is not None
        if not select.select([stream], [], [], SECONDS)[0]:
            return False
        data = os.read(stream.fileno(), 1 << 16)
        if not data:
            self.ended = True
            return False
        self.buffer, self.spent, self.idle = self.buffer + data, 0.0, 0
        *lines, self.buffer = self.buffer.split(b"\n")
        for line in lines:
            self._note(*json.loads(line))
        return True

    def _note(self, index: int, suffix: str, what: str, peak: int) -> None:
        if index >= 0:
            self.base = self.base if self.warm else peak
            self.next, self.warm = index + 1, True
            if peak - self.base > self.peak:
                self.peak, self.hungriest = peak - self.base, index
        self._count(what if what in ("accepted", "refused") else "broken", index, suffix, what)

    def _count(self, outcome: str, index: int, suffix: str, what: str) -> None:
        self.counts[outcome] += 1
        if outcome not in ("accepted", "refused"):
            place = what.rpartition(" at ")
            name = f"{what.partition(':')[0]} {place[2]}" if place[1] else what[:60]
            found = self.findings.setdefault(
                name, {"times": 0, "example": index, "suffix": suffix, "what": what}
            )
            found["times"] += 1

    def _died(self) -> None:
        if not self.ended:
            self.process.kill()
        status = self.process.wait()
        what = "hang" if not self.ended else f"crash by signal {-status}" if status < 0 else f"exit {status}"
        if not self.warm:
            self.errors.seek(0)
            raise SystemExit(
                f"the reader of {self.kind} does not start: {what}\n{self.errors.read().decode()}"
            )
        self._count(what.split()[0], self.next, "", what)
        self.next += 1
        self.begin()

    def report(self) -> dict[str, Any]:
        total = sum(self.counts.values())
        return {
            "inputs": total,
            **{
                name: self.counts[name] for name in ("accepted", "refused", "broken", "crash", "hang", "exit")
            },
            "peak_growth_mb": round(self.peak / 1e6, 1),
            "peak_at": self.hungriest,
            "seconds": round(self.seconds, 1),
            "next": self.next,
            "findings": dict(sorted(self.findings.items())),
        }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--minutes", type=float, default=1.0)
    parser.add_argument("--kind", choices=SHARES, help="this kind of reader alone")
    parser.add_argument("--start", type=int, default=0, help="the first input")
    parser.add_argument("--out", type=Path, help="JSON file")
    parser.add_argument(
        "--only", type=int, metavar="I", help="read this input alone, and say what comes of it"
    )
    parser.add_argument("--keep", type=Path, metavar="FILE", help="with --only: write the input here")
    parser.add_argument("--work", nargs=2, metavar=("KIND", "START"), help=argparse.SUPPRESS)
    arguments = parser.parse_args()
    if arguments.work:
        work(arguments.work[0], int(arguments.work[1]))
    elif arguments.only is not None:
        again(arguments.kind, arguments.only, arguments.keep)
    else:
        campaign(arguments)


def again(kind: str, index: int, keep: Path | None) -> None:
    """One input, in this process."""
    from experiments.abuse.targets import outcome

    with tempfile.TemporaryDirectory() as folder:
        seed, data = make_input(all_seeds(Path(folder)), kind, index)
        print(seed.suffix, outcome(kind, _write(folder, kind, seed, data)))
    if keep:
        keep.write_bytes(data)


def campaign(arguments: argparse.Namespace) -> None:
    """Each kind of reader for its share of the time, in rounds; figures after each, or when stopped."""
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(1))
    kinds = [arguments.kind] if arguments.kind else list(SHARES)
    whole = sum(SHARES[kind] for kind in kinds)
    rounds = max(1, round(arguments.minutes / 10))
    workers = {kind: Worker(kind, arguments.start) for kind in kinds}
    for _ in range(rounds):
        for kind, worker in workers.items():
            try:
                worker.run(60 * arguments.minutes * SHARES[kind] / whole / rounds)
            finally:
                print(kind, json.dumps(worker.report()), flush=True)
                if arguments.out:
                    result = {kind: worker.report() for kind, worker in workers.items()}
                    arguments.out.write_text(json.dumps(result, indent=1) + "\n")


if __name__ == "__main__":
    main()
