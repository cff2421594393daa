"""Run a diagnosis on many withheld cases and keep what it said.

    python -m experiments.withheld.study --kind raw+jpeg --split develop --out RESULTS.json

A run that was broken off goes on where it stopped. `tables` turns the file into Markdown.
"""

import argparse
import json
import re
import sys
import tempfile
import time
import traceback
import zlib
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from . import libraw, shoot
from .bodies import BODIES, LATER
from .effects import (
    DEVELOP,
    KINDS,
    LEVELS,
    LOST_HEADER,
    NULLS,
    OUTSIDE,
    PAIRED,
    PAIRS,
    SEALED,
    VOCABULARY,
    shows_in,
    without_header,
)
from .scenes import GREY, SETS

_CASES = 12  # of one process: programs for every camera that it has seen come to gigabytes
_TOO_SMALL = {"raw+jpeg": 0.05, "clean+noisy": 0.6}
"""Above the floor, in units: a diagnosis looks for effects in gaps of 0.1 and 0.7 on."""
Report = dict[str, Any]
Diagnose = Callable[..., Report]
SCENES = {
    "develop": "one", "sealed": "two", "nulls": "", "outside": "three", "pairs": "three", "alone": "three",
    "deleted": "three", "libraw": "three", "stripped": "three",
}  # fmt: skip
"""The scenes of each split; nulls come on all sets."""
_UNTRIED = ("verdict", "causes", "gap", "where", "own_seconds")
"""What is kept where nothing was tried."""
_WITHOUT_TRUTH = ("nulls", "alone", "deleted", "libraw", "stripped")
"""Where the share of the gap that an effect made is not asked for, or not known: LibRaw's change tone."""


@dataclass(frozen=True)
class Case:
    kind: str
    split: str
    body: str
    effects: tuple[tuple[str, int], ...]
    scenes: str

    @property
    def name(self) -> str:
        what = "+".join(f"{name}={level}" for name, level in self.effects)
        return f"{self.kind} {self.split} {self.scenes} {self.body} {what}"


def cases(
    kind: str, split: str, bodies: Sequence[str], levels: Sequence[int], scenes: str = ""
) -> Iterator[Case]:
    """All cases of a split; nulls come on every scene set, a body's own nothing among them.

    "deleted" is the whole vocabulary again, each effect left out of those that the diagnosis tries; "alone"
    the effects of the pairs one by one, nothing tried: how large a gap each makes; "stripped" the vocabulary
    beside a compression whose header is lost: pictures that were saved once more, as PNG.
    """
    if split == "nulls":
        for name in NULLS:
            if shows_in(name, kind):
                for where in [scenes] if scenes else SETS:
                    yield from (Case(kind, split, body, ((name, 1),), where) for body in bodies)
        return
    if split == "libraw":
        switched = [(name, body) for name in libraw.SWITCHES for body in bodies if kind == PAIRED]
        yield from (Case(kind, split, body, ((name, 1),), scenes or SCENES[split]) for name, body in switched)
        return
    names: dict[str, Sequence[tuple[str, ...]]] = {
        "develop": [(name,) for name in DEVELOP],
        "sealed": [(name,) for name in SEALED],
        "outside": [(name,) for name in OUTSIDE],
        "pairs": PAIRS,
        "alone": [(name,) for name in sorted({name for pair in PAIRS for name in pair})],
        "deleted": [(name,) for name in sorted(VOCABULARY)],
        "stripped": [(name,) for name in sorted({*VOCABULARY} - {LOST_HEADER[0]})],
    }
    beside = (LOST_HEADER,) if split == "stripped" else ()
    for group in names[split]:
        if all(shows_in(name, kind) for name in group):
            for level in levels:
                for body in bodies:
                    active = (*((name, level) for name in group), *beside)
                    yield Case(kind, split, body, active, scenes or SCENES[split])


def shuffled(found: Sequence[Case]) -> list[Case]:
    """A fixed order that mixes effects and bodies, so that a part of a run is a fair sample."""
    return sorted(found, key=lambda case: zlib.crc32(case.name.encode()))


