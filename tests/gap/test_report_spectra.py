"""Power spectra and autocorrelations of what a simulator lacks, and how the page draws them."""

import re

import numpy as np
import pytest

from experiments.withheld.shoot import write
from jaxisp.gap import EFFECTS, diagnose
from jaxisp.gap.features.spectra import LAGS, spread, spreads
from jaxisp.gap.report.spectra import lag_maps, spectra_part, spectra_plot, strongest

SHAPE = (4, 96, 120)
ALL = np.ones(SHAPE)
ROW, COLUMN = np.mgrid[: SHAPE[1], : SHAPE[2]]


def white(seed=0, std=3.0):
    return np.random.default_rng(seed).normal(0, std, SHAPE)


def beside(found):
    """The correlations but that of a pixel with itself."""
    return np.delete(found.correlation.ravel(), found.correlation.size // 2)


def test_white_noise_is_flat_and_goes_with_nothing():
    found = spread(white(), ALL)
    assert found.frequency[0] < 0.03 and 0.47 < found.frequency[-1] < 0.5
    np.testing.assert_allclose(found.energy[2:], 9.0, rtol=0.25)
    assert found.energy.mean() == pytest.approx(9.0, rel=0.06)
    assert found.correlation[LAGS, LAGS] == pytest.approx(1.0)
    assert np.abs(beside(found)).max() < 0.03


@pytest.mark.parametrize("across, down", [(0.1, 0.0), (0.0, 0.3), (0.3, 0.27)])
def test_a_wave_stands_at_its_frequency(across, down):
    wave = 5 * np.cos(2 * np.pi * (across * COLUMN + down * ROW)) + np.zeros(SHAPE)
    found = spread(wave, ALL)
    assert found.frequency[found.energy.argmax()] == pytest.approx(np.hypot(across, down), abs=0.5 / 24)
    for rows, columns in ((0, 1), (2, -3), (-4, 0)):
        there = np.cos(2 * np.pi * (across * columns + down * rows))
        assert found.correlation[LAGS + rows, LAGS + columns] == pytest.approx(there, abs=0.05)


def test_neighbours_that_were_averaged_go_together_by_half():
    grains = white()
    found = spread((grains + np.roll(grains, 1, 2)) / 2, ALL)  # two in a row
    assert found.correlation[LAGS, LAGS + 1] == pytest.approx(0.5, abs=0.03)
    assert abs(found.correlation[LAGS + 1, LAGS]) < 0.03 and abs(found.correlation[LAGS, LAGS + 2]) < 0.03
    np.testing.assert_array_equal(found.correlation, found.correlation[::-1, ::-1])
    assert found.energy[-3:].mean() < 0.6 * found.energy[1:4].mean()


def test_what_is_masked_does_not_count():
    weight = ALL.copy()
    weight[:, 30:50] = 0
    weight[0] = 0
    found, spoiled = white(), white()
    spoiled[weight == 0] = np.nan
    assert np.isfinite(spread(spoiled, weight).energy).all()
    np.testing.assert_array_equal(spread(spoiled, weight).energy, spread(found, weight).energy)
    np.testing.assert_array_equal(spread(spoiled, weight).correlation, spread(found, weight).correlation)
    assert spread(found, weight).energy.mean() == pytest.approx(9.0, rel=0.1)
    assert np.abs(beside(spread(found, weight))).max() < 0.04


def test_an_offset_is_no_residual_and_nothing_is_nothing():
    moved = spread(white() + 50 * np.arange(4)[:, None, None], ALL)
    np.testing.assert_allclose(moved.energy, spread(white(), ALL).energy, rtol=1e-6)
    for weight in (ALL, 0 * ALL):
        found = spread(0 * ALL, weight)
        assert (found.energy == 0).all() and (found.correlation == 0).all()


def test_chroma_is_both():
    planes = np.stack([white(0), white(1, 1.0), white(2, 2.0)], -1)
    found = spreads(planes, ALL)
    assert found["luma"].energy.mean() == pytest.approx(9.0, rel=0.06)
    assert found["chroma"].energy.mean() == pytest.approx(2.5, rel=0.06)  # of 1 and 4


def found_in(seed, **more):
    return spreads(np.stack([white(seed)] * 3, -1), ALL)


def test_the_page_shows_what_there_is():
    raw = {"spread_before": found_in(0), "spread_after": None, "spread_floor": found_in(1)}
    part = spectra_part("raw+jpeg", raw)
    assert [len(part[of]) for of in ("luma", "chroma")] == [2, 2]
    text = " ".join(f["plot"] for f in part["luma"])
    assert ">before<" in text and ">floor<" in text and ">after<" not in text
    noisy = spectra_part("clean+noisy", {f"spread_{w}": found_in(0) for w in ("real", "before", "after")})
    text = " ".join(f["plot"] for f in noisy["luma"])
    assert text.index(">real<") < text.index(">simulator before<") < text.index(">after<")
    assert spectra_part("raw+jpeg", {"name": "x"}) is None


def test_curves_are_to_scale():
    frequency = np.array([0.0, 0.25, 0.5])
    svg = spectra_plot({"one": (frequency, np.array([100.0, 10.0, 1.0]))}, ["before"], "of it")
    points = re.search(r'class="line before" points="([^"]+)"', svg)[1]
    (x0, y0), (x1, y1), (x2, y2) = (map(float, p.split(",")) for p in points.split())
    assert x1 == (x0 + x2) / 2 and y1 == pytest.approx((y0 + y2) / 2, abs=0.1) and y0 < y1 < y2
    assert {">100<", ">10<", ">1<"} <= set(re.findall(r">[\d.]+<", svg))
    narrow = spectra_plot({"one": (frequency, np.array([3.0, 2.5, 2.0]))}, ["before"], "of it")
    assert ">2<" in narrow and ">3<" in narrow
    nothing = spectra_plot({"one": (frequency, np.zeros(3))}, ["before"], "of it")
    assert "nan" not in nothing and "inf" not in nothing


def test_maps_have_one_scale():
    one, other = np.eye(3), np.zeros((3, 3))
    one[1, 0] = one[1, 2] = 0.25
    other[1, 1], other[0, 1] = 1.0, -0.5
    one[0, 0] = one[2, 2] = 0.0
    assert strongest([one, other]) == 0.5
    svg = lag_maps({"real": one, "before": other}, "of it")
    first, second = re.findall(r"<g .*?</g>", svg)
    assert first.count("<rect") == second.count("<rect") == 8  # the pixel itself has none
    assert first.count('class="fill" opacity="0.50"') == 2 and 'class="less" opacity="1.00"' in second
    assert ">\N{MINUS SIGN}0.50<" in svg and ">0.50<" in svg
    assert strongest([np.zeros((3, 3))]) == 0.01


@pytest.mark.slow
@pytest.mark.parametrize("kind, other", [("raw+jpeg", "floor"), ("clean+noisy", "real")])
def test_a_diagnosis_has_them(tmp_path, kind, other):
    write(tmp_path, "birch", {"vignetting": 4}, kind, size=128, count=8)  # of 4 low frequencies are rough
    kept = {"vignetting", "film_grain"}
    found = diagnose(tmp_path, exclude=sorted(set(EFFECTS) - kept))
    assert found.causes == ["vignetting"]
    luma = {w: found.pictures[f"spread_{w}"]["luma"] for w in ("before", "after", other)}
    assert all(np.isfinite(own.energy).all() and (own.energy > 0).all() for own in luma.values())
    assert all(own.correlation.shape == (2 * LAGS + 1,) * 2 for own in luma.values())
    if kind == "raw+jpeg":
        assert luma["after"].energy[0] < 0.2 * luma["before"].energy[0], "light falls off slowly"
    else:
        ratio = luma["after"].energy[2:] / luma["real"].energy[2:]
        assert ratio.min() > 0.6 and ratio.max() < 1.6
    page = found.save(tmp_path / "out").read_text()
    assert "Spectrum, luma" in page and "The same for chroma" in page
