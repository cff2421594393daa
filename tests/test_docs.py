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
from collections.abc import Callable
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

import jaxisp
from benchmarks import accelerator_report, report, stages_report, training
from experiments import gallery, raw_noise, readme_table, real_data, real_gap_tables
from experiments.denoisers import report as denoisers
from experiments.evaluation import page as evaluation
from experiments.fit_phones import __main__ as fit_phones
from jaxisp.gap import EFFECTS
from jaxisp.recipes import RECIPES, any_phase, find_recipe
from jaxisp.stages import STAGES

ROOT = Path(__file__).parent.parent
PUBLIC = [
    "jaxisp", "jaxisp.fit", "jaxisp.train", "jaxisp.data", "jaxisp.gap", "jaxisp.models", "jaxisp.io",
    "jaxisp.samples", "jaxisp.explore", "jaxisp.params", "jaxisp.priors", "jaxisp.metrics", "jaxisp.camera",
    "jaxisp.losses", "jaxisp.calibrate", "jaxisp.interop", "jaxisp.adapt",
]  # fmt: skip
OPTIONAL = {"torch", "datasets"}
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
    command += ["-D", "stage_pictures=0"]  # a minute
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


@pytest.fixture
def stage_pictures(monkeypatch):
    monkeypatch.syspath_prepend(str(ROOT / "docs"))
    return importlib.import_module("stage_pictures")


def test_settings_of_pictures_are_those_of_stages(stage_pictures):
    for name in STAGES:
        node, params, _ = stage_pictures.setting(name)
        node.check(params)
    assert not set(stage_pictures.SETTINGS) - set(STAGES)


@pytest.mark.parametrize(("name", "words"), [("vignetting", "a2 -0.8"), ("resize", ""), ("median", "noise")])
def test_a_stage_has_a_picture(name, words, stage_pictures, tmp_path):
    assert words in stage_pictures.write(name, tmp_path / "it.png")
    first, then = np.split(np.asarray(Image.open(tmp_path / "it.png"))[:, np.r_[:96, 100:196]], 2, 1)
    assert np.abs(first.astype(float) - then).mean() > 1


def test_a_picture_that_shows_nothing_is_refused(stage_pictures, tmp_path, monkeypatch):
    monkeypatch.setattr(stage_pictures, "SETTINGS", {})
    with pytest.raises(ValueError, match="changes nothing that is seen"):
        stage_pictures.write("vignetting", tmp_path / "it.png")


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


def read(name: str) -> Any:
    return json.loads((ROOT / name).read_text())


def test_the_tables_of_the_evaluation_are_made_from_their_results():
    page = (ROOT / "docs/diagnosis-evaluation.md").read_text()
    parts = evaluation.tables(ROOT / "docs/results")
    assert {name for name in parts if f"<!-- generated: {name} -->" in page} == set(parts)
    assert evaluation.rendered(page, parts) == page, "python -m experiments.evaluation"


def test_the_table_of_the_readme_is_made_from_the_results():
    page = (ROOT / "README.md").read_text()
    assert evaluation.rendered(page, {"results": readme_table.made(ROOT)}) == page, (
        "python -m experiments.readme_table"
    )


PAGES: dict[str, Callable[[Path], Any]] = {
    "performance": lambda page: report.write_performance(page, ROOT / "benchmarks/results/peers.json"),
    "performance-xeon": lambda page: report.write_performance(
        page, ROOT / "benchmarks/results/xeon/peers.json"
    ),
    "exactness": lambda page: report.write_exactness(page, ROOT / "benchmarks/results/exactness.json"),
    "stages": lambda page: stages_report.write_stages(page, ROOT / "benchmarks/results/stages.json"),
    "gpu": lambda page: accelerator_report.write_accelerator(
        page, ROOT / "benchmarks/results/h200/accelerator.json"
    ),
    "training": lambda page: page.write_text(training.markdown(read("benchmarks/results/training.json"))),
    "denoisers": lambda page: page.write_text(
        denoisers.document(read("docs/results/denoisers.json"), read("docs/results/noise-spectra.json"))
    ),
    "fit-phones": lambda page: page.write_text(fit_phones.markdown(read("docs/results/fit-phones.json"))),
    "raw-noise": lambda page: page.write_text(raw_noise.markdown(read("docs/results/raw-noise.json"))),
    "real-data": lambda page: page.write_text(real_data.markdown(read("docs/results/real-data.json"))),
    "real-gap": lambda page: page.write_text(real_gap_tables.markdown(read("docs/results/real-gap.json"))),
}
"""The pages of docs/results that are made from JSON alone, but for what stands around a generated part."""


@pytest.mark.parametrize("name", PAGES)
def test_pages_of_results_are_made_from_their_results(name: str, tmp_path: Path):
    page, whole = tmp_path / "page.md", (ROOT / f"docs/results/{name}.md").read_text()
    if "<!-- generated: " in whole:
        page.write_text(
            re.sub(r"(<!-- generated: .*? -->\n).*?(<!-- end -->)", r"\1\2", whole, flags=re.DOTALL)
        )
    PAGES[name](page)
    assert page.read_text() == whole


