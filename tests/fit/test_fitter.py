"""The fitter on the reference phone, whose code it does not share."""

import dataclasses
import io
import json

import cv2
import numpy as np
import pytest
from PIL import Image
from scipy import ndimage

from jaxisp.camera import develop
from jaxisp.cli import main
from jaxisp.errors import InputError
from jaxisp.fit import fit_examples, model
from jaxisp.fit.journal import alone
from jaxisp.fit.report import parameter_rows, write_report
from jaxisp.fit.search import MOST_TRIALS
from jaxisp.fit.seen import unseen
from jaxisp.fit.sharing import CAMERA, FIXED, IMAGE, sharing
from jaxisp.fit.tiles import prepare, split
from jaxisp.io import open_dataset, orient, read_jpeg, write_jpeg
from jaxisp.io.jpeg import decode_jpeg
from jaxisp.pipeline import Chain
from jaxisp.recipe import Recipe
from jaxisp.samples import PHONES, scene, write_pairs
from tests.fit.conftest import PLAIN, SIZE, example
from tests.io.profiles import COLORANTS, SRGB_CURVE, parametric, profile

pytestmark = pytest.mark.optimised


def psnr(a, b):
    return -10 * np.log10(np.mean((np.asarray(a) - b) ** 2))


@pytest.mark.slow
def test_it_finds_most_of_the_look_on_tiles_it_did_not_see(result):
    (pair,) = result.pairs
    before = psnr(pair.start[8:-8, 8:-8], pair.target[8:-8, 8:-8])
    # the start is good already (27.7 dB); gradient descent from a start of 25.1 dB came to 31.2 too
    # squared errors of tiles that were not fitted fall to 0.4 of the start's
    assert pair.held_out_psnr > max(31.5, before + 4)
    assert abs(pair.held_out_psnr - pair.psnr) < 3
    assert np.abs(pair.shift).max() < 0.2
    assert result.phases.count("first") > 3
    for phase in set(result.phases):  # each has its own scale
        assert np.all(np.diff(result.losses[np.asarray(result.phases) == phase]) <= 0)


def test_the_camera_file_renders_what_was_measured(folder, result, tmp_path):
    """CAMERA.toml applied by `develop` to the RAW gives the picture whose figures were reported."""
    result.camera.save(tmp_path / "camera.toml")
    pair = open_dataset(folder).pairs[0].load()
    developed = develop(pair.raw, Recipe.load(tmp_path / "camera.toml"))
    rendered = orient(result.pairs[0].render, pair.raw.orientation)
    assert psnr(developed[8:-8, 8:-8], rendered[8:-8, 8:-8]) > 35  # only the sub-pixel shift differs
    assert unseen(pair.raw, Recipe.load(tmp_path / "camera.toml")) == []


def test_figures_are_of_disjoint_tiles(folder, result):
    given = example(folder)
    shot = prepare(given)
    masks = split(given.picture, shot.alignment, given.raw.mosaic.shape)
    assert not (masks.fitted & masks.held_out).any()
    assert 0.3 < masks.fitted.mean() < 0.5 and 0.3 < masks.held_out.mean() < 0.5
    assert sum(c.mask.sum() for c in shot.chunks) == masks.fitted.sum()  # all of it, and nothing else
    (pair,) = result.pairs
    inside = np.broadcast_to(masks.held_out[..., None], pair.target.shape)
    assert pair.held_out_psnr == pytest.approx(psnr(pair.render[inside], pair.target[inside]), abs=0.01)
    figures = result.as_dict()
    assert figures["held_out"]["psnr"] == pytest.approx(pair.held_out_psnr)
    needed = {"name", "psnr", "ssim", "held_out_psnr", "held_out_ssim", "shift_px"}
    assert needed <= set(figures["pairs"][0])
    json.dumps(figures, allow_nan=False)


