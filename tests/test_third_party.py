"""The cases of other converters: what hashes decide, what is written for the programs, and the tables."""

import json
import struct

import cv2
import numpy as np
import pytest

from experiments.third_party import darktable, rawtherapee
from experiments.third_party.cameras import SENSORS, frames, noise, tuning
from experiments.third_party.cases import CONVERTERS, Case, cases
from experiments.third_party.chance import HALVES
from experiments.third_party.make import stands, write
from experiments.third_party.pictures import apart, write_hald
from experiments.third_party.run import PAIRS, PICTURES, REFERENCE, possible, two_pictures
from experiments.third_party.switches import NONE, OUTSIDE
from experiments.third_party.tables import first, groups, markdown, ranked, size, summary, surely_named
from jaxisp.gap import EFFECTS
from jaxisp.io import open_dataset, read_raw


def test_halves_share_no_camera_with_its_switch():
    develop, sealed = ({(c.converter, c.camera, c.switch) for c in cases(half) if c.level} for half in HALVES)
    assert not develop & sealed
    assert 0.3 < len(develop) / len(develop | sealed) < 0.7
    assert {c for c, _, _ in develop} == {c for c, _, _ in sealed} == set(CONVERTERS)


def test_there_are_twenty_switches_and_their_truths_are_effects():
    every = [what for driver in CONVERTERS.values() for what in driver.SWITCHES.values()]
    effects = {what.truth for what in every} - {NONE, OUTSIDE}
    assert len(every) > 40 and effects <= set(EFFECTS) and len(effects) >= 12
    assert all(set(what.also) <= {*EFFECTS, NONE} for what in every)
    assert sum(len(what.levels) == 5 for what in every) >= 20


def test_each_case_has_the_same_camera_without_its_switch():
    every = list(cases("develop"))
    names = {case.name for case in every}
    assert len(names) == len(every)
    for case in every:
        assert case.plain.name in names and case.plain.camera == case.camera
    lost = Case("libraw", "imx219", "lost_header", 3, "develop")
    assert lost.plain.settings == {"lossless": 100}


def test_a_sidecar_holds_the_bytes_of_each_module():
    text = darktable._sidecar({"sharpen": darktable._floats(1, 2.0, 0.5, 0.25)})
    assert f'darktable:params="{struct.pack("<3f", 2.0, 0.5, 0.25).hex()}"' in text
    assert 'darktable:history_end="1"' in text
    for name, switch in darktable.SWITCHES.items():
        sizes = {
            len(value[1])
            for settings in switch.levels
            for value in settings.values()
            if isinstance(value, tuple)
        }
        assert len(sizes) <= 1 and all(n % 4 == 0 for n in sizes), name


def test_a_profile_lists_its_sections(tmp_path):
    path = rawtherapee._profile({"Sharpening": {"Enabled": "true", "Amount": 200}}, tmp_path / "own.pp3")
    assert path.read_text() == "[Sharpening]\nEnabled=true\nAmount=200\n"


def test_a_table_of_colours_keeps_grey(tmp_path):
    table = cv2.imread(str(write_hald(tmp_path / "film.png")), cv2.IMREAD_UNCHANGED)[..., ::-1]
    cube = table.reshape(64, 64, 64, 3) / 65535  # blue slowest, red fastest
    grey = cube[np.arange(64), np.arange(64), np.arange(64)]
    np.testing.assert_allclose(grey, np.linspace(0, 1, 64)[:, None].repeat(3, 1), atol=2e-5)
    assert np.abs(cube[0, 0, 63] - [1, 0, 0]).max() > 0.02, "red is moved"


