"""Commands killed at random moments and run again: what comes of it must be what an undisturbed run gives.

    python -m experiments.abuse.kill --job degrade --times 50 --out kill-degrade.json

Each trial starts the command in a fresh folder, kills it (SIGKILL) at a moment drawn over its whole length,
looks at what it left, and starts it again as a user would, with --resume where the command has it.
"""

import argparse
import hashlib
import json
import os
import shutil
import signal
import sys
import tempfile
import time
import traceback
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np


class Job:
    """A command, what it works on, and what of its output must be the same in every run.

    The inputs are small, so that much of a run is spent on writing.
    """

    def __init__(self, name: str, data: Path) -> None:
        self.name, self.data = name, data

    def make_data(self) -> None:
        """Write the inputs."""
        if self.name == "fit":
            from jaxisp.samples import PHONES, scenes, write_pairs

            write_pairs(self.data, PHONES["a"], list(scenes((160, 224)))[:1])
            return
        from jaxisp.io import write_png

        for i in range(6):
            shape = (36, 48, 3) if i % 2 else (40, 32, 3)
            write_png(self.data / f"photo {i}.png", np.random.default_rng(i).uniform(size=shape))

    def command(self, out: Path) -> list[str]:
        """Its arguments."""
        if self.name == "fit":
            words = "--steps 4 --demosaic demosaic_bilinear --median none"
            return ["fit", str(self.data), "-o", str(out / "camera.toml"), *words.split()]
        if self.name == "train":
            words = """--recipe awgn --model fast --steps 12 --batch 2 --patch 16 --downsample 1
                --validation 2 --checkpoint-every 2 --log-every 1 --cpu-devices 1 --resume"""
            return ["train", "--clean", str(self.data), "-o", str(out), *words.split()]
        words = "--shards 5" if self.name == "shards" else "--resume"
        return ["degrade", str(self.data), "-o", str(out), *f"--recipe awgn --count 10 {words}".split()]

    def results(self, out: Path) -> dict[str, str]:
        """Digests of the output, times and dates left out."""
        if self.name == "train":
            return {"state": _train_state(out), "log": _without_times(out / "log.csv")}
        if self.name == "fit":
            return {"camera": _digest((out / "camera.toml").read_bytes())}
        found = {p.name: _digest(p.read_bytes()) for p in sorted(out.iterdir()) if p.name[0] != "."}
        if self.name == "shards":  # the container holds no promise of equal bytes: its records do
            return {k: v for k, v in found.items() if k.endswith(".toml")} | _records(out)
        return found

    def check_left(self, out: Path) -> None:
        """After a kill: what stands under its own name must be whole."""
        from jaxisp.io import read_image, read_toml

        for path in out.rglob("*") if out.exists() else ():
            if path.name.startswith(".") or not path.is_file() or "checkpoints" in path.parts:
                continue
            if path.suffix == ".png":
                read_image(path)
            elif path.suffix == ".toml":
                read_toml(path)
            elif path.suffix in (".json", ".partial"):
                json.loads(path.read_text())
        if self.name == "train" and (out / "config.toml").exists():
            from jaxisp.train.checkpoints import Checkpoints

            Checkpoints(out, "a run", reading=True).close()


def _digest(data: bytes) -> str:
    return hashlib.sha256(data).hexdigest()


def _records(out: Path) -> dict[str, str]:
    from jaxisp.data import ShardSource

    source = ShardSource(out)
    assert not source.verify(), "a shard's bytes are not those that were written"
    return {
        str(source.indices[i]): _digest(b"".join(v.tobytes() for _, v in sorted(source.arrays(i).items())))
        for i in range(len(source))
    }


def _train_state(out: Path) -> str:
    import orbax.checkpoint as ocp

    last = max(int(p.name) for p in (out / "checkpoints" / "last").iterdir() if p.name.isdigit())
    tree = ocp.StandardCheckpointer().restore((out / "checkpoints" / "last" / str(last) / "state").resolve())
    import jax

    leaves = jax.tree.leaves_with_path(tree)
    return f"{last}:" + _digest(b"".join(str(p).encode() + np.asarray(v).tobytes() for p, v in leaves))


def _without_times(path: Path) -> str:
    rows = [line.rsplit(",", 1)[0] for line in path.read_text().splitlines()]
    return _digest("\n".join(rows).encode())


