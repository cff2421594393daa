"""The reference phone: apart from the simulator, unlike from body to body, physically right, real files."""

import ast
from dataclasses import replace
from pathlib import Path

import colour
import numpy as np
import pytest
from PIL import Image

import jaxisp.samples
from jaxisp.io.raw import read_raw
from jaxisp.metrics import psnr
from jaxisp.samples import PHONES, scene, scene_names, scenes, shoot, write_clean_noisy, write_pairs
from jaxisp.samples.phone_filters import DEMOSAICKERS, color_filters

FOLDER = Path(jaxisp.samples.__file__).parent
NOISELESS = {"shot": 1e-12, "read": 0.0}


def imports(tree, inside):
    """The modules imported within a function (`inside`) or at the top of a file."""
    functions = {n for f in ast.walk(tree) if isinstance(f, ast.FunctionDef) for n in ast.walk(f)}
    for node in ast.walk(tree):
        if (node in functions) == inside:
            if isinstance(node, ast.Import):
                yield from (a.name for a in node.names)
            elif isinstance(node, ast.ImportFrom):
                yield node.module


def test_the_phone_shares_no_code_with_the_simulator():
    outside = {"io", "collections.abc", "dataclasses", "pathlib", "typing", "numpy", "PIL"}
    own = {"phone.py": {"jaxisp.samples.phone_filters"}, "phone_filters.py": set()}
    writers = {"phone.py": {"jaxisp.io.dng", "jaxisp.io.files"}, "phone_filters.py": set()}
    for name in own:
        tree = ast.parse((FOLDER / name).read_text())
        assert set(imports(tree, inside=False)) <= outside | own[name]
        assert set(imports(tree, inside=True)) == writers[name]
        dynamic = {n.id for n in ast.walk(tree) if isinstance(n, ast.Name)}
        assert not dynamic & {"__import__", "importlib", "eval", "exec"}
    scenery = ast.parse((FOLDER / "scenes.py").read_text())
    assert not [m for inside in (False, True) for m in imports(scenery, inside) if m.startswith("jaxisp")]


def test_the_bodies_differ_in_everything():
    switches = {"corrects_vignetting", "orientation"}  # on for one body only
    for name in set(PHONES["a"].__dataclass_fields__) - {"make", "illuminants"}:
        values = {getattr(phone, name) for phone in PHONES.values()}
        assert len(values) == (2 if name in switches else 3), name


@pytest.mark.parametrize("name", scene_names())
def test_scenes_are_linear_photographs_of_the_size_wanted(name):
    wide = scene(name, (90, 131))
    assert wide.shape == (90, 131, 3) and wide.dtype == np.float32
    assert wide.min() >= 0 and wide.max() <= 1 and wide.std() > 0.05
    corner = scene(name, 64, window=(0.0, 0.0, 0.3))
    assert corner.shape == (64, 64, 3)
    with pytest.raises(ValueError, match=f"{name}.*900x900"):
        scene(name, 900)


def test_scenes_keep_the_mean_light():
    import skimage.data

    linear = colour.cctf_decoding(skimage.data.astronaut() / 255, function="sRGB")
    expected = linear.reshape(64, 8, 64, 8, 3).mean((1, 3))
    np.testing.assert_allclose(scene("astronaut", 64), expected, atol=1e-5)
    assert [s.shape for s in scenes(32)] == [(32, 32, 3)] * len(scene_names())


@pytest.mark.parametrize("phone", PHONES.values(), ids=PHONES)
def test_noise_and_white_balance_are_what_the_header_says(phone):
    flat = replace(phone, vignetting=0.0)
    mosaic, _, header = shoot(np.full((200, 300, 3), 0.4), flat, 1)
    signal = (mosaic.astype(float) - header["black"][0]) / (header["white"] - header["black"][0])
    slope, offset = header["noise_profile"][0]
    site_color = color_filters(mosaic.shape, flat.cfa).argmax(-1)
    for color in range(3):
        values = signal[site_color == color]
        expected = 0.4 * phone.exposure * header["as_shot_neutral"][color]
        np.testing.assert_allclose(values.mean(), expected, rtol=0.005)
        rounding = 1 / 12 / (header["white"] - header["black"][0]) ** 2
        np.testing.assert_allclose(values.var(), slope * expected + offset + rounding, rtol=0.05)


@pytest.mark.parametrize("phone", PHONES.values(), ids=PHONES)
def test_the_colour_matrix_leads_back_to_the_scene(phone):
    """As a DNG reader does it: balance, normalise XYZ to camera so that white is white, invert."""
    plain = replace(phone, **NOISELESS, vignetting=0.0, exposure=0.5, bits=16, white=65535)
    colors = np.array([[0.8, 0.2, 0.1], [0.1, 0.6, 0.3], [0.2, 0.2, 0.7], [0.5, 0.5, 0.5]])
    for color in colors:
        mosaic, _, header = shoot(np.broadcast_to(color, (16, 16, 3)), plain, 0)
        signal = (mosaic.astype(float) - header["black"][0]) / (header["white"] - header["black"][0])
        filters = color_filters(mosaic.shape, plain.cfa)
        camera = np.array([signal[filters[..., c] > 0].mean() for c in range(3)]) / 0.5
        to_camera = header["color_matrix"] @ colour.RGB_COLOURSPACES["sRGB"].matrix_RGB_to_XYZ
        to_camera /= to_camera.sum(1, keepdims=True)
        balanced = camera / header["as_shot_neutral"]
        np.testing.assert_allclose(np.linalg.solve(to_camera, balanced), color, atol=2e-3)


