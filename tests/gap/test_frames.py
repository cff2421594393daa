"""Frames of one scene, of a camera that shares no code with the package: what stays in all of them, and what
changes from one to the next.

The pattern is written here: those of the study are kept for it.
"""

import cv2
import numpy as np
import pytest

from experiments.withheld.bodies import BODIES
from experiments.withheld.camera import DISTRIBUTIONS, Effect, Shot, before_body, compressed, develop, expose
from experiments.withheld.numeric import srgb_encode
from experiments.withheld.scenes import scenes
from jaxisp.gap import EFFECTS, diagnose
from jaxisp.gap.pairs.scenes import by_scene
from tests.gap.schema import keeps_the_schema

BODY = BODIES["alder"]
TRIED = ("prnu", "column_noise", "row_noise")


def pixel_gains(mosaic, amount, shot):
    return mosaic * (1 + amount * np.random.default_rng(5).normal(size=mosaic.shape))


def drifting_black(mosaic, amount, shot):
    return mosaic + amount * (1 if shot.frame else -1)


def diagnosed(folder, what, amount):
    effect = Effect("mine", "", (amount,) * 5, {DISTRIBUTIONS: {"sites": what}})
    for name, scene in scenes("one", 128, 4).items():
        seen = before_body(scene, BODY)
        clean = np.rint(255 * srgb_encode(seen)).astype(np.uint8)
        cv2.imwrite(str(folder / f"{name}.clean.png"), clean[..., ::-1])
        for frame in range(2):
            shot = Shot(BODY, DISTRIBUTIONS, ((effect, 1),), name, frame=frame)
            picture = develop(expose(seen, shot), shot)
            file = compressed(picture, BODY.quality, BODY.sampling, BODY.encoder)
            (folder / f"{name}.f{frame:02d}.jpg").write_bytes(file)
    (folder / "dataset.toml").write_text(f'[raw]\ncfa = "{BODY.cfa}"\n')
    report = diagnose(folder, exclude=sorted(set(EFFECTS) - set(TRIED))).report
    keeps_the_schema(report)
    return report


@pytest.mark.slow
def test_a_fixed_pattern_is_named(tmp_path):
    report = diagnosed(tmp_path, pixel_gains, 0.03)
    assert report["where"][0]["axis"] == "fixed_pattern"
    first = report["causes"][0]
    assert len(report["causes"]) == 1, "noise that changes from frame to frame is the base's"
    assert first["effect"] == "prnu" and first["alternatives"] == []
    assert first["params"]["std"] == pytest.approx(0.03, rel=0.2)
    sides = [{name.split(".")[0] for name in report["pairs"][side]} for side in ("fit", "held_out")]
    assert [len(report["pairs"][side]) for side in ("fit", "held_out")] == [4, 4]
    assert not sides[0] & sides[1], "frames of a scene stay on one side"


@pytest.mark.slow
def test_what_drifts_from_frame_to_frame_is_a_gap_of_frames(tmp_path):
    """No effect does so; on average over a scene's frames nothing is missing."""
    report = diagnosed(tmp_path, drifting_black, 0.01)
    assert report["where"][0]["axis"] == "frame" and report["where"][0]["share"] > 0.5
    assert report["verdict"] == "unknown" and report["unexplained"]["axes"][0] == "frame"


def test_intervals_are_over_scenes_and_their_frames():
    values = np.arange(5.0)[:, None]
    found = by_scene(values, ["a.f00", "a.f01", "b", "c.f00", "c.f01"])
    np.testing.assert_array_equal(found, [[0, 1], [2, np.nan], [3, 4]])
    np.testing.assert_array_equal(by_scene(values[:2], ["a", "b"]), values[:2])
    tiles = np.arange(6.0).reshape(3, 2)
    np.testing.assert_array_equal(
        by_scene(tiles, ["a", "a.f00", "b"]), [[0, 1, 2, 3], [4, 5, np.nan, np.nan]]
    )