def examine(
    case: Case, diagnose: Diagnose, size: int = 256, count: int = 8, frames: int = 1, untried: bool = False
) -> dict[str, Any]:
    """Shoot one case, diagnose it, and keep the parts of the report that the tables need; what it says with
    no effect to try where `untried`."""
    record: dict[str, Any] = {"case": case.name, **asdict(case), "standing": BODIES[case.body].standing}
    write = libraw.write if case.split == "libraw" else shoot.write
    with tempfile.TemporaryDirectory() as folder:
        try:
            taken = {"size": size, "count": count} | ({"frames": frames} if frames > 1 else {})
            write(Path(folder), case.body, dict(case.effects), case.kind, case.scenes, **taken)
            began = time.perf_counter()
            report = _report(case, Path(folder), diagnose, untried)
        except Exception as error:
            places = traceback.extract_tb(error.__traceback__, limit=-4)  # no paths: results are published
            trace = [f"{Path(own.filename).name}:{own.lineno} {own.name}" for own in places]
            return record | {"failed": repr(error), "trace": trace}
        record["seconds"] = round(time.perf_counter() - began, 2)
    found = kept(report)
    record |= {name: found[name] for name in _UNTRIED} if untried else found
    if case.split == "nulls" or case.split not in _WITHOUT_TRUTH:
        record["statistics"] = counted(report)
    return record


def _report(case: Case, folder: Path, diagnose: Diagnose, untried: bool) -> Report:
    """Of nulls nothing is tried at first: in a gap that is too small nothing would be looked for."""
    every = sorted(VOCABULARY)
    if untried:
        return diagnose(folder, exclude=every)
    if case.split == "nulls":
        report = diagnose(folder, exclude=every)
        gap = report["gap"]
        if gap["before"] - gap["floor"] < _TOO_SMALL[case.kind] * gap["unit"]:
            return report
    hidden = {"deleted": [name for name, _ in case.effects], "alone": every}.get(case.split, [])
    return diagnose(folder, exclude=hidden)


def counted(report: Report) -> list[list[float]]:
    """Each statistic's difference and how much it counts, by which a case and its plain body are compared."""
    found = report["gap"].get("statistics", {})
    return [[round(v, 4) for v in own] for _, own in sorted(found.items())]


def kept(report: Report) -> dict[str, Any]:
    causes = report["causes"]
    return {
        "verdict": report["verdict"],
        "causes": [c["effect"] for c in causes],
        "alternatives": {c["effect"]: c["alternatives"] for c in causes},
        "closed": {c["effect"]: c["closed"] for c in causes},
        "ci": {c["effect"]: c["ci"] for c in causes},
        "ranking": [r["effect"] for r in report["ranking"]],
        "status": {r["effect"]: r["status"] for r in report["ranking"]},
        "predicted": {r["effect"]: r["predicted"] for r in report["ranking"] if r.get("ci")},
        "absorbed": report["base"].get("absorbed", {}),
        "gap": {name: value for name, value in report["gap"].items() if name != "statistics"},
        "where": [w["axis"] for w in report["where"][:3]],
        "unexplained": report["unexplained"],
        "own_seconds": report["seconds"],
    }


def true_closure(record: dict[str, Any], plain: dict[str, Any] | None) -> float | None:
    """Share of the gap above the floor that the effect made: what is left is the same body's without it."""
    if plain is None or "failed" in plain or "failed" in record:
        return None
    before = record["gap"]["before"]
    above = before - record["gap"]["floor"]
    return (before - measured_alike(record, plain)) / above if above > 0 else None


def measured_alike(record: dict[str, Any], plain: dict[str, Any]) -> float:
    """The body's gap without its effect, as the record measures one: statistics count as they do there."""
    counted, found = record.get("statistics"), plain.get("statistics")
    if not counted or not found:
        return float(plain["gap"]["before"])
    return sum(weight * value**2 for (_, weight), (value, _) in zip(counted, found)) / len(counted)


