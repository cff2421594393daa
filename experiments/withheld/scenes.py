"""Scenes in linear light, (H, W, 3) in [0, 1], without visible noise, in three sets that share none.

Half are cut from the photographs that come inside scikit-image, half are drawn. A folder of pictures may
take the place of both.
"""

from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import skimage
from scipy import ndimage

from .numeric import blur, luma, seed_of, srgb_decode

PHOTOGRAPHS = {
    "one": (("astronaut.png", 0.0, 0.4), ("motorcycle_left.png", 0.5, 0.2), ("brick.png", 0.5, 0.5)),
    "two": (("coffee.png", 0.5, 0.55), ("retina.jpg", 0.4, 0.4), ("grass.png", 0.3, 0.3)),
    "three": (("chelsea.png", 0.5, 0.3), ("rocket.jpg", 0.6, 0.5), ("gravel.png", 0.5, 0.5)),
}
SETS = tuple(PHOTOGRAPHS)
GREY = "grey"
"""A palette too poor to tell colours by: set two without its colours."""
Scenes = dict[str, np.ndarray]


def scenes(name: str, size: int = 256, count: int = 8, folder: Path | None = None) -> Scenes:
    """The first `count` scenes of a set, or every third picture of `folder`."""
    if name == GREY:
        return {key: np.repeat(luma(p)[..., None], 3, -1) for key, p in scenes("two", size, count).items()}
    if name not in SETS:
        raise ValueError(f"no scene set {name!r}: there are {', '.join((*SETS, GREY))}")
    if folder is not None:
        files = sorted(p for p in folder.iterdir() if p.suffix.lower() in (".png", ".jpg", ".tif"))
        chosen = files[SETS.index(name) :: len(SETS)][:count]
        return {path.stem: photograph(path, size, 0.5, 0.5) for path in chosen}
    found = {}
    for file, down, across in PHOTOGRAPHS[name][: max(1, count * 3 // 8)]:
        path = Path(skimage.__file__).parent / "data" / file
        found[Path(file).stem] = photograph(path, size, down, across)
    kinds = list(DRAWN)
    for number in range(count - len(found)):
        kind = kinds[(number + SETS.index(name) * 2) % len(kinds)]
        rng = np.random.default_rng(seed_of("scene", name, kind, number))
        found[f"{kind}{number}"] = np.clip(DRAWN[kind](size, rng), 0.002, 1.0)
    return found


def photograph(path: Path, size: int, down: float, across: float) -> np.ndarray:
    """Shrunk so that its noise and compression average out, cut, and stretched to use the range."""
    picture = cv2.imread(str(path), cv2.IMREAD_COLOR)
    if picture is None:
        raise ValueError(f"{path}: not a picture that OpenCV reads")
    grey = bool(np.ptp(picture.astype(int), axis=2).max() == 0)
    linear = srgb_decode(picture[..., ::-1] / 255.0)
    short = min(linear.shape[:2])
    if short < size:
        pad = [(0, max(0, size - n)) for n in linear.shape[:2]]
        linear = np.pad(linear, [*pad, (0, 0)], mode="symmetric")
    scale = max(size / min(linear.shape[:2]), 0.5)
    linear = cv2.resize(linear, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA)
    top = int(down * (linear.shape[0] - size))
    left = int(across * (linear.shape[1] - size))
    cut = linear[top : top + size, left : left + size]
    cut = 0.95 * cut / np.quantile(cut, 0.995)
    return np.clip(_tinted(cut, path.stem) if grey else cut, 0.002, 1.0)


def _tinted(grey: np.ndarray, name: str) -> np.ndarray:
    """Give a grey texture slowly changing colours."""
    rng = np.random.default_rng(seed_of("tint", name))
    field = np.stack([clutter(grey.shape[0], rng, 2.4) for _ in range(3)], axis=-1)
    return grey * (0.35 + 0.65 * field)


def clutter(size: int, rng: np.random.Generator, slope: float) -> np.ndarray:
    """A field in [0, 1] whose amplitude spectrum falls as 1 / f ** slope."""
    frequency = np.hypot(np.fft.fftfreq(size)[:, None], np.fft.rfftfreq(size)[None])
    frequency[0, 0] = 1.0
    phase = np.exp(2j * np.pi * rng.random(frequency.shape))
    field = np.fft.irfft2(phase / frequency**slope, (size, size))
    return (field - field.min()) / np.ptp(field)


def natural(size: int, rng: np.random.Generator) -> np.ndarray:
    """Coloured 1/f clutter behind overlapping leaves of its own colours."""
    field = np.stack([clutter(size, rng, 1.2) for _ in range(3)], axis=-1)
    picture = 0.8 * field.mean(axis=-1, keepdims=True) ** 1.5 + 0.4 * (field - 0.5)
    y, x = np.mgrid[:size, :size]
    for _ in range(60):
        r = rng.pareto(1.8) * size / 50 + 2
        inside = np.hypot(y - rng.random() * size, x - rng.random() * size) < min(r, size / 4)
        colour = rng.random(3) ** 2
        picture[inside] = colour * (0.5 + 0.7 * field[inside].mean(axis=-1, keepdims=True))
    return blur(picture, 0.5)


def patches(size: int, rng: np.random.Generator) -> np.ndarray:
    """A chart of colour patches at several levels, with soft shading."""
    cells = 8
    colours = rng.random((cells, cells, 3)) ** 1.6
    colours[:, 0] = np.linspace(0.01, 0.98, cells)[:, None]
    colours[0] *= 0.15
    picture = np.kron(colours, np.ones((-(-size // cells), -(-size // cells), 1)))[:size, :size]
    shade = np.linspace(0.7, 1, size)[None, :, None]
    return blur(picture * shade, 0.5)


def gradients(size: int, rng: np.random.Generator) -> np.ndarray:
    """Smooth ramps of colour from black to white, crossed by thin lines."""
    y, x = np.mgrid[:size, :size] / size
    turns = rng.random(3) * 2 * np.pi
    ways = [(np.cos(t) * (x - 0.5) + np.sin(t) * (y - 0.5)) / np.sqrt(2) + 0.5 for t in turns]
    ramp = np.stack(ways, axis=-1) ** rng.uniform(1.5, 3, 3) * 0.9
    angle = rng.random() * np.pi
    lines = (np.sin((x * np.cos(angle) + y * np.sin(angle)) * 2 * np.pi * size / 24) > 0.95)[..., None]
    return blur(np.where(lines, 0.85 - 0.8 * ramp, ramp), 0.5)


def edges(size: int, rng: np.random.Generator) -> np.ndarray:
    """A star of slanted edges and a zone plate, both in colours."""
    y, x = np.mgrid[:size, :size] - size * (0.4 + 0.2 * rng.random(2))[:, None, None]
    star = np.sign(np.sin(np.arctan2(y, x) * 12)) * 0.4 + 0.5
    zone = 0.5 + 0.4 * np.cos(np.pi * (x**2 + y**2) / (size * 2.2))
    dark, light = 0.3 * rng.random(3), 0.6 + 0.4 * rng.random(3)
    mix = np.where(x + y > 0, star, np.clip(zone, 0, 1))[..., None]
    return blur(dark + (light - dark) * mix, 0.5)


def writing(size: int, rng: np.random.Generator) -> np.ndarray:
    """Lines of glyph-like strokes in several sizes on coloured paper."""
    paper = 0.55 + 0.4 * rng.random(3)
    picture = np.ones((size, size, 3)) * paper * (0.6 + 0.4 * clutter(size, rng, 2.5)[..., None])
    top = 6
    while top < size:
        scale = float(rng.uniform(0.3, 0.9))
        word = "".join(chr(rng.integers(33, 126)) for _ in range(60))
        cover = np.zeros((size, size), np.uint8)
        place = (int(rng.integers(0, 12)), int(top + 18 * scale))
        cv2.putText(cover, word, place, cv2.FONT_HERSHEY_COMPLEX, scale, 255, 1, cv2.LINE_AA)
        picture += cover[..., None] / 255 * (rng.random(3) * 0.4 - picture)
        top += int(30 * scale) + 4
    return picture


def weave(size: int, rng: np.random.Generator) -> np.ndarray:
    """Cloth-like texture: crossing threads whose pitch changes slowly, over patches of colour."""
    y, x = np.mgrid[:size, :size].astype(float)
    pitch = 5 + 6 * clutter(size, rng, 2.6)
    threads = np.sin(2 * np.pi * x / pitch) * np.sin(2 * np.pi * y / (pitch + 1))
    regions = np.digitize(clutter(size, rng, 2.0), [0.35, 0.5, 0.65])
    colour = (rng.random((4, 3)) ** 1.5)[regions]
    return blur(colour * (0.65 + 0.3 * ndimage.uniform_filter(threads, 2)[..., None]) + 0.02, 0.4)


DRAWN: dict[str, Callable[[int, np.random.Generator], np.ndarray]] = {
    "natural": natural,
    "patches": patches,
    "writing": writing,
    "gradients": gradients,
    "weave": weave,
    "edges": edges,
}


def summary(pictures: Scenes) -> dict[str, tuple[float, float, float]]:
    """Darkest and brightest hundredth and mean of each scene's luminance."""
    return {n: (*np.quantile(luma(p), [0.01, 0.99]), float(luma(p).mean())) for n, p in pictures.items()}
