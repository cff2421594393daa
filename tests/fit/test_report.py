"""The report of a fit: what it marks, tells apart and draws, of results made by hand."""

import matplotlib.pyplot as plt
import numpy as np
import pytest

from jaxisp.cli import fit as command
from jaxisp.fit.curvature import KNOWN, Identified
from jaxisp.fit.model import tone
from jaxisp.fit.report import doubts, in_common, parameter_rows, phases, without, write_report
from jaxisp.fit.result import FitResult, PairResult
from jaxisp.pipeline import Chain, stage
from jaxisp.recipe import Recipe
from jaxisp.stages.optics import GeometricDistortion, LateralChromaticAberration
from jaxisp.stages.tone import ZoneCurve

COMMON = "denoised in camera RGB, distortion and lateral colour"
FIRST, CHOICES, LAST = [1.0, 0.5, 0.05, 0.04], [0.039, 0.06, 0.038, 0.037], [0.99, 0.8, 0.79]


def found(name, value, error):
    return Identified(name, value, error, error <= KNOWN)


def made(**more):
    """Of a camera of three stages: k1 near zero, a scale near one, seven zones."""
    chain = Chain(
        tuple(map(stage, ("lateral_chromatic_aberration", "geometric_distortion", "zone_curve"))), "camera"
    )
    prior = {
        "lateral_chromatic_aberration": LateralChromaticAberration(red_scale=1.0002978, blue_scale=1.0),
        "geometric_distortion": GeometricDistortion(k1=0.00018, k2=-0.0),
        "zone_curve": ZoneCurve(offsets=np.array([0.1, -0.2, 0.0])),
    }
    given = {
        "losses": np.array(FIRST + CHOICES + LAST),
        "phases": ("first",) * 4 + tuple("abcd") + ("last 1",) * 3,
        "design": f"malvar, median 3x3, {COMMON}",
        "tried": list(
            zip(
                [f"malvar, {COMMON}", f"ahd, {COMMON}", f"malvar, {COMMON}", f"malvar, median 3x3, {COMMON}"],
                CHOICES,
            )
        ),
        "identified": [
            found("lateral_chromatic_aberration.red_scale", 1.0002978, 6e-5),
            found("geometric_distortion.k1", 0.00018, 0.0016),
            *(found(f"zone_curve.offsets[{i}]", 0, e) for i, e in enumerate((0.01, 0.3, 0.02))),
        ],
    }
    given |= {"camera": Recipe(chain, prior, "fitted"), "pairs": []}
    return FitResult(seconds=1.0, **(given | more))


def row_of(result, name):
    (row,) = [row for row in parameter_rows(result) if row[0] == name]
    return row


def test_an_entry_that_is_not_identified_is_marked():
    assert row_of(made(), "zone_curve.offsets")[1] == "[0.1, -0.2 (not identified), 0]"


def test_a_vector_of_which_nothing_is_identified_is_marked_once():
    result = made(identified=[found(f"zone_curve.offsets[{i}]", 0, 0.3) for i in range(3)])
    assert row_of(result, "zone_curve.offsets")[1] == "[0.1, -0.2, 0] (not identified)"
    assert doubts(result) == "Not to be believed: not identified by these pairs: zone_curve.offsets."


def test_the_page_says_what_is_not_to_be_believed_after_the_result(tmp_path):
    result = made(at_bound=["geometric_distortion.k1"])
    said = (
        "Not to be believed: not identified by these pairs: zone_curve.offsets[1]; "
        "at a bound: geometric_distortion.k1."
    )
    assert doubts(result) == said
    text = write_report(result, tmp_path).read_text()
    assert said in text[text.index("What not to rely on") :]
    assert "0 pairs in 1 s" in text[: text.index("<h2>")] and said not in text[: text.index("<h2>")]
    assert row_of(result, "geometric_distortion.k1")[1] == "0.00018 (at a bound)"
    assert doubts(made(identified=[])) == ""


@pytest.mark.parametrize("bound", [[], ["zone_curve.offsets"]])
def test_the_command_names_what_is_at_a_bound(bound, capsys):
    command._print(made(at_bound=bound), "camera.toml")
    lines = capsys.readouterr().out.splitlines()
    assert "not identified by these pairs: zone_curve.offsets[1]" in lines
    assert [line for line in lines if "bound" in line] == [f"at a bound: {name}" for name in bound]


def test_small_values_and_scales_show_their_digits():
    result = made()
    assert row_of(result, "geometric_distortion.k1")[1] == "0.00018"
    assert row_of(result, "geometric_distortion.k2")[1:3] == ("0", "not fitted")
    assert row_of(result, "lateral_chromatic_aberration.red_scale")[1] == "1.0003"


