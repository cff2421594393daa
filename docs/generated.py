"""Directives that write pages from the package itself: stages, recipes, effects, commands, API, notebooks.

Nothing of it is committed, so that nothing of it can be out of date.
"""

import argparse
import contextlib
import importlib
import inspect
import json
import re
import statistics
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import jupytext
from docutils import nodes
from sphinx.application import Sphinx
from sphinx.util import logging
from sphinx.util.docutils import SphinxDirective

ROOT = Path(__file__).parent.parent
EXECUTED = ROOT / "build" / "notebooks"
PICTURES = "_images/stages"
"""Where in the site the pictures of the stages are."""
FAMILIES = {
    "Light and lens": ("optics",),
    "Blur": ("blur",),
    "Sensor": ("sensor",),
    "Noise": ("noise", "balanced_noise"),
    "Defects": ("defects",),
    "Demosaicking": ("demosaic",),
    "Colour": ("balance",),
    "Automatic exposure and balance": ("auto",),
    "Tone": ("power", "tone"),
    "Look": ("look",),
    "Denoising": ("denoise",),
    "Smoothing and sharpening": ("smoothing", "detail"),
    "Resampling": ("resampling",),
    "Files": ("rounding", "jpeg"),
    "Choices between algorithms": ("choice",),
    "Colour spaces": ("spaces",),
    "Transfer functions": ("transfer",),
}
"""Titles of the stages' modules; those of others are their names."""
LIBRARIES = (
    "OpenCV", "kornia", "SciPy", "colour-demosaicing", "LibRaw", "rawpy", "scikit-image", "PyWavelets",
    "Pillow", "NumPy",
)  # fmt: skip
"""Peers of the benchmarks are named by one of these and the way it is called."""


def table(headers: list[str], rows: list[list[Any]]) -> str:
    """A Markdown table; bars in cells are escaped."""
    lines = [headers, ["---"] * len(headers), *rows]
    cells = [[" ".join(str(c).split()).replace("|", "\\|") for c in line] for line in lines]
    return "\n".join(f"| {' | '.join(line)} |" for line in cells) + "\n"


def stages(pictures: Path | None = None) -> Iterator[str]:
    """Every stage, family by family; with a picture where there is a folder for them."""
    from jaxisp.catalogue import describe_stages
    from jaxisp.stages import STAGES

    known = {row["name"]: row for row in describe_stages()}
    titles = {part: title for title, parts in FAMILIES.items() for part in parts}
    families: dict[str, list[str]] = {title: [] for title in FAMILIES}
    for name in known:
        part = STAGES[name].__module__.removeprefix("jaxisp.stages.").split(".")[0]
        families.setdefault(titles.get(part, part), []).append(name)
    yield f"{len(known)} stages.\n"
    yield table(
        ["stage", "takes", "gives", "parameters", "gradient"],
        [
            [f"[`{n}`](#{_label(n)})", row["takes"], row["gives"],
             ", ".join(p["name"] for p in row["params"]), re.split(r"[ ,.:;]", row["gradient"])[0]]
            for names in families.values() for n in names for row in [known[n]]
        ],
    )  # fmt: skip
    for title, names in families.items():
        yield f"## {title}\n"
        for name in names:
            yield from _stage(known[name], STAGES[name])
            if pictures is not None:
                yield _picture(name, pictures)


def _picture(name: str, folder: Path) -> str:
    from stage_pictures import compiled_quickly, write

    try:
        with compiled_quickly():
            caption = write(name, folder / f"{name}.png")
    except ValueError as error:  # the others are told too
        logging.getLogger(__name__).warning(str(error))
        return ""
    text = f"Before and after{': ' * bool(caption)}{caption}"
    return (
        f'```{{raw}} html\n<figure class="stage"><img alt="{name}, before and after" loading="lazy" '
        f'src="../{PICTURES}/{name}.png"><figcaption>{text}</figcaption></figure>\n```\n'
    )


