"""Photon transfer against a sensor whose numbers are known, and what the numbers are then used for."""

import json
from pathlib import Path

import jax
import numpy as np
import pytest

from jaxisp.calibrate import Calibrated, calibrate, with_noise
from jaxisp.calibrate.frames import BLOCK, Stack, blocks, interactions
from jaxisp.calibrate.measure import _measured as figures_of
from jaxisp.calibrate.measure import kurtosis
from jaxisp.cli import main
from jaxisp.errors import InputError
from jaxisp.fit.dataset import _Lazy
from jaxisp.fit.raw_noise import raw_noise
from jaxisp.io import Raw, open_dataset
from jaxisp.pipeline import run
from jaxisp.recipe import Recipe
from jaxisp.recipes import awgn, phone, phone_any
from jaxisp.samples import PHONES, scene, write_pairs
from tests.calibrate import sensor

TRUTH = {
    "shot": sensor.SHOT,
    "row": sensor.ROW,
    "row_temporal": sensor.ROW,
    "column": sensor.COLUMN,
    "column_fixed": sensor.COLUMN,
    "prnu": sensor.PRNU,
    "dsnu": sensor.DSNU,
    "dark_signal": sensor.RATE,
    "black": sensor.BLACK,
}
STEP = 1 / (sensor.WHITE - sensor.LOW)
PROFILE = [(3e-4, 5e-6)] * 3


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    folder = tmp_path_factory.mktemp("frames")
    for iso, tail, shot, seed in ((100, 0.0, sensor.SHOT, 0), (400, sensor.TAIL, 4 * sensor.SHOT, 1)):
        flats, darks = sensor.frames(seed, tail=tail, shot=shot)
        sensor.write(folder, "flats", flats, iso=iso, profile=PROFILE)
        sensor.write(folder, "darks", darks, iso=iso)
    return folder


@pytest.fixture(scope="module")
def found(folder):
    return calibrate(folder / "flats", folder / "darks")


@pytest.mark.parametrize("name", [*TRUTH, "read", "tail"])
@pytest.mark.parametrize("iso", [100, 400])
def test_a_known_sensor_is_found_within_its_standard_errors(found, iso, name):
    """Four of them, of over twenty figures. Rounding adds its variance to what is read."""
    heavy = iso == 400
    truth = TRUTH | {
        "shot": sensor.SHOT * iso / 100,
        "read": np.sqrt(sensor.READ**2 + STEP**2 / 12),
        "tail": sensor.TAIL if heavy else 0.0,
    }
    value, error = found.at(iso).figures[name]
    assert abs(value - truth[name]) < 4 * error
    assert error < {"tail": 0.01, "black": 5e-5}.get(name, 0.05 * truth[name] + 1e-5)


def test_errors_are_the_scatter_between_sensors():
    """What 16 sensors scatter by, against the errors that each states: the mean square of z is 1."""
    z = []
    for seed in range(16):
        flats, darks = sensor.frames(seed, size=(160, 192))
        noise = _measured(flats, darks)
        z.append([(noise.figures[n].value - TRUTH[n]) / noise.figures[n].error for n in TRUTH])
    mean, square = np.mean(z, 0), np.mean(np.square(z), 0)
    for name, m, s in zip(TRUTH, mean, square):
        assert abs(m) < 4 * np.sqrt(s / 16) + 0.3, (name, m)
        assert 0.25 < s < 2.5, (name, s)  # 0.4 to 1.8: 95 % of a chi-square of 16


def _measured(flats, darks):
    def stacks(shots):
        by_time = {}
        for time, frame in shots:
            level = round(float(frame.mean()), 1)
            raw = _raw(frame, time)
            by_time.setdefault((time, level), Stack.of(raw, None, "")).add(raw)
        return list(by_time.values())

    return figures_of(None, stacks(flats), stacks(darks), "test", [])


def _raw(frame, time):
    whole = (0, 0, *frame.shape)
    return Raw(
        Path("a.raw.npy"), frame.astype(np.float32), "GRBG", np.zeros(4), 1.0, np.ones(3), whole, whole,
        exposure_time=time,
    )  # fmt: skip


def test_interactions_know_no_rows_columns_slopes_and_levels():
    rng = np.random.default_rng(0)
    y, x = np.indices((4 * BLOCK, 4 * BLOCK))
    plane = rng.normal(size=(len(y), 1)) + rng.normal(size=(1, len(y))) + 0.1 * y - 0.3 * x + 5
    assert np.abs(interactions(blocks(plane))).max() < 1e-12
    white = rng.standard_normal((4 * BLOCK, 4 * BLOCK))
    assert np.allclose(interactions(interactions(blocks(white))), interactions(blocks(white)))


def test_the_kurtosis_is_that_of_tukeys_h():
    n = np.random.default_rng(0).standard_normal(4_000_000)
    for h in (0.02, 0.05):
        y = n * np.exp(h * n * n / 2)
        assert (y**4).mean() / (y**2).mean() ** 2 == pytest.approx(kurtosis(h), rel=0.02)


