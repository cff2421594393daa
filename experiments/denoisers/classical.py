"""Classical denoisers on the real sets, and the network that comes with the package beside them.

Each is measured with the strength that `jaxisp evaluate` gives it; with --more also with the one that turns
out best on the set itself. That one is chosen by the reported figures: it only says what a better choice
would gain. The network is blind.

python -m experiments.denoisers.classical DATA
"""

import argparse
from collections.abc import Sequence
from importlib import resources
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.machine import machine
from experiments.denoisers.pairs import aligned
from experiments.denoisers.report import save, tables
from jaxisp.cli.devices import use_cores
from jaxisp.models.apply import SHIPPED, shipped_denoiser
from jaxisp.train import AlignedPair, Classical, evaluate_pairs
from jaxisp.train.classical import METHODS

SETS = {"iphone8": None, "polyu": 248, "sidd": 248}
"""Real sets, and the side of the middle part that is used [px]."""
KEY = "classical"
NOISY = "noisy input"
NETWORK = "the package's network"
FACTORS = (1.0, 1.4, 2.0, 2.8, 4.0)
"""Of the chosen strength, among which the best in hindsight is."""


def rows(data: Path, name: str, more: bool) -> list[dict[str, Any]]:
    """Figures of each denoiser on a set."""
    pairs = aligned(data / name, SETS[name])
    made = [_row(NOISY, name, None, evaluate_pairs(lambda noisy: noisy, pairs))]
    if more:
        whole = aligned(data / name, SETS[name], "whole")
        title = f"{NOISY}, aligned as a whole"
        made.insert(0, _row(title, name, None, evaluate_pairs(lambda noisy: noisy, whole)))
    if (resources.files("jaxisp.models") / SHIPPED).is_file():
        made.append(_row(NETWORK, name, None, evaluate_pairs(shipped_denoiser()[0], pairs)))
    for method in METHODS:
        if Classical(method).missing():
            continue
        tried = {factor: _measured(method, factor, pairs) for factor in (FACTORS if more else (1.0,))}
        made.append(_row(method, name, 1.0, tried[1.0]))
        if more:
            best = max(tried, key=lambda factor: tried[factor]["mean"]["psnr_fixed"])
            made.append(_row(f"{method}, best in hindsight", name, best, tried[best]))
    return made


def _measured(method: str, factor: float, pairs: Sequence[AlignedPair]) -> dict[str, Any]:
    strengths: list[float] = []

    def denoise(image: np.ndarray) -> np.ndarray:
        strengths.append(factor * Classical(method).strength(image))
        return Classical(method, strengths[-1])(image)

    result = evaluate_pairs(denoise, pairs)
    for row, strength in zip(result["pairs"], strengths):
        row["strength"] = strength
    return result


def _row(denoiser: str, name: str, factor: float | None, result: dict[str, Any]) -> dict[str, Any]:
    kept = {key: result[key] for key in ("mean", "pairs")}
    return {"denoiser": denoiser, "set": name, "factor": factor, **kept}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("data", type=Path)
    parser.add_argument("--sets", nargs="+", choices=SETS, default=list(SETS), help="the others stay")
    parser.add_argument("--out", type=Path, default=Path("docs/results"))
    parser.add_argument("--more", action="store_true", help="best strengths in hindsight, aligned as a whole")
    options = parser.parse_args()
    use_cores()
    kept = tables(options.out).get(KEY, {}).get("rows", [])
    made = {name: rows(options.data, name, options.more) for name in options.sets}
    made = {name: made.get(name) or [row for row in kept if row["set"] == name] for name in SETS}
    table = {
        "title": "Classical denoisers, corrected: channels aligned, strengths chosen on other pictures",
        "command": "python -m experiments.denoisers.classical DATA` and then `--sets iphone8 --more",
        "machine": machine(),
        "left_out": [name for name in METHODS if Classical(name).missing()],
        "rows": [row for part in made.values() for row in part],
    }
    save(options.out, KEY, table)


if __name__ == "__main__":
    main()
