"""The same network with more channels: it gives what it gave, and can learn more.

python -m experiments.denoisers.widen FILE --features 64,64,96 --out WIDER

What was there does not see the new channels at first; their own weights are fresh.
Source: Chen, Goodfellow & Shlens, "Net2Net", 2016, in its simplest form.
"""

import argparse
from pathlib import Path

import jax
import numpy as np
from flax import nnx

from jaxisp.errors import InputError
from jaxisp.models import LevelNet, make_model, read_network, save_network


def widened(network: LevelNet, wide: LevelNet) -> None:
    """Give the wide network the weights of the other one, which may have fewer features at each resolution.

    Raises:
        InputError: it has fewer channels somewhere.
    """
    old, new = (dict(nnx.to_flat_state(nnx.state(n, nnx.Param))) for n in (network, wide))
    for path, fresh in new.items():
        name = path[0]
        before, after = np.asarray(old[path].get_value()), np.array(fresh.get_value())
        if any(a > b for a, b in zip(before.shape, after.shape)):
            raise InputError(f"{name}: has {after.shape} weights, fewer than {before.shape}")
        # a picture at half the resolution has the four photosites of a block one after the other
        outputs = _places(before.shape[-1], after.shape[-1], 4 if name == "grow" else 1)
        if before.ndim == 1:
            after[outputs] = before
        else:
            inputs = _places(before.shape[-2], after.shape[-2], 4 if name == "shrink" else 1)
            after[..., outputs] = 0
            after[..., inputs[:, None], outputs] = before
        fresh.set_value(jax.numpy.asarray(after))


def _places(old: int, new: int, groups: int) -> np.ndarray:
    """Where channels are among the new ones; each group has its own at its beginning."""
    return (np.arange(groups)[:, None] * (new // groups) + np.arange(old // groups)).ravel()


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("file", type=Path)
    parser.add_argument("--features", default="64,64,96")
    parser.add_argument("--seed", type=int, default=0, help="of the fresh weights")
    parser.add_argument("--out", type=Path, required=True)
    options = parser.parse_args()
    network, about = read_network(options.file)
    changed = {**about.pop("options"), "features": tuple(int(n) for n in options.features.split(","))}
    wide = make_model(about["model"], seed=options.seed, **changed)
    if not (isinstance(network, LevelNet) and isinstance(wide, LevelNet)):
        raise InputError(f"{options.file}: holds no levelnet")
    widened(network, wide)
    save_network(options.out, wide, about.pop("model"), changed, **about)


if __name__ == "__main__":
    main()
