"""JPEG+JPEG pairs: what takes the first picture of each pair to the second."""

import io

import cv2
import jax
import numpy as np
import pytest
from PIL import Image

from experiments.withheld.scenes import scenes
from jaxisp.errors import InputError
from jaxisp.gap import EFFECTS, diagnose
from jaxisp.gap.base.two_jpegs import jpeg_case
from jaxisp.gap.pairs.read import aligned_pairs
from jaxisp.gap.report.simulator import simulator_of
from jaxisp.gap.search.verdict import searched
from jaxisp.io import open_dataset
from tests.gap.schema import keeps_the_schema

TRIED = ("sharpening", "saturation", "vignetting")


def sharper(picture):
    """An unsharp mask of luma, blurred by OpenCV."""
    luma = picture @ np.float32([0.299, 0.587, 0.114])
    return np.clip(picture + 0.8 * (luma - cv2.GaussianBlur(luma, (0, 0), 1.2))[..., None], 0, 1)


def richer(picture):
    """Chroma of ITU-R BT.601 scaled."""
    luma = picture @ np.float32([0.299, 0.587, 0.114])
    return np.clip(luma[..., None] + 1.6 * (picture - luma[..., None]), 0, 1)


def write(folder, change, count=4, size=96, quality=(95, 92)):
    """Two JPEGs of each scene, the second changed."""
    for name, light in scenes("one", size, count).items():
        encoded = np.where(light > 0.0031308, 1.055 * light ** (1 / 2.4) - 0.055, 12.92 * light)
        first = np.float32(encoded) * 0.8 + 0.1
        for letter, picture, q in zip("ab", (first, change(first)), quality):
            pixels = Image.fromarray(np.rint(255 * picture).astype(np.uint8))
            pixels.save(folder / f"{name}.{letter}.jpg", quality=q, subsampling=0)
    return folder


def stored(pictures, quality=92):
    """What a JPEG leaves of pictures."""
    found = []
    for picture in pictures:
        file = io.BytesIO()
        Image.fromarray(np.rint(255 * picture).astype(np.uint8)).save(
            file, "JPEG", quality=quality, subsampling=0
        )
        found.append(np.asarray(Image.open(file), np.float32) / 255)
    return np.stack(found)


def case_of(folder, *effects):
    kept = aligned_pairs(open_dataset(folder)).kept
    return jpeg_case(kept, sorted(set(EFFECTS) - set(effects)), lambda *_: None)


@pytest.mark.parametrize(
    ("effect", "change"),
    [("sharpening", sharper), pytest.param("saturation", richer, marks=pytest.mark.slow)],
)
def test_what_changed_is_named(tmp_path, effect, change):
    case = case_of(write(tmp_path, change), *TRIED)
    assert case.kind == "jpeg+jpeg" and case.absorbed == {} and set(case.offered) == set(TRIED)
    found = searched(case, case.gap(), lambda *_: None)
    assert [t.effect for t, _ in found.causes][:1] == [effect]
    assert found.causes[0][0].closed > 0.85
    recipe = simulator_of(case, found.point, [effect])
    pairs = [pair.load() for pair in open_dataset(tmp_path).pairs]
    first, second = (np.stack([getattr(p, name) for p in pairs]) for name in ("clean", "picture"))
    made = np.asarray(recipe.degrade(jax.random.key(0), first)[0])
    # as near as the change itself, stored by Pillow; it has the first file's compression to change too
    own, right = (((x - second) ** 2).mean() for x in (made, stored([*map(change, first)])))
    assert own < 1.1 * right
    assert case.about["headers"]["subsampling"] == ["4:4:4", "4:4:4"]
    assert case.about["headers"]["quality"][1] == pytest.approx(92, abs=1)


def test_the_same_picture_twice_has_no_gap(tmp_path):
    folder = write(tmp_path, lambda p: p, quality=(92, 92))
    found = diagnose(folder, exclude=sorted(set(EFFECTS) - {"sharpening"}))
    report = found.report
    keeps_the_schema(report)
    assert "pairs of two JPEGs" in found.save(tmp_path / "out").read_text()
    assert report["verdict"] == "none" and report["kind"] == "jpeg+jpeg" and report["gap"]["before"] < 0.01


def test_effects_of_a_mosaic_are_not_looked_for(tmp_path):
    case = case_of(write(tmp_path, lambda p: p, count=2, size=64), *EFFECTS)
    assert not {"demosaicking", "crosstalk", "black_level_offset"} & set(case.point.model.effects)
    assert {"white_balance", "color_matrix", "tone_curve", "optical_blur"} <= set(case.offered)
    assert "jpeg_quantization" not in case.offered, "the header states it"


def test_two_jpegs_are_told_from_other_pairs(tmp_path):
    write(tmp_path, lambda p: p, count=2, size=64)
    data = open_dataset(tmp_path)
    assert data.kind == "jpeg+jpeg" and len(data.pairs) == 2 and data.problems == ()
    (tmp_path / "lonely.a.jpg").write_bytes((tmp_path / f"{data.pairs[0].name}.a.jpg").read_bytes())
    assert [path.name for path, _ in open_dataset(tmp_path).problems] == ["lonely.a.jpg"]
    (tmp_path / "dataset.toml").write_text(f'["{data.pairs[0].name}"]\ncamera = "mine"\n')
    assert open_dataset(tmp_path).pairs[0].settings.camera == "mine"
    for path in list(tmp_path.glob("*.a.jpg")):  # beside a RAW it is that RAW's picture
        np.save(path.with_name(path.name.replace(".jpg", ".raw.npy")), np.ones((64, 64), np.float32))
    assert open_dataset(tmp_path).kind == "raw+jpeg"


@pytest.mark.parametrize("option", ["reference", "camera"])
def test_what_two_jpegs_have_no_use_for_is_refused(tmp_path, option):
    folder = write(tmp_path, lambda p: p, count=2, size=64)
    value = folder if option == "reference" else "phone"
    with pytest.raises(InputError, match="first"):
        diagnose(folder, **{option: value})
