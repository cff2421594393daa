"""White noise on clean pictures: a network, blind, and others told the level.

python -m experiments.denoisers.white_noise DATA [--network FILE]
"""

import argparse
from pathlib import Path

import numpy as np

from experiments.denoisers.gate import psnr, with_true_map
from experiments.denoisers.training import TEST_PICTURES
from jaxisp.cli.devices import use_cores
from jaxisp.io import read_image
from jaxisp.models import read_network
from jaxisp.models.apply import Denoiser, shipped_denoiser
from jaxisp.train import Classical

STD, SIDE = 0.1, 256
TOLD = ("ffdnet", "bm3d")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("data", type=Path)
    parser.add_argument("--network", type=Path, help="a file of weights; none: those of the package")
    options = parser.parse_args()
    use_cores()
    clean = options.data / "clean"
    paths = [clean / "kodak" / f"{name}.png" for name in TEST_PICTURES]
    paths += sorted((clean / "cbsd68").iterdir())[1::6]
    network = shipped_denoiser()[0]
    if options.network:
        model, about = read_network(options.network)
        network = Denoiser(model, about["light"])
    told = [name for name in TOLD if not Classical(name).missing()]
    rows = []
    for i, path in enumerate(paths):
        picture = read_image(path)[:SIDE, :SIDE]
        noisy = picture + STD * np.random.default_rng(i).standard_normal(picture.shape).astype(np.float32)
        shown = np.clip(noisy, 0, 1)
        others = [Classical(name, STD)(noisy) for name in told]
        made = (shown, network(shown), with_true_map(network.model, shown, picture), *others)
        rows.append([psnr(own, picture) for own in made])
        print(path.name, *np.round(rows[-1], 2), flush=True)
    print(dict(zip(("noisy", "network", "network, true map", *told), np.round(np.mean(rows, 0), 2).tolist())))


if __name__ == "__main__":
    main()
