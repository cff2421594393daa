"""Clean+noisy pairs: cameras that share no code with the package, one that does, and the parts between."""

import functools
import io
import json
from types import SimpleNamespace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from PIL import Image

from experiments.withheld.scenes import scenes
from experiments.withheld.shoot import write
from jaxisp import gap
from jaxisp.cli import main
from jaxisp.color import linear_to_srgb
from jaxisp.gap import EFFECTS, diagnose
from jaxisp.gap.base import cfa_phase, clean_noisy
from jaxisp.gap.base.mean import fit_mean
from jaxisp.gap.base.palette import TYPICAL
from jaxisp.gap.base.plain_clean import Camera, noise_freedom, primaries
from jaxisp.gap.pairs.align_clean import align_clean, clean_pairs
from jaxisp.gap.pairs.scenes import Split, split_of
from jaxisp.gap.simulator.effects import candidates
from jaxisp.gap.simulator.model import MIXING, build, plain_freedom
from jaxisp.io import write_png
from jaxisp.io.datasets import Loaded, open_dataset
from jaxisp.io.settings import Settings
from jaxisp.recipe import Recipe
from jaxisp.testing import smooth_image
from tests.gap.schema import keeps_the_schema

pytestmark = pytest.mark.optimised

COUNT, SIZE = 4, 128
TRIED = ("vignetting", "optical_blur", "row_noise", "column_noise", "correlated_noise", "film_grain",
         "heavy_tailed_noise", "color_shading", "sharpening")  # fmt: skip


def shot(folder, body, name, level):
    write(folder, body, {name: level}, "clean+noisy", size=SIZE, count=COUNT)
    return diagnose(folder, exclude=sorted(set(EFFECTS) - set(TRIED)))


def own_camera(folder, row_noise=0.0, places=((0, 0),) * COUNT):
    """The package's own camera, its pictures cut at these places: row noise is sealed in the study, and its
    pictures are kept for that."""
    folder.mkdir(exist_ok=True)
    room = np.max(places)
    chain, params = Camera(None, "RGGB", "malvar").chain()
    effects = [e for e in candidates("clean+noisy") if e.name == "row_noise"]
    shared = params | primaries(np.eye(3) + 0.9 * TYPICAL)
    model = build(chain, shared, {}, plain_freedom(), effects, keep_file=True)
    found = scenes("one", SIZE + int(room), COUNT)
    light = jnp.asarray(np.stack(list(found.values())), jnp.float32)
    z = np.zeros(len(model.coordinates))
    z[model.indices(["row_noise"])] = row_noise
    noisy = model.render(z, light, jax.random.split(jax.random.key(9), COUNT))
    for name, clean, picture, (top, left) in zip(found, light, noisy, places):
        encoded = np.where(clean <= 0.0031308, 12.92 * clean, 1.055 * clean ** (1 / 2.4) - 0.055)
        for ending, a in ((".clean.png", encoded), (".noisy.png", picture)):
            part = np.rint(255 * np.clip(a, 0, 1)).astype(np.uint8)[top : top + SIZE, left : left + SIZE]
            Image.fromarray(part).save(folder / (name + ending))
    return diagnose(folder, exclude=sorted(set(EFFECTS) - set(TRIED)))


@pytest.fixture(scope="module")
def cases(tmp_path_factory):
    """The folder of a case and what was found, made when it is asked for."""

    @functools.cache
    def case(name):
        folder = tmp_path_factory.mktemp(name)
        levels = {"nothing": 1, "vignetting": 4}
        found = shot(folder, "alder", name, levels[name]) if name in levels else own_camera(folder, 0.012)
        keeps_the_schema(found.report)
        assert sum(w["share"] for w in found.report["where"]) == pytest.approx(
            1 if found.report["where"] else 0
        )
        assert found.report["kind"] == "clean+noisy"
        return folder, found

    return case


@pytest.fixture(scope="module")
def diagnosed(cases):
    """The report of a case."""
    return lambda name: cases(name)[1].report


def test_no_effect_is_named_where_none_is_missing(diagnosed):
    report = diagnosed("nothing")
    assert report["verdict"] == "none" and report["causes"] == [] and report["where"] == []


