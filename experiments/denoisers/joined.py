"""Two networks made one: the mean of their weights, with the noise map's estimator of a third.

python -m experiments.denoisers.joined BEFORE AFTER --share 0.7 --estimator FILE --out FILE

AFTER was trained further from BEFORE, on other data. Their mean keeps much of what either has learned.
The estimator learns from errors of the map alone, so that one serves any network that is given a map.

Source: Wortsman et al., "Robust fine-tuning of zero-shot models", 2022.
"""

import argparse
from pathlib import Path

import jax
from flax import nnx

from jaxisp.errors import InputError
from jaxisp.models import LevelNet, read_network, save_network


def joined(before: LevelNet, after: LevelNet, share: float, estimator: LevelNet) -> LevelNet:
    """The network whose weights are `share` of those after and the rest of those before.

    Raises:
        InputError: they have other features.
    """
    graph, first = nnx.split(before)
    last = nnx.state(after)
    if jax.tree.map(lambda a: a.shape, first) != jax.tree.map(lambda a: a.shape, last):
        raise InputError("the networks have other features: their weights have no mean")
    network = nnx.merge(graph, jax.tree.map(lambda a, b: (1 - share) * a + share * b, first, last))
    network.sense, network.cells, network.levels = estimator.sense, estimator.cells, estimator.levels
    return network


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("before", type=Path)
    parser.add_argument("after", type=Path)
    parser.add_argument("--share", type=float, default=0.7, help="of the weights after")
    parser.add_argument("--estimator", type=Path, required=True, help="weights that the estimator is of")
    parser.add_argument("--out", type=Path, required=True)
    options = parser.parse_args()
    read = [read_network(file) for file in (options.before, options.after, options.estimator)]
    networks = [network for network, _ in read if isinstance(network, LevelNet)]
    if len(networks) < len(read):
        raise InputError("one of the files holds no levelnet")
    about = read[1][1]
    network = joined(networks[0], networks[1], options.share, networks[2])
    save_network(options.out, network, about.pop("model"), about.pop("options"), **about)


if __name__ == "__main__":
    main()
