"""What an installed package needs: every file of data is in the wheel, and the citation agrees with it."""

import fnmatch
import tomllib
from pathlib import Path

import jaxisp

ROOT = Path(__file__).parent.parent
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text())


def test_every_file_of_data_is_packaged():
    patterns = PROJECT["tool"]["setuptools"]["package-data"]["jaxisp"]
    files = [p for p in (ROOT / "jaxisp").rglob("*") if p.is_file() and "__pycache__" not in p.parts]
    data = [str(p.relative_to(ROOT / "jaxisp")) for p in files if p.suffix != ".py"]
    assert "py.typed" in data and "report/page.html" in data
    left = [name for name in data if not any(fnmatch.fnmatch(name, pattern) for pattern in patterns)]
    assert not left, f"not in package-data: {left}"


def test_every_package_has_its_init():
    """`packages.find` takes folders with `__init__.py` alone."""
    folders = {p.parent for p in (ROOT / "jaxisp").rglob("*.py")}
    assert not [f for f in folders if not (f / "__init__.py").is_file()]


def test_versions_agree():
    citation = (ROOT / "CITATION.cff").read_text()
    assert f"version: {jaxisp.__version__}\n" in citation
    assert PROJECT["project"]["version"] == jaxisp.__version__
