"""What a RAW file's header says of its lens is put before the pairs, not inferred."""

import dataclasses
from collections.abc import Sequence
from importlib import import_module
from pathlib import Path

import cv2
import numpy as np
import pytest
from PIL import Image
from scipy import ndimage

from experiments.withheld.scenes import scenes
from jaxisp.gap.base.raw_jpeg import raw_case
from jaxisp.gap.pairs.align_raw import Aligned, align_raw
from jaxisp.gap.pairs.headers import of_one_sampling, stated_warp
from jaxisp.gap.report.document import _aligned
from jaxisp.gap.simulator.effects import EFFECTS
from jaxisp.io import read_raw
from jaxisp.io.datasets import open_dataset
from jaxisp.io.dng import write_dng
from jaxisp.io.opcodes import FixVignetteRadial, Opcode, WarpRectilinear

SIZE = 128
EARLIER = (3, 5)
TERMS = np.array(
    [[1.004, -0.03, 0.008, 0, 0.002, -0.001], [1, -0.03, 0.008, 0, 0.002, -0.001], [1, -0.032, 0, 0, 0, 0]]
)
WARP = WarpRectilinear(TERMS, (0.52, 0.47))
VIGNETTE = FixVignetteRadial(np.array([0.4, 0.1, 0, 0, 0]), (0.5, 0.5))


def corrected(linear: np.ndarray) -> np.ndarray:
    """A camera's correction by SciPy's splines, of vignetting and then of distortion, both about the same."""
    y, x = np.indices(linear.shape[:2]).astype(float)
    end = SIZE - 1
    squared = ((y - end / 2) ** 2 + (x - end / 2) ** 2) / (end**2 / 2)
    linear = linear * (1 + 0.4 * squared + 0.1 * squared**2)[..., None]
    column, row = (end * c for c in WARP.center)
    reach = np.hypot(max(column, end - column), max(row, end - row))
    v, u = (y - row) / reach, (x - column) / reach
    r2, out = v * v + u * u, []
    for (k0, k1, k2, k3, t0, t1), plane in zip(TERMS, np.moveaxis(linear, -1, 0)):
        factor = k0 + k1 * r2 + k2 * r2**2 + k3 * r2**3
        down = factor * v + t1 * 2 * u * v + t0 * (r2 + 2 * v * v)
        across = factor * u + t0 * 2 * u * v + t1 * (r2 + 2 * u * u)
        places = [row + reach * down, column + reach * across]
        out.append(ndimage.map_coordinates(plane, places, order=3, mode="nearest"))
    return np.stack(out, -1)


def shoot(folder: Path, stated: Sequence[Opcode]) -> Path:
    """Three RAW+JPEG pairs by NumPy, OpenCV, SciPy and Pillow."""
    folder.mkdir()
    for name, scene in list(scenes("one", SIZE).items())[:3]:
        levels = np.rint(64 + 3000 * 0.8 * scene).astype(np.uint16)
        mosaic = levels[..., 1].copy()
        mosaic[::2, ::2], mosaic[1::2, 1::2] = levels[::2, ::2, 0], levels[1::2, 1::2, 2]
        write_dng(
            folder / f"{name}.dng",
            mosaic,
            cfa="RGGB",
            black=(64,),
            white=3064,
            color_matrix=None,
            opcodes_3=stated,
        )
        rgb = cv2.cvtColor(mosaic, cv2.COLOR_BayerBG2RGB) - 64.0
        linear = np.clip(corrected(rgb / 3000), 0, 1)
        encoded = np.where(
            linear < 0.0031308, 12.92 * linear, 1.055 * np.maximum(linear, 1e-9) ** (1 / 2.4) - 0.055
        )
        Image.fromarray(np.rint(255 * encoded).astype(np.uint8)).save(
            folder / f"{name}.jpg", quality=95, subsampling=0
        )
    return folder


def error(folder: Path) -> float:
    """What the fitted base leaves, in floors."""
    aligned = align_raw([pair.load() for pair in open_dataset(folder).pairs])
    case = raw_case(aligned.kept, None, sorted(EFFECTS), lambda *_: None)
    assert len(aligned.kept) == 3 and case.pixels.earlier == EARLIER
    return float(case.point.error / np.mean(case.floors))


