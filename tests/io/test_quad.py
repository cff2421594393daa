"""Filters of several pixels each: found, binned and remosaicked, against closed forms."""

import numpy as np
import pytest

from jaxisp.cfa import PATTERNS
from jaxisp.io.opcodes import GainMap
from jaxisp.io.quad import Filters, filters, remosaicked
from jaxisp.io.raw import read_raw
from jaxisp.samples import scene
from tests.io.samples import BLACK, NEUTRAL, WHITE, dng
from tests.io.test_raw import refused

NOT_XTRANS = np.array([[1, 0, 2, 1, 2, 0], [1, 2, 0, 1, 0, 2]] * 3)
GAINS = 1 / np.array(NEUTRAL)


def cell(cfa: str, size: int, start=(0, 0)) -> np.ndarray:
    """The repeated cell of filters the first of which begins at `start`."""
    bayer = np.array(["RGB".index(c) for c in cfa]).reshape(2, 2)
    return np.roll(np.kron(bayer, np.ones((size, size), int)), start, (0, 1))


def quad_dng(path, pixels, filter_cell, **options):
    tags = [
        (33421, 3, 2, filter_cell.shape),
        (33422, 1, filter_cell.size, bytes(filter_cell.ravel().tolist())),
    ]
    options = {"black": (64,), **options}
    return dng(path, pixels, extra_tags=tags, **options)


def colors(shape, filter_cell) -> np.ndarray:
    y, x = np.indices(shape)
    return filter_cell[y % filter_cell.shape[0], x % filter_cell.shape[1]]


@pytest.mark.parametrize("cfa", PATTERNS)
@pytest.mark.parametrize("size", [1, 2, 3, 4])
def test_filters_are_found(cfa, size):
    for start in np.ndindex(size, size):
        own = filters(cell(cfa, size, start))
        assert own == Filters(cfa, size, start)
        for cut in ((0, 0), (1, 2), (5, 3)):
            assert own.after(*cut) == filters(np.roll(cell(cfa, size, start), np.negative(cut), (0, 1)))
    assert filters(np.tile(cell(cfa, size), (2, 1))) == Filters(cfa, size)


def test_what_is_no_bayer_pattern_is_none(tmp_path):
    assert filters(NOT_XTRANS) is None
    assert filters(np.array([[0, 1, 2, 1], [1, 0, 1, 2]] * 2)) is None
    refused(
        quad_dng(tmp_path / "a.dng", np.full((60, 60), 500, np.uint16), NOT_XTRANS),
        "not Bayer or X-Trans (6x6 cell)",
    )