def test_hot_pixels_are_counted_and_left_out(tmp_path):
    flats, darks = sensor.frames(3, hot=2e-4)
    noise = _measured(flats, darks)
    assert noise.value("hot_pixels") == pytest.approx(2e-4, abs=4 * np.sqrt(2e-4 / np.prod(sensor.SIZE)))
    for name in ("shot", "dsnu", "prnu"):
        value, error = noise.figures[name]
        assert abs(value - TRUTH[name]) < 4 * error, name
    assert noise.figures["tail"].value <= 4 * noise.figures["tail"].error


def test_the_file_reads_back_and_states_the_profile(found, tmp_path):
    found.save(tmp_path / "noise.toml")
    again = Calibrated.load(tmp_path / "noise.toml")
    assert again == found and again.to_toml() == found.to_toml()
    shot, variance = PROFILE[1]
    assert again.at(100).stated == pytest.approx((shot, np.sqrt(variance)), rel=1e-5)
    assert again.camera == "jaxisp known"


def test_between_two_isos_figures_lie_on_lines_of_logarithms(found):
    assert found.at(200).value("shot") == pytest.approx(2 * sensor.SHOT, rel=0.02)
    for iso, what in ((None, "say which"), (50, "no noise was measured at ISO 50"), (401, "401")):
        with pytest.raises(InputError, match=what):
            found.at(iso)


def test_its_stages_draw_noise_of_its_figures(found):
    """Moments of what the stages draw on a grey mosaic, in float64 NumPy."""
    for iso in (100, 400):
        noise = found.at(iso)
        assert noise.heavy_tailed == (iso == 400)
        chain, params = noise.stages()
        level = 0.4
        grey = np.full((256, 256), level, np.float32)
        drawn = np.asarray(run(chain, params, grey, jax.random.key(iso)), np.float64) - level
        v = noise.value
        pixels = v("shot") * level + v("read") ** 2 + v("dsnu") ** 2 + (v("prnu") * level) ** 2
        left = drawn - drawn.mean(0) - drawn.mean(1, keepdims=True) + drawn.mean()
        assert left.var() == pytest.approx(pixels, rel=0.03)
        rows = drawn.mean(1).var(ddof=1) - pixels / 256
        assert rows == pytest.approx(v("row") ** 2, rel=0.4)


@pytest.mark.parametrize("recipe", [phone(), phone_any(), awgn()], ids=lambda r: r.name)
def test_it_takes_the_place_of_a_recipes_noise(found, recipe):
    new = with_noise(recipe, found.at(100))
    assert new.prior["shot_read_noise"].shot == np.float32(found.at(100).value("shot"))
    assert "gaussian_noise" not in {s.name for s in new.chain.stages()}
    kept = set(recipe.prior) - {"shot_read_noise", "gaussian_noise"}
    assert kept <= set(new.prior)
    assert Recipe.from_toml(new.to_toml()) == new
    again = with_noise(new, found.at(400))
    assert again.prior["read_noise"].tail == np.float32(found.at(400).value("tail"))
    assert again.prior["row_noise"].std == np.float32(found.at(400).value("row"))


def test_a_recipe_without_noise_has_no_place_for_it(found):
    with pytest.raises(InputError, match="no stage of noise"):
        with_noise(phone().without("shot_read_noise"), found.at(100))


def test_the_command(folder, found, capsys, tmp_path):
    out = tmp_path / "noise.toml"
    arguments = [folder / "flats", folder / "darks", "-o", out, "--report", tmp_path / "report", "--json"]
    assert main(["calibrate", *map(str, arguments)]) == 0
    told = json.loads(capsys.readouterr().out)
    assert [n["iso"] for n in told["noise"]] == [100, 400]
    assert told["noise"][0]["figures"]["shot"]["value"] == found.at(100).value("shot")
    assert told["noise"][0]["electrons"]["capacity"] == pytest.approx(1 / sensor.SHOT, rel=0.01)
    assert Calibrated.load(out) == found
    page = (tmp_path / "report" / "report.html").read_text()
    assert "ISO 400" in page and "NoiseProfile" in page and page.count("data:image/png") == 6
    made = tmp_path / "phone.toml"
    assert main(["recipe", "phone", "-o", str(made), "--noise", str(out), "--iso", "400"]) == 0
    assert Recipe.load(made) == with_noise(phone(), found.at(400))
    assert main(["recipe", "phone", "-o", str(made), "--noise", str(out)]) == 2
    assert "ISO 100, 400: say which" in capsys.readouterr().err


