"""`jaxisp data`: public data sets."""

from argparse import Namespace
from typing import Any

from jaxisp.cli.common import add_command, print_json, progress, say, warn


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
        say(f"{s['name']}: {s['title']}")
        say(f"    for {s['use']}; {s['size']}; licence: {s['licence']}; {_state(s)}")
        say(f"    {s['page']}" + ("; no checksum is published" if s["unpinned"] else ""))
    say(f"folder: {data_folder()} (JAXISP_DATA changes that)")
    return 0


def _state(row: dict[str, Any]) -> str:
    return "here" if row["fetched"] else "not fetched" if row["files"] else "to be fetched by hand"


def run_fetch(arguments: Namespace) -> int:
    from jaxisp.data.catalogue import SUMS, fetch, find_set, is_fetched

    wanted = find_set(arguments.name)
    warn(f"{wanted.title}; licence: {wanted.licence} ({wanted.page})")
    if wanted.unpinned and not is_fetched(wanted.name):
        names = ", ".join(wanted.unpinned)
        warn(f"no checksum is published of {names}: the first that comes is trusted, and noted in {SUMS}")
    with progress(f"fetching {wanted.name}") as tick:
        folder = fetch(wanted, tick=tick)
    if arguments.json:
        print_json({**wanted.as_dict(), "folder": str(folder)})
    else:
        say(folder)
    return 0
