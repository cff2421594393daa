"""Commands that are asked to stop at random moments: one line, the right status, within two seconds.

    python -m experiments.abuse.stop --times 100 --state FOLDER
    python -m experiments.abuse.stop --state FOLDER --table

SIGINT (Ctrl-C), SIGTERM and SIGHUP (a lost terminal) by turns, at moments drawn over a command's length, or
its first `MOST` seconds.
A tenth of the runs start Python anew, so that imports are interrupted too; the others are forked from a
process that has imported everything. A command that was stopped is started again into the same folder until
one of its runs ends: what it wrote then must be what an undisturbed run wrote. FOLDER keeps all
runs, and goes on with them. Before Python has begun to run the program, a signal ends it without a line:
these are "early".
"""

import argparse
import collections
import contextlib
import json
import os
import shutil
import signal
import subprocess
import sys
import tempfile
import time
import traceback
from pathlib import Path
from typing import Any

import numpy as np

from jaxisp.process.signals import LINE

ENDINGS = {signal.SIGINT: 130, signal.SIGTERM: 143, signal.SIGHUP: 129}
MOST = 6.0
"""Seconds after which the last signals come."""
LATE = 2.0
ANEW = 10
"""One of so many runs starts Python anew."""


def start(arguments: list[str], log: Path, *, anew: bool) -> int:
    """The command in a process of its own, that writes standard error into `log`; its number."""
    with log.open("wb") as errors, open(os.devnull, "wb") as nothing:
        if anew:
            words = [sys.executable, "-m", "jaxisp", *arguments]
            return subprocess.Popen(words, stdout=nothing, stderr=errors).pid
        from jaxisp.__main__ import main

        held = signal.pthread_sigmask(signal.SIG_BLOCK, ENDINGS)
        if pid := os.fork():
            signal.pthread_sigmask(signal.SIG_SETMASK, held)
            return pid
        status = 1
        try:
            os.dup2(nothing.fileno(), 1)
            os.dup2(errors.fileno(), 2)
            sys.argv[1:] = arguments
            # one that came since ends the process as one does that comes before Python runs the program
            for number in ENDINGS:
                signal.signal(number, signal.SIG_DFL)
            signal.pthread_sigmask(signal.SIG_SETMASK, held)
            status = main()
        except SystemExit as error:
            status = int(error.code or 0)
        except BaseException:
            traceback.print_exc()
        finally:
            with contextlib.suppress(BaseException):
                sys.stderr.flush()
            os._exit(status)


def _wait(pid: int, seconds: float) -> int | None:
    """The status of a process, None where it has not ended after so long; signals are below 0."""
    end = time.monotonic() + seconds
    while True:
        ended, status = os.waitpid(pid, os.WNOHANG)
        if ended:
            return os.waitstatus_to_exitcode(status)
        if time.monotonic() > end:
            return None
        time.sleep(0.005)


def stopped(
    arguments: list[str], delay: float, number: signal.Signals, log: Path, *, anew: bool = True
) -> dict[str, Any]:
    """Start a command, send it a signal, and say how it ended."""
    pid = start(arguments, log, anew=anew)
    status = _wait(pid, delay)
    if status is not None:
        return {"what": "finished" if status == 0 else f"failed: {status}", "said": log.read_text()[-500:]}
    clock = time.monotonic()
    os.kill(pid, number)
    status = _wait(pid, 30)
    seconds = round(time.monotonic() - clock, 2)
    if status is None:
        os.kill(pid, signal.SIGKILL)
        os.waitpid(pid, 0)
        return {"what": "did not stop"}
    said = log.read_text(errors="replace")
    found = {"seconds": seconds, "load": round(os.getloadavg()[0], 1), "delay": round(delay, 2)}
    # Python's own start tells of Ctrl-C by a traceback, in which the program has no line
    if status == -number or (anew and "Traceback" in said and "jaxisp/__main__.py" not in said):
        return {"what": "early", **found}
    if status == 0 and LINE not in said:
        return {"what": "finished", **found}
    lines = said.splitlines()  # `data fetch` tells the licence before
    if status != ENDINGS[number] or lines[-1:] != [LINE] or not all(n.startswith("jaxisp: ") for n in lines):
        return {"what": "wrong", "status": status, "said": said[-800:], **found}
    return {"what": "right" if seconds < LATE else "late", **found}


class Runs:
    """The runs of one command, kept in a file of a line each."""

    def __init__(self, state: Path, name: str) -> None:
        self.path = state / f"{name.replace(' ', '-')}.jsonl"

    def all(self) -> list[dict[str, Any]]:
        return [json.loads(line) for line in self.path.read_text().splitlines()] if self.path.exists() else []

    def add(self, run: dict[str, Any]) -> None:
        with self.path.open("a") as file:
            file.write(json.dumps(run) + "\n")