@pytest.mark.parametrize("cfa", ["RGGB", "BGGR", "GRBG", "GBRG"])
def test_demosaicking_reproduces_a_ramp_and_bilinear_is_bilinear(cfa):
    from colour_demosaicing import demosaicing_CFA_Bayer_bilinear, mosaicing_CFA_Bayer

    filters = color_filters((21, 34), cfa)
    y, x = np.mgrid[:21, :34] / 40
    ramp = np.stack([0.2 + x, 0.1 + x + y, 0.3 + y], -1)
    inner = (slice(3, -3), slice(3, -3))
    for demosaicker in DEMOSAICKERS.values():
        out = demosaicker((ramp * filters).sum(-1), filters)
        np.testing.assert_allclose(out[inner], ramp[inner], atol=1e-12)
    noise = np.random.default_rng(0).uniform(size=(21, 34, 3))
    mosaic = mosaicing_CFA_Bayer(noise, cfa)
    expected = demosaicing_CFA_Bayer_bilinear(mosaic, cfa)
    np.testing.assert_allclose(DEMOSAICKERS["bilinear"](mosaic, filters)[inner], expected[inner], atol=1e-12)


@pytest.mark.parametrize("phone", PHONES.values(), ids=PHONES)
def test_the_jpeg_resembles_the_scene(phone):
    truth = scene("chelsea", (96, 129))
    mosaic, picture, header = shoot(truth, phone, 5)
    assert mosaic.dtype == np.uint16 and picture.dtype == np.uint8
    assert picture.shape == (*mosaic.shape, 3)
    upright = np.rot90(picture, -1) if header["orientation"] == 6 else picture
    assert upright.shape == truth.shape
    assert psnr(upright / 255, truth ** (1 / 2.2)) > 18
    again, other = shoot(truth, phone, 5), shoot(truth, phone, 6)
    np.testing.assert_array_equal(again[0], mosaic)
    assert (other[0] != mosaic).mean() > 0.5


def test_gray_stays_gray_and_black_and_white_are_finite():
    for phone in PHONES.values():
        for level in (0.0, 0.2, 1.0, 4.0):
            _, picture, _ = shoot(np.full((40, 48, 3), level), replace(phone, **NOISELESS, vignetting=0.0), 0)
            assert np.ptp(picture[5:-5, 5:-5].astype(int), axis=-1).max() <= 2


@pytest.mark.parametrize("phone", PHONES.values(), ids=PHONES)
def test_written_pairs_are_a_real_dng_and_a_real_jpeg(phone, tmp_path):
    truth = scene("coffee", (80, 101))
    assert write_pairs(tmp_path / "new", phone, [truth], seed=3, size=(64, 80)) == ["scene0"]
    assert sorted(p.name for p in (tmp_path / "new").iterdir()) == ["scene0.dng", "scene0.jpg"]
    mosaic, picture, _ = shoot(truth[8:72, 10:90], phone, (3, 0))
    with Image.open(tmp_path / "new" / "scene0.jpg") as file:
        assert file.format == "JPEG" and file.getexif()[0x0112] == phone.orientation
        np.testing.assert_array_equal(np.asarray(file), picture)
    raw = read_raw(tmp_path / "new" / "scene0.dng")
    levels = (mosaic.astype(float) - phone.black) / (phone.white - phone.black)
    np.testing.assert_allclose(raw.mosaic, levels, atol=1e-6)
    assert (raw.cfa, raw.orientation, raw.iso) == (phone.cfa, phone.orientation, phone.iso)
    np.testing.assert_allclose(raw.white_balance, phone.gains, rtol=1e-4)
    np.testing.assert_allclose(raw.xyz_to_camera, phone.xyz_to_camera, atol=1e-4)
    if phone.illuminant == "daylight":  # in another light a reader adapts by other rules than the phone
        np.testing.assert_allclose(raw.camera_to_srgb, np.linalg.inv(phone.srgb_to_camera), atol=5e-3)
    shot, variance = phone.noise_profile[0]
    np.testing.assert_allclose(raw.noise_profile, [[shot, np.sqrt(variance)]] * 3, rtol=1e-4)
    with pytest.raises(ValueError, match="80x101"):
        write_pairs(tmp_path, phone, [truth], size=200)


def test_clean_and_noisy_files(tmp_path):
    truth = scene("rocket", (48, 65))
    names = write_clean_noisy(tmp_path, PHONES["c"], {"one": truth, "two": truth}, seed=1)
    written = sorted(p.name for p in tmp_path.iterdir())
    assert written == [f"{n}.{e}" for n in names for e in ("clean.png", "jpg")]
    clean = np.asarray(Image.open(tmp_path / "one.clean.png")) / 255
    np.testing.assert_allclose(clean, colour.cctf_encoding(truth, function="sRGB"), atol=0.5 / 255 + 1e-4)
    files = [np.asarray(Image.open(tmp_path / f"{n}.jpg")) for n in names]
    assert (files[0] != files[1]).any()  # the same scene, other noise
