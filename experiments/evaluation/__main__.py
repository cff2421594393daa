"""`python -m experiments.evaluation`: the page's tables, or the file that they are made from."""

import argparse
from collections import defaultdict
from pathlib import Path

from .kept import BESIDE, GROUPS, collect
from .page import PAGE, rendered, tables


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    commands = parser.add_subparsers(dest="command")
    collecting = commands.add_parser("collect", help="make docs/results/diagnosis.json")
    collecting.add_argument(
        "results", nargs="+", metavar="GROUP=FILE", help=f"a group of {', '.join((*GROUPS, *BESIDE))}"
    )
    collecting.add_argument("--axes", type=Path, nargs="*", default=[], help="results of `study --untried`")
    collecting.add_argument("-o", "--out", type=Path, required=True)
    arguments = parser.parse_args()
    if arguments.command is None:
        PAGE.write_text(rendered(PAGE.read_text(), tables()))
        return
    files: dict[str, list[Path]] = defaultdict(list)
    for word in arguments.results:
        group, _, path = word.partition("=")
        if group not in (*GROUPS, *BESIDE):
            parser.error(f"{word}: must be GROUP=FILE, with a group of {', '.join((*GROUPS, *BESIDE))}")
        files[group].append(Path(path))
    collect(files, arguments.axes, arguments.out)


if __name__ == "__main__":
    main()
