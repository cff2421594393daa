"""The HTML pages in a real browser: nothing asked of the network, nothing wide, everything readable."""

import copy

import numpy as np
import pytest

from jaxisp.fit.curvature import Identified
from jaxisp.fit.report import write_report as write_fit
from jaxisp.fit.result import FitResult, PairResult
from jaxisp.gap.report.page import write_report as write_diagnosis
from jaxisp.recipe import Recipe
from jaxisp.recipes import RECIPES
from jaxisp.report import Page
from jaxisp.testing import smooth_image
from tests.browser import CHROMIUM, Browser
from tests.gap.page import PICTURES, REPORT

pytestmark = pytest.mark.skipif(CHROMIUM is None, reason="chromium is not installed")

CELLS = """[...document.querySelectorAll('td')].map(e => {
  const words = document.createRange(), box = e.getBoundingClientRect();
  words.selectNodeContents(e);
  return {text: e.textContent, right: box.right, inside: e.scrollWidth - e.clientWidth,
    lines: words.getClientRects().length, wide: !!e.closest('.wide'),
    label: getComputedStyle(e, '::before').content};
})"""
LONG = "a-name-that-somebody-gave-to-a-file-without-any-space-in-it_2019-03-04_final.dng"
# every text against what is painted behind it, as WCAG 2 counts contrast
TEXTS = """(() => {
  const rgba = c => { const n = c.match(/[\\d.]+/g).map(Number); return n.length < 4 ? [...n, 1] : n; };
  const light = c => c.slice(0, 3).map(v => v / 255)
    .map(v => v <= 0.04045 ? v / 12.92 : ((v + 0.055) / 1.055) ** 2.4)
    .reduce((sum, v, i) => sum + v * [0.2126, 0.7152, 0.0722][i], 0);
  const behind = e => {
    for (; e; e = e.parentElement) {
      const colour = rgba(getComputedStyle(e).backgroundColor);
      if (colour[3]) return colour;
    }
    return [255, 255, 255, 1];
  };
  const found = [];
  const walk = document.createTreeWalker(document.body, NodeFilter.SHOW_TEXT);
  while (walk.nextNode()) {
    const text = walk.currentNode.textContent.trim(), e = walk.currentNode.parentElement;
    if (!text || !e.getClientRects().length) continue;
    const style = getComputedStyle(e), svg = e instanceof SVGElement;
    const pair = [light(rgba(svg ? style.fill : style.color)), light(behind(e))].sort((a, b) => b - a);
    const box = e.getBoundingClientRect();
    found.push({text: text.slice(0, 40), contrast: (pair[0] + 0.05) / (pair[1] + 0.05),
      size: svg ? 99 : parseFloat(style.fontSize), left: box.left, right: box.right});
  }
  return found;
})()"""


def demo(folder):
    page = Page("A demo", "Made offline from data that comes with the package. " * 3)
    picture = smooth_image((48, 48, 3))
    page.heading("One photograph, stage by stage", "A crop after each stage.")
    page.figures([(f"stage_{i}: {LONG}, [1.25 0.875 2.5]", picture) for i in range(7)], magnify=3)
    page.heading("Two and one", "")
    page.figures([("clean", picture), ("degraded, 24.1 dB", picture)], magnify=3)
    page.figures([("alone", smooth_image((48, 300)))])
    page.table(("effect", "closes", "not told from"), [(LONG, "43 %", "a, b, " * 20)] * 3)
    page.write(folder / "report.html")
    return folder / "report.html"


def pair(name, **more):
    picture = smooth_image((96, 128, 3))
    level = {"level": 0.25, "std": (0.01, 0.012), "lag1": (0.5, 0.4)}
    noise = {"luma": {"by_level": [level]}, "edge_detail_ratio": 0.98}
    figures = (31.0, 0.91, 30.5, 0.9, (0.1, -1.2))
    return PairResult(name, *figures, picture, picture, 1 - picture, noise, 29.0, **more)


def fit(folder):
    camera = RECIPES["awgn"]()
    constants = {name: type(values)() for name, values in camera.prior.items()}
    return write_fit(
        FitResult(
            Recipe(camera.chain, constants, "fitted"),
            [pair(LONG, notes=("the JPEG was cut at a multiple of 8",)), pair("b")],
            np.geomspace(1, 1e-3, 20),
            ("first",) * 12 + ("last 1",) * 8,
            12.5,
            failed=[("c.dng", f"/a/long/path/{LONG}: no JPEG of the same name")],
            design="demosaic_malvar, median none, denoising in camera RGB",
            tried=[("demosaic_malvar", 0.0123), ("demosaic_ahd", 0.0456)],
            identified=[Identified("gaussian_noise.std", 0.1, 0.01, True)],
            at_bound=["gaussian_noise.std"],
        ),
        folder,
    )