def run(
    todo: Sequence[Case], diagnose: Diagnose, out: Path, jobs: int, options: dict[str, int], command: str = ""
) -> None:
    """Examine every case that `out` does not hold yet; the file is whole after each.

    Args:
        todo: the cases.
        diagnose: from a folder to a report.
        out: the results, and the commands that asked for them.
        jobs: processes.
        options: of `examine`.
        command: the arguments that this run was asked for with.
    """
    before: dict[str, Any] = json.loads(out.read_text()) if out.exists() else {"cases": {}}
    done, commands = before["cases"], list(dict.fromkeys([*before.get("commands", []), command]))
    commands = [asked for asked in commands if asked]
    left = [case for case in todo if case.name not in done or "failed" in done[case.name]]
    out.parent.mkdir(parents=True, exist_ok=True)
    for record in _examined(left, diagnose, jobs, options):
        done[record["case"]] = record
        for other in done.values():
            if other["split"] not in _WITHOUT_TRUTH:
                other["true_closure"] = true_closure(other, done.get(_plain(other).name))
        partial = out.with_suffix(".partial")
        partial.write_text(written(commands, done))
        partial.replace(out)
        told = record.get("failed") or f"{record['verdict']} {record['causes']} {record['seconds']} s"
        print(record["case"], "->", told, flush=True)


def written(commands: Sequence[str], done: dict[str, Any]) -> str:
    """The results as JSON, a case a line."""
    lines = ",\n".join(f"{json.dumps(name)}: {json.dumps(record)}" for name, record in done.items())
    return f'{{"schema": 1, "commands": {json.dumps(commands)}, "cases": {{\n{lines}\n}}}}\n'


def _examined(left: Sequence[Case], diagnose: Diagnose, jobs: int, options: dict[str, int]) -> Iterator[Any]:
    if jobs == 1:
        yield from (examine(case, diagnose, **options) for case in left)
        return
    for start in range(0, len(left), _CASES * jobs):
        with ProcessPoolExecutor(jobs) as pool:
            some = left[start : start + _CASES * jobs]
            futures = [pool.submit(examine, case, diagnose, **options) for case in some]
            yield from (future.result() for future in futures)


def _plain(record: dict[str, Any]) -> Case:
    """The same pictures without the effect, in a file that is compressed if theirs is."""
    name = "lossless" if without_header(dict(record["effects"])) else "nothing"
    return Case(record["kind"], "nulls", record["body"], ((name, 1),), record["scenes"])


def chosen(arguments: argparse.Namespace) -> list[Case]:
    """The cases asked for, each body's plain pictures first, from which the true closures are worked out."""
    found: list[Case] = []
    for kind in arguments.kind:
        for split in arguments.split:
            found += cases(kind, split, arguments.bodies, arguments.strengths, arguments.scenes)
    found = [case for case in shuffled(found) if re.search(arguments.match, case.name)]
    found = found[arguments.skip : arguments.limit]
    plain = {_plain(asdict(case)): None for case in found if case.split not in _WITHOUT_TRUTH}
    return list(dict.fromkeys([*plain, *found]))


def parse(words: Sequence[str] | None = None) -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--kind", nargs="+", choices=KINDS, default=KINDS)
    parser.add_argument("--split", nargs="+", choices=SCENES, required=True)
    parser.add_argument("--bodies", nargs="+", choices=sorted(BODIES), default=sorted({*BODIES} - {*LATER}))
    parser.add_argument("--strengths", nargs="+", type=int, choices=LEVELS, default=LEVELS)
    parser.add_argument("--scenes", choices=(*SETS, GREY), default="", help="instead of the split's own set")
    parser.add_argument("--match", default="", help="a regular expression that a case's name has")
    parser.add_argument("--size", type=int, default=256)
    parser.add_argument("--count", type=int, default=8, help="scenes in a data set")
    parser.add_argument("--frames", type=int, default=1, help="of each scene")
    parser.add_argument(
        "--untried", action="store_true", help="try no effect: where a base's gap lies, alone"
    )
    parser.add_argument("--skip", type=int, default=0, help="leave out as many: thresholds were set on them")
    parser.add_argument("--limit", type=int, help="end before this case")
    parser.add_argument("--jobs", type=int, default=1)
    parser.add_argument("--out", type=Path, required=True)
    arguments = parser.parse_args(words)
    if arguments.frames > 1 and "libraw" in arguments.split:
        parser.error("LibRaw's data sets have one frame of each scene")
    return arguments


def main() -> None:
    arguments = parse()
    from jaxisp.gap import diagnose_folder

    options = {key: getattr(arguments, key) for key in ("size", "count", "frames", "untried")}
    asked = " ".join(sys.argv[1:]).replace(f"--out {arguments.out}", "").strip()
    run(chosen(arguments), diagnose_folder, arguments.out, arguments.jobs, options, asked)


if __name__ == "__main__":
    main()
