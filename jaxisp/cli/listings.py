"""`jaxisp stages`, `jaxisp effects` and `jaxisp recipes`: listings."""

from argparse import Namespace
from typing import Any

from jaxisp.cli.common import add_command, print_json, print_table, say
from jaxisp.errors import InputError, meant


def add_commands(commands: Any) -> None:
    stages = add_command(
        commands, "stages", run_stages, "list the stages with their parameters, bounds and units"
    )
    stages.add_argument(
        "names", nargs="*", metavar="STAGE", help="show options, gradient and source of these stages"
    )
    add_command(commands, "effects", run_effects, "list the effects that a diagnosis tries")
    add_command(commands, "recipes", run_recipes, "list the built-in recipes and what they draw")


def run_stages(arguments: Namespace) -> int:
    from jaxisp.catalogue import describe_stages

    stages = describe_stages()
    if arguments.names:
        stages = [_named(stages, name) for name in arguments.names]
    if arguments.json:
        print_json(stages)
        return 0
    if arguments.names:
        for found in stages:
            _print_stage(found)
        return 0
    rows = [
        (s["name"] if i == 0 else "", p["name"], p["default"], p["bounds"], p["unit"], p["scale"])
        for s in stages
        for i, p in enumerate(
            s["params"] or [dict.fromkeys(("name", "default", "bounds", "unit", "scale"), "")]
        )
    ]
    print_table(("stage", "parameter", "default", "bounds", "unit", "scale"), rows)
    say(f"{len(stages)} stages, {sum(len(s['params']) for s in stages)} parameters")
    return 0


def _named(stages: list[dict[str, Any]], name: str) -> dict[str, Any]:
    for found in stages:
        if found["name"] == name:
            return found
    raise InputError(f"no stage named {name!r}{meant(name, (found['name'] for found in stages))}")


def _print_stage(found: dict[str, Any]) -> None:
    say(f"{found['name']}: {found['summary']}")
    say(f"  {found['takes']} -> {found['gives']}{', random' if found['stochastic'] else ''}")
    for title in ("gradient", "source"):
        say(f"  {title}: {' '.join(found[title].split())}")
    for option in found["static"]:
        say(f"  option {option['name']}, default {option['default']!r}")
    rows = [
        (f"  {p['name']}", p["default"], p["bounds"], p["unit"], p["scale"], p["doc"])
        for p in found["params"]
    ]
    if rows:
        print_table(("  parameter", "default", "bounds", "unit", "scale", ""), rows)
    say()


def run_effects(arguments: Namespace) -> int:
    from jaxisp.gap import EFFECTS

    effects = [effect.as_dict() for effect in EFFECTS.values()]
    if arguments.json:
        print_json(effects)
        return 0
    rows = [
        (e["name"], e["site"], " ".join(e["shows_in"]), " ".join(e["axes"]), " ".join(e["alternatives"]))
        for e in effects
    ]
    print_table(("effect", "site", "shows in", "axes", "easily confused with"), rows)
    return 0


def run_recipes(arguments: Namespace) -> int:
    from jaxisp.catalogue import describe_recipes

    recipes = describe_recipes()
    if arguments.json:
        print_json(recipes)
        return 0
    for recipe in recipes:
        say(f"{recipe['name']}: {recipe['description']}")
        drawn = [(f"  {name}", what) for name, what in recipe["draws"].items()]
        if drawn:
            print_table(("  parameter", "drawn from"), drawn)
        say()
    return 0