def diagnosis(folder):
    report = copy.deepcopy(REPORT)
    report["pairs"]["held_out"] = [LONG, "b"]
    report["causes"][0]["alternatives"] = ["color_shading", "local_tone_mapping"]
    report["causes"][0]["next_measurement"] = (
        "a flat field, taken twice, once with the camera turned by 180 degrees"
    )
    report["ranking"] += [
        {"effect": f"lateral_chromatic_aberration_{i}", "closed": 0.01 * i, "status": "not_identifiable"}
        for i in range(9)
    ]
    report["ranking"][0] |= {"predicted": 0.64}
    report["ranking"][-1] |= {"reason": "looks the same as lateral_chromatic_aberration_and_so_on"}
    report["gap"]["reducible"] = {"best": 2.2, "explained": 0.93, "how": "a small network on what is left"}
    report["where"][0]["ci"] = [0.5, 0.9]
    wave = list(np.sin(np.arange(20.0)))
    report["where"].append(
        {"axis": "intensity", "share": 0.3, "p_value": 0.001, "bins": list(range(20)), "profile": wave}
    )
    pictures = {**PICTURES, "name": LONG}
    return write_diagnosis(report, pictures, folder)


@pytest.fixture(scope="module")
def browser(tmp_path_factory):
    opened = Browser(tmp_path_factory.mktemp("profile"))
    yield opened
    opened.close()


@pytest.fixture(scope="module", params=[demo, fit, diagnosis], ids=lambda make: make.__name__)
def page(request, tmp_path_factory):
    return request.param(tmp_path_factory.mktemp("a page & more"))  # the path has what a URL must escape


@pytest.mark.parametrize("scheme", ["light", "dark"])
@pytest.mark.parametrize("width", [1280, 400])
def test_page(browser, page, width, scheme):
    browser.open(page, width=width, scheme=scheme)
    assert not browser.named("Runtime.exceptionThrown") + browser.named("Runtime.consoleAPICalled")
    assert not [e["entry"]["text"] for e in browser.named("Log.entryAdded")]
    asked = [e["request"]["url"] for e in browser.named("Network.requestWillBeSent")]
    assert asked[0] == page.as_uri() and all(u.startswith("data:") for u in asked[1:])
    assert browser.evaluate("document.documentElement.scrollWidth") <= width
    assert browser.evaluate("[...document.images].every(i => i.complete && i.naturalWidth > 0)")
    assert browser.evaluate("document.images.length") > 0
    texts = browser.evaluate(TEXTS)
    assert len(texts) > 10
    for text in texts:
        assert text["contrast"] >= 4.5, text
        assert text["size"] >= 12, text
        assert text["left"] >= 0 and text["right"] <= width, text


@pytest.mark.parametrize("width", [1280, 700, 400])
def test_tables_need_no_scrolling_and_break_no_number(browser, tmp_path, width):
    page = Page("Tables")
    page.table([f"figure {i} of a pair [dB]" for i in range(9)], [("a", *[f"{i}12.3456" for i in range(8)])])
    page.table(("name", "figure", "why"), [(LONG.replace("-", "_"), "12.3456", "words " * 40)])
    page.write(tmp_path / "page.html")
    browser.open(tmp_path / "page.html", width=width, scheme="light")
    cells = browser.evaluate(CELLS)
    assert len(cells) == 12
    for cell in cells:
        assert cell["right"] <= width and cell["inside"] <= 1, cell
        assert cell["lines"] == 1 or "12.3456" not in cell["text"], cell
        assert ("figure" in cell["label"]) == (width < 760 and "12.3456" in cell["text"] and cell["wide"]), (
            cell
        )


def test_dark_is_dark(browser, page):
    lightness = []
    for scheme in ("light", "dark"):
        browser.open(page, width=800, scheme=scheme)
        colour = browser.evaluate("getComputedStyle(document.body).backgroundColor")
        lightness.append(sum(map(int, colour.removeprefix("rgb(").removesuffix(")").split(","))))
    assert lightness[0] > 600 and lightness[1] < 150


def test_the_checks_notice(browser, tmp_path):
    """A page that does everything wrong."""
    bad = tmp_path / "bad.html"
    bad.write_text(
        "<body style='width:3000px;color:#999;background:#fff;font-size:9px'>pale"
        "<img src='http://localhost:9/x.png'><script>console.error('x'); undefined.y</script>"
    )
    browser.open(bad, width=400, scheme="light")
    assert browser.named("Runtime.exceptionThrown") and browser.named("Runtime.consoleAPICalled")
    assert any("localhost" in e["request"]["url"] for e in browser.named("Network.requestWillBeSent"))
    assert browser.evaluate("document.documentElement.scrollWidth") > 400
    (text,) = browser.evaluate(TEXTS)
    assert text["contrast"] < 4.5 and text["size"] < 12
