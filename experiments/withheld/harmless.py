"""Mismatches that no effect stands behind: with these, and with none, a diagnosis should name nothing.

Each has one strength. They are what two right implementations of the same camera may differ in.
"""

from dataclasses import replace

import numpy as np

from .bodies import Body
from .camera import DISTRIBUTIONS, KINDS, Act, Effect, Shot, compressed, with_body


def own_border(body: Body, value: float, shot: Shot) -> Body:
    return replace(body, border="cells" if body.border != "cells" else "own")


def quality(body: Body, value: float, shot: Shot) -> Body:
    return replace(body, quality=body.quality - int(value))


def nearby_curve(body: Body, value: float, shot: Shot) -> Body:
    return replace(body, curve=lambda x: body.curve(x) + value * np.sin(np.pi * body.curve(x)))


def linear_demosaicker(body: Body, value: float, shot: Shot) -> Body:
    return replace(body, demosaicker="bilinear" if body.demosaicker == "malvar" else "malvar")


def rounded_down(encoded: np.ndarray, value: float, shot: Shot) -> np.ndarray:
    return np.floor(np.clip(encoded, 0, 1) * 255) / 255


def per_scene_gain(linear: np.ndarray, value: float, shot: Shot) -> np.ndarray:
    return linear * (1 + value * shot.per_scene("gain").uniform(-1, 1))


def per_scene_light(light: np.ndarray, value: float, shot: Shot) -> np.ndarray:
    return light * (1 - value * shot.per_scene("light").uniform(0, 1))


def cropped(pixels: np.ndarray, value: float, shot: Shot) -> np.ndarray:
    edge = int(value)
    return np.ascontiguousarray(pixels[edge:-edge, edge:-edge])


def as_jpeg(pixels: np.ndarray, value: float, shot: Shot) -> bytes:
    return compressed(pixels, int(value), "4:2:0")


def _anywhere(name: str, what: str, value: float, place: str, act: Act) -> Effect:
    return Effect(name, what, (value,) * 5, {kind: {place: act} for kind in KINDS})


def _body(name: str, what: str, **changes: object) -> Effect:
    return _anywhere(name, what, 1.0, "rendering", with_body(**changes))


HARMLESS = (
    Effect("nothing", "the body itself", (0.0,) * 5, {}),
    _anywhere("lossless", "a file without compression", 1.0, "pixels", lambda pixels, value, shot: pixels),
    _anywhere("other_border", "another rule at the border", 1.0, "rendering", own_border),
    _anywhere("other_quality", "JPEG quality lower by this, as its header says", 6.0, "rendering", quality),
    _anywhere("nearby_curve", "the tone curve higher by this in the middle", 0.01, "rendering", nearby_curve),
    _anywhere(
        "linear_demosaicker", "Malvar's for bilinear and the like", 1.0, "rendering", linear_demosaicker
    ),
    _anywhere("rounded_down", "8 bits by cutting off", 1.0, "encoded", rounded_down),
    _anywhere(
        "scene_gain", "exposure differs by up to this between pictures", 0.004, "linear", per_scene_gain
    ),
    _anywhere("scene_light", "light differs by up to this between scenes", 0.3, "light", per_scene_light),
    _anywhere("cropped", "pixels cut from every side", 1.0, "pixels", cropped),
    _body("full_sampling", "no chroma subsampling, as the header says", sampling="4:4:4"),
    _body("half_sampling", "4:2:0, as the header says", sampling="4:2:0"),
    _body("short_words", "12 bits between the steps", intermediate_bits=12),
    _body("pillow", "Pillow writes the file", encoder="pillow"),
    _body("opencv", "OpenCV writes the file", encoder="opencv"),
    Effect(
        "compressed_clean",
        "clean pictures are JPEGs of this quality, 4:2:0",
        (75.0,) * 5,
        {DISTRIBUTIONS: {"clean": as_jpeg}},
    ),
)
