"""The documentation: it builds without a warning, and names everything that is public."""

import ast
import functools
import importlib
import inspect
import itertools
import json
import re
import subprocess
import sys
from importlib.util import find_spec
from pathlib import Path

import pytest

import jaxisp
from experiments.withheld.tables import collected
from experiments.withheld_targets import located, targets
from jaxisp.gap import EFFECTS
from jaxisp.recipes import RECIPES
from jaxisp.stages import STAGES

ROOT = Path(__file__).parent.parent
PUBLIC = [
    "jaxisp", "jaxisp.fit", "jaxisp.train", "jaxisp.data", "jaxisp.gap", "jaxisp.models", "jaxisp.io",
    "jaxisp.samples", "jaxisp.explore", "jaxisp.params", "jaxisp.priors", "jaxisp.metrics", "jaxisp.camera",
    "jaxisp.losses",
]  # fmt: skip
MISSING = [name for name in ("sphinx", "myst_parser", "furo", "jupytext") if find_spec(name) is None]
built = pytest.mark.skipif(bool(MISSING), reason=f"not installed: {', '.join(MISSING)}")


def public_names(module: str) -> list[str]:
    """What a module makes public: `__all__`, or what it defines without an underscore."""
    found = importlib.import_module(module)
    if hasattr(found, "__all__"):
        return list(found.__all__)
    return [
        name
        for name, value in vars(found).items()
        if not name.startswith("_")
        and (inspect.isclass(value) or inspect.isroutine(value))
        and value.__module__ == module
    ]


@functools.cache
def described_constants() -> set[str]:
    """Names of the package that are assigned at a module's top with a string below: their description."""
    found = set()
    for path in (ROOT / "jaxisp").rglob("*.py"):
        body = ast.parse(path.read_text()).body
        for node, below in itertools.pairwise(body):
            target = node.targets[0] if isinstance(node, ast.Assign) else getattr(node, "target", None)
            text = getattr(getattr(below, "value", None), "value", None)
            if isinstance(target, ast.Name) and isinstance(text, str):
                found.add(target.id)
    return found


@pytest.mark.parametrize("module", PUBLIC)
def test_public_names_are_described(module):
    found = importlib.import_module(module)
    assert found.__doc__, module
    for name in public_names(module):
        value = getattr(found, name)
        if inspect.isclass(value) or inspect.isroutine(value) or inspect.ismodule(value):
            doc = inspect.getdoc(value) or ""
            assert len(doc) > 15, f"{module}.{name} has no docstring"
            # a dataclass without one gets its signature instead
            assert not doc.startswith(f"{name}("), f"{module}.{name} has no docstring"
        else:
            assert name in described_constants(), f"{module}.{name} has no description below it"


def test_every_public_module_is_listed():
    """A package that declares `__all__` is in the reference."""
    packages = {
        f"jaxisp.{p.parent.name}"
        for p in (ROOT / "jaxisp").glob("*/__init__.py")
        if "__all__" in p.read_text()
    }
    assert packages - set(PUBLIC) == {"jaxisp.stages", "jaxisp.report"}  # a page of its own; for the commands
    assert {f"jaxisp.{name}" for name in jaxisp._MODULES} <= set(PUBLIC) | {"jaxisp.stages", "jaxisp.recipes"}


@pytest.fixture(scope="module")
def build(tmp_path_factory):
    """The site's folder and what Sphinx said."""
    out = tmp_path_factory.mktemp("site")
    command = [sys.executable, "-m", "sphinx", "-W", "--keep-going", "-q", "-b", "html"]
    done = subprocess.run(
        [*command, str(ROOT / "docs"), str(out)], capture_output=True, text=True, timeout=600
    )
    assert (out / "index.html").exists(), done.stderr[-4000:]
    return out, done


@pytest.fixture(scope="module")
def site(build):
    return build[0]


@built
def test_it_builds_without_a_warning(build):
    done = build[1]
    assert done.returncode == 0, done.stderr[-4000:]


