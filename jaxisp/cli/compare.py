"""`jaxisp compare`: two reports of one kind side by side."""

from argparse import Namespace
from pathlib import Path
from typing import Any

from jaxisp.cli.common import add_command, print_json, print_table, say


def add_commands(commands: Any) -> None:
    command = add_command(commands, "compare", run, "compare two reports of fit, diagnose or evaluate")
    for name in ("first", "second"):
        command.add_argument(
            name, metavar=name.upper(),
            help="a folder that fit --report or diagnose wrote, or a file with what --json printed",
        )  # fmt: skip
    command.add_argument("-o", "--out", metavar="PAGE.html", help="write a page (default: print a table)")


def run(arguments: Namespace) -> int:
    from jaxisp.io import output_file
    from jaxisp.report.compare import cells, compare, comparison_page

    result = compare(arguments.first, arguments.second)
    if arguments.out:
        given = [Path(arguments.first), Path(arguments.second)]
        reports = [folder / name for folder in given for name in ("report.json", "report.html")]
        path = output_file(arguments.out, [*given, *reports])
        comparison_page(result).write(path)
    if arguments.json:
        print_json({**result, "page": arguments.out})
    elif arguments.out:
        say(f"{arguments.out}: open it in a browser")
    else:
        print_table(("", "", "A", "B", "change"), [(row["group"], *cells(row)) for row in result["values"]])
    return 0
