import numpy as np
import pytest

from jaxisp.gap.account import Shown, accounted, kept_axes, misfit
from jaxisp.gap.measured import Gap

CLEAN, RAW = "clean+noisy", "raw+jpeg"


def pixels(error, p_value=0.005, **shares):
    return Shown(error, [{"axis": axis, "share": s, "p_value": p_value} for axis, s in shares.items()])


def statistics(bias=0.0, noise=1.0, **squares):
    """One statistic an axis, its square in units."""
    rows = [{"axis": a, "bins": ["corr Y"], "profile": [np.sqrt(s)]} for a, s in squares.items()]
    return Shown(1.0, rows, bias, noise)


@pytest.mark.parametrize(
    ("kind", "left", "excess", "said"),
    [(CLEAN, 6.0, 0.5, True), (CLEAN, 6.1, 0.5, False), (CLEAN, 8.0, 9.0, True), (RAW, 4.2, 0.5, True),
     (RAW, 4.4, 0.5, False), (RAW, 4.4, 4.0, True)],
)  # fmt: skip
def test_causes_close_most_of_the_gap_or_leave_none(kind, left, excess, said):
    one = statistics(row=9.0), statistics(row=1.0)
    two = pixels(10.0, edge=0.5), pixels(5.0, edge=0.1)
    states = two if kind == RAW else one
    assert accounted(kind, ["row_noise"], *states, Gap(11.0, 1.0), left, excess) == said


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
    assert kept_axes(["vignetting"], BEFORE, after, Gap(floor + 10, floor)) == kept
    assert accounted(RAW, ["vignetting"], BEFORE, after, Gap(floor + 10, floor), floor, 0.5) == (not kept)


def test_what_closes_the_largest_part_and_spoils_the_rest_does_not_account_for_it():
    before = statistics(frequency=40.0, row=5.0, radius=1.0, intensity=1.0)
    assert misfit(before.rows) == pytest.approx(np.log(200))

    def said(after, left):
        return accounted(CLEAN, ["film_grain"], before, after, Gap(41.0, 1.0), left, 2.0)

    assert said(statistics(frequency=4.0, row=2.0, radius=1.0), 6.0)
    spoilt = statistics(frequency=4.0, row=5.0, radius=4.0, intensity=3.0)
    assert not said(spoilt, 6.0)
    assert said(spoilt, 2.4)  # so near the floor that there is nothing to spoil
    assert accounted(CLEAN, [], before, spoilt, Gap(141.0, 1.0), 8.0, 2.0)  # or all but closed
    assert not accounted(CLEAN, [], before, spoilt, Gap(141.0, 1.0), 8.1, 2.0)


def test_statistics_of_one_group_are_averaged():
    rows = [{"axis": "edge", "bins": ["mean a", "mean b", "logvar Y"], "profile": [3.0, 1.0, 2.0]}]
    assert misfit(rows) == pytest.approx(np.log(5) + np.log(4))


@pytest.mark.parametrize(("bias", "left", "said"), [(20.0, 11.0, False), (20.0, 9.0, True), (8.0, 8.0, True)])
def test_pictures_that_were_off_by_more_than_noise_come_nearer(bias, left, said):
    before, after = statistics(bias, 10.0, edge=30.0), statistics(left, 10.0, edge=2.0)
    assert accounted(CLEAN, [], before, after, Gap(31.0, 1.0), 3.0, 1.0) == said