def test_an_error_says_what_it_is_relative_to():
    assert row_of(made(), "geometric_distortion.k1")[2] == "0.2 % of 0.1"  # nine tenths of the value
    assert row_of(made(), "zone_curve.offsets")[2] == "30.0 % of 0.2"
    assert row_of(made(), "lateral_chromatic_aberration.red_scale")[2] == "0.006 % of 1"


def test_what_each_image_has_of_its_own_is_not_called_unfitted():
    own = {name: {"zone_curve": {"offsets": [v, 0, 0]}} for name, v in (("a", 0.1), ("b", 0.2))}
    assert row_of(made(identified=[], per_image=own), "zone_curve.offsets")[2] == "each image's own"
    assert row_of(made(identified=[]), "zone_curve.offsets")[2] == "not fitted"


def test_choices_are_told_apart_by_what_differs(tmp_path):
    assert in_common([text for text, _ in made().tried]) == COMMON.split(", ")
    medians = ["malvar", "malvar, median cross"]
    assert [without(text, in_common(medians)) for text in medians] == ["nothing else", "median cross"]
    text = write_report(made(), tmp_path).read_text()
    assert text.count(COMMON) == 1 and "In the end" not in text
    assert ">malvar, median 3x3 (chosen)<" in text and text.count("(chosen)") == 1
    assert text.count(">malvar<") == 1


@pytest.mark.parametrize("order", [1, -1])
def test_of_a_choice_that_was_tried_again_the_best_is_shown(order, tmp_path):
    text = write_report(made(tried=made().tried[::order]), tmp_path).read_text()
    assert ">0.03800<" in text and ">0.03900<" not in text


def test_a_lens_that_was_left_out_at_last_is_said(tmp_path):
    ended = "malvar, median 3x3, denoised in camera RGB"
    text = write_report(made(design=ended), tmp_path).read_text()
    assert f"In the end: {ended}." in text and ">malvar, median 3x3 (chosen)<" in text


def test_the_best_start_is_marked(tmp_path):
    tried = [("start 1", 0.5), ("start 2", 0.04), *made().tried]
    text = write_report(made(tried=tried), tmp_path).read_text()
    assert ">start 1<" in text and ">start 2 (chosen)<" in text and text.count(COMMON) == 1


def test_where_nothing_was_tried_the_design_is_told(tmp_path):
    result = made(
        tried=[], losses=np.zeros(0), phases=()
    )  # as of a fit that went on where all steps were done
    text = write_report(result, tmp_path).read_text()
    assert f"<p>{result.design}.</p>" in text and "a panel a phase" not in text


def test_phases_have_the_steps_that_were_done_in_them():
    parts = [(name, first, list(values)) for name, first, values in phases(made())]
    assert parts == [("first", 1, FIRST), ("last 1", 9, LAST)]  # choices have a step each


def test_each_phase_has_a_panel_with_its_own_scale(tmp_path, monkeypatch):
    figures = []
    monkeypatch.setattr(plt, "close", figures.append)
    write_report(made(), tmp_path)
    (first, last) = figures[0].axes
    assert first.get_yscale() == "log" and last.get_yscale() == "linear"
    assert first.get_ylim()[1] > 0.9 and 0.7 < last.get_ylim()[0] < last.get_ylim()[1] < 1.1
    assert list(last.lines[0].get_xdata()) == [9, 10, 11] and last.get_title() == "last 1"


def pair(**figures):
    flat = np.full((8, 8, 3), 0.5, np.float32)
    levels = [{"level": x, "blocks": 9, "std": [0.01 * x, 0.012 * x], "lag1": [0.2, 0.3]} for x in (0.2, 0.7)]
    noise = {kind: {"by_level": levels} for kind in ("luma", "chroma")}
    return PairResult(
        "a", 39.0, 0.96, 38.5, 0.95, (0.0, 0.1), flat, flat, flat, **({"noise": noise} | figures)
    )


def test_the_page_opens_with_its_result_and_draws_noise_and_tone(tmp_path):
    plain = write_report(made(pairs=[pair(noise={})]), tmp_path).read_text()
    lead = plain[: plain.index("<h2>")]
    assert "38.50 dB, SSIM 0.9500 held out" in lead and "1 pair in 1 s" in lead
    camera = Recipe(Chain((*made().camera.chain.nodes[:2], *tone().nodes), "camera"), {}, "fitted")
    drawn = write_report(made(pairs=[pair()], camera=camera), tmp_path).read_text()
    assert drawn.count("data:image/png") == plain.count("data:image/png") + 3
    assert "tone curve on encoded levels" in drawn and "lag-1 autocorrelation of the noise by" in drawn


def test_pictures_enlarge_without_a_script(tmp_path):
    text = write_report(made(pairs=[pair()]), tmp_path).read_text()
    assert text.count('<input type="checkbox" class="zoom"') == text.count("<img ") > 0
    assert "<script" not in text