@pytest.mark.slow
def test_a_scene_held_out_is_measured_on_a_camera_that_never_saw_it(folder, result, tmp_path):
    """The reference: a fit of the other pair alone, applied by `develop`."""
    write_pairs(tmp_path, PHONES["a"], {"coffee": scene("coffee", SIZE)})
    first, other = example(folder), dataclasses.replace(example(tmp_path), name="coffee")
    both = fit_examples([first, other], steps=10, **PLAIN, hold_out="scenes")
    assert both.scenes.names == ("astronaut", "coffee")
    alone = fit_examples([other], steps=10, **PLAIN).camera
    shot = prepare(first)
    tiles = split(first.picture, shot.alignment, first.raw.mosaic.shape).held_out
    wanted = psnr(develop(first.raw, alone)[tiles], first.picture[tiles])
    assert both.scenes.psnr[0] == pytest.approx(wanted, abs=0.5)
    figures = both.as_dict()
    assert figures["held_out"]["psnr"] == pytest.approx(np.mean(both.scenes.psnr))
    assert figures["held_out_tiles"]["psnr"] == pytest.approx(np.mean([p.held_out_psnr for p in both.pairs]))
    assert both.scenes.psnr[0] < both.pairs[0].held_out_psnr


def test_of_one_pair_its_halves_are_held_out(folder, result, tmp_path):
    found = fit_examples([example(folder)], steps=3, **PLAIN, hold_out="scenes")
    (psnr,), (ssim,) = found.scenes.psnr, found.scenes.ssim
    assert 20 < psnr < result.pairs[0].held_out_psnr and 0.5 < ssim < 1
    assert "half" in found.as_dict()["held_out"]["how"]
    assert f"{psnr:.2f}" in write_report(found, tmp_path).read_text()
    with pytest.raises(InputError, match="tiles, scenes"):
        fit_examples([example(folder)], hold_out="pairs")


def test_a_known_shift_is_found(folder):
    given = example(folder)
    moved = dataclasses.replace(given, picture=np.roll(given.picture, (2, -3), (0, 1)), jpeg=None)
    shot = prepare(moved)
    assert shot.alignment.dy == pytest.approx(-2, abs=0.15)
    assert shot.alignment.dx == pytest.approx(3, abs=0.15)


def test_known_parameters_are_recovered_and_unknown_ones_named(own, refitted):
    truth, found = own[0], refitted
    assert found.pairs[0].held_out_psnr > 45
    for name in ("saturation.amount", "unsharp_mask.amount"):
        stage, field = name.split(".")
        wanted = float(getattr(truth.prior[stage], field))
        assert float(getattr(found.camera.prior[stage], field)) == pytest.approx(wanted, rel=0.1)
    errors = {p.name: p for p in found.identified}
    assert errors["saturation.amount"].known
    assert "vignetting.a4" in found.unidentified  # nothing in so small a picture tells it from a2
    assert found.camera.meta["not_identified"] == found.unidentified


def test_what_the_encoder_took_is_not_put_down_to_the_camera(own, tmp_path):
    """A coarse JPEG loses detail. Fitted to it as to a picture, sharpening would come out too weak."""
    truth, given = own
    write_jpeg(tmp_path / "coarse.jpg", given.picture, quality=75, subsampling="4:4:4")
    file = read_jpeg(tmp_path / "coarse.jpg")
    coarse = dataclasses.replace(given, picture=file.image, jpeg=file)
    found = fit_examples([coarse], steps=10, **PLAIN)
    mask, wanted = (c.prior["unsharp_mask"] for c in (found.camera, truth))
    assert float(mask.amount) == pytest.approx(1.0, rel=0.1)
    assert float(mask.sigma) == pytest.approx(float(wanted.sigma), rel=0.1)


def test_halved_chroma_is_found_where_no_file_states_it(own, refitted, result):
    _, given = own
    file = io.BytesIO()
    Image.fromarray(np.uint8(np.rint(255 * given.picture))).save(
        file, "JPEG", quality=97, subsampling="4:2:0"
    )
    halved = dataclasses.replace(given, picture=np.float32(Image.open(file)) / 255)
    found = fit_examples([halved], steps=5, **PLAIN).camera.prior["chroma_subsampling"]
    assert found.horizontal > 0.75 and found.vertical > 0.75
    plain = refitted.camera.prior["chroma_subsampling"]
    assert plain.horizontal < 0.2 and plain.vertical < 0.2
    assert "chroma_subsampling" not in result.camera.prior  # its file states it, and the encoder does it


@pytest.mark.slow
def test_the_demosaicker_that_was_used_is_found(own):
    _, given = own
    found = fit_examples([given], steps=3, median="none")
    assert found.design.startswith("malvar,")
    tried = {text.split(",")[0] for text, _ in found.tried if "+" not in text}
    assert {"malvar"} < tried <= {name.removeprefix("demosaic_") for name in model.DEMOSAICKERS}
    assert len(tried) > MOST_TRIALS  # the nearest of the others, and the one that was begun with