@pytest.fixture
def data(tmp_path):
    """A sensor's tuning and noise, and photographs for both halves."""
    ccm = [[1.8, -0.7, -0.1], [-0.3, 1.8, -0.5], [-0.1, -0.5, 1.6]]
    algorithms = [
        {"rpi.ccm": {"ccms": [{"ct": 5000, "ccm": np.ravel(ccm).tolist()}]}},
        {"rpi.awb": {"ct_curve": [4000, 0.5, 0.5, 6000, 0.4, 0.6]}},
    ]
    model = {"A": [1e-6] * 4, "B": [0.0] * 4, "C": [0.0] * 4, "D": [4e-7] * 4}
    folders = {
        name: tmp_path / name
        for name in ("calibration/libcamera", "calibration/noise_tables", "clean/photos", "clean/kodak")
    }
    for folder in folders.values():
        folder.mkdir(parents=True)
    for sensor in SENSORS.values():
        (folders["calibration/libcamera"] / f"{sensor.tuning}.json").write_text(
            json.dumps({"algorithms": algorithms})
        )
    table = {sensor.noise: model for sensor in SENSORS.values()}
    (folders["calibration/noise_tables"] / "phone_dng_noise_models.json").write_text(json.dumps(table))
    rng = np.random.default_rng(0)
    for i in range(12):
        picture = cv2.resize(rng.integers(40, 220, (6, 8, 3), np.uint8), (640, 512))
        cv2.imwrite(str(folders["clean/kodak"] / f"photo{i}.png"), picture)
    return tmp_path


def test_a_sensors_file_is_undone_by_its_own_tags(data, tmp_path):
    """Balanced and turned by the stated matrix, a grey stays grey, and flat noise is as stated."""
    sensor = SENSORS["imx219"]
    matrix, gains = tuning(data, sensor)
    np.testing.assert_allclose(matrix.sum(1), 1)
    shown = next(iter(frames(data, "imx219", "develop", 1, 64)))
    shown.save(tmp_path / "a.dng")
    raw = read_raw(tmp_path / "a.dng")
    np.testing.assert_allclose(raw.white_balance, gains, rtol=1e-3)
    np.testing.assert_allclose(raw.camera_to_srgb, matrix, atol=5e-3)
    assert noise(data, sensor) == pytest.approx((2e-4, 4e-7))


def test_the_halves_of_a_camera_see_other_photographs(data):
    kept = [np.stack([f.mosaic for f in frames(data, "imx378", half, 2, 64)]) for half in HALVES]
    assert not any(np.array_equal(a, b) for a in kept[0] for b in kept[1])
    again = np.stack([f.mosaic for f in frames(data, "imx378", "develop", 2, 64)])
    np.testing.assert_array_equal(kept[0], again)


def test_pictures_of_two_sizes_have_no_distance(tmp_path):
    for name, side in (("a", 32), ("b", 32), ("c", 24)):
        cv2.imwrite(
            str(tmp_path / f"{name}.png"), np.full((side, side, 3), 100 + (name == "b") * 10, np.uint8)
        )
    assert apart(tmp_path / "a.png", tmp_path / "b.png") == pytest.approx(10, abs=0.1)
    with pytest.raises(ValueError, match="32x32 and 24x24 px"):
        apart(tmp_path / "a.png", tmp_path / "c.png")


RESIZED = Case("rawtherapee", "imx378", "resize", 5, "develop")


def pictures_of(side):
    """A converter that writes no more than pictures of a size."""

    def develop(raws, camera, settings, out):
        paths = [out / f"{raw.stem}.png" for raw in raws]
        for path in paths:
            cv2.imwrite(str(path), np.full((side, side, 3), 90, np.uint8))
        return paths

    return develop


def test_a_switch_that_changes_the_size_is_no_case(tmp_path, data, monkeypatch):
    """A resize of RawTherapee came back 8 px larger than its plain picture: a scale beside the switch."""
    plain = RESIZED.plain
    monkeypatch.setattr(rawtherapee, "develop", pictures_of(40))
    write(data, tmp_path, plain, 48)
    assert write(data, tmp_path, RESIZED, 48)["apart"] == 0 and stands(tmp_path / RESIZED.name, RESIZED)
    monkeypatch.setattr(rawtherapee, "develop", pictures_of(48))
    with pytest.raises(ValueError, match="40x40 and 48x48 px"):
        write(data, tmp_path, RESIZED, 48)


def test_a_folder_of_other_settings_is_written_anew(tmp_path):
    assert not stands(tmp_path, RESIZED)
    for settings, far, right in (("0.5", 8.0, True), ("0.66", 8.0, False), ("0.5", None, False)):
        (tmp_path / "truth.json").write_text(json.dumps({"settings": {"resize": settings}, "apart": far}))
        assert stands(tmp_path, RESIZED) == right


