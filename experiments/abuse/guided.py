"""Damaged files for every reader, guided by what code they reach: atheris keeps what reaches more.

    pip install atheris
    nice -n 19 python -m experiments.abuse.guided --minutes 100 --state FOLDER
    python -m experiments.abuse.guided --state FOLDER --table
    python -m experiments.abuse.guided --again FOLDER/found/raw-1a2b3c4d.dng --kind raw

FOLDER keeps the corpus, the counts and what was found; a run that was stopped goes on where it was. Readers
have their turns in one process at a time, which holds one input to 1 GiB of memory and `SLOW` seconds of the
processor. Half of the changes are libFuzzer's own, half know the format (`mutate.py`).
"""

import argparse
import hashlib
import json
import os
import random
import re
import resource
import signal
import subprocess
import sys
import tempfile
import time
import warnings
from pathlib import Path
from typing import Any

import numpy as np

from experiments.abuse.limits import MEMORY, SECONDS, SHARES, file_name

TURN = 60.0
"""Seconds of a share of 1 in each round."""
HANG = 120
"""Seconds by the clock after which libFuzzer ends a reader: the machine may do other work."""
LONGEST = 1 << 18
"""Bytes of an input."""
INSTRUMENTED = ("jaxisp", "tifffile", "PIL", "tarfile", "zipfile", "tomllib")
COUNTS = ("inputs", "accepted", "refused", "broken")


class Told:
    """Counts of one reader, on the disk after each input: a reader that dies has told them."""

    def __init__(self, path: Path) -> None:
        if not path.exists():
            path.write_bytes(bytes(8 * len(COUNTS)))
        self._numbers = np.memmap(path, np.int64, "r+")

    def add(self, name: str) -> None:
        self._numbers[0] += 1
        self._numbers[COUNTS.index(name)] += 1

    def __iter__(self) -> Any:
        return iter(map(int, self._numbers))


def work(kind: str, seconds: int, state: Path) -> None:
    """One reader's turn, in this process."""
    import atheris

    # libraries that C loads have to be there before their Python is changed
    with atheris.instrument_imports(include=list(INSTRUMENTED)):
        from experiments.abuse.mutate import mutate
        from experiments.abuse.seeds import all_seeds
        from experiments.abuse.targets import outcome

    memory = "/dev/shm" if os.access("/dev/shm", os.W_OK) else None
    folder = Path(tempfile.mkdtemp(dir=memory, prefix="abuse-"))
    own = [seed for seed in all_seeds(folder) if seed.kind == kind]
    corpus = state / "corpus" / kind
    for place in (corpus, state / "found"):
        place.mkdir(parents=True, exist_ok=True)
    told = Told(state / f"{kind}.counts")
    suffixes = sorted({seed.suffix for seed in own})
    for seed in own:  # the last byte says the suffix
        data = seed.data + bytes([suffixes.index(seed.suffix)])
        (corpus / hashlib.sha1(data).hexdigest()).write_bytes(data)
        path = folder / file_name(kind, seed.suffix)
        path.write_bytes(seed.data)
        outcome(kind, path)  # loads all that is loaded at first use
    printed = os.open(folder / "printed", os.O_CREAT | os.O_RDWR | os.O_APPEND)
    errors = os.dup(2)
    warnings.simplefilter("always", RuntimeWarning)  # would be a second line beside the one of an error
    warnings.simplefilter("always", UserWarning)

    def read(data: bytes) -> None:
        suffix = suffixes[data[-1] % len(suffixes)] if data else suffixes[0]
        path = folder / file_name(kind, suffix)
        path.write_bytes(data[:-1])
        os.dup2(printed, 2)
        clock = time.process_time()
        found = outcome(kind, path)
        used = time.process_time() - clock
        sys.stderr.flush()
        os.dup2(errors, 2)
        if size := os.fstat(printed).st_size:
            found = f"printed: {os.pread(printed, min(size, 2000), 0).decode(errors='replace')!r} ({found})"
            os.truncate(printed, 0)
        if used > SECONDS:
            found = f"slow: {used:.0f} s ({found})"
        name = found if found in ("accepted", "refused") else "broken"
        told.add(name)
        if name == "broken":
            _keep(state / "found", kind, suffix, found, data[:-1])

    def change(data: bytes, most: int, seed: int) -> bytes:
        if seed % 2 or len(data) < 2:
            return atheris.Mutate(data, most)
        rng = np.random.default_rng(seed)
        return mutate(data[:-1], [s.data for s in own], rng)[: most - 1] + data[-1:]

    resource.setrlimit(resource.RLIMIT_AS, (_mapped() + MEMORY,) * 2)
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    flags = {
        "max_total_time": seconds, "timeout": HANG, "rss_limit_mb": 0, "max_len": LONGEST, "len_control": 0,
        "print_final_stats": 0, "verbosity": 0, "seed": random.randrange(1, 1 << 31), "use_value_profile": 0,
        "artifact_prefix": f"{state / 'found'}/{kind}-", "reload": 0, "detect_leaks": 0,
    }  # fmt: skip
    arguments = [sys.argv[0], *(f"-{name}={value}" for name, value in flags.items()), str(corpus)]
    atheris.Setup(arguments, read, custom_mutator=change)
    atheris.Fuzz()


