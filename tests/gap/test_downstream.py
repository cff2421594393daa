"""Denoisers trained without and with an effect: figures, what is kept of them, the page, what is refused."""

from types import SimpleNamespace

import numpy as np
import pytest

from experiments.withheld.shoot import write
from jaxisp.cli import main
from jaxisp.errors import InputError
from jaxisp.gap import Downstream
from jaxisp.gap.case import Case
from jaxisp.gap.criteria import CRITERIA
from jaxisp.gap.diagnose import _trained
from jaxisp.gap.downstream import denoisers
from jaxisp.gap.downstream.denoisers import measure_downstream
from jaxisp.gap.objective.protocol import Point
from jaxisp.gap.pairs.scenes import Split
from jaxisp.gap.report.downstream import downstream_part
from jaxisp.gap.search.states import Shown
from jaxisp.gap.search.verdict import Found, Refused
from jaxisp.io.digests import sealed_json
from tests.gap.scenes import scenes

NOISE = 0.15


def case(names=("a", "b", "c", "d")):
    """Four noisy scenes, of which two are fitted; a simulator is the deviation of its noise."""
    rng = np.random.default_rng(0)
    luma = scenes(rng, 4, (64, 72))[..., :1] / 255
    clean = np.repeat(luma, 3, -1)
    noisy = np.clip(clean + NOISE * rng.standard_normal(clean.shape), 0, 1).astype(np.float32)
    pairs = SimpleNamespace(names=names, pictures=noisy, light=clean)

    def rendered(model, z, replicate):
        return model(clean, replicate)

    return Case(
        kind="clean+noisy", criteria=CRITERIA["clean+noisy"], pairs=pairs, absorbed={},
        floors=np.ones(4),
        evidence=SimpleNamespace(split=Split((0, 2), (1, 3))), point=None, offered=[], reference=clean,
        statistics=SimpleNamespace(measure=SimpleNamespace(rendered=rendered)),
    )  # fmt: skip


def simulator(std):
    def render(light, replicate):
        noise = np.random.default_rng(replicate).standard_normal(light.shape)
        return np.clip(light + std * noise, 0, 1).astype(np.float32)

    return Point(render, np.zeros(0), np.zeros(4))


def nothing(*_):
    return None


@pytest.fixture(scope="module")
def kept(tmp_path_factory):
    return tmp_path_factory.mktemp("kept") / "figures.json"


@pytest.fixture(scope="module")
def found(kept):
    models = {"without": simulator(0.01), "with": simulator(NOISE)}
    return measure_downstream(case(), models, Downstream(steps=40, seeds=(0, 1), keep=kept), nothing)


def test_the_right_noise_makes_the_better_denoiser(found):
    gain = found["gain"]["with"]
    assert min(gain["psnr"]) > 0.5 and min(gain["ssim"]) > 0.01
    assert found["arms"]["real"]["psnr_mean"] > found["arms"]["without"]["psnr_mean"] + 0.5
    assert gain["psnr_spread"] == pytest.approx(np.std(gain["psnr"], ddof=1))
    assert found["scenes"] == {"trained": 2, "held_out": 2} and found["seeds"] == [0, 1]


def test_what_is_done_is_not_done_again(found, kept, monkeypatch):
    trained = []
    monkeypatch.setattr(denoisers, "_measured", lambda task, steps, seed: trained.append(seed) or [1.0, 1.0])
    models = {"without": simulator(0.01), "with": simulator(NOISE)}
    again = measure_downstream(case(), models, Downstream(steps=40, seeds=(0, 1), keep=kept), nothing)
    assert again == found and trained == []
    whole = kept.read_text()
    for others in (whole[:20], whole.replace(", 0.", ", 1.", 1), '{"mine": [1, 2]}', sealed_json('{"x": 1}')):
        kept.write_text(others)
        with pytest.raises(InputError, match="would be replaced"):
            measure_downstream(case(), models, Downstream(steps=40, seeds=(1,), keep=kept), nothing)
        assert kept.read_text() == others and trained == []
    kept.unlink()
    measure_downstream(case(), models, Downstream(steps=40, seeds=(1,), keep=kept), nothing)
    assert trained == [1, 1, 1]


def test_one_scene_alone_is_not_held_out_from_itself():
    alone = case(("a (even tiles)", "a (odd tiles)", "a (even tiles)", "a (odd tiles)"))
    assert "one scene" in measure_downstream(alone, {}, Downstream(), nothing)["skipped"]
    frames = case(("a.f00", "a.f01", "a.f02", "a.f03"))
    assert "skipped" in measure_downstream(frames, {}, Downstream(), nothing)


def test_the_page_has_a_row_an_arm(found):
    part = downstream_part(found)
    assert [row["name"] for row in part["rows"]][1:] == [
        "simulated pairs, without the effects",
        "simulated pairs, with the effects",
        "the real pairs that were fitted",
    ]
    assert "dB" in part["text"] and downstream_part(None) is None
    assert downstream_part({"skipped": "why"}) == {"skipped": "why"}


def test_it_needs_clean_pictures(tmp_path, capsys):
    write(tmp_path, "alder", {}, size=64, count=1)
    assert main(["diagnose", str(tmp_path), "-o", str(tmp_path / "o"), "--downstream"]) == 2
    assert "clean+noisy" in capsys.readouterr().err
    with pytest.raises(InputError, match="0 steps"):
        Downstream(steps=0)


@pytest.mark.parametrize("accepted", [True, False])
def test_denoisers_are_trained_with_what_comes_nearest_where_nothing_is_accepted(monkeypatch, accepted):
    cause = SimpleNamespace(effect="prnu"), []
    near = None if accepted else Refused([cause], Shown(0.0, []), "near")
    found = Found([cause] if accepted else [], "here", {}, {}, Shown(0.0, []), Shown(0.0, []), near)
    monkeypatch.setattr(
        "jaxisp.gap.downstream.denoisers.measure_downstream", lambda case, models, *rest: models
    )
    arms = _trained(SimpleNamespace(point="base"), found, Downstream(), nothing)
    assert (arms["without"], arms["with"]) == ("base", "here" if accepted else "near")
    assert arms["effects"] == ["prnu"]
    none = Found([], "base", {}, {}, Shown(0.0, []), Shown(0.0, []))
    assert "skipped" in _trained(SimpleNamespace(point="base"), none, Downstream(), nothing)