def start(arguments: list[str], log: Path) -> int:
    """The command in a child process that has everything imported already."""
    pid = os.fork()
    if pid:
        return pid
    status = 1
    try:
        with log.open("ab") as file:
            os.dup2(file.fileno(), 1)
            os.dup2(file.fileno(), 2)
        from jaxisp.cli import main as command

        status = command(arguments)
    except BaseException:
        traceback.print_exc()
    finally:
        sys.stderr.flush()
        os._exit(status)


def finish(arguments: list[str], log: Path) -> float:
    """Run the command to its end; the seconds it took."""
    clock = time.monotonic()
    _, status = os.waitpid(start(arguments, log), 0)
    if status:
        raise RuntimeError(f"exit {os.waitstatus_to_exitcode(status)}: {log.read_text()[-400:]}")
    return time.monotonic() - clock


def in_child(function: Callable[[], Any]) -> Any:
    """What a function gives, computed in a child: a device that was started does not survive a fork."""
    receive, send = os.pipe()
    pid = os.fork()
    if not pid:
        try:
            answer = {"value": function()}
        except BaseException as error:
            answer = {"error": f"{type(error).__name__}: {' '.join(str(error).split())[:400]}"}
        os.write(send, json.dumps(answer).encode())
        os._exit(0)
    os.close(send)
    with os.fdopen(receive) as file:
        text = file.read()
    os.waitpid(pid, 0)
    answer = json.loads(text or '{"error": "died"}')
    if "error" in answer:
        raise RuntimeError(answer["error"])
    return answer["value"]


def trial(
    job: Job, out: Path, wanted: dict[str, str], seconds: float, rng: np.random.Generator
) -> dict[str, Any]:
    """Kill once or twice, run to the end, compare."""
    log, found = out.with_suffix(".log"), {"kills": 0, "wrong": ""}
    try:
        for _ in range(1 + int(rng.integers(2))):
            pid = start(job.command(out), log)
            time.sleep(rng.uniform(0, seconds))
            if os.waitpid(pid, os.WNOHANG)[0] == 0:
                os.kill(pid, signal.SIGKILL)
                os.waitpid(pid, 0)
                found["kills"] += 1
            in_child(lambda: job.check_left(out))
        finish(job.command(out), log)
        got = in_child(lambda: job.results(out))
        differ = sorted(k for k in wanted.keys() | got.keys() if wanted.get(k) != got.get(k))
        left = [str(p.relative_to(out)) for p in out.rglob("*tmp*")]
        found["wrong"] = f"differs: {differ[:4]}" if differ else f"left: {left[:4]}" if left else ""
    except Exception as error:
        found["wrong"] = f"{type(error).__name__}: {' '.join(str(error).split())[:400]}"
    return found


def campaign(name: str, times: int, seed: int, root: Path) -> dict[str, Any]:
    """All trials of one job; figures."""
    import jaxisp.demo  # noqa: F401  (imports nearly everything, and starts no device)

    job = Job(name, root / "data")
    job.data.mkdir()
    in_child(job.make_data)
    runs = []
    for place in ("first", "second"):  # the first also compiles
        out = root / place
        out.mkdir()
        seconds = finish(job.command(out), root / f"{place}.log")
        runs.append(in_child(lambda out=out: job.results(out)))
    if runs[0] != runs[1]:
        raise SystemExit("two undisturbed runs differ")
    rng, kills, wrong = np.random.default_rng(seed), 0, []
    for i in range(times):
        out = root / f"trial {i} é"
        out.mkdir()
        found = trial(job, out, runs[0], seconds, rng)
        kills += found["kills"]
        if found["wrong"]:
            wrong.append(found["wrong"])
        print(f"{name} {i}: {found}", flush=True)
        shutil.rmtree(out)
    table = {"job": name, "trials": times, "kills": kills, "wrong": wrong}
    return {**table, "seconds_undisturbed": round(seconds, 2)}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--job", choices=("degrade", "shards", "fit", "train"), required=True)
    parser.add_argument("--times", type=int, default=50)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--out", type=Path, help="JSON file")
    arguments = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        os.environ["JAX_COMPILATION_CACHE_DIR"] = f"{folder}/compiled"
        os.environ["JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS"] = "0"
        result = campaign(arguments.job, arguments.times, arguments.seed, Path(folder))
    print(json.dumps(result))
    if arguments.out:
        arguments.out.write_text(json.dumps(result, indent=1) + "\n")


if __name__ == "__main__":
    main()