def test_what_cannot_be_calibrated_is_refused_in_words(folder, tmp_path, capsys):
    flats, darks = sensor.frames(5, size=(128, 128))
    sensor.write(tmp_path, "flats", flats)
    sensor.write(tmp_path, "one", darks[:1])
    sensor.write(tmp_path, "other", darks, iso=800)
    sensor.write(tmp_path, "empty", [])
    sensor.write(tmp_path, "small", [(t, f[:60, :60]) for t, f in darks])
    sensor.write(tmp_path, "bright", [(t, f + 0.8) for t, f in darks])
    sensor.write(tmp_path, "good", darks)
    for flat, dark, words in (
        (tmp_path / "flats", tmp_path / "one", "no two dark frames"),
        (tmp_path / "flats", tmp_path / "other", "no two dark frames"),
        (tmp_path / "flats", tmp_path / "empty", "holds no RAW file"),
        (tmp_path / "flats", tmp_path / "small", "expected 64 or more a side"),
        (tmp_path / "flats", folder / "darks", "expected frames of one sensor"),
        (tmp_path / "bright", tmp_path / "good", "brighter than 70 % of white"),
        (tmp_path / "flats", tmp_path / "none", "none"),
    ):
        status = main(["calibrate", str(flat), str(dark), "-o", str(tmp_path / "noise.toml")])
        error = capsys.readouterr().err
        assert status == 2 and words in error and len(error.splitlines()) == 1, error
        assert not (tmp_path / "noise.toml").exists()


def test_frames_that_cannot_be_read_are_left_out_and_told(tmp_path, capsys):
    flats, darks = sensor.frames(5, size=(128, 128))
    sensor.write(tmp_path, "flats", flats)
    sensor.write(tmp_path, "darks", darks)
    command = ["calibrate", *(str(tmp_path / name) for name in ("flats", "darks")), "-o"]
    assert main([*command, str(tmp_path / "whole.toml")]) == 0
    capsys.readouterr()
    (tmp_path / "flats" / "0.dng").symlink_to("0.dng")
    (tmp_path / "darks" / "z.raw.npy").write_bytes(b"damaged")
    assert main([*command, str(tmp_path / "noise.toml"), "--json"]) == 2
    told = capsys.readouterr()
    assert (tmp_path / "noise.toml").read_text() == (tmp_path / "whole.toml").read_text()
    assert len(told.err.splitlines()) == len(json.loads(told.out)["failed"]) == 2
    assert "too many levels of symbolic links" in told.err and "z.raw.npy" in told.err
    for path in (tmp_path / "darks").iterdir():
        path.write_bytes(b"damaged")
    assert main([*command, str(tmp_path / "none.toml")]) == 2
    assert capsys.readouterr().err.count("\n") == 1 and not (tmp_path / "none.toml").exists()
    with pytest.raises(InputError, match="damaged"):
        calibrate(tmp_path / "flats", tmp_path / "darks")


def test_a_damaged_file_is_refused(found, tmp_path):
    text = found.to_toml()
    black = f"black = {found.noise[0].black}"
    numbers = [text.replace(black, f"black = {wrong}", 1) for wrong in ("nan", "inf", "9" * 400, '"64"')]
    assert text not in numbers
    for wrong in (
        text.replace("sensor noise", "noise"),
        text.replace("value = ", "valve = ", 1),
        "x = 1",
        *numbers,
    ):
        with pytest.raises(InputError, match=r"noise\.toml"):
            Calibrated.from_toml(wrong, "noise.toml")


def test_single_dark_frames_are_taken_together(tmp_path):
    flats, darks = sensor.frames(7, size=(192, 192))
    sensor.write(tmp_path, "flats", flats)
    sensor.write(tmp_path, "darks", [darks[0], darks[-1]])
    found = calibrate(tmp_path / "flats", tmp_path / "darks")
    assert any("taken as of one exposure" in note for note in found.notes)
    value, error = found.at().figures["shot"]
    assert abs(value - sensor.SHOT) < 4 * error


def test_read_noise_below_rounding_is_called_a_bound(tmp_path, monkeypatch):
    """At 8 bits a read noise of 0.003 is 0.77 of a step; at 6 bits 0.19, which rounding hides."""
    flats, darks = sensor.frames(8, size=(192, 192))
    for bits, hidden in ((8, False), (6, True)):
        monkeypatch.setattr(sensor, "LOW", 16)
        monkeypatch.setattr(sensor, "WHITE", 16 + 2**bits - 1)
        own = tmp_path / str(bits)
        sensor.write(own, "flats", flats)
        sensor.write(own, "darks", darks)
        notes = calibrate(own / "flats", own / "darks").notes
        assert any("rounding hides it" in note for note in notes) == hidden


def test_a_fit_notes_the_noise_that_was_calibrated(found, tmp_path):
    write_pairs(tmp_path, PHONES["a"], {"scene": scene("astronaut", (64, 96))})
    pair = open_dataset(tmp_path).pairs[0]
    stated = raw_noise(_Lazy(pair, None)().raw)
    noted = raw_noise(_Lazy(pair, found)().raw)  # the phone's ISO number is 100
    own = found.at(100)
    assert (noted.shot, noted.read) == pytest.approx((own.value("shot"), own.value("read")))
    assert noted.gains == stated.gains and noted.shot != stated.shot
