"""X-Trans files: read, rendered, and refused where only Bayer will do."""

import numpy as np
import pytest

from jaxisp.camera import develop, exposure_for_highlights, standard_camera
from jaxisp.cfa import XTRANS, shifted
from jaxisp.cli import main
from jaxisp.errors import InputError
from jaxisp.io import open_dataset
from jaxisp.io.description import RawDescription
from jaxisp.io.opcodes import GainMap
from jaxisp.io.raw import _read_other, read_raw
from jaxisp.pipeline import Chain, stage
from jaxisp.recipe import Recipe
from tests.io.samples import NEUTRAL, XYZ_TO_CAMERA, dng
from tests.io.test_raw import refused

CFA = shifted(XTRANS, 4, 1)
AREA, CROP = (3, 2, 47, 62), (5, 7, 36, 49)
"""Top, left, bottom, right in the frame; top, left, height, width in that."""


def colors(shape, cfa=CFA):
    """0, 1, 2 of every pixel."""
    y, x = np.indices(shape)
    return np.array(["RGB".index(c) for c in cfa]).reshape(6, 6)[y % 6, x % 6]


def grey(shape=(50, 66), cfa=CFA):
    """What the sensor sees of grey; the pattern is that of the frame."""
    return np.round(400 * np.array(NEUTRAL)[colors(shape, cfa)] + 64).astype(np.uint16)


def xtrans(path, pixels=None, **options):
    return dng(path, grey() if pixels is None else pixels, **{"cfa": CFA, "black": (64,), **options})


def test_reads_the_mosaic_and_its_pattern(tmp_path):
    pixels = np.random.default_rng(0).integers(40, 1023, (50, 66)).astype(np.uint16)
    raw = read_raw(xtrans(tmp_path / "a.dng", pixels, active_area=AREA, crop=CROP))
    assert raw.cfa == shifted(CFA, *CROP[:2])
    top, left = AREA[0] + CROP[0], AREA[1] + CROP[1]
    want = (pixels[top : top + 36, left : left + 49] - 64.0) / (1023 - 64)
    np.testing.assert_allclose(raw.mosaic, want, atol=1e-6)
    assert not raw.notes


def test_black_levels_of_a_cell_of_six(tmp_path):
    black, (y, x) = np.arange(36), np.indices((30, 43))
    tags = [(50713, 3, 2, (6, 6)), (50714, 3, 36, tuple(map(int, black)))]
    pixels = (500 + black.reshape(6, 6)[y % 6, x % 6]).astype(np.uint16)
    raw = read_raw(xtrans(tmp_path / "a.dng", pixels, extra_tags=tags))
    np.testing.assert_allclose(raw.mosaic, 500 / (1023 - 35), rtol=1e-6)


@pytest.mark.parametrize("crop", [None, CROP])
def test_libraw_tells_the_same_of_files_that_are_no_dng(tmp_path, crop):
    """A RAF goes this way: LibRaw's pattern, levels and sizes."""
    path = xtrans(tmp_path / "a.dng", active_area=AREA, crop=crop)
    raw, want = _read_other(path, None, RawDescription()), read_raw(path)
    top, left = np.subtract(raw.crop[:2], want.crop[:2])
    assert raw.cfa == shifted(want.cfa, top, left)
    height, width = want.mosaic.shape
    np.testing.assert_allclose(raw.mosaic[-top:, -left:][:height, :width], want.mosaic, atol=1e-6)


def test_a_mosaic_without_a_header(tmp_path):
    np.save(tmp_path / "a.raw.npy", grey(cfa=XTRANS))
    (tmp_path / "dataset.toml").write_text(f'[raw]\ncfa = "{XTRANS}"\nblack = 64\nwhite = 1023\n')
    raw = read_raw(tmp_path / "a.raw.npy")
    assert raw.cfa == XTRANS
    np.testing.assert_allclose(raw.mosaic, 400 * np.array(NEUTRAL)[colors((50, 66), XTRANS)] / 959, atol=1e-3)
    (tmp_path / "dataset.toml").write_text(f'[raw]\ncfa = "{XTRANS[1:]}G"\nblack = 64\nwhite = 1023\n')
    with pytest.raises(InputError, match=r"dataset\.toml: \[raw\] cfa = .*letters of X-Trans"):
        read_raw(tmp_path / "a.raw.npy")