def _mapped() -> int:
    return int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize()


def _keep(folder: Path, kind: str, suffix: str, what: str, data: bytes) -> None:
    """One input of each kind of finding: by its error and place, or by its first words."""
    place = what.rpartition(" at ")
    name = f"{what.partition(':')[0]} {place[2]}" if place[1] else re.sub(r"[0-9]+|0x[0-9a-f]+", "N", what)
    stem = f"{kind}-{hashlib.sha1(name[:100].encode()).hexdigest()[:8]}"
    told = folder / f"{stem}.txt"
    before = told.read_text().count("\n") if told.exists() else 0
    if before < 200:
        with told.open("a") as file:
            file.write(f"{what[:400]}\n")
    path = folder / f"{stem}{suffix}"
    if not path.exists() or len(data) < path.stat().st_size:
        path.write_bytes(data)


def campaign(minutes: float, state: Path, kinds: list[str]) -> None:
    """Turns of all readers, in rounds, for some time; their seconds of the processor are written down."""
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(1))
    state.mkdir(parents=True, exist_ok=True)
    end = time.monotonic() + 60 * minutes
    file = state / "state.json"
    told = json.loads(file.read_text()) if file.exists() else {}
    while True:
        for kind in sorted(kinds, key=lambda k: told.get(k, {}).get("cpu", 0) / SHARES[k]):
            left = end - time.monotonic()
            if left < 20:
                return
            before = resource.getrusage(resource.RUSAGE_CHILDREN)
            command = [
                sys.executable,
                "-m",
                "experiments.abuse.guided",
                "--work",
                kind,
                "--state",
                str(state),
            ]
            turn = int(min(TURN * SHARES[kind], left - 10))
            with (state / f"{kind}.log").open("ab") as log:
                status = subprocess.run(
                    [*command, "--seconds", str(turn), "--state", str(state)], stdout=log, stderr=log
                ).returncode
            after = resource.getrusage(resource.RUSAGE_CHILDREN)
            one = told.setdefault(kind, {"cpu": 0.0, "turns": 0, "died": []})
            one["cpu"] += after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
            one["turns"] += 1
            if status:
                one["died"].append(status)
            file.write_text(json.dumps(told, indent=1) + "\n")


def table(state: Path) -> str:
    """All that was read, as a table."""
    told = json.loads((state / "state.json").read_text())
    lines = ["| reader | inputs | accepted | refused | broken | died | CPU [s] | kept for their coverage |"]
    lines += ["| --- | --- | --- | --- | --- | --- | --- | --- |"]
    sums = np.zeros(6, np.int64)
    for kind in (k for k in SHARES if k in told):
        numbers = [*Told(state / f"{kind}.counts"), len(told[kind]["died"]), round(told[kind]["cpu"])]
        sums += np.array(numbers)
        kept = len(list((state / "corpus" / kind).iterdir()))
        lines.append(f"| {kind} | {' | '.join(f'{n:,}' for n in numbers)} | {kept:,} |")
    return "\n".join([*lines, f"| all | {' | '.join(f'{n:,}' for n in sums)} | |"])


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--minutes", type=float, default=10.0)
    parser.add_argument("--state", type=Path, help="folder, outside the repository")
    parser.add_argument("--kind", choices=SHARES, help="this kind of reader alone")
    parser.add_argument("--table", action="store_true", help="print what was read so far")
    parser.add_argument("--again", type=Path, metavar="FILE", help="read this input alone")
    parser.add_argument("--work", choices=SHARES, help=argparse.SUPPRESS)
    parser.add_argument("--seconds", type=int, help=argparse.SUPPRESS)
    arguments = parser.parse_args()
    if arguments.again:
        from experiments.abuse.targets import outcome

        with tempfile.TemporaryDirectory() as folder:
            path = Path(folder) / file_name(arguments.kind, arguments.again.suffix)
            path.write_bytes(arguments.again.read_bytes())
            print(outcome(arguments.kind, path))
    elif arguments.table:
        print(table(arguments.state))
    elif arguments.work:
        work(arguments.work, arguments.seconds, arguments.state)
    else:
        campaign(arguments.minutes, arguments.state, [arguments.kind] if arguments.kind else list(SHARES))


if __name__ == "__main__":
    main()