def test_the_effect_that_is_missing_is_named(diagnosed):
    report = diagnosed("vignetting")
    assert report["verdict"] == "effect" and report["where"][0]["axis"] == "radius"
    assert report["causes"][0]["effect"] == "vignetting", [r["effect"] for r in report["ranking"][:4]]
    assert report["causes"][0]["closed"] > 0.5


def test_the_simulator_with_the_cause_makes_pictures_as_the_cameras(cases, tmp_path):
    folder, found = cases("vignetting")
    found.save(tmp_path)
    recipe = Recipe.load(tmp_path / "simulator.toml")
    assert recipe == found.simulator and recipe.meta["causes"] == ["vignetting"]
    assert not any(name.startswith("use_") for name in recipe.chain.names())
    pairs = [pair.load() for pair in open_dataset(folder).pairs]
    clean, noisy = (np.stack([getattr(p, name) for p in pairs]) for name in ("clean", "picture"))
    made = np.stack([np.asarray(recipe.degrade(jax.random.key(k), clean)[0]) for k in range(8)])
    # corners are as much darker than the middle as in the camera's pictures, and unlike the clean ones
    parts = [(slice(None), slice(0, 24), slice(0, 24)), (slice(None), slice(52, 76), slice(52, 76))]
    fall = [np.log(x[parts[0]].mean() / x[parts[1]].mean()) for x in (made.mean(0), noisy, clean)]
    assert abs(fall[0] - fall[1]) < 0.04 < abs(fall[2] - fall[1])
    # the noise of either, about the mean of eight draws, whose own noise is in both
    one, real = (np.diff(x - made[1:].mean(0), 2, axis=-2).std() for x in (made[0], noisy))
    assert one == pytest.approx(real, rel=0.1)


def test_the_command_adapts_to_pairs_through_the_diagnosis(cases, tmp_path, capsys, monkeypatch):
    folder, found = cases("nothing")
    monkeypatch.setattr(gap, "diagnose", lambda *_, **__: found)
    assert main(["adapt", str(folder), "-o", str(tmp_path / "camera.toml"), "--json"]) == 0
    table = json.loads(capsys.readouterr().out)
    assert table["verdict"] == "none" and table["causes"] == [] and table["run"] is None
    assert Recipe.load(tmp_path / "camera.toml") == found.simulator
    assert main(["adapt", str(folder), "-o", str(tmp_path / "camera.toml"), "--draws", "64"]) == 2
    assert "which are diagnosed" in capsys.readouterr().err


@pytest.mark.slow
def test_row_noise_is_seen_on_its_axis(diagnosed):
    report = diagnosed("row_noise")
    assert report["verdict"] != "none"
    assert "row" in [w["axis"] for w in report["where"][:3]]


@pytest.mark.slow
def test_pairs_may_be_cut_anywhere(tmp_path, monkeypatch):
    """Crops at odd places have no pattern in common."""
    report = own_camera(tmp_path / "cut", places=((0, 0), (1, 0), (0, 1), (1, 1))).report
    assert report["verdict"] == "none" and report["gap"]["before"] < 1.5 * report["gap"]["unit"]
    monkeypatch.setattr(cfa_phase, "moves", lambda *arguments: np.zeros((COUNT, 2), int))
    kept = own_camera(tmp_path / "kept", places=((0, 0), (1, 0), (0, 1), (1, 1))).report
    assert kept["gap"]["before"] > 2 * report["gap"]["before"] and kept["where"][0]["axis"] == "cfa_phase"


@pytest.fixture(scope="module")
def model():
    camera = Camera(None, "GBRG", "malvar", (2.0, 1.5), late=True)
    return camera.whole_model(camera.mean_model({}), candidates("clean+noisy"))


def test_the_base_may_shrink_its_noise(model):
    noise = [c for c in noise_freedom(model.shared) if c.node == "balanced_noise"]
    assert len(noise) == 4
    for coordinate in noise:
        value = float(getattr(model.shared["balanced_noise"], coordinate.move.field))
        assert -value < coordinate.move.low <= 0 < coordinate.move.high


