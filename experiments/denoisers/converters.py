"""Cameras of other programs, with clean pictures: what networks are chosen on before any real set.

A simulated RAW file with noise and one without are developed alike by RawTherapee, darktable or LibRaw. Each
scene is as soft as a lens makes it, and as sharp as a picture that somebody made smaller. The scenes are of
photographs that the networks learned from, seen by other cameras.

python -m experiments.denoisers.converters DATA --work RUNS [--network FILE ...]
"""

import argparse
import dataclasses
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np
from scipy.ndimage import gaussian_filter

from benchmarks.machine import machine
from experiments.denoisers.classical import NETWORK
from experiments.denoisers.gate import with_true_map
from experiments.denoisers.pairs import as_pair
from experiments.denoisers.report import save
from experiments.third_party import cameras, rawtherapee, scenes
from experiments.third_party.cases import CONVERTERS
from experiments.third_party.chance import DEVELOP
from jaxisp.cli.devices import use_cores
from jaxisp.data.clean import SOFTNESS
from jaxisp.io import read_image
from jaxisp.models import read_network
from jaxisp.models.apply import Denoiser
from jaxisp.process.cache import keep_compiled
from jaxisp.stages.transfer import srgb_oetf
from jaxisp.train import AlignedPair, Classical, evaluate_pairs
from jaxisp.train.classical import METHODS
from jaxisp.train.finetune import beginning

SIDE, SCENES = 256, 6
SOFT = {"as a lens": SOFTNESS, "made smaller": 0.0}
"""Standard deviation of the scenes' blur [px]."""
KEY = "converters"
TOLD = f"{NETWORK}, told the true noise map"


class Camera(NamedTuple):
    """A converter, a sensor at an ISO, and the converter's settings beside its plain profile."""

    converter: str
    sensor: str
    iso: int
    settings: dict[str, Any]


def _denoised() -> dict[str, Any]:
    """RawTherapee's reduction of noise: a low strength of luma's, a middle one of chroma's."""
    luma = rawtherapee.SWITCHES["luma_noise"].levels[1]
    chroma = rawtherapee.SWITCHES["chroma_noise"].levels[2]
    return {name: {**dict(luma.get(name, {})), **dict(chroma.get(name, {}))} for name in {*luma, *chroma}}


CAMERAS = {
    "RawTherapee, denoised": Camera("rawtherapee", "imx477", 400, _denoised()),
    "RawTherapee": Camera("rawtherapee", "ov5647", 100, {}),
    "darktable": Camera("darktable", "imx219", 200, {}),
    "LibRaw": Camera("libraw", "imx378", 400, {}),
    "darktable, strong noise": Camera("darktable", "imx219", 1600, {}),
    "LibRaw, strong noise": Camera("libraw", "imx378", 1600, {}),
    "LibRaw, stronger noise": Camera("libraw", "imx477", 800, {}),
}


def pairs(data: Path, work: Path, name: str, softness: float) -> list[AlignedPair]:
    """Noisy and clean pictures of a camera; kept on disk."""
    folder = work / f"{name} {softness:g}".lower().replace(",", "").replace(" ", "-")
    camera = CAMERAS[name]
    sensor = dataclasses.replace(cameras.SENSORS[camera.sensor], iso=camera.iso)
    pictures = []
    for noisy in (True, False):
        out = folder / ("noisy" if noisy else "clean")
        raws = [out / "raw" / f"s{i}.dng" for i in range(SCENES)]
        if not (out / "done").exists():
            raws[0].parent.mkdir(parents=True, exist_ok=True)
            for path, place in zip(raws, scenes.chosen(data, DEVELOP, camera.sensor, SCENES), strict=True):
                light = gaussian_filter(scenes.light(place, SIDE), (softness, softness, 0))
                seen = f"{place[0].stem} {place[1]}"
                cameras.exposed(data, camera.sensor, sensor, light, seen, noisy=noisy).save(path)
            CONVERTERS[camera.converter].develop(raws, camera.sensor, camera.settings, out)
            (out / "done").touch()
        pictures.append([read_image(out / f"{raw.stem}.jpg") for raw in raws])
    return [as_pair(f"s{i}", *both) for i, both in enumerate(zip(*pictures, strict=True))]


def measured(own: list[AlignedPair], networks: dict[str, Path]) -> Iterator[tuple[str, dict[str, Any]]]:
    """(denoiser, figures) of classical ones and of networks, all blind; and of that of the package told the
    true noise map."""
    yield "noisy input", evaluate_pairs(lambda noisy: noisy, own)
    for method in METHODS:
        if not Classical(method).missing():
            yield method, evaluate_pairs(Classical(method), own)
    for name, path in networks.items():
        model, about = read_network(path)
        yield name, evaluate_pairs(Denoiser(model, about["light"]), own)
    yield TOLD, evaluate_pairs(_told(read_network(networks[NETWORK])[0], own), own)


def _told(model: Any, own: list[AlignedPair]) -> Callable[[np.ndarray], np.ndarray]:
    """The network with the true noise map of these pictures."""
    clean = {pair.noisy.tobytes(): np.asarray(srgb_oetf(jnp.asarray(pair.clean))) for pair in own}
    return lambda noisy: with_true_map(model, noisy, clean[np.ascontiguousarray(noisy).tobytes()])


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("data", type=Path)
    parser.add_argument("--work", type=Path, required=True, help="pictures are kept here")
    parser.add_argument("--network", type=Path, nargs="*", default=[], help="beside that of the package")
    parser.add_argument("--out", type=Path, default=Path("docs/results"))
    options = parser.parse_args()
    use_cores()
    keep_compiled()
    networks = {path.stem: path for path in options.network}
    rows = []
    with beginning() as (shipped, _):
        for name in CAMERAS:
            for how, softness in SOFT.items():
                own = pairs(options.data, options.work, name, softness)
                for denoiser, result in measured(own, networks | {NETWORK: shipped}):
                    mean = {key: round(value, 4) for key, value in result["mean"].items()}
                    rows.append({"denoiser": denoiser, "camera": name, "scenes": how, "mean": mean})
                    print(name, how, denoiser, mean["psnr_fixed"], flush=True)
    save(options.out, KEY, {
        "title": "Cameras of other programs, before any real set",
        "command": "python -m experiments.denoisers.converters DATA --work RUNS --network BEFORE.npz",
        "machine": machine(), "rows": rows,
    })  # fmt: skip


if __name__ == "__main__":
    main()
