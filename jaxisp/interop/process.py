"""What a recipe needs in programs that JAX knows nothing of: whose process it is, and pictures of any
size."""

import os
import sys
from typing import Any

import jax
import numpy as np

from jaxisp.errors import InputError
from jaxisp.mixture import Degradation, parts
from jaxisp.recipe import check_photographs
from jaxisp.recipes import RecipeLike, find_degradation, read_degradation

MULTIPLE = 32
"""Sizes are filled up to multiples of it [px]: each size is a compiled program of its own."""

_PROCESS = os.getpid()  # the one that imports this; a forked one has another


class Degrader:
    """A recipe that counts its pictures; picklable, and safe where workers are started by spawn.

    Args:
        recipe: takes and gives encoded sRGB: a recipe, a mixture, a chain, a name, or a TOML file.
        seed: of everything that is drawn.
        multiple: what sizes are filled up to, by reflection, before a recipe runs.

    Raises:
        InputError: there is no such recipe, it is not for photographs, or there is no such multiple.
    """

    def __init__(self, recipe: RecipeLike, seed: int = 0, multiple: int = MULTIPLE) -> None:
        found = find_degradation(recipe)
        for part in parts(found):
            check_photographs(part)
        if multiple < 1:
            raise InputError(f"multiple = {multiple}: sizes cannot be filled up to that")
        self.recipe: Degradation = found
        self.seed, self.multiple = seed, multiple

    def __getstate__(self) -> dict[str, Any]:
        """The recipe as TOML where all its stages are of the package: fingerprints of data sets stay."""
        stages = (s for part in parts(self.recipe) for s in part.chain.stages())
        if all(s.fn.__module__.startswith("jaxisp.") for s in stages):
            return {**vars(self), "recipe": self.recipe.to_toml()}
        return dict(vars(self))

    def __setstate__(self, state: dict[str, Any]) -> None:
        vars(self).update(state)
        if isinstance(state["recipe"], str):
            self.recipe = read_degradation(state["recipe"])

    def key(self, stream: int = 0) -> jax.Array:
        """The root key of a stream of pictures.

        Raises:
            InputError: the process was forked from one that has JAX, whose threads it lacks.
        """
        if os.getpid() != _PROCESS:
            raise InputError(
                "this process was forked from one that has JAX, where a recipe may hang: start workers with "
                "multiprocessing_context='spawn', or degrade in the main process (without num_proc)"
            )
        return jax.random.fold_in(jax.random.key(self.seed), stream)

    def degrade(self, key: jax.Array, images: np.ndarray, indices: np.ndarray) -> np.ndarray:
        """(N, H, W, 3) pictures of one size, by their indices; float32 NumPy."""
        height, width = images.shape[1:3]
        fill = [-n % self.multiple for n in (height, width)]
        if any(f >= n for f, n in zip(fill, (height, width))):
            filled = np.pad(images, ((0, 0), (0, fill[0]), (0, fill[1]), (0, 0)), mode="symmetric")
        else:
            filled = np.pad(images, ((0, 0), (0, fill[0]), (0, fill[1]), (0, 0)), mode="reflect")
        noisy = self.recipe.degrade(key, filled, indices)[0]
        return np.asarray(noisy)[:, :height, :width]


def worker() -> int:
    """The number of this worker among those of a PyTorch loader, 0 in a main process."""
    data = sys.modules.get("torch.utils.data")
    info = data.get_worker_info() if data is not None else None
    return 0 if info is None else 1 + int(info.id)