def _stage(row: dict[str, Any], fn: Any) -> Iterator[str]:
    yield f"({_label(row['name'])})=\n### {row['name']}\n"
    yield re.split(r"^(?:Args|Returns):", inspect.getdoc(fn) or "", flags=re.MULTILINE)[0]
    if row["params"]:
        yield table(
            ["parameter", "default", "bounds", "unit", "scale", ""],
            [
                [f"`{p['name']}`", _short(p["default"]), _range(p["bounds"]), p["unit"], p["scale"], p["doc"]]
                for p in row["params"]
            ],
        )
    options = ", ".join(f"`{o['name']}={o['default']!r}`" for o in row["static"]) or "none"
    yield f"- **takes** {row['takes']}, **gives** {row['gives']}{'; draws noise' * row['stochastic']}"
    yield f"- **static options** {options}"
    yield f"- **gradient** {row['gradient']}"
    yield f"- **source** {row['source']}\n"


def _label(stage: str) -> str:
    return f"stage-{stage.replace('_', '-')}"


def _range(bounds: list[float]) -> str:
    return f"{bounds[0]:g} to {bounds[1]:g}"


def _short(value: Any) -> str:
    flat = json.dumps(value) if not isinstance(value, float) else f"{value:.4g}"
    flat = re.sub(r"\d+\.\d{5,}", lambda m: f"{float(m[0]):.4g}", flat)
    return flat if len(flat) <= 60 else f"{flat[:40]}..."


def recipes() -> Iterator[str]:
    from jaxisp.catalogue import describe_recipes

    for row in describe_recipes():
        yield f"## {row['name']}\n\n{row['description'][:1].upper()}{row['description'][1:]}.\n"
        yield "`" + "` → `".join(row["stages"]) + "`\n"
        yield table(["drawn", "from"], [[f"`{name}`", law] for name, law in row["draws"].items()])


def effects() -> Iterator[str]:
    from jaxisp.gap import EFFECTS

    yield f"{len(EFFECTS)} effects.\n"
    for name, effect in EFFECTS.items():
        row, fields = effect.as_dict(), dict.fromkeys(move.field for move in effect.moves)
        ranges = {m.field: (m.low, m.high, m.off) for m in effect.moves}
        yield f"## {name}\n"
        moves = ", ".join(
            f"`{f}` by {ranges[f][0]:g} to {ranges[f][1]:g} from {ranges[f][2]:g}" for f in fields
        )
        yield f"- **stage** [`{row['stage']}`](#{_label(row['stage'])}), at {row['site']}"
        yield f"- **moves** {moves}"
        yield f"- **shows in** {', '.join(row['shows_in'])}; by {', '.join(row['axes'])}"
        yield f"- **easily confused with** {', '.join(f'`{a}`' for a in row['alternatives']) or 'nothing'}\n"


def peers() -> Iterator[str]:
    """What the benchmarks found, a row for each library that is compared."""
    results = json.loads((ROOT / "benchmarks" / "results" / "peers.json").read_text())
    found: dict[str, list[tuple[float, str]]] = {}
    for family in results["families"].values():
        for row in family["rows"]:
            for peer in row["peers"]:
                if "ratio" in peer:
                    library = next(
                        (name for name in LIBRARIES if peer["name"].startswith(name)), peer["name"]
                    )
                    found.setdefault(library, []).append((peer["ratio"], f"{row['stage']}, {row['size']}"))
    yield table(
        ["library", "comparisons", "won", "least", "median", "most", "least at", "most at"],
        [
            [library, len(ratios), sum(r > 1 for r, _ in ratios), f"{min(ratios)[0]:.2g}",
             f"{statistics.median(r for r, _ in ratios):.2g}", f"{max(ratios)[0]:.2g}",
             min(ratios)[1], max(ratios)[1]]
            for library, ratios in sorted(found.items(), key=lambda item: -len(item[1]))
        ],
    )  # fmt: skip


def commands() -> Iterator[str]:
    from jaxisp.cli import parser

    top = parser()
    (group,) = (a for a in top._actions if isinstance(a, argparse._SubParsersAction))
    for name, command in group.choices.items():
        command.formatter_class = lambda prog: argparse.HelpFormatter(prog, width=100)
        yield f"## jaxisp {name}\n\n```text\n{command.format_help().strip()}\n```\n"


def api(module: str) -> Iterator[str]:
    """Every public name of a module, as autodoc directives."""
    found = importlib.import_module(module)
    for name in public_names(found):
        value = getattr(found, name)
        if inspect.ismodule(value):
            continue
        kind = "class" if inspect.isclass(value) else "function" if inspect.isroutine(value) else "data"
        home = _home(found, name) if kind == "data" else module
        options = {"class": "   :members:\n", "function": "", "data": "   :no-value:\n"}[kind]
        yield f"```{{eval-rst}}\n.. auto{kind}:: {home}.{name}\n{options}```\n"


