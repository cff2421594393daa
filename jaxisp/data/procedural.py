"""Drawn pictures, for what small collections of photographs lack: sharp edges of all sizes, text, stripes,
smooth gradients, texture, strong colours.

Drawn at twice the size with Pillow and made smaller in linear light, so that edges are as soft as a lens and
sensor would make them.
"""

import string
from typing import Any

import numpy as np
from PIL import Image, ImageDraw, ImageFont

from jaxisp.data.clean import CleanImages, downsample_linear

DRAWN = 24
"""Drawn pictures that stand beside few photographs."""
KINDS = ("leaves", "text", "stripes", "gradients")
_TWICE = 2
_SMALLEST, _LARGEST = 2.0, 0.35  # radius of a leaf: px of the drawing, and share of its side


def drawn(kind: str, seed: int, side: int = 512) -> np.ndarray:
    """A drawn picture: the same for the same kind and seed.

    Args:
        kind: "leaves", shapes of all sizes that cover each other, their radii spread by the law r**-3 that
            makes pictures look alike at all scales (Ruderman 1997; Lee, Mumford & Huang 2001); "text", lines
            of letters on plain or textured paper; "stripes", gratings and checkerboards; "gradients", smooth
            light and colour.
        seed: of all that is drawn.
        side: of the picture [px].

    Returns:
        (side, side, 3) float32 encoded sRGB in [0, 1].

    Raises:
        ValueError: there is no such kind.
    """
    if kind not in KINDS:
        raise ValueError(f"kind must be one of {', '.join(KINDS)}, got {kind!r}")
    rng = np.random.default_rng((seed, KINDS.index(kind)))
    paint = {"leaves": _leaves, "text": _text, "stripes": _stripes, "gradients": _gradients}[kind]
    picture = paint(rng, _TWICE * side)
    return downsample_linear(np.clip(picture, 0, 1).astype(np.float32), _TWICE)


def drawn_images(count: int, seed: int = 0, side: int = 256) -> CleanImages:
    """Drawn pictures as clean ones, half of them leaves.

    Args:
        count: of pictures.
        seed: of all of them.
        side: of each [px].
    """
    kinds = ("leaves", "text", "leaves", "stripes", "leaves", "gradients")
    named = [(kinds[i % len(kinds)], seed * count + i) for i in range(count)]
    images = (np.round(drawn(kind, own, side) * np.float32(65535)).astype(np.uint16) for kind, own in named)
    return CleanImages(tuple(f"drawn {kind} {own}" for kind, own in named), tuple(images))


def _leaves(rng: np.random.Generator, side: int) -> np.ndarray:
    palette = _palette(rng, 24)
    image = Image.new("RGB", (side, side), _as_levels(palette[0]))
    draw = ImageDraw.Draw(image)
    largest = _LARGEST * side
    smallest = _SMALLEST * float(np.exp(rng.uniform(0, np.log(8))))
    # each picture is covered about four times
    mean = 2 * np.pi * smallest * smallest * np.log(largest / smallest)
    for _ in range(min(20_000, int(4 * side * side / mean))):
        # u**-1/2 is spread as r**-3
        u = rng.uniform((smallest / largest) ** 2, 1)
        _leaf(draw, rng, smallest / np.sqrt(u), rng.uniform(0, side, 2), _as_levels(_near(rng, palette)))
    picture = np.asarray(image, np.float32) / 255
    return picture * _shade(rng, side) * _texture(rng, side)


def _leaf(draw: Any, rng: np.random.Generator, radius: float, centre: np.ndarray, color: Any) -> None:
    kind, (x, y) = rng.integers(4), centre
    stretch = np.exp(rng.uniform(-0.7, 0.7))
    if kind == 0:
        draw.ellipse((x - radius, y - radius * stretch, x + radius, y + radius * stretch), fill=color)
        return
    corners = {1: 4, 2: 3, 3: int(rng.integers(5, 9))}[int(kind)]
    angles = rng.uniform(0, 2 * np.pi) + 2 * np.pi * np.arange(corners) / corners
    radii = radius * (rng.uniform(0.5, 1, corners) if kind == 3 else np.ones(corners))
    turn = rng.uniform(0, np.pi)
    across, down = radii * np.cos(angles) * stretch, radii * np.sin(angles)
    points = np.stack([
        x + across * np.cos(turn) - down * np.sin(turn), y + across * np.sin(turn) + down * np.cos(turn)
    ], 1)  # fmt: skip
    draw.polygon([tuple(p) for p in points.tolist()], fill=color)


