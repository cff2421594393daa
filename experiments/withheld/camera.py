"""How a picture goes through a body, with the places at which effects may act.

scene -> light -> sites -> (noise) -> readout -> RAW file -> raw -> (demosaicking) -> linear -> rgb
      -> (tone curve) -> encoded -> pixels -> picture file
scene -> clean -> clean file, of clean+noisy pairs
"""

import io
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import cv2
import numpy as np
from PIL import Image
from scipy import ndimage

from .bodies import Body
from .demosaic import demosaic, mosaicked
from .numeric import blur, luma, seed_of

PAIRED, DISTRIBUTIONS = "raw+jpeg", "clean+noisy"
KINDS = (PAIRED, DISTRIBUTIONS)
Act = Callable[[Any, float, "Shot"], Any]


@dataclass(frozen=True)
class Effect:
    """What is done, at which places for either kind of data, at five strengths."""

    name: str
    what: str
    strengths: Sequence[float]
    acts: dict[str, dict[str, Act]]  # kind -> place -> what is done there


@dataclass(frozen=True)
class Shot:
    """One picture being taken: the body, the kind of data, the active effects and the random numbers."""

    body: Body
    kind: str
    active: tuple[tuple[Effect, int], ...]
    scene: str
    seed: int = 0
    frame: int = 0

    def at(self, place: str, value: Any) -> Any:
        for effect, level in self.active:
            act = effect.acts.get(self.kind, {}).get(place)
            if act is not None:
                value = act(value, effect.strengths[level - 1], self)
        return value

    def chance(self, *words: object) -> np.random.Generator:
        """Random numbers of this frame of this scene."""
        return self._random(self.scene, self.frame, *words)

    def fixed(self, *words: object) -> np.random.Generator:
        """Random numbers of the body: the same in all of its pictures."""
        return self._random("fixed", *words)

    def per_scene(self, *words: object) -> np.random.Generator:
        return self._random(self.scene, "scene", *words)

    def _random(self, *words: object) -> np.random.Generator:
        return np.random.default_rng(seed_of(self.body.seeds or self.body.name, self.seed, *words))


def before_body(scene: np.ndarray, body: Body) -> np.ndarray:
    """The scene as this body can see it: its own small spot is no effect, so it belongs to the scene."""
    return np.clip(blur(scene, body.spot), 0, 1)


def expose(scene: np.ndarray, shot: Shot) -> np.ndarray:
    """The RAW file's numbers."""
    body = shot.body
    light = shot.at("light", scene) @ np.linalg.inv(body.matrix).T
    mosaic = mosaicked(np.clip(light, 0, None) * body.exposure / np.array(body.gains), body.cfa)
    mosaic = shot.at("sites", mosaic)
    mosaic = shot.at("readout", _noisy(mosaic, shot))
    counts = np.rint(body.black + mosaic * (body.white - body.black))
    return np.clip(counts, 0, body.white).astype(np.uint16)


def _noisy(mosaic: np.ndarray, shot: Shot) -> np.ndarray:
    noise = shot.at("noise", shot.body.noise(shot.kind))
    rng = shot.chance("noise")
    electrons = rng.poisson(np.clip(mosaic, 0, 4) * noise.full_well).astype(float)
    if np.isfinite(noise.freedom):
        read = rng.standard_t(noise.freedom, mosaic.shape) / np.sqrt(noise.freedom / (noise.freedom - 2))
        read = np.clip(read, -40, 40)
    else:
        read = rng.standard_normal(mosaic.shape)
    if noise.reach > 0:
        read = ndimage.gaussian_filter(read, noise.reach, mode="wrap")
        read = read / read.std()
    return (electrons + noise.read * read) / noise.full_well


def develop(raw: np.ndarray, shot: Shot) -> np.ndarray:
    """The picture in 8 bits that the body makes of its RAW."""
    body = shot.at("rendering", shot.body)
    steps = 2.0**body.intermediate_bits
    mosaic = shot.at("raw", (raw.astype(float) - body.black) / (body.white - body.black))
    gains = np.array(body.gains) / body.exposure
    if body.order == "balance-first":
        balanced = np.ones((*mosaic.shape, 3)) * gains
        mosaic = np.minimum(mosaic * mosaicked(balanced, body.cfa), 1.0)
        linear = shot.at("demosaicked", _interpolated(mosaic, body))
    else:
        linear = np.minimum(shot.at("demosaicked", _interpolated(mosaic, body)) * gains, 1.0)
    linear = np.rint(shot.at("linear", linear) * steps) / steps
    rgb = np.clip(shot.at("rgb", linear @ body.matrix.T), 0, 1)
    encoded = np.clip(shot.at("encoded", toned(rgb, body)), 0, 1)
    return shot.at("pixels", np.rint(encoded * 255).astype(np.uint8))


def _interpolated(mosaic: np.ndarray, body: Body) -> np.ndarray:
    return demosaic(mosaic, body.cfa, body.demosaicker, body.border)


def toned(rgb: np.ndarray, body: Body) -> np.ndarray:
    """The tone curve on each channel, mixed with the same curve on luma alone where the body does so."""
    channels = body.curve(rgb)
    if body.luma_share == 0:
        return channels
    y = luma(rgb)[..., None]
    lifted = np.clip(body.curve(y) + (rgb - y) * body.curve(y) / np.maximum(y, 1e-3), 0, 1)
    return (1 - body.luma_share) * channels + body.luma_share * lifted


def compressed(pixels: np.ndarray, quality: int, sampling: str, encoder: str = "pillow") -> bytes:
    """A JPEG file, by Pillow or by OpenCV."""
    if encoder == "opencv":
        factor = getattr(cv2, "IMWRITE_JPEG_SAMPLING_FACTOR_" + sampling.replace(":", ""))
        options = [cv2.IMWRITE_JPEG_QUALITY, quality, cv2.IMWRITE_JPEG_SAMPLING_FACTOR, factor]
        return cv2.imencode(".jpg", np.ascontiguousarray(pixels[..., ::-1]), options)[1].tobytes()
    file = io.BytesIO()
    codes = {"4:4:4": 0, "4:2:2": 1, "4:2:0": 2}
    Image.fromarray(pixels).save(file, "JPEG", quality=quality, subsampling=codes[sampling])
    return file.getvalue()


def decompressed(file: bytes) -> np.ndarray:
    return np.asarray(Image.open(io.BytesIO(file)).convert("RGB"))


def with_body(**changes: object) -> Act:
    """An act that changes what the rendering takes the body for."""
    return lambda body, value, shot: replace(body, **changes)
