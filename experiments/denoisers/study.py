"""Train, measure, write: what all tables share."""

import argparse
import dataclasses
import json
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.machine import machine
from experiments.denoisers import report
from experiments.denoisers.ceilings import in_camera_sharpness, in_camera_tone
from experiments.denoisers.pairs import evaluation_set
from experiments.denoisers.training import SCALES, Place, configuration, trained
from jaxisp.cli.devices import use_cores
from jaxisp.models import MODELS
from jaxisp.train import AlignedPair, Classical, Denoiser, evaluate_pairs
from jaxisp.train.classical import METHODS

Denoise = Callable[[np.ndarray], np.ndarray]
CEILINGS: dict[str, Callable[[AlignedPair], np.ndarray]] = {
    "clean in the camera's tone (no denoiser)": in_camera_tone,
    "and as sharp as the camera's (no denoiser)": in_camera_sharpness,
}
CHANGES = ("model", "steps", "light")
"""What a command may have in place of its scale's."""
_SEEN = {"encoded": "networks in encoded sRGB", "linear": "networks in linear light"}


@dataclasses.dataclass(frozen=True)
class Table:
    """A table of the paper.

    Args:
        name: key in the results, name of the module.
        title: heading.
        recipes: that networks are trained on, all else being equal.
        sets: that they are measured on.
        baselines: whether the classical denoisers stand beside them.
        more: further rows of one trained network, `more(place, name, denoiser)`.
    """

    name: str
    title: str
    recipes: tuple[str, ...]
    sets: tuple[str, ...]
    baselines: bool = False
    more: Callable[[Place, str, Denoiser], list[dict[str, Any]]] | None = None


def main(table: Table, arguments: Sequence[str] | None = None) -> None:
    """The command of a table."""
    options = _parser(table).parse_args(arguments)
    use_cores()
    place = Place(options.data, options.work, tuple(options.clean))
    changes = {name: getattr(options, name) for name in CHANGES if getattr(options, name)}
    recipes = [name for name in table.recipes if name in options.recipes]
    rows = measure(table, place, options.scale, recipes, options.seeds, changes)
    settings = dataclasses.asdict(configuration(place, options.scale, "RECIPE", 0, **changes))
    for name in ("clean", "recipe", "seed"):
        del settings[name]
    result = {
        "title": f"{table.title}: {settings['model']}, {settings['steps']} steps, {_SEEN[settings['light']]}",
        "command": f"python -m experiments.denoisers.{table.name} DATA --work RUNS --scale {options.scale}"
        + "".join(f" --{name} {value}" for name, value in changes.items()),
        "scale": options.scale,
        "settings": settings,
        "machine": machine(),
        "rows": rows,
    }
    key = f"{table.name} {options.scale} {settings['steps']} {settings['light']} {settings['model']}"
    print(report.table_text(save(options.out, key, result)))


def _parser(table: Table) -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(description=table.title)
    parser.add_argument("data", type=Path)
    parser.add_argument("--work", type=Path, required=True, help="runs and aligned pairs are kept here")
    parser.add_argument("--clean", nargs="*", default=[], help="train on these, not on DATA/clean")
    parser.add_argument("--scale", choices=SCALES, default="cpu")
    parser.add_argument("--model", choices=MODELS, help="in place of the scale's")
    parser.add_argument("--steps", type=int, help="in place of the scale's")
    parser.add_argument("--light", choices=("encoded", "linear"), help="in place of the scale's")
    parser.add_argument("--seeds", type=int, nargs="+", default=[0])
    parser.add_argument("--recipes", nargs="+", default=table.recipes, help="only these of the table's")
    parser.add_argument("--out", type=Path, default=Path("docs/results"))
    return parser


def measure(
    table: Table,
    place: Place,
    scale: str,
    recipes: Sequence[str],
    seeds: Sequence[int],
    changes: Mapping[str, Any],
) -> list[dict[str, Any]]:
    """A row for each denoiser, seed and set."""
    sets = {name: evaluation_set(place, name) for name in table.sets}
    rows = baselines(place, table.sets) if table.baselines else []
    for seed in seeds:
        for recipe in recipes:
            name, denoiser = trained(place, scale, recipe, seed, **changes)
            who = {"denoiser": recipe, "seed": seed}
            rows += [{**who, **row} for row in _kept(place, name, denoiser, sets)]
            if table.more:
                rows += [{**who, **row} for row in table.more(place, name, denoiser)]
    return rows


def _kept(
    place: Place, name: str, denoise: Denoise, sets: Mapping[str, list[AlignedPair]]
) -> list[dict[str, Any]]:
    """Figures of a denoiser on each set; those computed before are read."""
    file = place.work / "figures" / f"{name}.json"
    known = json.loads(file.read_text()) if file.exists() else {}
    for which, pairs in sets.items():
        if which not in known:
            known[which] = figures(denoise, pairs)
            file.parent.mkdir(parents=True, exist_ok=True)
            file.write_text(json.dumps(known))
    return [{"set": which, **known[which]} for which in sets]


def figures(denoise: Denoise, pairs: Sequence[AlignedPair]) -> dict[str, Any]:
    """Means and each pair's figures, and how far the output is from the input (encoded, PSNR)."""
    change: list[float] = []

    def noted(image: np.ndarray) -> np.ndarray:
        output = denoise(image)
        change.append(-10 * float(np.log10(max(((output - image) ** 2).mean(), 1e-12))))
        return output

    result = evaluate_pairs(noted, pairs)
    for row, value in zip(result["pairs"], change):
        row["change"] = value
    return {"mean": {**result["mean"], "change": float(np.mean(change))}, "pairs": result["pairs"]}


def baselines(place: Place, names: Sequence[str]) -> list[dict[str, Any]]:
    """The noisy input and the classical denoisers; the seed is None, as nothing is drawn."""
    sets = {name: evaluation_set(place, name) for name in names}
    methods: dict[str, Denoise] = {name: Classical(name) for name in METHODS if not Classical(name).missing()}
    rows = []
    for title, denoise in {"noisy input": lambda image: image, **methods}.items():
        kept = _kept(place, title, denoise, sets)
        rows += [{"denoiser": title, "seed": None, **row} for row in kept]
    return rows + [
        {"denoiser": title, "seed": None, "set": name, **ceiling(picture, sets[name])}
        for title, picture in CEILINGS.items()
        for name in names
    ]


def ceiling(picture: Callable[[AlignedPair], np.ndarray], pairs: Sequence[AlignedPair]) -> dict[str, Any]:
    """What is left where all noise is gone: alignment apart, what no denoiser undoes."""
    pictures = iter([picture(pair) for pair in pairs])
    return figures(lambda image: next(pictures), pairs)


def save(folder: Path, name: str, result: Mapping[str, Any]) -> dict[str, Any]:
    """Put a table into denoisers.json, and write denoisers.md from all that are there.

    Rows of other denoisers and seeds that are there stay, where they were made with the same settings.
    """
    before = report.tables(folder).get(name, {})
    rows = list(result["rows"])
    if before.get("settings") == result["settings"]:
        made = {_identity(row) for row in rows}
        rows = [row for row in before["rows"] if _identity(row) not in made] + rows
    rows = sorted(rows, key=lambda row: (row["seed"] is not None, row["seed"] or 0))
    return report.save(folder, name, {**result, "rows": rows})


def _identity(row: Mapping[str, Any]) -> tuple[Any, ...]:
    return row["denoiser"], row["seed"], row["set"]
