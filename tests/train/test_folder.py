"""The folder that a run is begun in."""

import dataclasses

import pytest

from jaxisp.errors import InputError
from jaxisp.recipes import RECIPES
from jaxisp.train import TrainConfig
from jaxisp.train.checkpoints import Checkpoints
from jaxisp.train.folder import check_folder, load_settings, write_card
from tests.io.test_files import as_nobody, open_to_all


@pytest.mark.parametrize("link", ["checkpoints/last", "tensorboard/mine"])
def test_nothing_is_begun_where_a_link_leads_elsewhere(tmp_path, link):
    run, elsewhere = tmp_path / "run", tmp_path / "elsewhere"
    (elsewhere / "1.orbax-checkpoint-tmp-1").mkdir(parents=True)
    (elsewhere / "1.orbax-checkpoint-tmp-1" / "mine").write_text("mine")
    (run / link).parent.mkdir(parents=True)
    (run / link).symlink_to(elsewhere)
    with pytest.raises(InputError, match="stands there already and would be replaced"):
        check_folder(run, TrainConfig(clean=("in",), recipe="awgn"), RECIPES["awgn"](), resume=False)


def test_a_card_shows_names_and_descriptions_as_text(tmp_path):
    config = TrainConfig(clean=("a\x1b[2J",), recipe="awgn")
    recipe = dataclasses.replace(
        RECIPES["awgn"](), description="<script>alert(1)</script> ![i](http://a.b) \u202eback"
    )
    result = {"best": None, "validation": None, "parameters": 1, "step": 1, "finished": True, "devices": "1"}
    write_card(tmp_path, config, recipe, result, "a\x1b[2J")
    text = (tmp_path / "MODEL_CARD.md").read_text()
    before_its_text = text[: text.index("```toml")]
    assert "&lt;script&gt;" in text and "<script>" not in before_its_text
    assert "![i]" not in before_its_text and "&#91;i&#93;" in text
    assert "\\x1b" in text and all(line.isprintable() for line in text.split("\n"))


def test_what_cannot_be_read_says_so(tmp_path):
    run = tmp_path / "run"
    open_to_all(tmp_path)
    Checkpoints(run, "a run").close()
    for place, call in (
        (run / "checkpoints" / "last", lambda: Checkpoints(run, "a run", reading=True)),
        (run, lambda: load_settings(run)),
    ):
        place.chmod(0)
        with as_nobody(), pytest.raises(InputError, match="cannot be read: permission denied"):
            call()
