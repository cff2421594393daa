"""`jaxisp data`: public data sets."""

import sys
from argparse import Namespace
from typing import Any

from jaxisp.cli.common import add_command, print_json, progress


def add_commands(commands: Any) -> None:
    text = "list and fetch public data sets"
    inner = commands.add_parser("data", help=text, description=text).add_subparsers(
        metavar="list|fetch", required=True
    )
    add_command(inner, "list", run_list, "list the sets with licence, size and source")
    command = add_command(inner, "fetch", run_fetch, "download a set (JAXISP_DATA changes the folder)")
    command.add_argument("name", metavar="NAME", help="a name from jaxisp data list")


def run_list(arguments: Namespace) -> int:
    from jaxisp.data.catalogue import SETS, data_folder

    sets = [s.as_dict() for s in SETS.values()]
    if arguments.json:
        print_json(sets)
        return 0
    for s in sets:
        print(f"{s['name']}: {s['title']}")
        print(f"    for {s['use']}; {s['size']}; licence: {s['licence']}; {_state(s)}")
        print(f"    {s['page']}")
    print(f"folder: {data_folder()} (JAXISP_DATA changes that)")
    return 0


def _state(row: dict[str, Any]) -> str:
    return "here" if row["fetched"] else "not fetched" if row["files"] else "to be fetched by hand"


def run_fetch(arguments: Namespace) -> int:
    from jaxisp.data.catalogue import fetch, find_set

    wanted = find_set(arguments.name)
    print(f"jaxisp: {wanted.title}; licence: {wanted.licence} ({wanted.page})", file=sys.stderr)
    with progress(f"fetching {wanted.name}") as tick:
        folder = fetch(wanted, tick=tick)
    if arguments.json:
        print_json({**wanted.as_dict(), "folder": str(folder)})
    else:
        print(folder)
    return 0
