"""The cameras of the withheld-effect study: independent of the package, and each effect does something."""

import ast
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from skimage.color import rgb2gray

from experiments.withheld import effects
from experiments.withheld.bodies import BODIES, Noise, _by_name
from experiments.withheld.camera import KINDS, Shot, before_body, develop, expose
from experiments.withheld.demosaic import DEMOSAICKERS, demosaic, mosaicked
from experiments.withheld.libraw import SWITCHES, developed
from experiments.withheld.outside import AXES as OUTSIDE_AXES
from experiments.withheld.scenes import GREY, SETS, clutter, scenes
from experiments.withheld.shoot import write
from experiments.withheld.study import cases
from jaxisp.gap.simulator.effects import AXES

PACKAGE = Path(__file__).parent.parent / "experiments" / "withheld"
ALLOWED = {"numpy", "scipy", "cv2", "PIL", "skimage"}
MORE = {"study": {"jaxisp"}, "libraw": {"rawpy", "tifffile"}}


def imported(path: Path) -> set[str]:
    """Top-level names of all that a module imports, at any depth; what lies beside it is left out."""
    found = set()
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.Import):
            found |= {alias.name.split(".")[0] for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            assert node.level <= 1, f"{path}: reaches outside its folder"
            found |= {node.module.split(".")[0]} if node.level == 0 and node.module else set()
        elif isinstance(node, ast.Call) and isinstance(node.func, ast.Name):
            assert node.func.id not in ("__import__", "exec", "eval"), path
    return found


@pytest.mark.parametrize("path", sorted(PACKAGE.glob("*.py")), ids=lambda p: p.stem)
def test_imports_nothing_of_the_package(path: Path) -> None:
    extra = imported(path) - set(sys.stdlib_module_names) - ALLOWED
    assert extra == MORE.get(path.stem, set())
    assert "importlib" not in imported(path)
    assert path.stem == "scenes" or "skimage" not in imported(path)


def test_study_names_the_package_once() -> None:
    assert (PACKAGE / "study.py").read_text().count("jaxisp") == 1


def test_vocabulary_is_the_contract() -> None:
    assert len(effects.VOCABULARY) == 34
    assert set(effects.DEVELOP) | set(effects.SEALED) == set(effects.VOCABULARY)
    assert not set(effects.DEVELOP) & set(effects.SEALED)
    assert all(len(effect.strengths) == 5 for effect in effects.EVERYTHING.values())
    assert sum(1 for _ in cases(KINDS[0], "nulls", list(BODIES), [1])) >= 100
    assert set(OUTSIDE_AXES) == set(effects.OUTSIDE)
    assert set().union(*OUTSIDE_AXES.values()) <= set(AXES)


def picture(size: int = 64) -> np.ndarray:
    rng = np.random.default_rng(3)
    field = np.stack([clutter(size, rng, 1.1) for _ in range(3)], axis=-1)
    found = np.clip(0.15 + 0.85 * field.mean(-1, keepdims=True) + 0.5 * (field - 0.5), 0.01, 1)
    found[8:16, 8:24], found[40:48, 30:40], found[30:36, 4:20] = (0.9, 0.02, 0.02), 1.0, (0.02, 0.05, 0.8)
    return found


def shoot(body: str, kind: str, active: dict[str, int], scene: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """RAW and picture of a body that has next to no noise of its own."""
    chosen = tuple((effects.EVERYTHING[name], level) for name, level in active.items())
    still = replace(BODIES[body], bright=Noise(1e10, 1.0), dim=Noise(1e10, 1.0))
    shot = Shot(still, kind, chosen, "test")
    raw = expose(before_body(scene, still), shot)
    return raw, develop(raw, shot)


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("body", ["alder", "birch"])
def test_effects_grow_and_leave_the_raw_alone(body: str, kind: str) -> None:
    scene = picture()
    raw, plain = shoot(body, kind, {}, scene)
    for name in (*effects.VOCABULARY, *effects.OUTSIDE):
        if not effects.shows_in(name, kind) or "noise" in effects.EVERYTHING[name].acts[kind]:
            continue
        change = []
        for level in (1, 5):
            other, pixels = shoot(body, kind, {name: level}, scene)
            change.append(np.sqrt(np.mean((pixels.astype(float) - plain) ** 2)))
            if kind == "raw+jpeg":
                np.testing.assert_array_equal(other, raw, err_msg=name)
        assert 0.02 < change[0] < change[1], (name, change)


def flat_noise(name: str, level: int) -> np.ndarray:
    """Noise in the RAW of a dark card, without the mean of each place in the CFA."""
    shot = Shot(BODIES["alder"], "clean+noisy", ((effects.EVERYTHING[name], level),), "card")
    cells = expose(np.full((256, 256, 3), 0.004), shot).reshape(128, 2, 128, 2).astype(float)
    return (cells - cells.mean((0, 2), keepdims=True)).reshape(256, 256)


@pytest.mark.parametrize(
    ("name", "measure"),
    [
        ("noise_level", np.std),
        ("correlated_noise", lambda x: np.mean(x[:, 1:] * x[:, :-1]) / x.var()),
        ("heavy_tailed_noise", lambda x: np.mean(x**4) / x.var() ** 2),
        ("row_noise", lambda x: x.mean(axis=1).std()),
        ("column_noise", lambda x: x.mean(axis=0).std()),
    ],
)
def test_noise_effects_grow(name, measure) -> None:
    weak, strong = (measure(flat_noise(name, level)) for level in (1, 5))
    assert strong > 1.3 * weak


@pytest.mark.parametrize("cfa", ["RGGB", "BGGR", "GRBG", "GBRG"])
@pytest.mark.parametrize("name", sorted(DEMOSAICKERS))
def test_demosaickers_keep_colours_of_all_mosaics(name: str, cfa: str) -> None:
    y, x = np.mgrid[:32, :40] / 40
    smooth = np.stack([0.2 + 0.5 * x, 0.3 + 0.4 * y, 0.7 - 0.4 * x], axis=-1)
    for border in ("reflect", "cells"):
        found = demosaic(mosaicked(smooth, cfa), cfa, name, border)
        assert np.abs(found - smooth)[4:-4, 4:-4].max() < 0.01


def test_write_is_repeatable_and_as_the_contract_says(tmp_path: Path) -> None:
    chosen = {"first": picture(48)}
    for folder in ("a", "b"):
        write(tmp_path / folder, "dogwood", {"vignetting": 3, "sharpening": 2}, "raw+jpeg", chosen)
    write(tmp_path / "c", "alder", {"jpeg_quantization": 4}, "clean+noisy", chosen, frames=2)
    files = {p.name: p.read_bytes() for p in (tmp_path / "a").iterdir()}
    assert set(files) == {"first.raw.npy", "first.jpg", "dataset.toml"}
    assert files == {p.name: p.read_bytes() for p in (tmp_path / "b").iterdir()}
    found = {p.name for p in (tmp_path / "c").iterdir()}
    assert found == {"first.clean.png", "first.f00.noisy.png", "first.f01.noisy.png", "dataset.toml"}
    assert Image.open(tmp_path / "a" / "first.jpg").size == (48, 48)
    with pytest.raises(ValueError, match="does not show"):
        write(tmp_path / "d", "alder", {"hot_pixels": 1}, "raw+jpeg", chosen)


@pytest.mark.parametrize("name", sorted(BODIES))
def test_libraw_develops_what_a_body_took(name: str) -> None:
    """Its bilinear demosaicking is the study's, with BT.709's curve after the body's gains and matrix."""
    body = BODIES[name]
    raw, _ = shoot(name, "raw+jpeg", {}, picture(96))
    mosaic = np.maximum((raw.astype(float) - body.black) / (body.white - body.black), 0)
    gains = mosaicked(np.ones((96, 96, 3)) * body.gains, body.cfa)
    linear = demosaic(np.minimum(mosaic * gains, 1), body.cfa, "bilinear", "reflect") @ body.matrix.T
    linear = np.clip(linear, 0, 1)
    curve = np.where(linear < 0.018054, 4.5 * linear, 1.0993 * linear**0.45 - 0.0993)
    error = developed(raw, name, SWITCHES["linear"].settings) - 255 * curve
    assert np.sqrt(np.mean(error[4:-4, 4:-4] ** 2)) < 1
    assert np.abs(developed(raw, name, {}) - 255 * curve).mean() > 1, "AHD is another"


def test_scene_sets_are_disjoint() -> None:
    names = [set(scenes(name, 64)) for name in SETS]
    assert all(len(found) == 8 for found in names)
    pictures = [p for name in SETS for p in scenes(name, 64).values()]
    assert all(p.shape == (64, 64, 3) and p.min() >= 0 and p.max() <= 1 for p in pictures)
    assert all(np.abs(a - b).max() > 0.1 for i, a in enumerate(pictures) for b in pictures[:i])


def test_grey_scenes_are_a_set_s_without_its_colours() -> None:
    coloured, grey = scenes("two", 64, 3), scenes(GREY, 64, 3)
    assert list(coloured) == list(grey)
    for own, plain in zip(coloured.values(), grey.values()):
        assert np.ptp(plain, axis=-1).max() == 0 and np.ptp(own, axis=-1).max() > 0.05
        np.testing.assert_allclose(plain[..., 0], rgb2gray(own), atol=0.01)


def test_no_two_bodies_have_one_name() -> None:
    with pytest.raises(ValueError, match="one name"):
        _by_name([BODIES["alder"], BODIES["alder"]])
    assert BODIES["elder"].cfa != BODIES["elm"].cfa  # the one was once run under the other's
