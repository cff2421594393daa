"""The folder that a run is begun in."""

import pytest

from jaxisp.errors import InputError
from jaxisp.recipes import RECIPES
from jaxisp.train import TrainConfig
from jaxisp.train.folder import check_folder


@pytest.mark.parametrize("link", ["checkpoints/last", "tensorboard/mine"])
def test_nothing_is_begun_where_a_link_leads_elsewhere(tmp_path, link):
    run, elsewhere = tmp_path / "run", tmp_path / "elsewhere"
    (elsewhere / "1.orbax-checkpoint-tmp-1").mkdir(parents=True)
    (elsewhere / "1.orbax-checkpoint-tmp-1" / "mine").write_text("mine")
    (run / link).parent.mkdir(parents=True)
    (run / link).symlink_to(elsewhere)
    with pytest.raises(InputError, match="stands there already and would be replaced"):
        check_folder(run, TrainConfig(clean=("in",), recipe="awgn"), RECIPES["awgn"](), resume=False)
