"""Write what came of the fits as JSON and Markdown.

    python -m experiments.fit_phones DATA [--only iphone7,recovery:a,libraw] [--out docs/results]

DATA is a folder with iphone7/ (a RAW+JPEG pair) and raw/*.dng; without it those parts are left out. A part is
run as a whole, or case by case (`recovery:a`). What is not run keeps what the JSON file holds of it. Nothing
but figures is written.
"""

import argparse
import json
import time
from collections.abc import Iterator
from importlib.metadata import version
from pathlib import Path
from typing import Any

from experiments.fit_phones import intensity, iphone7, large, lens, libraw, phones, recovery, scenes
from experiments.fit_phones.common import SEED, Run
from jaxisp.io import output_folder

PARTS = {
    "iphone7": iphone7,
    "recovery": recovery,
    "phones": phones,
    "libraw": libraw,
    "lens": lens,
    "intensity": intensity,
    "large": large,
    "scenes": scenes,
}
"""By name: modules with `runs(data)`, what makes the figures of each case, and `page(cases)`, its section."""


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("data", type=Path, nargs="?")
    parser.add_argument("--only", default="", help="parts, or part:case, by commas; all unless given")
    parser.add_argument("--out", type=Path, default=Path("docs/results"))
    arguments = parser.parse_args()
    path = output_folder(arguments.out) / "fit-phones.json"
    results = json.loads(path.read_text()) if path.exists() else {}
    for part, case, run in chosen({p: m.runs(arguments.data) for p, m in PARTS.items()}, arguments.only):
        results.setdefault(part, {})[case] = run()
        results["versions"] = {name: version(name) for name in ("jax", "numpy", "rawpy")}
        path.write_text(json.dumps(results, indent=1) + "\n")
    path.with_suffix(".md").write_text(markdown(results))
    print(markdown(results))


def chosen(known: dict[str, dict[str, Run]], only: str) -> Iterator[tuple[str, str, Run]]:
    for wanted in only.split(",") if only else known:
        part, _, case = wanted.partition(":")
        for name, run in known[part].items():
            if case in ("", name):
                yield part, name, run


def markdown(results: dict[str, Any]) -> str:
    lines = [
        "# Fitted phones",
        "",
        f"Made by `python -m experiments.fit_phones DATA`, seed {SEED}. A checkerboard of 64x64 tiles is "
        "held out: half are fitted, half reported. No pixel of a reported tile is in any loss. The filters "
        "of a fitted tile look up to 16 px into its neighbours' RAW. The alignment starts from the whole "
        "picture.",
        "",
    ]
    for part, module in PARTS.items():
        if part in results:
            lines += [*module.page(results[part]), ""]
    return "\n".join(lines)


if __name__ == "__main__":
    started = time.perf_counter()
    main()
    print(f"{time.perf_counter() - started:.0f} s")
