"""Training that goes on from a network for all cameras, on the recipe of one."""

import contextlib
from collections.abc import Callable, Iterator, Sequence
from importlib import resources
from pathlib import Path
from typing import Any

from jaxisp.checks import several
from jaxisp.errors import InputError
from jaxisp.models import read_network
from jaxisp.models.apply import SHIPPED
from jaxisp.recipes import RecipeLike, find_degradation
from jaxisp.train.config import TrainConfig
from jaxisp.train.trainer import TrainResult, train


@contextlib.contextmanager
def beginning(start: str | Path | None = None) -> Iterator[tuple[Path, dict[str, Any]]]:
    """The file of the network that training goes on from, and what is kept with its weights.

    Args:
        start: a file of weights; those that come with the package unless given.

    Raises:
        InputError: there are no weights, or the file holds no network.
    """
    with contextlib.ExitStack() as stack:
        if start is None:
            shipped = resources.files("jaxisp.models") / SHIPPED
            if not shipped.is_file():
                raise InputError("no network comes with this jaxisp: give the weights of one to begin with")
            start = stack.enter_context(resources.as_file(shipped))
        yield Path(start), read_network(start)[1]


def fine_tune(
    recipe: RecipeLike,
    clean: str | Path | Sequence[str | Path],
    run: str | Path,
    *,
    start: str | Path | None = None,
    downsample: int = 3,
    drawn: int = 0,
    steps: int = 2000,
    seed: int = 0,
    tick: Callable[[int, int, str], Any] = lambda done, total, text: None,
) -> TrainResult:
    """Train a network further on the recipe of one camera; resumed where it was stopped.

    Args:
        recipe: as `jaxisp.adapt` narrows one.
        clean: folders of photographs, which are made smaller.
        run: the folder of the run.
        start: a file of weights; those that come with the package unless given.
        downsample: the factor by which photographs are made smaller.
        drawn: pictures that are drawn and used beside them: what a few photographs lack.
        steps: updates of 16 patches of 64 px.
        seed: of everything that is drawn.
        tick: called with (done, total, text).

    Raises:
        InputError: there are no weights to begin with, or `train` raises it.
    """
    found = find_degradation(recipe)
    name = str(recipe) if isinstance(recipe, str | Path) else found.name
    with beginning(start) as (begin, about):
        config = TrainConfig(
            clean=tuple(map(str, several(clean))), recipe=name, model=about["model"],
            model_options=about["options"], light=about.get("light", "encoded"),
            start=str(begin), downsample=downsample, drawn=drawn, steps=steps, seed=seed, batch=16,
            patch=64, per_image=20, target="camera", loss="log_rms", lr=3e-4, pool=min(8192, 16 * steps),
        )  # fmt: skip
        return train(config, run, recipe=found, resume=True, tick=tick)
