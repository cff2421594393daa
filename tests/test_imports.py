"""Imports point one way: core -> arrays -> stages -> recipes -> fit, demo -> cli."""

import ast
import subprocess
import sys
import time
from pathlib import Path

import pytest

PACKAGE = Path(__file__).parent.parent / "jaxisp"
LAYERS = [
    {"errors", "process"},
    {"params", "domains", "options", "arrays", "shown"},
    {"checks", "priors", "cfa", "color", "colorimetry", "metrics", "losses"},
    {"registry"},
    {"node", "edits"},
    {"pipeline", "phase", "unprocess", "jpeg", "io"},
    {"testing"},
    {"stages", "samples"},
    {"serialize"},
    {"recipe"},
    {"mixture", "published"},
    {"recipes", "camera", "encoder", "report", "frames"},
    {"calibrate"},
    {"catalogue", "explore", "fit", "data", "models"},
    {"generate"},
    {"interop"},
    {"train", "adapt"},
    {"gap"},
    {"demo"},
    {"cli"},
]
RANK = {name: i for i, layer in enumerate(LAYERS) for name in layer}
GAP = (
    "parallel", "pairs", "simulator", "features", "axes", "criteria", "objective", "gauss_newton", "case",
    "base", "search", "downstream", "report", "diagnose", "residual",
)  # fmt: skip
"""The folders and modules of the diagnosis, lowest first: each imports only those before it."""


def modules() -> list[Path]:
    entry = {PACKAGE / "__init__.py", PACKAGE / "__main__.py"}
    return sorted(set(PACKAGE.rglob("*.py")) - entry)


def layer(path: Path, within: Path = PACKAGE) -> str:
    return path.relative_to(within).parts[0].removesuffix(".py")


def imported(text: str, package: str = "jaxisp") -> set[str]:
    """The folders and modules of a package that a module imports, wherever in it."""
    found, depth = set(), package.count(".") + 1
    for node in ast.walk(ast.parse(text)):
        names = [a.name for a in node.names] if isinstance(node, ast.Import) else []
        if isinstance(node, ast.ImportFrom) and node.module:
            names = [node.module] + [f"{node.module}.{a.name}" for a in node.names]
        found |= {n.split(".")[depth] for n in names if n.startswith(f"{package}.")}
    return found - {"__version__"}


def upward(text: str, own: str) -> set[str]:
    """What a module of a folder of the diagnosis must not import."""
    return {name for name in imported(text, "jaxisp.gap") if GAP.index(name) > GAP.index(own)}


@pytest.mark.parametrize("path", modules(), ids=lambda p: str(p.relative_to(PACKAGE)))
def test_imports_point_down(path):
    own = layer(path)
    assert own in RANK, f"{own}: say in which layer it is"
    above = {name for name in imported(path.read_text()) if RANK[name] > RANK[own]}
    assert not above, f"{path.name} imports upwards: {above}"


@pytest.mark.parametrize(
    "path",
    sorted({*(PACKAGE / "gap").rglob("*.py")} - {PACKAGE / "gap" / "__init__.py"}),
    ids=lambda p: str(p.relative_to(PACKAGE / "gap")),
)
def test_the_folders_of_the_diagnosis_import_one_way(path):
    own = layer(path, PACKAGE / "gap")
    assert own in GAP, f"{own}: say where in the order it is"
    assert not upward(path.read_text(), own), f"{path.name} imports upwards"


@pytest.mark.parametrize(
    "line",
    [
        "from jaxisp.gap.search.refit import Trial",
        "from jaxisp.gap import search",
        "import jaxisp.gap.search.refit",
        "def late():\n    from jaxisp.gap.search import refit",
    ],
)
def test_an_import_upwards_is_seen(line):
    assert upward(line, "objective") == {"search"} and upward(line, "report") == set()


def test_io_does_not_need_jax_arrays():
    for path in (PACKAGE / "io").glob("*.py"):
        assert "import jax\n" not in path.read_text(), path


@pytest.mark.parametrize("arguments", [["--help"], ["degrade", "--help"], ["degrade"], ["nonsense"]])
def test_help_and_usage_errors_do_not_load_jax(arguments):
    code = (
        "import sys\nfrom jaxisp.cli import main\n"
        f"try:\n    main({arguments!r})\nexcept SystemExit as e:\n    status = e.code\n"
        "assert 'jax' not in sys.modules and 'numpy' not in sys.modules\nsys.exit(status)"
    )
    clock = time.perf_counter()
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert done.returncode == (0 if "--help" in arguments else 2), done.stderr
    assert time.perf_counter() - clock < 5  # a guard against a heavy import, not a benchmark


def test_slow_imports_wait_until_they_are_needed():
    """tensorboardX loads PyTorch where that is installed, which takes seconds; SciPy doubles the time."""
    code = (
        "import sys, jaxisp.recipes, jaxisp.io, jaxisp.camera; assert 'scipy' not in sys.modules\n"
        "import jaxisp.cli.train, jaxisp.train, jaxisp.gap; assert 'tensorboardX' not in sys.modules"
    )
    subprocess.run([sys.executable, "-c", code], check=True)


def test_the_names_at_the_top_are_what_they_say():
    """A submodule that is imported later must not hide a name, as `jaxisp.stage` once did."""
    import jaxisp
    import jaxisp.cli
    import jaxisp.demo  # imports nearly everything

    assert callable(jaxisp.stage) and callable(jaxisp.run)
    for name in jaxisp.__all__:
        value = getattr(jaxisp, name)
        assert (type(value).__name__ == "module") == (name in jaxisp._MODULES), name
        assert name in dir(jaxisp)
    with pytest.raises(AttributeError, match="no attribute 'nonsense'"):
        _ = jaxisp.nonsense


FRESH = {
    "a stage by name": "import jaxisp; assert jaxisp.stage('bilateral').name == 'bilateral'",
    "the pipeline alone": "from jaxisp.pipeline import stage; stage('median')",
    "a node alone": "from jaxisp.node import stage; stage('jpeg')",
    "what a name may be": """
import jaxisp
try:
    jaxisp.stage("bilaterall")
except KeyError as error:
    assert "bilateral" in str(error), error
""",
    "a name that is taken": """
from jaxisp.pipeline import register
from jaxisp.domains import RGB
def bilateral(image: RGB) -> RGB:
    return image
try:
    register(bilateral)
except ValueError as error:
    assert "registered already" in str(error), error
else:
    raise AssertionError("taken")
""",
    "modules": """
import jaxisp
for name in ("data", "train", "gap", "explore", "models", "camera", "losses", "errors", "pipeline", "recipe"):
    assert getattr(jaxisp, name).__name__ == f"jaxisp.{name}", name
""",
    "the process": "import jaxisp; jaxisp.keep_freed(); jaxisp.keep_compiled('{folder}')",
}


@pytest.mark.parametrize("what", FRESH)
def test_in_a_fresh_process(what, tmp_path):
    """A stage and a module are found whatever was imported before."""
    code = FRESH[what].replace("{folder}", str(tmp_path))
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