def test_shading_goes_by_the_filters(tmp_path):
    """A map of list 3 for blue alone touches blue pixels alone."""
    gains = GainMap(np.full((1, 1, 1), 1.5, np.float32), (0, 0, 44, 60), plane=2, planes=1)
    raw = read_raw(xtrans(tmp_path / "a.dng", active_area=AREA, crop=CROP, opcodes_3=[gains]))
    np.testing.assert_allclose(raw.shading, np.where(colors((36, 49), raw.cfa) == 2, 1.5, 1), rtol=1e-6)


def test_grey_is_rendered_grey(tmp_path):
    """By the plain camera: balanced, demosaicked with the pattern of the crop, exposed by the brightest."""
    pixels = grey(cfa=shifted(CFA, -AREA[0], -AREA[1]))
    raw = read_raw(xtrans(tmp_path / "a.dng", pixels, active_area=AREA, crop=CROP))
    assert exposure_for_highlights(raw) == pytest.approx(np.log2(959 / 400), abs=0.01)
    picture = develop(raw)
    assert picture.shape == (36, 49, 3)
    np.testing.assert_allclose(picture, 1, atol=0.02)


def test_develop_from_the_command_line(tmp_path, capsys):
    path = xtrans(tmp_path / "a.dng")
    assert main(["develop", str(path), "-o", str(tmp_path / "a.png")]) == 0
    assert "66 x 50, X-Trans" in capsys.readouterr().out


def camera(demosaic, **options):
    nodes = (stage("mosaic_white_balance"), stage(demosaic, **options), stage("srgb_oetf"))
    chain = Chain(nodes, "own")
    return Recipe(chain, chain.init(), "", {})


@pytest.mark.parametrize(("demosaic", "needed"), [("demosaic_ahd", "RGGB"), ("demosaicking", "markesteijn")])
def test_a_camera_for_bayer_does_not_render_it(tmp_path, demosaic, needed):
    raw = read_raw(xtrans(tmp_path / "a.dng"))
    with pytest.raises(InputError, match=f"own.*X-Trans.*{needed}"):
        develop(raw, camera(demosaic))


def test_a_camera_for_xtrans_does_not_render_bayer(tmp_path):
    with pytest.raises(InputError, match=r"standard.*must be X-Trans.*RGGB"):
        develop(read_raw(dng(tmp_path / "a.dng")), standard_camera("demosaic_markesteijn"))


def test_a_camera_for_every_pattern_renders_both(tmp_path):
    for path in (xtrans(tmp_path / "a.dng"), dng(tmp_path / "b.dng")):
        assert np.isfinite(develop(read_raw(path), camera("demosaic_normalized_convolution"))).all()


def test_pairs_are_refused(tmp_path):
    """So fits and diagnoses refuse it: both read pairs."""
    from jaxisp.io import write_png

    xtrans(tmp_path / "a.dng", color_matrix=XYZ_TO_CAMERA)
    write_png(tmp_path / "a.png", np.full((50, 66, 3), 0.5, np.float32))
    with pytest.raises(InputError, match=r"a\.dng: is an X-Trans RAW; pairs need a Bayer mosaic"):
        open_dataset(tmp_path).pairs[0].load()


def test_less_than_a_cell_is_refused(tmp_path):
    np.save(tmp_path / "a.raw.npy", grey((5, 40)))
    (tmp_path / "dataset.toml").write_text(f'[raw]\ncfa = "{CFA}"\nblack = 64\nwhite = 1023\n')
    refused(tmp_path / "a.raw.npy", "6 x 6 or more")
