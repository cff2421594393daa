"""`python -m experiments.third_party`: make, run, table."""

import argparse
import json
from pathlib import Path

from jaxisp.io.files import atomic_write

from .cases import sample
from .chance import HALVES
from .run import HOW, PAIRS, records, run

PARTS = dict(zip(HOW, ("switches", "beside", "changed")))
"""What a file of results has of each way to diagnose a case."""


def parse() -> argparse.Namespace:
    parser = argparse.ArgumentParser(prog="python -m experiments.third_party")
    commands = parser.add_subparsers(dest="command", required=True)
    make = commands.add_parser("make", help="write the cases of a half")
    make.add_argument("--data", type=Path, required=True, help="folder with clean/, raw/ and calibration/")
    make.add_argument("-o", "--out", type=Path, required=True)
    make.add_argument("--half", choices=HALVES, required=True)
    make.add_argument("--size", type=int, default=224, help="of a scene, px a side")
    make.add_argument("--levels", type=int, nargs="+", default=[1, 2, 3, 4, 5], help="strengths")
    make.add_argument("--match", default="", help="a regular expression that a case's name has")
    runs = commands.add_parser("run", help="diagnose every case of a folder")
    runs.add_argument("cases", type=Path)
    runs.add_argument("-o", "--out", type=Path, required=True, help="gets a JSON file a case")
    runs.add_argument("--match", default="")
    runs.add_argument("--limit", type=int)
    runs.add_argument("--sample", action="store_true", help="every switch and every camera once")
    runs.add_argument(
        "--how", choices=HOW, default=HOW[0], help="pairs alone, beside a reference, or as two pictures"
    )
    runs.add_argument("--json", action="store_true", help="print counts as JSON at the end")
    table = commands.add_parser("table", help="Markdown tables of a run")
    table.add_argument("out", type=Path, help="what `run` wrote")
    collect = commands.add_parser("collect", help="put a run of a sample into a file of results")
    collect.add_argument("out", type=Path, help="what `run --sample` wrote")
    collect.add_argument("--into", type=Path, default=Path("docs/results/third-party.json"))
    collect.add_argument("--half", choices=HALVES, required=True)
    collect.add_argument("--how", choices=HOW, default=HOW[0], help="as it was run")
    collect.add_argument("--seen", nargs="*", default=[], help="cases that the method was changed by")
    collect.add_argument("--before", type=Path, help="what `run` wrote of these before the changes")
    return parser.parse_args()


def main() -> None:
    arguments = parse()
    if arguments.command == "make":
        from .make import make

        make(arguments.data, arguments.out, arguments.half, arguments.size, arguments.match, arguments.levels)
        return
    from .tables import kept, markdown, summary

    if arguments.command == "collect":
        result = json.loads(arguments.into.read_text())
        done = [kept(record) for record in records(arguments.out)]
        ran = {record["truth"]["case"] for record in done}
        asked = [case for case in sample(arguments.half) if case.level or arguments.how == PAIRS]
        result[PARTS[arguments.how]] = {
            "half": arguments.half,
            "records": done,
            "seen": sorted(arguments.seen),
            "before": [kept(record) for record in records(arguments.before)] if arguments.before else [],
            "not run": [case.name for case in asked if case.name not in ran],
        }
        with atomic_write(arguments.into) as file:
            file.write((json.dumps(result, indent=1) + "\n").encode())
        return
    if arguments.command == "table":
        print(markdown(records(arguments.out)))
        return
    found = run(
        arguments.cases, arguments.out, arguments.match, arguments.how, arguments.limit, arguments.sample
    )
    if arguments.json:
        print(json.dumps(summary(found)))


if __name__ == "__main__":
    main()