def _text(rng: np.random.Generator, side: int) -> np.ndarray:
    dark, light = sorted(_palette(rng, 2), key=lambda c: float(c.mean()))
    ink, paper = (dark * 0.5, 0.5 + light / 2) if rng.uniform() < 0.7 else (0.5 + light / 2, dark * 0.5)
    image = Image.new("RGB", (side, side), _as_levels(paper))
    draw = ImageDraw.Draw(image)
    letters = list(string.ascii_letters + string.digits + "     .,;:-()&%")
    y = 0.0
    while y < side:
        size = int(np.exp(rng.uniform(np.log(14), np.log(90))))
        font = ImageFont.load_default(size)
        for _ in range(int(rng.integers(1, 6))):
            line = "".join(rng.choice(letters, 2 * side // size + 4))
            draw.text((-rng.uniform(0, size), y), line, fill=_as_levels(ink), font=font)
            y += size * rng.uniform(1.1, 1.6)
    picture = np.asarray(
        image.rotate(float(rng.uniform(-8, 8)), Image.Resampling.BILINEAR, fillcolor=_as_levels(paper))
    )
    return picture.astype(np.float32) / 255 * _shade(rng, side) * _texture(rng, side)


def _stripes(rng: np.random.Generator, side: int) -> np.ndarray:
    y, x = np.mgrid[:side, :side].astype(np.float32)
    colors = _palette(rng, 4)
    cells = int(rng.integers(1, 4))
    picture = np.empty((side, side, 3), np.float32)
    for row in range(cells):
        for column in range(cells):
            part = np.s_[
                row * side // cells : (row + 1) * side // cells,
                column * side // cells : (column + 1) * side // cells,
            ]
            angle, period = rng.uniform(0, np.pi), np.exp(rng.uniform(np.log(5), np.log(80)))
            wave = np.sin(2 * np.pi / period * (x[part] * np.cos(angle) + y[part] * np.sin(angle)))
            if rng.uniform() < 0.3:
                wave = wave * np.sin(2 * np.pi / period * (y[part] * np.cos(angle) - x[part] * np.sin(angle)))
            share = 0.5 + 0.5 * np.clip(wave * np.exp(rng.uniform(0, 3)), -1, 1)
            one, other = colors[rng.permutation(4)[:2]]
            picture[part] = one + (other - one) * share[..., None]
    return picture * _shade(rng, side)


def _gradients(rng: np.random.Generator, side: int) -> np.ndarray:
    colors = _palette(rng, 3)
    shares = np.stack([_smooth(rng, side, 2.5) for _ in range(2)], -1)
    picture = colors[0] + shares @ (colors[1:] - colors[0])
    if rng.uniform() < 0.5:
        picture = picture * _texture(rng, side)
    return picture * _shade(rng, side)


def _palette(rng: np.random.Generator, count: int) -> np.ndarray:
    """(count, 3) colours about a few hues, most of them pale, from dark to light."""
    base = rng.uniform(0, 1, (int(rng.integers(1, 5)), 3))
    light = rng.beta(1.2, 1.4, (count, 1))
    strength = rng.beta(1, 2, (count, 1))
    hue = base[rng.integers(len(base), size=count)] + rng.normal(0, 0.08, (count, 3))
    return np.clip(light + strength * (hue - hue.mean(1, keepdims=True)), 0, 1).astype(np.float32)


def _near(rng: np.random.Generator, palette: np.ndarray) -> np.ndarray:
    return palette[rng.integers(len(palette))] + rng.normal(0, 0.04)


def _as_levels(color: np.ndarray) -> tuple[int, int, int]:
    r, g, b = np.clip(np.round(255 * np.asarray(color)), 0, 255).astype(int).tolist()
    return r, g, b


def _shade(rng: np.random.Generator, side: int) -> np.ndarray:
    """Light that falls unevenly, (side, side, 1) about 1."""
    if rng.uniform() < 0.3:
        return np.ones((1, 1, 1), np.float32)
    return 1 + rng.uniform(0, 0.4) * (_smooth(rng, side, 2.5) - 0.5)[..., None]


def _texture(rng: np.random.Generator, side: int) -> np.ndarray:
    """Fine grain of a surface, (side, side, 1) about 1, none in every other picture and not everywhere."""
    if rng.uniform() < 0.5:
        return np.ones((1, 1, 1), np.float32)
    where = np.clip(3 * (_smooth(rng, side, 2.5) - 0.5), 0, 1)
    grain = _smooth(rng, side, float(rng.uniform(0.6, 1.8))) - 0.5
    return 1 + rng.uniform(0, 0.6) * (where * grain)[..., None]


def _smooth(rng: np.random.Generator, side: int, power: float) -> np.ndarray:
    """A random field from 0 to 1 whose amplitudes fall with frequency as f**-power, (side, side) float32."""
    f = np.hypot(np.fft.fftfreq(side)[:, None], np.fft.rfftfreq(side)[None])
    f[0, 0] = np.inf
    spectrum = np.fft.rfft2(rng.standard_normal((side, side))) * f**-power
    field = np.fft.irfft2(spectrum, (side, side))
    low, high = np.quantile(field, (0.01, 0.99))
    return np.clip((field - low) / (high - low), 0, 1).astype(np.float32)