def test_wherever_the_primaries_move_their_inverse_follows_and_white_stays(model):
    z = np.zeros(len(model.coordinates))
    moved = [i for i, c in enumerate(model.base) if c.node == MIXING]
    z[moved] = np.linspace(-0.4, 0.3, len(moved))
    for shared in (model.shared, model.params(z)):
        mixing, inward = (np.asarray(shared[name].matrix, float) for name in (MIXING, "primaries"))
        np.testing.assert_allclose(mixing @ inward, np.eye(3), atol=1e-5)
        np.testing.assert_allclose(mixing.sum(1), 1, atol=1e-6)
    assert np.abs(mixing - model.shared[MIXING].matrix).max() > 0.3


@pytest.mark.slow
def test_primaries_that_are_like_no_typical_ones_are_found_in_the_noise(tmp_path):
    """A bilinear sensor's errors at edges say nothing of them; the typical ones leave nine floors."""
    write(tmp_path, "oak", {"nothing": 1}, "clean+noisy", size=SIZE, count=6, scenes="two")
    report = diagnose(tmp_path, exclude=sorted(EFFECTS)).report
    assert report["gap"]["before"] < 2 * report["gap"]["unit"]


def test_frames_of_a_scene_stay_on_one_side():
    split = split_of(["a.f00", "a.f01", "b.f00", "b.f01", "c"])
    assert split.fit == (0, 1, 4) and split.held_out == (2, 3)
    assert split_of(["a.f00", "a.f01"]).held_out == (1,)


def clean_pair(name, clean, picture):
    settings = Settings(clean_encoding="linear")
    return Loaded(
        name, picture.astype(np.float32), None, None, clean.astype(np.float32), settings, False, None
    )


def textured(seed: int, size=(90, 100)):
    scene = np.stack([smooth_image(size, seed + k) for k in range(3)], -1)
    return scene + 0.2 * (np.random.default_rng(seed).random((*size, 1)) > 0.8)


def test_a_scene_is_laid_under_a_picture_of_another_size_and_place():
    scene = textured(0)
    picture = np.sqrt(scene)[1:-1, 1:-1]
    whole, moved = clean_pair("a", scene, picture), np.roll(picture, (2, -3), (0, 1))
    inner = clean_pair("b", scene[1:-1, 1:-1], moved)
    (cut, laid), failed, rows, _ = align_clean([whole, inner])
    assert failed == []
    np.testing.assert_array_equal(cut.clean, whole.clean[1:-1, 1:-1])
    there = np.roll(whole.clean[1:-1, 1:-1], (2, -3), (0, 1))
    np.testing.assert_array_equal(laid.clean[8:-8, 8:-8], there[8:-8, 8:-8])
    assert [row["done"] for row in rows] == ["nothing", "moved"]
    np.testing.assert_allclose(rows[1]["shift_px"], (2, -3), atol=0.3)


def test_a_clean_picture_that_was_compressed_is_compressed_again(tmp_path):
    """On a grid where that costs it something, as Pillow's libjpeg does it."""
    encoded = [np.uint8(np.rint(255 * np.clip(textured(k, (96, 96)), 0, 1))) for k in range(2)]
    write_png(tmp_path / "a.clean.png", encoded[0])
    Image.fromarray(encoded[1]).save(tmp_path / "b.clean.jpg", quality=75)
    for name, noisy in zip("ab", encoded):
        write_png(tmp_path / f"{name}.noisy.png", noisy)
    loaded = [pair.load() for pair in open_dataset(tmp_path).pairs]
    assert [p.clean_file and p.clean_file.quality for p in loaded] == [None, 75]
    pairs = clean_pairs(loaded)
    light, again = (np.asarray(a) for a in (pairs.light, pairs.again))
    np.testing.assert_allclose(again[0], light[0], atol=1e-6)
    stored, found = np.asarray(Image.open(tmp_path / "b.clean.jpg")), 255 * linear_to_srgb(again[1])
    assert min(np.abs(found - pillow_again(stored, by)).max() for by in ((0, 0), (3, 3), (5, 5))) < 1e-3
    assert 0.5 < np.std(found - stored) / np.std(encoded[1] - stored.astype(float)) < 1.1
    assert clean_pairs(loaded[:1]).again is None
    (tmp_path / "dataset.toml").write_text('clean_encoding = "linear"\n')
    assert [pair.load().clean_file for pair in open_dataset(tmp_path).pairs] == [None, None]


