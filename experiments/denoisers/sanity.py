"""Whether networks do anything to real JPEG noise, and whether those for white noise take white noise off."""

from typing import Any

from experiments.denoisers.pairs import REAL, gaussian
from experiments.denoisers.study import Table, figures, main
from experiments.denoisers.training import Place
from jaxisp.train import Denoiser

STD = 0.1


def on_white_noise(place: Place, name: str, denoiser: Denoiser) -> list[dict[str, Any]]:
    """AWGN of a standard deviation of 0.1 in linear light."""
    return [{"set": f"awgn {STD}", **figures(denoiser, gaussian(place, STD))}]


TABLE = Table(
    "sanity",
    "Input against output, and white Gaussian noise of std 0.1",
    ("awgn", "amwgn", "phone"),
    tuple(REAL),
    more=on_white_noise,
)

if __name__ == "__main__":
    main(TABLE)
