import numpy as np
import pytest

from jaxisp.gap.account import Shown, accounted, kept_axes, misfit

CLEAN, RAW = "clean+noisy", "raw+jpeg"


def pixels(error, p_value=0.005, **shares):
    return Shown(error, [{"axis": axis, "share": s, "p_value": p_value} for axis, s in shares.items()])


def statistics(bias=0.0, noise=1.0, **squares):
    """One statistic an axis, its square in units."""
    rows = [{"axis": a, "bins": ["corr Y"], "profile": [np.sqrt(s)]} for a, s in squares.items()]
    return Shown(1.0, rows, bias, noise)


@pytest.mark.parametrize(
    ("kind", "left", "enough", "said"),
    [(CLEAN, 5.0, 0.5, True), (CLEAN, 5.1, 0.5, False), (CLEAN, 7.0, 9.0, True), (RAW, 3.0, 0.5, True),
     (RAW, 4.0, 0.5, False)],
)  # fmt: skip
def test_causes_close_most_of_the_gap_or_leave_none(kind, left, enough, said):
    one = statistics(row=9.0), statistics(row=1.0)
    two = pixels(10.0, edge=0.5), pixels(5.0, edge=0.1)
    assert accounted(kind, *(two if kind == RAW else one), 10.0, left, enough) == said


def test_an_axis_that_the_gap_lay_on_is_left_by_a_stranger():
    before = pixels(12.0, frequency=0.5, orientation=0.25, lag=0.2, hue=0.05)
    assert kept_axes(before, pixels(4.0, frequency=0.25, orientation=0.2), 10.0) == []
    assert kept_axes(before, pixels(4.0, frequency=0.25, orientation=0.3), 10.0) == ["orientation"]
    assert kept_axes(before, pixels(4.0, 0.2, orientation=0.3), 10.0) == []  # by chance
    assert kept_axes(before, pixels(4.0, lag=0.6, hue=0.15), 10.0) == []  # of form; small before
    assert not accounted(RAW, before, pixels(4.0, orientation=0.3), 10.0, 1.0, 5.0)


def test_what_closes_the_largest_part_and_spoils_the_rest_does_not_account_for_it():
    before = statistics(frequency=40.0, row=5.0, radius=1.0, intensity=1.0)
    assert misfit(before.rows) == pytest.approx(np.log(200))
    assert accounted(CLEAN, before, statistics(frequency=4.0, row=2.0, radius=1.0), 40.0, 4.0, 1.0)
    spoilt = statistics(frequency=4.0, row=5.0, radius=4.0, intensity=3.0)
    assert not accounted(CLEAN, before, spoilt, 40.0, 4.0, 1.0)
    assert not accounted(CLEAN, before, spoilt, 40.0, 0.6, 1.0)
    assert accounted(
        CLEAN, before, spoilt, 40.0, 0.4, 1.0
    )  # so near the floor that there is nothing to spoil


def test_statistics_of_one_group_are_averaged():
    rows = [{"axis": "edge", "bins": ["mean a", "mean b", "logvar Y"], "profile": [3.0, 1.0, 2.0]}]
    assert misfit(rows) == pytest.approx(np.log(5) + np.log(4))


@pytest.mark.parametrize(("bias", "left", "said"), [(20.0, 11.0, False), (20.0, 9.0, True), (8.0, 8.0, True)])
def test_pictures_that_were_off_by_more_than_noise_come_nearer(bias, left, said):
    before, after = statistics(bias, 10.0, edge=30.0), statistics(left, 10.0, edge=2.0)
    assert accounted(CLEAN, before, after, 30.0, 2.0, 1.0) == said
