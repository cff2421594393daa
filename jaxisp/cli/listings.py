"""`jaxisp stages`, `jaxisp effects` and `jaxisp recipes`: listings."""

import sys
from argparse import Namespace
from typing import Any

from jaxisp.cli.common import add_command, print_json, print_table, say, terminal_width
from jaxisp.errors import InputError, meant


def add_commands(commands: Any) -> None:
    stages = add_command(
        commands, "stages", run_stages, "list the stages with their parameters, bounds and units"
    )
    stages.add_argument(
        "names",
        nargs="*",
        metavar="STAGE",
        help="a stage to show whole, a group to list, or a word to look for in names and summaries",
    )
    add_command(commands, "effects", run_effects, "list the effects that a diagnosis tries")
    recipes = add_command(commands, "recipes", run_recipes, "list the built-in recipes and what they draw")
    recipes.add_argument("names", nargs="*", metavar="RECIPE", help="a recipe to show, or a word in its name")


def run_stages(arguments: Namespace) -> int:
    from jaxisp.catalogue import describe_stages

    stages = describe_stages()
    found = [_found(stages, name) for name in arguments.names] or [stages]
    wanted = list({s["name"]: s for own in found for s in own}.values())
    if arguments.json:
        print_json(wanted)
    elif all(name == own[0]["name"] for name, own in zip(arguments.names, found)) and arguments.names:
        for one in wanted:
            _print_stage(one)
    else:
        _print_groups(wanted)
    return 0


def _found(stages: list[dict[str, Any]], word: str) -> list[dict[str, Any]]:
    """The stage of a name, or the stages of a group; else those with the word in their name or summary."""
    from jaxisp.catalogue import GROUPS, group_of

    exact = [s for s in stages if s["name"] == word]
    group = [s for s in stages if group_of(s["name"]) == word.lower()]
    found = exact or group or [s for s in stages if word.lower() in f"{s['name']} {s['summary']}".lower()]
    if not found:
        hint = meant(word, [s["name"] for s in stages]) or f"; groups are {', '.join(GROUPS)}"
        raise InputError(f"no stage named {word!r}{hint}")
    return found


def _print_groups(stages: list[dict[str, Any]]) -> None:
    """A line for each stage, group by group in the order of a camera."""
    from jaxisp.catalogue import GROUPS, first_sentence, group_of

    width, most = max(len(s["name"]) for s in stages), terminal_width() or sys.maxsize
    for group, what in GROUPS.items():
        own = [s for s in stages if group_of(s["name"]) == group]
        if own:
            say(f"{group}: {what}")
        for s in own:
            line = f"  {s['name']:<{width}}  {' '.join(first_sentence(s['summary']).split())}"
            say(line if len(line) <= most else f"{line[: most - 3].rstrip()}...")
    parameters = sum(len(s["params"]) for s in stages)
    say(f"{len(stages)} stages, {parameters} parameters; jaxisp stages NAME shows one whole")


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

    known = {recipe["name"]: recipe for recipe in describe_recipes()}
    found = [_recipes_of(known, name) for name in arguments.names] or [list(known)]
    recipes = [known[name] for name in dict.fromkeys(name for own in found for name in own)]
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


def _recipes_of(known: dict[str, Any], word: str) -> list[str]:
    """The recipe of a name; else those with the word in their name."""
    found = [word] if word in known else [name for name in known if word.lower() in name]
    if not word or not found:
        hint = meant(word, known) or f"; there are {', '.join(known)}"
        raise InputError(f"no recipe named {word!r}{hint}")
    return found
