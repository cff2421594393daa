"""The notebooks: text without outputs, run from top to bottom; and the explorer, without a browser."""

import os
import re
from importlib.util import find_spec
from pathlib import Path

import numpy as np
import pytest

from jaxisp import Chain, stage
from jaxisp.explore import MOST, Explorer, Pictures, explore_stages, for_screen, in_domain, picture_after
from jaxisp.params import specs
from jaxisp.pipeline import signature
from jaxisp.stages import STAGES
from jaxisp.testing import smooth_image

FOLDER = Path(__file__).parent.parent / "notebooks"
NAMES = sorted(p.stem for p in FOLDER.glob("*.py"))
QUICK = ("03_your_own_stage", "04_fit_a_camera", "07_sharp_bits")
"""Run by `make test-all`; all of them where JAXISP_NOTEBOOKS=all, as `make notebooks` has it."""
MISSING = [name for name in ("jupytext", "nbclient", "ipykernel", "ipywidgets") if find_spec(name) is None]
jupyter = pytest.mark.skipif(bool(MISSING), reason=f"not installed: {', '.join(MISSING)}")
widgets = pytest.mark.skipif("ipywidgets" in MISSING, reason="ipywidgets is not installed")


@jupyter
@pytest.mark.slow
@pytest.mark.parametrize("name", NAMES)
def test_it_runs(name):
    whole = os.environ.get("JAXISP_NOTEBOOKS") == "all"
    if not whole and name not in QUICK:
        pytest.skip("run by `make notebooks`")
    import jupytext
    import nbclient
    import nbformat

    book = jupytext.read(FOLDER / f"{name}.py")
    of_tests = ("XLA_FLAGS", "MPLBACKEND")
    own = {variable: value for variable, value in os.environ.items() if variable not in of_tests}
    resources = {"metadata": {"path": str(FOLDER)}}
    # on a busy machine outputs come late, and would be dropped silently
    client = nbclient.NotebookClient(
        book, timeout=900, iopub_timeout=120, kernel_name="python3", resources=resources
    )
    client.execute(env=own)
    outputs = [output for cell in book.cells for output in cell.get("outputs", [])]
    assert any({"image/png", "text/html"} & set(output.get("data", {})) for output in outputs), "no picture"
    if whole:  # the documentation shows these
        out = FOLDER.parent / "build" / "notebooks"
        out.mkdir(parents=True, exist_ok=True)
        nbformat.write(book, out / f"{name}.ipynb")


@pytest.mark.parametrize("name", NAMES)
def test_it_is_text(name):
    text = (FOLDER / f"{name}.py").read_text()
    assert "format_name: percent" in text and "%matplotlib" not in text
    assert re.search(r"^# # \w", text, re.MULTILINE), "no title"
    assert len(text) < 12_000
    for link in re.findall(r"\]\(([\w./]+)\)", text):
        assert (FOLDER / link).exists(), link


def test_no_outputs_are_kept():
    assert not list(FOLDER.rglob("*.ipynb"))


@widgets
def test_sliders_come_from_the_specs():
    picture = smooth_image((20, 26, 3))
    explorer = Explorer(stage("unsharp_mask"), picture)
    for field, spec in specs(signature(STAGES["unsharp_mask"]).params).items():
        slider = explorer.sliders[f"unsharp_mask.{field}"]
        log = spec.scale == "log"
        ends = [10**v for v in (slider.min, slider.max)] if log else [slider.min, slider.max]
        assert type(slider).__name__ == ("FloatLogSlider" if log else "FloatSlider")
        np.testing.assert_allclose(ends, spec.bounds)
        np.testing.assert_allclose(slider.value, spec.default, rtol=1e-6)
        assert slider.tooltip == spec.doc and (spec.unit == "1" or spec.unit in slider.description)


@widgets
def test_the_picture_follows():
    picture = smooth_image((20, 26, 3))
    explorer = Explorer(
        Chain((stage("mosaic"), stage("shot_read_noise"), stage("demosaic_bilinear"))), picture
    )
    before = bytes(explorer.picture.value)
    assert before.startswith(b"\x89PNG") and "26x20" in explorer.status.value
    explorer.sliders["shot_read_noise.read"].value = 0.1
    noisy = bytes(explorer.picture.value)
    assert noisy != before and float(explorer.params["shot_read_noise"].read) == np.float32(0.1)
    explorer.sliders["seed"].value = 5
    assert bytes(explorer.picture.value) != noisy


@widgets
def test_values_stay_within_their_bounds():
    """A logarithmic slider gives 10**x, which may step over the end of the range by a bit."""
    explorer = Explorer(stage("white_balance"), smooth_image((8, 10, 3)))
    slider = explorer.sliders["white_balance.gains[2]"]
    low, high = specs(signature(STAGES["white_balance"]).params)["gains"].bounds
    slider.value = 10**slider.max
    assert explorer.params["white_balance"].gains[2] == np.float32(high)
    slider.value = 10**slider.min
    assert explorer.params["white_balance"].gains[2] == np.float32(low)


@widgets
def test_long_vectors_get_no_sliders():
    explorer = Explorer(stage("jpeg_tables"), smooth_image((16, 16, 3)))
    assert not explorer.sliders and MOST < 64


@widgets
def test_all_stages_can_be_chosen():
    box = explore_stages(smooth_image((8, 10, 3)), first="exposure")
    choice = box.children[0]
    assert set(choice.options) == set(STAGES)
    shown = box.children[1].children[0]
    choice.value = "saturation"
    assert box.children[1].children[0] is not shown


def test_pictures_go_to_a_domain_and_back():
    picture = smooth_image((12, 15, 3)).astype(np.float32)
    for name in (
        "exposure",
        "xyz_to_linear_srgb",
        "prophoto_oetf",
        "prophoto_eotf",
        "ycbcr_to_rgb",
        "rounding",
        "clip",
    ):
        domain = signature(STAGES[name]).domain_in
        shown = for_screen(in_domain(picture, domain), domain)
        np.testing.assert_allclose(shown, picture, atol=2e-5, err_msg=name)
    assert in_domain(picture, signature(STAGES["demosaic_ahd"]).domain_in).shape == (12, 15)
    same = picture_after(stage("exposure"), picture)
    np.testing.assert_allclose(same, picture, atol=2e-5)


@pytest.mark.parametrize("dtype", [np.uint8, np.uint16])
def test_whole_levels_are_shares_of_the_largest(dtype):
    picture = smooth_image((12, 15, 3))
    whole = np.round(picture * np.iinfo(dtype).max).astype(dtype)
    html = Pictures([("a", whole)])._repr_html_()
    assert html == Pictures([("a", whole / np.iinfo(dtype).max)])._repr_html_()
    np.testing.assert_allclose(picture_after(stage("clip"), whole), picture, atol=0.003)


def test_pictures_are_escaped():
    html = Pictures([("<b>&", np.zeros((2, 3)))], magnify=4)._repr_html_()
    assert (
        "&lt;b&gt;&amp;" in html and "<b>" not in html and "width:12px" in html and "data:image/png" in html
    )