def test_a_resized_picture_of_rawtherapee_gets_back_what_its_border_leaves(tmp_path, data, monkeypatch):
    """RawTherapee cuts 4 px off each side of a picture that it demosaics, none off what it enlarges."""
    asked = []
    monkeypatch.setattr(
        rawtherapee, "_run", lambda files, profile, output, out: asked.append(profile.read_text()) or files
    )
    raw = tmp_path / "s0.dng"
    next(frames(data, "imx378", "develop", 1, 48)).save(raw)
    rawtherapee.develop([raw], "imx378", RESIZED.settings, tmp_path)
    assert "Scale=0.5" in asked[0] and "Border=4" in asked[0]
    assert "Width=40\nHeight=40" in asked[1] and "Border" not in asked[1]


def record(case, truth, before, causes=(), ranking=(), plain="p", also=()):
    found = [{"effect": name, "closed": 0.5, **more} for name, more in causes]
    report = {
        "verdict": "effect" if causes else "unknown",
        "causes": found,
        "gap": {"before": before, "floor": 10.0},
        "ranking": [{"effect": name} for name in ranking],
    }
    about = {
        "case": case,
        "truth": truth,
        "also": list(also),
        "plain": plain,
        "converter": "x",
        "switch": case,
        "level": 1,
    }
    return {"truth": about, "report": report, "seconds": 1.0}


def test_answers_are_counted_with_all_cases():
    plain = record("p", NONE, 20.0, [("film_grain", {})])
    right = record("a", "sharpening", 40.0, [("sharpening", {"probability": 0.95})], ["sharpening"])
    also = record("b", "luma_denoising", 22.0, [("chroma_denoising", {})], also=["chroma_denoising"])
    wrong = record("c", "sharpening", 80.0, [("film_grain", {"probability": 0.4})], ["a", "b", "sharpening"])
    failed = {"truth": dict(wrong["truth"], case="d"), "failed": "ValueError()"}
    every = [plain, right, also, wrong, failed]
    by_name = {r["truth"]["case"]: r for r in every}
    assert size(right, by_name) == pytest.approx(3.0) and size(failed, by_name) is None
    assert [first(r) for r in every] == [False, True, True, False, False]
    assert ranked(wrong, 3) and not ranked(wrong, 2)
    assert surely_named(wrong) == [] and surely_named(plain) == ["film_grain"]
    assert [len(own) for own in groups(every).values()] == [4, 1, 0, 1, 1, 1, 1, 0]
    assert summary(every)["effects, all"]["truth named first"] == 2
    text = markdown(every)
    assert "50%" in text and "(2/4)" in text and "ValueError()" in text


def test_a_case_is_laid_out_as_two_pictures(tmp_path):
    off, on, out = (tmp_path / name for name in ("off", "on", "out"))
    for folder, value in ((off, 90), (on, 120), (out, 0)):
        folder.mkdir()
        (folder / "truth.json").write_text(json.dumps({"level": int(folder == on)}))
        if value:
            for name in ("s0", "s1"):
                cv2.imwrite(str(folder / f"{name}.jpg"), np.full((64, 64, 3), value, np.uint8))
    (out / "truth.json").unlink()
    two_pictures(on, off, out)
    data = open_dataset(out)
    assert data.kind == "jpeg+jpeg" and [p.name for p in data.pairs] == ["s0", "s1"]
    first = data.pairs[0].load()
    assert first.clean.mean() < first.picture.mean() and possible(on, PICTURES)
    (on / "s0.jpg").unlink(), (on / "s1.jpg").unlink()
    assert not possible(on, PICTURES) and possible(on, PAIRS) and possible(on, REFERENCE)
    assert possible(off, PAIRS) and not possible(off, REFERENCE), "it is no case beside itself"


def test_beside_plain_pictures_what_a_base_takes_up_is_to_be_named():
    black = record("b", NONE, 40.0, [("black_level_offset", {})], also=["black_level_offset"])
    quality, bloom = record("q", NONE, 5.0), record("o", OUTSIDE, 30.0, also=["veiling_glare"])
    every = [dict(r, how=REFERENCE) for r in (black, quality, bloom)]
    parts = groups(every)
    assert parts["effects, all"] == every[:1] and parts["nothing added"] == every[1:2]
    assert parts["outside the library"] == every[2:] and first(every[0])
    assert size(every[0], {}) == 4.0, "a gap is what the switch did"
    every[1]["report"]["gap"]["floor"] = 0.0
    assert size(every[1], {}) == 1.0 and groups([black])["effects, all"] == []