@pytest.fixture
def earlier(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(import_module("jaxisp.gap.base.raw_jpeg"), "earlier_grid", lambda luma: EARLIER)


@pytest.mark.usefixtures("earlier")
def test_a_stated_lens_is_no_gap(tmp_path: Path) -> None:
    """Corrections of 3 px and of half of the light are put before the pairs. Where an earlier compression
    began is known, though nothing is tried."""
    assert error(shoot(tmp_path / "all", [VIGNETTE, WARP])) < 1.4


@pytest.mark.slow
@pytest.mark.usefixtures("earlier")
def test_either_correction_alone_is_a_gap(tmp_path: Path) -> None:
    """The check above sees either."""
    found = {}
    for name, stated in {"all": [VIGNETTE, WARP], "warp": [WARP], "vignetting": [VIGNETTE]}.items():
        found[name] = error(shoot(tmp_path / name, stated))
    assert min(found["warp"], found["vignetting"]) > 2 * found["all"], found


def test_a_file_that_samples_chroma_otherwise_is_left_out(tmp_path: Path) -> None:
    """One base cannot hold for both; the reason names the file and what is to be done."""
    folder = shoot(tmp_path / "pairs", [])
    names = sorted(path.stem for path in folder.glob("*.jpg"))
    with Image.open(folder / f"{names[0]}.jpg") as picture:
        picture.save(folder / f"{names[0]}.jpg", quality=95, subsampling=2)
    loaded = [pair.load() for pair in open_dataset(folder).pairs]
    kept, ((name, reason),) = of_one_sampling(loaded)
    assert sorted(pair.name for pair in kept) == names[1:] and name == names[0]
    for words in (name, "JPEG, 4:2:0", "JPEG, 4:4:4", "apart"):
        assert words in reason
    as_png = [dataclasses.replace(pair, jpeg=None) for pair in loaded]
    assert of_one_sampling(as_png) == (as_png, [])
    assert loaded[1].jpeg is not None and _aligned(Aligned(loaded, [], []), {})["encoder_not_modelled"] == []
    odd = dataclasses.replace(loaded[1], jpeg=dataclasses.replace(loaded[1].jpeg, subsampling="4:1:1"))
    (said,) = _aligned(Aligned([odd, *as_png], [], []), {})["encoder_not_modelled"]
    assert said["name"] == odd.name and "4:1:1" in said["reason"]
    noted = dataclasses.replace(loaded[1], raw=dataclasses.replace(loaded[1].raw, notes=("it is odd",)))
    plain = dataclasses.replace(loaded[2], raw=dataclasses.replace(loaded[2].raw, notes=()))
    rows = _aligned(Aligned([noted, plain], [], []), {})["raw_notes"]
    assert rows == [{"name": noted.name, "notes": ["it is odd"]}]
    own = dataclasses.replace(loaded[1], jpeg=dataclasses.replace(loaded[1].jpeg, color_space="RGB"))
    assert "JPEG, 4:4:4, RGB" in of_one_sampling([own, *loaded[2:]])[1][0][1]
    assert "no JPEG" in of_one_sampling([as_png[0], *loaded[1:]])[1][0][1]


def test_the_lens_of_a_part(tmp_path: Path) -> None:
    """Its centre and its farthest corner are the frame's."""
    raw = read_raw(next(shoot(tmp_path / "pairs", [VIGNETTE, WARP]).glob("*.dng")))
    whole = stated_warp(raw)
    assert whole is not None
    np.testing.assert_allclose(whole.centre, (0.47, 0.52), rtol=1e-6)
    np.testing.assert_allclose(whole.radial, TERMS[:, :4] - [[1, 0, 0, 0]], rtol=1e-4, atol=1e-7)
    part = stated_warp(raw, (16, 32), (64, 64))
    cut = stated_warp(dataclasses.replace(raw, mosaic=raw.mosaic[16:80, 32:96], crop=(16, 32, 64, 64)))
    assert part is not None and cut is not None
    for own in (part, cut):
        np.testing.assert_allclose(own.centre * 63 + (16, 32), whole.centre * (SIZE - 1), rtol=1e-5)
        np.testing.assert_allclose(own.farthest * 63, whole.farthest * (SIZE - 1), rtol=1e-5)
    assert stated_warp(dataclasses.replace(raw, warp=None)) is None
    alike = stated_warp(dataclasses.replace(raw, warp=WarpRectilinear(TERMS[:1], WARP.center)))
    assert alike is not None
    np.testing.assert_array_equal(alike.radial, [whole.radial[0]] * 3)
