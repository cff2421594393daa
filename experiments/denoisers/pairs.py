"""What the denoisers are measured on: real pairs, cameras that share no code with the package, recipes."""

import dataclasses
import pickle
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np

from experiments.denoisers.training import Place, pictures, recipe_named
from experiments.withheld.shoot import write
from jaxisp.io import read_image
from jaxisp.stages.transfer import srgb_eotf, srgb_oetf
from jaxisp.train import AlignedPair, align_dataset
from jaxisp.train.evaluate import Align

REAL = {"iphone8": None, "polyu": 512, "sidd": 512}
"""Real pairs, and the side of the middle part that is used [px]."""
CAMERAS = {
    "birch": {"chroma_denoising": 3, "sharpening": 2},
    "cedar": {"luma_denoising": 2, "chroma_denoising": 4},
    "dogwood": {"luma_denoising": 1, "chroma_denoising": 2, "sharpening": 3},
}
"""Simulated cameras with their own demosaicking, tone and JPEG, and how strongly each processes."""
SIMULATED = "cameras"
RAW = "raw"
RAW_NOISE = {"shot": 0.01, "read": 0.05}
_SIDE = 192


def evaluation_set(place: Place, name: str) -> list[AlignedPair]:
    """The pairs of a set, aligned; kept on disk, as aligning whole frames takes minutes."""
    file = place.work / "pairs" / f"{name}.pickle"
    if not file.exists():
        made = _make(place, name)
        file.parent.mkdir(parents=True, exist_ok=True)
        file.write_bytes(pickle.dumps(made))
    return pickle.loads(file.read_bytes())


def _make(place: Place, name: str) -> list[AlignedPair]:
    if name == SIMULATED:
        return _cameras(place)
    if name == RAW:
        return _demosaicked(place)
    return aligned(place.data / name, REAL[name])


def aligned(folder: Path, crop: int | None, align: Align = "channels") -> list[AlignedPair]:
    """The pairs of a set, aligned; ends the program where one cannot be."""
    failed: list[tuple[str, str]] = []
    made = list(align_dataset(folder, crop=crop, align=align, failed=failed))
    if failed:
        raise SystemExit(f"{folder}: {failed[0][1]}")
    return made


def _cameras(place: Place) -> list[AlignedPair]:
    scenes = {name: to_linear(image) for name, image in test_pictures(place).items()}
    made: list[AlignedPair] = []
    for body, effects in CAMERAS.items():
        folder = place.work / "cameras" / body
        write(folder, body, effects, kind="clean+noisy", scenes=scenes)
        made += [dataclasses.replace(pair, name=f"{body} {pair.name}") for pair in align_dataset(folder)]
    return made


def _demosaicked(place: Place) -> list[AlignedPair]:
    """RAW noise and Kodak demosaicking, nothing after it."""
    images = test_pictures(place)
    clean = np.stack(list(images.values()))
    recipe = recipe_named(place, "phone-kodak")
    key = jax.random.key(1)
    _, _, params = recipe.degrade(key, clean)
    noise = params["shot_read_noise"]
    fixed = type(noise)(**{k: jnp.full_like(getattr(noise, k), v) for k, v in RAW_NOISE.items()})
    noisy = np.asarray(recipe.repeat(key, {**params, "shot_read_noise": fixed}, clean))
    return [as_pair(*item) for item in zip(images, noisy, clean)]


def gaussian(place: Place, std: float) -> list[AlignedPair]:
    """White Gaussian noise in linear light, not rounded, as the AWGN networks are trained for."""
    made = []
    for i, (name, clean) in enumerate(test_pictures(place).items()):
        noise = np.random.default_rng((7, i)).standard_normal(clean.shape)
        noisy = srgb_oetf(jnp.clip(jnp.asarray(to_linear(clean) + std * noise, jnp.float32), 0, 1))
        made.append(as_pair(name, np.asarray(noisy), clean))
    return made


def as_pair(name: str, noisy: np.ndarray, clean: np.ndarray) -> AlignedPair:
    """Two encoded pictures that lie on one another."""
    whole = (slice(0, clean.shape[0]), slice(0, clean.shape[1]))
    return AlignedPair(name, noisy, whole, to_linear(clean), True, (0.0, 0.0))


def test_pictures(place: Place) -> dict[str, np.ndarray]:
    """Middles of the pictures that are in no training set, encoded."""
    return {path.stem: _middle(path) for path in sorted(pictures(place, "test").iterdir())}


def _middle(path: Path) -> np.ndarray:
    image = read_image(path)
    y, x = ((n - _SIDE) // 2 for n in image.shape[:2])
    return np.ascontiguousarray(image[y : y + _SIDE, x : x + _SIDE])


def to_linear(image: np.ndarray) -> np.ndarray:
    """Encoded sRGB to light."""
    return np.asarray(srgb_eotf(jnp.asarray(image, jnp.float32)))