def pillow_again(stored, by):
    file = io.BytesIO()
    Image.fromarray(np.roll(stored, by, (0, 1))).save(file, "JPEG", quality=75)
    return np.roll(np.asarray(Image.open(file)), [-n for n in by], (0, 1)).astype(float)


@pytest.mark.slow
def test_what_compression_took_from_clean_pictures_is_no_gap(tmp_path):
    """15.6 floors where the same pixels come without their header, 1.0 where they were never compressed."""
    write(tmp_path, "catalpa", {"nothing": 1}, "clean+noisy", size=SIZE, count=COUNT, scenes="two")
    for path in tmp_path.glob("*.clean.png"):
        Image.open(path).save(path.with_suffix(".jpg"), quality=60)
        path.unlink()
    report = diagnose(tmp_path, exclude=sorted(EFFECTS)).report
    assert report["gap"]["before"] < 4 * report["gap"]["unit"]


def test_a_clean_picture_is_turned_as_the_noisy_one_and_left_out_where_its_size_is_another():
    scenes = [np.random.default_rng(k).random((90, 100, 3)) for k in range(4)]
    noisy = [np.sqrt(scene) for scene in scenes]
    cleans = [scenes[0], scenes[1][::-1, ::-1], np.rot90(scenes[2]), scenes[3][:60]]
    kept, failed, rows, _ = align_clean(
        [clean_pair(str(k), c, n) for k, (c, n) in enumerate(zip(cleans, noisy))]
    )
    assert [row["done"] for row in rows] == ["nothing", "turned", "turned"]
    assert all(row["certain"] for row in rows)
    for pair, scene in zip(kept, scenes):
        np.testing.assert_array_equal(pair.clean, scene.astype(np.float32))
    assert [name for name, _ in failed] == ["3"] and "100x60 px, the noisy one 100x90" in failed[0][1]


def test_a_pair_of_two_scenes_is_not_certain():
    scenes = [np.random.default_rng(k).random((90, 100, 3)) for k in range(2)]
    rows = align_clean([clean_pair("a", scenes[0], np.sqrt(scenes[1]))]).rows
    assert [row["certain"] for row in rows] == [False]
    names, errors = ("a", "b", "c", "d", "e", "f"), np.array([50.0, 1.1, 1.0, 0.9, 5.0, 20.0])
    objective = SimpleNamespace(names=names, split=Split((0, 2, 4), (1, 3, 5)))
    mean = SimpleNamespace(point=SimpleNamespace(errors=errors), objective=objective)
    assert clean_noisy._outliers(mean, ()) == (), (
        "the fitted ones are believed, and no other is twelve times as far off as they are"
    )
    assert clean_noisy._outliers(mean, ("a", "c")) == ("a",)


@pytest.mark.slow
def test_pattern_and_demosaicker_are_found_through_a_soft_lens(tmp_path):
    """Blur hides what tells them; an even softer demosaicker would stand in for it."""
    write(tmp_path, "birch", {"optical_blur": 4}, "clean+noisy", size=SIZE, count=COUNT)
    pairs = clean_pairs([pair.load() for pair in open_dataset(tmp_path).pairs], 0.0)
    camera = fit_mean(None, pairs, Split((0, 2), (1, 3)), None).camera
    assert (camera.cfa, camera.algorithm, camera.late) == ("BGGR", "malvar", True)