@pytest.mark.slow
def test_a_mix_stands_for_a_demosaicker_that_is_none_of_them(own, monkeypatch):
    camera, given = own
    design = model.Design("demosaic_rcd", mixed=("demosaic_ahd_libraw", 0.35))
    mix = model.head(given.raw.cfa, design).nodes[-1]
    nodes = [mix if n.name.startswith("demosaic") else n for n in camera.chain.nodes]
    truth = Recipe(Chain(tuple(nodes)), camera.prior | model.shares(design), meta=camera.meta)
    given = dataclasses.replace(given, picture=develop(given.raw, truth))
    found = fit_examples([given], steps=6, median="none")
    mixed = found.design.split(",")[0]
    assert " with " in mixed and "rcd" in mixed and "ahd_libraw" in mixed
    again = Recipe.from_toml(found.camera.to_toml())
    assert again == found.camera
    assert fit_examples([given], steps=1, median="none", start=again).design.startswith(mixed)

    monkeypatch.setattr("jaxisp.fit.search.MIXED", 0.0)
    refused = fit_examples([given], steps=6, median="none")
    assert any(" with " in text for text, _ in refused.tried) and " with " not in refused.design
    monkeypatch.setattr("jaxisp.fit.search.PARTNERS", 0)
    alone = fit_examples([given], steps=6, median="none")
    assert not any(" with " in text for text, _ in alone.tried)
    assert alone.camera == refused.camera  # the trials leave no trace
    assert found.pairs[0].held_out_psnr > alone.pairs[0].held_out_psnr + 0.5


def test_a_stopped_fit_goes_on_where_it_was(own, refitted, tmp_path):
    _, given = own
    path, steps = tmp_path / "camera.toml.partial", []

    def stop(done, total, text):
        steps.append(done)
        if done == 3:
            raise KeyboardInterrupt

    options = {"steps": 10, **PLAIN}
    with pytest.raises(KeyboardInterrupt):
        fit_examples([given], **options, journal=path, tick=stop)
    assert path.exists()
    again = []
    resumed = fit_examples([given], **options, journal=path, tick=lambda done, *_: again.append(done))
    assert resumed.resumed and not refitted.resumed and path.exists(), "it stays until the result is saved"
    assert len(again) == len(refitted.losses) + 1 - 3  # three were done; one tick more says what is aligned
    for name, values in refitted.camera.prior.items():
        for field, value in vars(values).items():
            np.testing.assert_array_equal(getattr(resumed.camera.prior[name], field), value)
    path.write_text("{broken")
    assert not fit_examples([given], **options | {"steps": 1}, journal=path).resumed


def test_two_fits_into_one_file_give_one_clear_error(own, tmp_path):
    path = tmp_path / "camera.toml.partial"
    with alone(path), pytest.raises(InputError, match="another process is fitting into"):
        fit_examples([own[1]], journal=path)
    assert list(tmp_path.iterdir()) == []


def test_the_best_of_several_starts_is_taken(own):
    _, given = own
    found = fit_examples([given], steps=2, starts=3, **PLAIN)
    begun = {text: value for text, value in found.tried if text.startswith("start")}
    assert list(begun) == ["start 1", "start 2", "start 3"] and len(set(begun.values())) == 3
    assert found.losses[6] < min(begun.values())  # 3 starts of 2 steps, then on from the best
    with pytest.raises(InputError, match="9 starts: there are 1 to 4"):
        fit_examples([given], starts=9)


@pytest.mark.slow
def test_each_image_can_have_its_own_exposure(own):
    _, given = own
    darker = dataclasses.replace(given, name="darker", picture=0.8 * given.picture)
    both = fit_examples([given, darker], per_image=["tone", "exposure"], steps=4, **PLAIN)
    levels = [both.per_image[p.name]["exposure"]["exposure_ev"] for p in both.pairs]
    assert levels[0] != levels[1]
    assert min(p.held_out_psnr for p in both.pairs) > 35
    with pytest.raises(InputError, match="no fitted parameter is named 'sharpness'"):
        fit_examples([given], per_image=["sharpness"])


@pytest.mark.parametrize("orientation", [2, 3])
def test_a_mirrored_or_turned_picture_is_turned_back_and_said_so(own, orientation):
    _, given = own
    turned = dataclasses.replace(given, picture=orient(given.picture, orientation))
    shot = prepare(turned)
    assert shot.orientation == orientation
    assert f"EXIF orientation {orientation}" in shot.notes[0] and "correlation" in shot.notes[0]


