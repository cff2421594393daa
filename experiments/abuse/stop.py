"""Commands that are asked to stop at random moments: one line, the right status, within two seconds.

    python -m experiments.abuse.stop --job train --times 100 --out stop-train.json

Ctrl-C (SIGINT) and SIGTERM by turns, at moments drawn over the command's whole length. Before Python has
begun to run the program, some 50 ms, a signal ends it without a line; these are counted apart.
"""

import argparse
import json
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np

from experiments.abuse.kill import Job
from jaxisp.process.signals import LINE

ENDINGS = {signal.SIGINT: 130, signal.SIGTERM: 143}


def stopped(command: list[str], delay: float, number: signal.Signals) -> dict[str, Any]:
    """Start a command, send it a signal, and say how it ended."""
    words = [sys.executable, "-m", "jaxisp", *command]
    process = subprocess.Popen(words, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    try:
        process.communicate(timeout=delay)
        return {"what": "finished" if process.returncode == 0 else f"failed: {process.returncode}"}
    except subprocess.TimeoutExpired:
        clock = time.monotonic()
        process.send_signal(number)
    try:
        _, said = process.communicate(timeout=30)
    except subprocess.TimeoutExpired:
        process.kill()
        return {"what": "did not stop"}
    found = {"seconds": round(time.monotonic() - clock, 2), "status": process.returncode, "said": said}
    if process.returncode == -number or (number == signal.SIGINT and "Traceback" in said and delay < 0.3):
        return {"what": "too early", **found}
    right = found["status"] == ENDINGS[number] and said == LINE + "\n" and found["seconds"] < 2
    return {"what": "right" if right else "finished" if process.returncode == 0 else "wrong", **found}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--job", choices=("degrade", "shards", "fit", "train"), required=True)
    parser.add_argument("--times", type=int, default=100)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--out", type=Path, help="JSON file")
    arguments = parser.parse_args()
    rng = np.random.default_rng(arguments.seed)
    with tempfile.TemporaryDirectory() as root:
        job = Job(arguments.job, Path(root, "data"))
        job.data.mkdir()
        job.make_data()
        clock = time.monotonic()
        subprocess.run([sys.executable, "-m", "jaxisp", *job.command(Path(root, "first"))], check=True)
        length = time.monotonic() - clock
        found = [
            stopped(job.command(Path(root, f"{i}")), rng.uniform(0, length), list(ENDINGS)[i % 2])
            for i in range(arguments.times)
        ]
    counts = {what: sum(f["what"] == what for f in found) for what in sorted({f["what"] for f in found})}
    slowest = max((f["seconds"] for f in found if "seconds" in f), default=0)
    table = {"job": arguments.job, "ended": counts, "slowest [s]": slowest, "length [s]": round(length, 1)}
    wrong = [f for f in found if f["what"] not in ("right", "finished", "too early")]
    print(json.dumps({**table, "wrong": wrong}))
    if arguments.out:
        arguments.out.write_text(json.dumps(table, indent=1) + "\n")


if __name__ == "__main__":
    main()
