import numpy as np
import pytest

from jaxisp.gap.case import Gap
from jaxisp.gap.criteria import CRITERIA
from jaxisp.gap.search.account import Shown, accounted, kept_axes

CLEAN, RAW = "clean+noisy", "raw+jpeg"


def pixels(error, p_value=0.005, **shares):
    return Shown(error, [{"axis": axis, "share": s, "p_value": p_value} for axis, s in shares.items()])


def statistics(distance=0.0, noise=1.0, **squares):
    """One statistic an axis, its square in units."""
    whole = sum(squares.values())
    rows = [
        {"axis": a, "share": s / whole, "p_value": 0.0, "bins": ["corr Y"], "profile": [np.sqrt(s)]}
        for a, s in squares.items()
    ]
    return Shown(1.0 + whole, rows, distance, noise)


@pytest.mark.parametrize(
    ("kind", "gap", "left", "said"),
    [
        (RAW, 11.0, 4.2, True), (RAW, 11.0, 4.4, False), (RAW, 3.0, 1.4, True), (RAW, 2.0, 1.6, False),
        (CLEAN, 2.0, 1.25, True), (CLEAN, 3.0, 1.35, False),
        (CLEAN, 8.0, 1.9, True), (CLEAN, 6.5, 1.9, False),
        (CLEAN, 30.0, 3.0, True), (CLEAN, 30.0, 3.1, False),
    ],
)  # fmt: skip
def test_causes_close_most_of_the_gap_or_leave_little(kind, gap, left, said):
    """The more is left, the more they must close."""
    states = (
        (pixels(10.0, edge=0.5), pixels(5.0, edge=0.1))
        if kind == RAW
        else (statistics(row=9.0), statistics(row=1.0))
    )
    assert accounted(CRITERIA[kind], ["row_noise"], *states, Gap(gap, 1.0), left) == said


@pytest.mark.parametrize(("distance", "said"), [(41.0, False), (39.0, True)])
def test_what_brings_pixels_nearer_may_leave_more_of_the_statistics(distance, said):
    """A filter of another form than the camera's; strangers bring pixels a fifth nearer at most."""
    states = statistics(50.0, 40.0, edge=9.0), statistics(distance, 40.0, edge=1.0)
    assert accounted(CRITERIA[CLEAN], ["luma_denoising"], *states, Gap(31.0, 1.0), 9.0) == said
    assert not accounted(CRITERIA[CLEAN], ["luma_denoising"], *states, Gap(31.0, 1.0), 12.0)


BEFORE = pixels(12.0, frequency=0.5, orientation=0.25, lag=0.2, hue=0.05, radius=0.2)


@pytest.mark.parametrize(
    ("after", "floor", "kept"),
    [
        (pixels(4.0, frequency=0.25, orientation=0.2), 2.0, []),  # less than three tenths of what it was
        (pixels(4.0, frequency=0.25, orientation=0.3), 2.0, ["orientation"]),
        (pixels(4.0, frequency=0.25, orientation=0.3), 9.0, []),  # little beside the floor
        (pixels(4.0, 0.2, orientation=0.3), 2.0, []),  # by chance
        (pixels(4.0, lag=0.6, hue=0.15), 2.0, []),  # of form; small before
        (pixels(4.0, radius=0.9), 2.0, []),  # where the cause itself shows
    ],
)
def test_an_axis_that_the_gap_lay_on_is_left_by_a_stranger(after, floor, kept):
    assert kept_axes(CRITERIA[RAW], ["vignetting"], BEFORE, after, Gap(floor + 10, floor)) == kept
    assert accounted(CRITERIA[RAW], ["vignetting"], BEFORE, after, Gap(floor + 10, floor), floor) == (
        not kept
    )


@pytest.mark.parametrize(
    ("distance", "left", "noise", "said"),
    [
        (60.0, 36.0, 10.0, False),
        (60.0, 34.0, 10.0, True),
        (38.0, 38.0, 10.0, True),
        (60.0, 36.0, 15.0, True),  # the base had less noise than the camera: it was hardly off
    ],
)
def test_pictures_that_were_off_by_more_than_noise_come_nearer(distance, left, noise, said):
    before, after = statistics(distance, 10.0, edge=30.0), statistics(left, noise, edge=2.0)
    assert accounted(CRITERIA[CLEAN], [], before, after, Gap(31.0, 1.0), 2.4) == said


def test_of_statistics_only_place_and_direction_must_go():
    """Flicker is rows; grain closes most of what else it makes."""
    before = statistics(frequency=60.0, row=30.0, edge=10.0)
    after = statistics(frequency=5.0, row=20.0, edge=9.0)
    gap = Gap(100.0, 1.0)
    assert kept_axes(CRITERIA[CLEAN], ["film_grain"], before, after, gap) == ["row"]
    assert kept_axes(CRITERIA[CLEAN], ["row_noise"], before, after, gap) == []
    assert not accounted(CRITERIA[CLEAN], ["film_grain"], before, after, gap, 5.0)
    nearly = statistics(frequency=5.0, row=14.0, edge=9.0)  # less than half of it
    assert accounted(CRITERIA[CLEAN], ["film_grain"], before, nearly, gap, 5.0)
    none = statistics(row=1.0)._replace(error=1.01)  # all of what is left, which is nothing
    assert kept_axes(CRITERIA[CLEAN], ["film_grain"], before, none, gap) == []