def campaign(name: str, times: int, state: Path, data: Path, until: float) -> None:
    """Interrupt one command until it was `times` times, or the time is over."""
    from experiments.abuse.commands import Job
    from experiments.abuse.kill import in_child

    job, runs, root = Job(name, data), Runs(state, name), Path(tempfile.mkdtemp(prefix="abuse stop é "))
    os.environ["JAXISP_DATA"] = str(root / "out")
    log, out, wanted, length = root / "log", root / "out", None, MOST
    try:
        if job.ends:
            for place in (root / "first", root / "second"):  # the first also compiles
                place.mkdir()
                os.environ["JAXISP_DATA"] = str(place)
                clock = time.monotonic()
                pid = start(job.command(place), log, anew=False)
                if status := _wait(pid, 600):
                    raise RuntimeError(f"{name}: status {status}: {log.read_text()[-400:]}")
                length = min(time.monotonic() - clock, MOST)
            wanted = in_child(lambda: job.results(root / "second"))
            if in_child(lambda: job.results(root / "first")) != wanted:
                raise RuntimeError(f"{name}: two undisturbed runs differ")
            os.environ["JAXISP_DATA"] = str(out)
        out.mkdir()
        for i in range(len(runs.all()), times):
            if time.monotonic() > until:
                return
            rng = np.random.default_rng((i, *name.encode()))
            anew = job.anew and i % ANEW == 0
            delay = rng.uniform(0, length + 2 * anew)
            number = list(ENDINGS)[(i // ANEW if anew else i) % len(ENDINGS)]
            found = stopped(job.command(out), delay, number, log, anew=anew)
            found |= {"signal": number.name, "anew": anew}
            if left := in_child(lambda: job.check_left(out)):
                found = {**found, "what": "wrong", "left": left}
            if found["what"] == "finished":
                if wanted is not None and (got := in_child(lambda: job.results(out))) != wanted:
                    differ = sorted(k for k in wanted.keys() | got.keys() if wanted.get(k) != got.get(k))
                    found = {**found, "what": "wrong", "differ": differ[:5]}
                found["same"] = wanted is not None
                shutil.rmtree(out)
                out.mkdir()
            runs.add(found)
    finally:
        shutil.rmtree(root, ignore_errors=True)


def table(state: Path) -> str:
    """A row for each command."""
    from experiments.abuse.commands import NAMES

    lines = [
        "| command | sent | right | late | early | wrong | ended first | compared | slowest [s] | load |"
    ]
    lines += ["| --- | --- | --- | --- | --- | --- | --- | --- | --- | --- |"]
    for name in NAMES:
        if not (runs := Runs(state, name).all()):
            continue
        kinds = collections.Counter(run["what"].partition(":")[0] for run in runs)
        sent = len(runs) - kinds["finished"]
        wrong = sum(kinds.values()) - sum(kinds[k] for k in ("right", "late", "early", "finished"))
        slowest = max((run["seconds"] for run in runs if "seconds" in run), default=0)
        load = np.mean([run["load"] for run in runs if "load" in run] or [0])
        compared = sum(bool(run.get("same")) for run in runs)
        cells = (sent, kinds["right"], kinds["late"], kinds["early"], wrong, kinds["finished"], compared)
        lines.append(f"| {name} | {' | '.join(map(str, cells))} | {slowest:.2f} | {load:.1f} |")
    return "\n".join(lines)


def main() -> None:
    from experiments.abuse.commands import NAMES, make_data, serve

    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--state", type=Path, required=True, help="folder, outside the repository")
    parser.add_argument("--job", choices=NAMES, help="this command alone")
    parser.add_argument("--times", type=int, default=100)
    parser.add_argument("--minutes", type=float, default=25.0, help="for all commands")
    parser.add_argument("--table", action="store_true", help="print what was found so far")
    arguments = parser.parse_args()
    arguments.state.mkdir(parents=True, exist_ok=True)
    if arguments.table:
        print(table(arguments.state))
        return
    import jaxisp.demo  # noqa: F401  (imports nearly everything, and starts no device)

    # what a shell starts in the background ignores Ctrl-C, what nohup starts SIGHUP; so would their children
    signal.signal(signal.SIGINT, signal.default_int_handler)
    if signal.getsignal(signal.SIGHUP) is signal.SIG_IGN:
        signal.signal(signal.SIGHUP, lambda *_: None)
    until = time.monotonic() + 60 * arguments.minutes
    os.environ["JAX_COMPILATION_CACHE_DIR"] = str(arguments.state / "compiled")
    os.environ["JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS"] = "0"
    if not (arguments.state / "data").exists():
        make_data(arguments.state / "data")
    serve()
    names = [arguments.job] if arguments.job else list(NAMES)
    step = 10
    for times in range(step, arguments.times + step, step):  # all commands a little, then all again
        for name in names:
            if time.monotonic() < until and len(Runs(arguments.state, name).all()) < times:
                try:
                    campaign(
                        name, min(times, arguments.times), arguments.state, arguments.state / "data", until
                    )
                except RuntimeError as error:  # of an undisturbed run: the others can still be tried
                    print(error, flush=True)
    print(table(arguments.state))


if __name__ == "__main__":
    main()
