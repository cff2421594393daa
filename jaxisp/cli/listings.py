"""`jaxisp stages`, `jaxisp effects` and `jaxisp recipes`: what there is."""

from argparse import Namespace
from typing import Any

from jaxisp.cli.common import add_command, print_json, print_table


def add_commands(commands: Any) -> None:
    add_command(commands, "stages", run_stages, "list the stages with their parameters, bounds and units")
    add_command(commands, "effects", run_effects, "list the effects that a diagnosis tries")
    add_command(commands, "recipes", run_recipes, "list the built-in recipes and what they draw")


def run_stages(arguments: Namespace) -> int:
    from jaxisp.catalogue import describe_stages

    stages = describe_stages()
    if arguments.json:
        print_json(stages)
        return 0
    rows = [
        (s["name"] if i == 0 else "", p["name"], p["default"], p["bounds"], p["unit"], p["scale"])
        for s in stages
        for i, p in enumerate(
            s["params"] or [dict.fromkeys(("name", "default", "bounds", "unit", "scale"), "")]
        )
    ]
    print_table(("stage", "parameter", "default", "bounds", "unit", "scale"), rows)
    print(f"{len(stages)} stages, {sum(len(s['params']) for s in stages)} parameters")
    return 0


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
    print_table(("effect", "site", "shows in", "axes", "easily taken for"), rows)
    return 0


def run_recipes(arguments: Namespace) -> int:
    from jaxisp.catalogue import describe_recipes

    recipes = describe_recipes()
    if arguments.json:
        print_json(recipes)
        return 0
    for recipe in recipes:
        print(f"{recipe['name']}: {recipe['description']}")
        drawn = [(f"  {name}", what) for name, what in recipe["draws"].items()]
        if drawn:
            print_table(("  parameter", "drawn from"), drawn)
        print()
    return 0