@built
def test_the_reference_is_whole(site):
    text = {
        name: (site / "reference" / f"{name}.html").read_text()
        for name in ("stages", "recipes", "effects", "api")
    }
    for page, names in (("stages", STAGES), ("recipes", RECIPES), ("effects", EFFECTS)):
        shown = set(re.findall(r"<h3>([\w-]+)<" if page == "stages" else r"<h2>([\w-]+)<", text[page]))
        assert shown == set(names), page
    for module in PUBLIC:
        for name in public_names(module):
            if not inspect.ismodule(getattr(importlib.import_module(module), name)):
                assert re.search(rf'id="[\w.]*\.{name}"', text["api"]), (
                    f"{module}.{name} is not in the reference"
                )


@built
def test_peers_are_those_of_the_benchmarks(site):
    text = (site / "peers.html").read_text()
    for name in ("OpenCV", "kornia", "SciPy", "colour-demosaicing"):
        assert re.search(rf"<td><p>{name}</p></td>\s*<td><p>\d+</p></td>", text), name


@built
def test_pages_link_to_pages_that_are_there(site):
    for page in site.rglob("*.html"):
        for link in re.findall(r'(?:href|src)="([^"#?]+)', page.read_text()):
            if not re.match(r"[a-z]+:", link):
                assert (page.parent / link).exists(), f"{page.relative_to(site)}: {link}"


@built
def test_notebooks_are_pages(site):
    sources = sorted((ROOT / "notebooks").glob("*.py"))
    assert sources
    for source in sources:
        title = re.search(r"^# # (.+)$", source.read_text(), re.MULTILINE)[1]
        page = site / "tutorials" / (source.stem.replace("_", "-") + ".html")
        assert f"<h1>{title}<" in page.read_text()


def test_the_readmes_figures_are_those_measured():
    text = (ROOT / "README.md").read_text()
    found = json.loads((ROOT / "docs/results/real-data.json").read_text())
    assert " and ".join(f"{raw['psnr_levels_matched']:.1f}" for raw in found["develop"]) + " dB" in text
    (pair,) = found["fit"]["pairs"]
    quality = f"{pair['held_out_psnr']:.1f} dB, SSIM {pair['held_out_ssim']:.3f}"
    assert f"{quality}, in {found['fit']['seconds']:.0f} s" in text
    assert f"{found['degrade']['seconds']:.0f} s, compilation" in text


def test_what_the_diagnosis_reaches_is_what_the_results_say():
    """The table of docs/results/targets.md, from the files that it names; in the guide and in the README."""
    page = (ROOT / "docs/results/targets.md").read_text()
    command = next(
        line for line in page.splitlines() if line.startswith("python -m experiments.withheld_targets")
    )
    results, _, located_in = command.partition(" --axes ")
    files, axes = (re.findall(r"docs/results/\S+\.json", part) for part in (results, located_in))
    records, again = (collected(ROOT / name for name in names)[0] for names in (files, axes))
    found = targets(located(records, again))
    assert found in page and found.strip() in (ROOT / "docs/diagnosis.md").read_text()
    rows = {row.split(" | ")[0]: row.split(" | ") for row in found.splitlines()}
    first = rows["| right effect first"]
    told = " ".join((ROOT / "README.md").read_text().split())
    unknown, axis, both = (
        [re.search(r"\((\d+)/(\d+)\)", rows[name][column]).groups() for column in (1, 3)]
        for name in (
            '| outside the vocabulary: "unknown"',
            "| outside the vocabulary: right axis in the first three",
            "| two effects, either alone twice the floor: both found",
        )
    )
    said = (
        "{} of {} and, in clean+noisy pairs, {} of {} are called unknown, and {} and {} are put on the right"
    )
    assert said.format(*unknown[0], *unknown[1], axis[0][0], axis[1][0]) in told
    assert "found in {} of {} (RAW+JPEG) and {} of {} (clean+noisy)".format(*both[0], *both[1]) in told
    for cell, where in ((first[1], "RAW+JPEG pairs"), (first[3], "clean+noisy pairs")):
        share, hits, total = re.fullmatch(r"(\d+)% \[.*\] \((\d+)/(\d+)\)", cell).groups()
        assert re.search(rf"{share} % (are named first )?in {re.escape(where)} \({hits} of {total}\)", told)