def test_a_portrait_blur_is_refused_with_its_figure(tmp_path):
    write_pairs(tmp_path, PHONES["a"], {"portrait": scene("astronaut", (192, 256))})
    given = example(tmp_path)
    background = np.arange(256)[None, :, None] < 112
    blurred = np.where(background, ndimage.gaussian_filter(given.picture, (6, 6, 0)), given.picture)
    portrait = dataclasses.replace(given, name="portrait", picture=blurred, jpeg=None)
    with pytest.raises(InputError, match=r"portrait: .*detail was removed locally.*gone from \d+ % of the"):
        fit_examples([portrait], steps=2, **PLAIN)


def merged(shot):
    """A pair whose picture is brightened here and darkened there."""
    y, x = np.indices(shot.picture.shape[:2])
    gain = 1 + 0.35 * np.sin(y / 22) * np.cos(x / 27)
    picture = np.clip(shot.picture * gain[..., None], 0, 1)
    return dataclasses.replace(shot, name="hdr", picture=picture, jpeg=None)


@pytest.mark.slow
def test_a_merge_of_exposures_is_refused_with_its_figure(own, tmp_path):
    _, given = own
    write_pairs(tmp_path, PHONES["a"], {"hdr": scene("astronaut", (192, 256))})
    options = {"steps": 3, **PLAIN}
    with pytest.raises(InputError, match=r"hdr: .*brightness was changed locally.*levels off"):
        fit_examples([merged(example(tmp_path))], **options)
    found = fit_examples([given, merged(given)], **options)
    assert [p.name for p in found.pairs] == ["astronaut"]
    assert found.failed[0][0] == "hdr" and "left out" in found.failed[0][1]


def test_unknown_choices_are_refused(own):
    with pytest.raises(InputError, match="'demosaic_magic' is no demosaicker; is it demosaic_"):
        fit_examples([own[1]], demosaic="demosaic_magic")
    with pytest.raises(InputError, match="'7x7' is no median"):
        fit_examples([own[1]], median="7x7")


@pytest.mark.parametrize("option", ["freeze", "free", "per_image"])
def test_a_name_that_is_misspelt_is_refused_before_anything_is_read(option):
    def load():
        raise AssertionError("it was read")

    with pytest.raises(InputError, match="named 'vignettting'; is it vignetting"):
        fit_examples([load], **{option: ["vignettting"]})
    with pytest.raises(InputError, match=r"named 'saturation\.amont'; is it saturation\.amount"):
        fit_examples([load], **{option: ["saturation.amont"]})


def test_what_is_fixed_is_so_beside_what_is_anyway():
    start = model.start()
    flags = sharing(
        start, per_image=["exposure"], fixed=["vignetting", "tone"], free=["geometric_distortion.k2"]
    )
    assert {flags["vignetting"].a2, flags["vignetting"].a6, flags["s_curve"].strength} == {FIXED}
    assert flags["denoise_encoding"].gamma == FIXED, "it is by itself"
    assert flags["geometric_distortion"].k2 == flags["bilateral"].luma_sigma_space == CAMERA
    assert flags["exposure"].exposure_ev == IMAGE
    with pytest.raises(InputError, match=r"frozen, and free or per image at once: saturation\.amount"):
        sharing(start, per_image=["colour"], fixed=["saturation"])


def test_a_part_of_the_picture_is_laid_where_it_was_cut(tmp_path):
    """Upright of a wide RAW; one that was resized besides is refused with the sizes."""
    write_pairs(tmp_path, PHONES["a"], {"whole": scene("astronaut", (384, 512))})
    whole = example(tmp_path)
    y, x = 40, 290
    part = dataclasses.replace(whole, picture=whole.picture[y : y + 240, x : x + 208], jpeg=None)
    shot = prepare(part)
    assert shot.alignment.dy == pytest.approx(y + 119.5 - 191.5, abs=0.3)
    assert shot.alignment.dx == pytest.approx(x + 103.5 - 255.5, abs=0.3)
    small = dataclasses.replace(part, picture=cv2.resize(part.picture, None, fx=0.5, fy=0.5))
    with pytest.raises(InputError, match="104x120 px beside a RAW of 512x384 px, is a part that was resized"):
        prepare(small)