def public_names(module: Any) -> list[str]:
    """`__all__`, or the functions and classes that a module defines without an underscore."""
    if hasattr(module, "__all__"):
        return list(module.__all__)
    return [
        name
        for name, value in vars(module).items()
        if not name.startswith("_")
        and (inspect.isclass(value) or inspect.isroutine(value))
        and value.__module__ == module.__name__
    ]


def _home(module: Any, name: str) -> str:
    """The module that a constant is written in: it alone has the constant's description."""
    for line in inspect.getsource(module).splitlines():
        if match := re.match(r"from ([\w.]+) import .*\b" + name + r"\b", line):
            return match[1]
        if match := re.match(rf'\s*"{name}": "([\w.]+)"', line):
            return match[1]
    return str(module.__name__)


def notebook(name: str) -> Iterator[str]:
    """A notebook as text, with its pictures where `make notebooks` has run it."""
    source = jupytext.read(ROOT / "notebooks" / f"{name}.py")
    executed = EXECUTED / f"{name}.ipynb"
    cells = source.cells
    if executed.exists():
        ran = jupytext.read(executed).cells
        if [c.source for c in ran] == [c.source for c in cells]:
            cells = ran
    for cell in cells:
        if cell.cell_type == "markdown":
            yield re.sub(
                r"\((0\d)_([a-z_]+)\.py\)", lambda m: f"({m[1]}-{m[2].replace('_', '-')}.md)", cell.source
            )
            continue
        yield f"```python\n{cell.source}\n```\n"
        for output in cell.get("outputs", []):
            yield from _output(output)
    yield f"\n*The notebook is `notebooks/{name}.py`: jupytext opens it in Jupyter.*\n"


def _output(output: Any) -> Iterator[str]:
    data = output.get("data", {})
    if output.output_type == "stream":
        yield f"```text\n{output.text.rstrip()}\n```\n"
    elif "application/vnd.jupyter.widget-view+json" in data:
        yield "*(sliders, in a notebook)*\n"
    elif "text/html" in data:
        yield f"```{{raw}} html\n{data['text/html']}\n```\n"
    elif "image/png" in data:
        uri = f"data:image/png;base64,{data['image/png'].strip()}"
        yield f'```{{raw}} html\n<img alt="plot" src="{uri}">\n```\n'
    elif "text/plain" in data:
        yield f"```text\n{data['text/plain']}\n```\n"


class Generated(SphinxDirective):
    """`{generated} KIND [ARGUMENT]`: one of the functions above, parsed as the page's own text."""

    required_arguments = 1
    optional_arguments = 1
    has_content = False

    def run(self) -> list[nodes.Node]:
        kind, *arguments = self.arguments
        makers = {f.__name__: f for f in (stages, recipes, effects, peers, commands, api, notebook)}
        if kind == "notebook":
            self.env.note_dependency(str(ROOT / "notebooks" / f"{arguments[0]}.py"))
        with contextlib.chdir(ROOT):
            if kind == "stages" and self.env.app.builder.format == "html" and self.config.stage_pictures:
                text = "\n".join(stages(Path(self.env.app.outdir) / PICTURES))
            else:
                text = "\n".join(makers[kind](*arguments))
        return self.parse_text_to_nodes(text, allow_section_headings=True)


def as_rest(app: Sphinx, what: str, name: str, value: Any, options: Any, lines: list[str]) -> None:
    """Docstrings mark names `so`, also in plurals, which reStructuredText would not take."""
    text = "\n".join(lines)
    if what == "data" and text.strip() == (inspect.getdoc(type(value)) or "").strip():
        text = ""  # that of dict is of no use
    text = re.sub(r"(?<!`)`([^`]+)`(?!`)", r"``\1``\\ ", text)
    lines[:] = re.sub(r"\\ (?=[\s.,;:)\]])|\\ $", "", text, flags=re.MULTILINE).split("\n")


def setup(app: Sphinx) -> dict[str, Any]:
    app.add_directive("generated", Generated)
    app.add_config_value("stage_pictures", True, "env", bool)
    app.connect("autodoc-process-docstring", as_rest, priority=100)  # before napoleon
    return {"parallel_read_safe": True, "version": "1"}