MARKDOWN = [
    path
    for pattern in ("*.md", "docs/**/*.md", "benchmarks/**/*.md", "experiments/**/*.md")
    for path in sorted(ROOT.glob(pattern))
    if "_build" not in path.parts
]


@pytest.mark.parametrize("path", MARKDOWN, ids=lambda path: str(path.relative_to(ROOT)))
def test_links_and_paths_lead_somewhere(path: Path):
    """Relative links, and files of the repository that are named in code marks."""
    text = re.sub(r"^```.*?^```", "", path.read_text(), flags=re.DOTALL | re.MULTILINE)
    # notes that become part of a page link from there
    folder = ROOT / "docs/results" if path.is_relative_to(ROOT / "benchmarks") else path.parent
    for link in re.findall(r"\]\(([^)#\s]+)", text):
        if not re.match(r"[a-z]+:", link):
            built_from = re.fullmatch(r"(?:.*tutorials/)?(\d\d-[\w-]+)\.md", link)
            notebook = ROOT / f"notebooks/{built_from[1].replace('-', '_')}.py" if built_from else None
            assert (folder / link).exists() or (notebook and notebook.exists()), link
    for named in re.findall(r"`((?:jaxisp|tests|experiments|benchmarks|docs|notebooks)/[\w./-]+)`", text):
        placeholder = re.search(r"[A-Z]{3,}|_build", named)
        assert placeholder or (ROOT / named).exists(), named


def test_pages_that_the_package_names_are_there():
    for path in (ROOT / "jaxisp").rglob("*.py"):
        for named in re.findall(r"\b(?:docs|experiments|benchmarks)/[\w/-]+\.\w+", path.read_text()):
            assert (ROOT / named).exists(), f"{path.relative_to(ROOT)}: {named}"


def python_blocks() -> list[Any]:
    """Every block of Python in the pages that stands alone: it imports all that it uses."""
    found = []
    for path in MARKDOWN:
        for k, code in enumerate(
            re.findall(r"^```python\n(.*?)^```", path.read_text(), re.DOTALL | re.MULTILINE)
        ):
            found.append(pytest.param(code, id=f"{path.relative_to(ROOT)}-{k}"))
    return found


@pytest.mark.parametrize("code", python_blocks())
def test_python_in_the_pages_names_what_is_there(code: str):
    """It compiles, and what it imports of the package exists."""
    for node in ast.walk(ast.parse(code)):
        if isinstance(node, ast.ImportFrom) and (node.module or "").startswith("jaxisp"):
            try:
                module = importlib.import_module(node.module)
            except ModuleNotFoundError as error:  # of a library that is for comparison and bridges alone
                assert error.name in OPTIONAL, error.name
                continue
            for alias in node.names:
                assert hasattr(module, alias.name) or find_spec(f"{node.module}.{alias.name}"), alias.name


def test_the_readmes_example_runs():
    text = (ROOT / "README.md").read_text()
    (code,) = re.findall(r"^```python\n(.*?)^```", text, re.DOTALL | re.MULTILINE)
    names: dict[str, Any] = {}
    exec(code.replace("size=(32, 80, 80, 3)", "size=(2, 16, 16, 3)"), names)
    assert names["noisy"].shape == (2, 16, 16, 3)
    np.testing.assert_array_equal(names["again"], names["noisy"])


def test_the_page_on_composing_runs(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)  # it saves a recipe
    text = (ROOT / "docs/how-to/compose.md").read_text()
    names: dict[str, object] = {}
    for code in re.findall(r"^```python\n(.*?)^```", text, re.DOTALL | re.MULTILINE):
        exec(code, names)
    assert set(names["names"]) <= {"awgn", "amwgn", "clean"}
    assert find_recipe("mine.toml") == names["mine"] and names["mine"].name == "mine"
    assert find_recipe("mine.toml-phases") == any_phase(names["mine"])


def test_the_gallery_is_what_its_command_writes():
    """The page holds the lines that make each picture; there are twelve, of ten lines or a few more."""
    assert Path("docs/gallery.md") == gallery.PAGE and (ROOT / gallery.PAGE).read_text() == gallery.page()
    assert len(gallery.PICTURES_OF) == 13
    for name, make in gallery.PICTURES_OF.items():
        assert (ROOT / gallery.PICTURES / f"{name}.jpg").stat().st_size < 200_000
        assert len(inspect.getsource(make).splitlines()) <= 15, name


def test_a_picture_of_the_gallery_is_made():
    tiles = gallery.PICTURES_OF["film_grain"]()
    row = gallery.picture(tiles)
    assert row.size == (3 * tiles[0].shape[1] + 2 * gallery.GAP, tiles[0].shape[0])