@pytest.mark.parametrize(("size", "start"), [(2, (0, 0)), (2, (1, 0)), (3, (2, 1)), (4, (0, 3))])
@pytest.mark.parametrize("crop", [None, (3, 5, 40, 51)])
def test_binned(tmp_path, size, start, crop):
    """Each filter's mean, in its colour, with its place in the active area, its shading and its noise."""
    area, own = (2, 1, 62, 71), cell("GBRG", size, start)
    shape = area[2] - area[0], area[3] - area[1]
    y, x = np.indices(shape)
    frame = np.zeros((64, 72), np.uint16)
    active = 100 + 100 * colors(shape, own) + y + 2 * x
    frame[area[0] : area[2], area[1] : area[3]] = active
    gains = [GainMap(np.array([[[1.0], [1.0]], [[3.0], [3.0]]]), (0, 0, *shape))]
    path = quad_dng(
        tmp_path / "a.dng", frame, own, active_area=area, crop=crop, gain_map=gains,
        noise_profile=np.array([[1e-3, 1e-6]]),
    )  # fmt: skip
    raw = read_raw(path)
    top, left, height, width = crop or (0, 0, *shape)
    first = [(s - cut) % size for s, cut in zip(start, (top, left))]
    part = active[top : top + height, left : left + width][first[0] :, first[1] :]
    rows, columns = (n // size for n in part.shape)
    # of what the pixels show once their shading is corrected
    gain = 1 + 2 * (np.arange(shape[0])[top : top + height][first[0] :] + 0.5)[:, None] / shape[0]
    shown = (gain * (part - 64) / (WHITE - 64))[: rows * size, : columns * size]
    means = shown.reshape(rows, size, columns, size).mean((1, 3))
    np.testing.assert_allclose(raw.mosaic * raw.shading, means, rtol=1e-5)
    seen = colors(shape, own)[top:, left:][first[0] :: size, first[1] :: size][:2, :2]
    assert raw.cfa == "".join("RGB"[i] for i in seen.ravel())
    np.testing.assert_allclose(raw.noise_profile, [[1e-3 / size**2, 1e-3 / size]] * 3)
    # the map rises from 1 to 3 over the active area: its value in the middle of each filter
    middle = top + first[0] + size * np.arange(rows) + size / 2
    np.testing.assert_allclose(raw.shading[:, 0], 1 + 2 * middle / shape[0], atol=2 * size / shape[0])
    assert len(raw.notes) == 1 and f"{size} x {size} pixels" in raw.notes[0]


def test_a_bayer_pattern_stated_as_a_larger_cell_is_plain(tmp_path):
    pixels = (np.arange(64 * 96).reshape(64, 96) % 900).astype(np.uint16)
    plain = read_raw(dng(tmp_path / "a.dng", pixels, black=BLACK))
    large = read_raw(quad_dng(tmp_path / "b.dng", pixels, np.tile(cell("RGGB", 1), (2, 2)), black=BLACK))
    np.testing.assert_array_equal(large.mosaic, plain.mosaic)
    assert (large.cfa, large.notes) == ("RGGB", ())


def seen(light: np.ndarray, which: np.ndarray) -> np.ndarray:
    """Codes of a mosaic of a balanced picture (H, W, 3)."""
    camera = light / GAINS
    return np.rint(64 + (WHITE - 64) * np.take_along_axis(camera, which[..., None], -1)[..., 0]).astype(
        np.uint16
    )


@pytest.mark.parametrize(("size", "start"), [(2, (0, 0)), (2, (1, 1)), (3, (0, 2)), (4, (0, 0))])
def test_remosaicked_is_exact_on_a_grey_ramp_and_keeps_what_was_measured(tmp_path, size, start):
    own, shape = cell("RGGB", size, start), (64, 96)
    y, x = np.indices(shape)
    light = np.repeat((0.1 + 0.005 * x + 0.004 * y)[..., None], 3, -1)
    pixels = seen(light, colors(shape, own))
    raw = read_raw(quad_dng(tmp_path / "a.dng", pixels, own), quad="remosaic")
    wanted = colors(shape, cell(raw.cfa, 1))
    want = (light / GAINS)[y, x, wanted]
    inside = np.s_[2 * size : -2 * size, 2 * size : -2 * size]
    np.testing.assert_allclose(raw.mosaic[inside], want[inside], atol=2e-3)  # codes are whole numbers
    same = wanted == colors(shape, own)
    assert 0.2 < same.mean() < 0.6
    np.testing.assert_array_equal(raw.mosaic[same], read_as_bayer(tmp_path, pixels)[same])
    flat = read_raw(
        quad_dng(tmp_path / "b.dng", seen(0 * light + 0.3, colors(shape, own)), own), quad="remosaic"
    )
    np.testing.assert_allclose(flat.mosaic, 0.3 / GAINS[wanted], atol=1.1e-3)


@pytest.mark.parametrize(("size", "start"), [(2, (0, 0)), (2, (1, 1)), (3, (0, 2)), (4, (3, 0))])
@pytest.mark.parametrize("shape", [(64, 96), (37, 51)])
def test_ramps_are_exact_up_to_the_borders(size, start, shape):
    own = Filters("GRBG", size, start)
    y, x = np.indices(shape)
    light = (0.1 + 0.005 * x - 0.002 * y)[..., None] / GAINS
    pixels = np.take_along_axis(light, colors(shape, cell("GRBG", size, start))[..., None], -1)[..., 0]
    mosaic, cfa = remosaicked(pixels.astype(np.float32), own, GAINS)
    np.testing.assert_allclose(mosaic, light[y, x, colors(shape, cell(cfa, 1))], atol=1e-6)


@pytest.mark.parametrize("pitch", [1, 2, 4])
@pytest.mark.parametrize("quad", ["bin", "remosaic"])
def test_shading_is_corrected_before_pixels_are_compared(tmp_path, quad, pitch):
    """A grey wall behind a steep lens is level; maps for single pixels of a filter count too."""
    shape, own = (64, 96), cell("RGGB", 2)
    y, x = np.indices(shape)
    points = np.array([[1.0, 2.0, 1.5], [3.0, 1.0, 2.5]])
    grid = [np.clip((np.arange(n) + 0.5) / n * (m - 1), 0, m - 1) for n, m in zip(shape, points.shape)]
    down, across = (np.maximum(0, 1 - np.abs(g[:, None] - np.arange(m))) for g, m in zip(grid, points.shape))
    gain = down @ points @ across.T
    each = 1 + 0.1 * ((y % pitch) + 2 * (x % pitch))  # pixels of a filter under lenses of their own
    maps = [
        GainMap(points[..., None] * (1 + 0.1 * (i + 2 * j)), (i, j, *shape), (pitch, pitch), (0, 0), (1, 0.5))
        for i in range(pitch)
        for j in range(pitch)
    ]
    light = np.repeat((0.25 / (gain * each))[..., None], 3, -1)
    path = quad_dng(tmp_path / "a.dng", seen(light, colors(shape, own)), own, gain_map=maps)
    raw = read_raw(path, quad=quad)
    shown = raw.mosaic * (1 if raw.shading is None else raw.shading)
    assert (raw.shading is None) == (pitch > 1)
    wanted = colors(shown.shape, cell(raw.cfa, 1))
    np.testing.assert_allclose(shown * GAINS[wanted], 0.25, atol=4 * 3.0 / (WHITE - 64) * 1.6)
    rms = np.sqrt(np.square(shown * GAINS[wanted] - 0.25).mean())
    assert rms < 1.5e-3  # that of whole codes, under gains of up to 4.8
    assert len(raw.notes) == 1


def test_shading_of_the_demosaicked_picture(tmp_path):
    """OpcodeList3 has a gain for each colour."""
    shape, own = (64, 96), cell("GBRG", 3, (1, 2))
    gains = np.array([[[2.0, 1.0, 1.5]], [[1.0, 1.5, 3.0]]])
    y = (np.arange(shape[0]) + 0.5)[:, None, None] / shape[0]
    full = np.broadcast_to((1 - y) * gains[0] + y * gains[1], (*shape, 3))
    maps = [GainMap(gains, (0, 0, *shape), planes=3)]
    path = quad_dng(tmp_path / "a.dng", seen(0.3 / full, colors(shape, own)), own, opcodes_3=maps)
    for quad in ("bin", "remosaic"):
        raw = read_raw(path, quad=quad)
        wanted = colors(raw.mosaic.shape, cell(raw.cfa, 1))
        np.testing.assert_allclose(raw.mosaic * raw.shading * GAINS[wanted], 0.3, atol=8e-3)


def read_as_bayer(folder, pixels):
    return read_raw(dng(folder / "bayer.dng", pixels, black=(64,))).mosaic


def test_remosaicked_keeps_detail(tmp_path):
    """Against the mosaic that plain filters would have seen: closer than local means of the colour."""
    light = scene("astronaut", (128, 128)) * 0.9
    own = cell("RGGB", 2)
    raw = read_raw(quad_dng(tmp_path / "a.dng", seen(light, colors((128, 128), own)), own), quad="remosaic")
    y, x = np.indices((128, 128))
    want = (light / GAINS)[y, x, colors((128, 128), cell(raw.cfa, 1))]
    binned = read_raw(tmp_path / "a.dng")
    means = np.zeros((128, 128))
    for i in range(4):
        row, column = divmod(i, 2)
        plane = np.kron(binned.mosaic[row::2, column::2], np.ones((4, 4)))
        means[row::2, column::2] = plane[row::2, column::2]
    error, usual = (np.sqrt(np.square(m - want)[8:-8, 8:-8].mean()) for m in (raw.mosaic, means))
    assert error < 0.5 * usual


def test_strips_of_rows_make_the_whole(monkeypatch, rng):
    light = rng.uniform(size=(50, 40)).astype(np.float32)
    for own in (Filters("GRBG", 2, (1, 0)), Filters("RGGB", 3, (2, 1))):
        whole, _ = remosaicked(light, own, GAINS)
        monkeypatch.setattr("jaxisp.io.quad._STRIP", 7)
        parts, _ = remosaicked(light, own, GAINS)
        monkeypatch.undo()
        np.testing.assert_allclose(parts, whole, atol=1e-6)


def test_other_words_are_refused(tmp_path):
    with pytest.raises(ValueError, match="bin or remosaic"):
        read_raw(tmp_path / "a.dng", quad="average")