@pytest.mark.parametrize(
    "effect", ["chroma_subsampling", pytest.param("chroma_denoising", marks=pytest.mark.slow)]
)
def test_what_smooths_chroma_does_not_pass_for_the_sensor(tmp_path, effect):
    """Gains and order are seen in false colours at edges, which it hides."""
    write(tmp_path, "birch", {effect: 4}, "clean+noisy", size=SIZE, count=COUNT)
    pairs = clean_pairs([pair.load() for pair in open_dataset(tmp_path).pairs], 0.0)
    camera = fit_mean(None, pairs, Split((0, 2), (1, 3)), None).camera
    assert (camera.cfa, camera.algorithm, camera.late) == ("BGGR", "malvar", True)
    np.testing.assert_allclose(camera.gains, (2.2, 1.4), atol=0.3)


@pytest.mark.slow
def test_demosaicking_of_square_roots_is_found(tmp_path):
    """On linear values nothing has its errors at edges, and gains that balance late would make up for it."""
    write(tmp_path, "maple", {"nothing": 1}, "clean+noisy", size=SIZE, count=COUNT)
    pairs = clean_pairs([pair.load() for pair in open_dataset(tmp_path).pairs], 0.0)
    camera = fit_mean(None, pairs, Split((0, 2), (1, 3)), None).camera
    assert (camera.cfa, camera.algorithm, camera.late, camera.gamma) == ("GRBG", "vng", True, 2.0)


@pytest.mark.slow
def test_without_a_header_the_grid_says_which_compression_it_was(tmp_path):
    """On the picture's own grid it is the file's, elsewhere an earlier one."""
    few = sorted(set(EFFECTS) - {"double_compression", "jpeg_quantization"})

    def offered(folder):
        loaded = [pair.load() for pair in open_dataset(folder).pairs]
        case = clean_noisy.clean_case(loaded, None, few, 0, lambda *a: None)
        return sorted(case.offered), case.seen

    shot, whole, cropped = (tmp_path / name for name in ("shot", "whole", "cropped"))
    write(shot, "alder", {"jpeg_quantization": 4}, "clean+noisy", size=SIZE, count=2)
    for folder, top, left in ((whole, 0, 0), (cropped, 3, 5)):  # of one size: they share a program
        folder.mkdir()
        (folder / "dataset.toml").write_bytes((shot / "dataset.toml").read_bytes())
        for picture in shot.glob("*.png"):
            part = np.asarray(Image.open(picture))[top : top + SIZE - 8, left : left + SIZE - 8]
            Image.fromarray(part).save(folder / picture.name)
    assert offered(whole) == (["jpeg_quantization"], ())
    assert offered(cropped) == (["double_compression", "jpeg_quantization"], ("double_compression",))


@pytest.mark.slow
@pytest.mark.parametrize(
    ("which", "change", "reason"),
    [(1, lambda x: x[..., ::-1], "carry over"), (3, lambda x: 255 - x, "two scenes")],  # both are held out
)
def test_a_pair_that_the_fitted_ones_say_nothing_of_is_left_out(tmp_path, which, change, reason):
    """Its red is another camera's blue, or it is a negative; the others are diagnosed without it."""
    write(tmp_path, "alder", {"nothing": 1}, "clean+noisy", size=SIZE, count=6)
    stray = sorted(tmp_path.glob("*.jpg"))[which]
    Image.fromarray(change(np.asarray(Image.open(stray)))).save(stray, quality=95, subsampling=0)
    report = diagnose(tmp_path, exclude=sorted(set(EFFECTS) - {"vignetting"})).report
    (left_out,) = report["pairs"]["left_out"]
    assert left_out["name"] == stray.stem and reason in left_out["reason"]
    assert len(report["pairs"]["fit"] + report["pairs"]["held_out"]) == 5
    assert report["verdict"] == "none"


@pytest.mark.slow
def test_the_halves_of_one_pair_are_never_left_out(tmp_path, monkeypatch):
    monkeypatch.setattr(clean_noisy, "_OUTLIER", 0.0)  # all that is held out is far off
    write(tmp_path, "alder", {"nothing": 1}, "clean+noisy", size=SIZE, count=1)
    report = diagnose(tmp_path, exclude=sorted(set(EFFECTS) - {"vignetting"})).report
    assert report["pairs"]["failed"] == [] and len(report["pairs"]["held_out"]) == 1