def test_another_scene_is_refused_with_its_figure(folder):
    other = example(folder)
    coffee = scene("coffee", SIZE).astype(np.float32) ** (1 / 2.2)
    wrong = dataclasses.replace(other, picture=coffee, jpeg=None)
    with pytest.raises(InputError, match=r"do not show the same scene \(correlation"):
        fit_examples([wrong], steps=1)


def test_one_bad_pair_does_not_stop_the_others(tmp_path, capsys):
    write_pairs(tmp_path, PHONES["a"], {"astronaut": scene("astronaut", SIZE)})
    (tmp_path / "broken.dng").write_bytes((tmp_path / "astronaut.dng").read_bytes()[:3000])
    (tmp_path / "broken.jpg").write_bytes((tmp_path / "astronaut.jpg").read_bytes())
    (tmp_path / "alone.dng").write_bytes((tmp_path / "astronaut.dng").read_bytes())
    (tmp_path / "tiny.dng").write_bytes((tmp_path / "astronaut.dng").read_bytes())
    Image.new("RGB", (8, 8)).save(tmp_path / "tiny.jpg")
    out = tmp_path / "out" / "camera.toml"
    call = ["fit", str(tmp_path), "-o", str(out), "--steps", "2", "--demosaic", "demosaic_malvar"]
    call += ["--median", "none", "--recipe", str(tmp_path / "prior.toml"), "--json"]
    assert main(call) == 2
    printed, errors = capsys.readouterr()
    assert [p["name"] for p in json.loads(printed)["pairs"]] == ["astronaut"]
    assert Recipe.load(out).name == "fitted"
    assert not out.with_name("camera.toml.partial").exists()
    assert Recipe.load(tmp_path / "prior.toml").chain.domain_out.name == "encoded sRGB"
    lines = errors.strip().splitlines()
    assert len(lines) == 3
    assert all(sum(f"{name}.dng" in line for line in lines) == 1 for name in ("broken", "alone"))
    assert sum("tiny: the JPEG has 8x8 px" in line for line in lines) == 1


def test_a_folder_for_an_output_is_refused_before_the_fit(folder, tmp_path, capsys):
    assert main(["fit", str(folder), "-o", str(tmp_path)]) == 2
    assert "is a folder, expected the name of a file" in capsys.readouterr().err


def test_the_report_is_one_file_without_requests(result, tmp_path):
    path = write_report(result, tmp_path / "new folder")
    text = path.read_text()
    assert 'src="data:image/png;base64,' in text and "http" not in text.replace("http-equiv", "")
    assert f"{result.pairs[0].held_out_psnr:.2f}" in text
    rows = parameter_rows(result)
    assert any(name == "bilateral.luma_sigma_space" for name, *_ in rows)


def test_what_no_encoder_models_is_noted(folder):
    given = example(folder)
    odd = dataclasses.replace(given, jpeg=dataclasses.replace(given.jpeg, subsampling="4:1:1"))
    assert not any("encoder" in note for note in prepare(given).notes)
    assert any("JPEG encoder did is not modelled: its chroma sampling 4:1:1" in n for n in prepare(odd).notes)
    raw = dataclasses.replace(given.raw, notes=("its A is not applied", "its B is not applied"))
    stated = prepare(dataclasses.replace(given, raw=raw)).notes
    assert stated == ("RAW: its A is not applied; its B is not applied",)


@pytest.mark.slow
def test_the_encoder_of_a_file_in_display_p3_with_three_tables(folder, tmp_path):
    """It is rendered while the fit runs, and is part of the camera that is saved."""
    given = example(folder)
    icc = profile("P3", COLORANTS["Display P3"], parametric(*SRGB_CURVE))
    data = io.BytesIO()
    tables = [[step] * 64 for step in (6, 12, 300)]
    picture = Image.fromarray(np.rint(given.picture * 255).astype(np.uint8))
    picture.save(data, "JPEG", qtables=tables, subsampling=0, icc_profile=icc)
    jpeg = decode_jpeg(data.getvalue(), "a.jpg")
    wide = dataclasses.replace(given, picture=jpeg.image, jpeg=jpeg)
    result = fit_examples([wide], steps=1, **PLAIN)
    result.camera.save(tmp_path / "camera.toml")
    camera = Recipe.load(tmp_path / "camera.toml")
    assert camera.chain.nodes[-1].fn.__name__ == "jpeg_file"
    np.testing.assert_array_equal(camera.prior["jpeg_tables"].tables[:, 0, 0], (6, 12, 300))
    assert np.isfinite(develop(given.raw, camera)).all()
