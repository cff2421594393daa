"""Write a data set that a body took, with the named effects in it.

    python -m experiments.withheld.shoot FOLDER BODY --effects vignetting=3 --kind raw+jpeg

The same arguments give the same files.
"""

import argparse
from collections.abc import Mapping
from pathlib import Path

import cv2
import numpy as np

from .bodies import BODIES, Body
from .camera import DISTRIBUTIONS, KINDS, PAIRED, Shot, before_body, compressed, develop, expose
from .effects import EVERYTHING, LEVELS, shows_in, without_header
from .numeric import srgb_encode
from .scenes import Scenes
from .scenes import scenes as scene_set


def write(
    folder: Path,
    body: str,
    effects: Mapping[str, int] | None = None,
    kind: str = PAIRED,
    scenes: str | Scenes = "one",
    size: int = 256,
    seed: int = 0,
    frames: int = 1,
    count: int = 8,
) -> list[str]:
    """Write one data set and return the names of its scenes.

    `effects` gives a strength from 1 (hardly visible) to 5 (strong) for each name; `scenes` is one of the
    sets or pictures in linear light; `frames` above one writes so many exposures of each scene.
    """
    effects = dict(effects or {})
    _check(effects, kind)
    folder.mkdir(parents=True, exist_ok=True)
    pictures = scene_set(scenes, size, count) if isinstance(scenes, str) else scenes
    active = tuple((EVERYTHING[name], level) for name, level in effects.items())
    for name, scene in pictures.items():
        seen = before_body(scene, BODIES[body])
        if kind == DISTRIBUTIONS:
            pixels = np.rint(255 * srgb_encode(seen)).astype(np.uint8)
            _save_clean(
                folder / f"{name}.clean", Shot(BODIES[body], kind, active, name, seed).at("clean", pixels)
            )
        for frame in range(frames):
            stem = name if frames == 1 else f"{name}.f{frame:02d}"
            shot = Shot(BODIES[body], kind, active, name, seed, frame)
            _save(folder, stem, seen, shot, lossless=without_header(effects))
    (folder / "dataset.toml").write_text(description(BODIES[body], kind))
    return list(pictures)


def _check(effects: Mapping[str, int], kind: str) -> None:
    if kind not in KINDS:
        raise ValueError(f"no kind {kind!r}: there are {', '.join(KINDS)}")
    for name, level in effects.items():
        if name not in EVERYTHING:
            raise ValueError(f"no effect {name!r}")
        if level not in LEVELS:
            raise ValueError(f"{name}: strength is {level!r}, must be one of {LEVELS}")
        if not shows_in(name, kind):
            raise ValueError(f"{name} does not show in {kind} pairs")


def _save(folder: Path, stem: str, scene: np.ndarray, shot: Shot, lossless: bool) -> None:
    raw = expose(scene, shot)
    if shot.kind == PAIRED:
        np.save(folder / f"{stem}.raw.npy", raw)
    pixels = develop(raw, shot)
    if lossless:
        ending = ".png" if shot.kind == PAIRED else ".noisy.png"
        _save_png(folder / f"{stem}{ending}", pixels)
    else:
        body = shot.at("rendering", shot.body)
        (folder / f"{stem}.jpg").write_bytes(compressed(pixels, body.quality, body.sampling, body.encoder))


def _save_clean(path: Path, clean: np.ndarray | bytes) -> None:
    """Pixels, or a JPEG file as it stands."""
    if isinstance(clean, bytes):
        path.with_name(f"{path.name}.jpg").write_bytes(clean)
    else:
        _save_png(path.with_name(f"{path.name}.png"), clean)


def _save_png(path: Path, pixels: np.ndarray) -> None:
    path.write_bytes(cv2.imencode(".png", np.ascontiguousarray(pixels[..., ::-1]))[1].tobytes())


def description(body: Body, kind: str) -> str:
    """dataset.toml of what a body took."""
    lines = [f'camera = "{body.name}"', f"iso = {100 if kind == PAIRED else 1600}"]
    if kind == DISTRIBUTIONS:
        return "\n".join([*lines, 'clean_encoding = "srgb"', ""])
    lines += ["", "[raw]", f'cfa = "{body.cfa}"', f"black = {body.black:.1f}", f"white = {body.white:.1f}"]
    return "\n".join([*lines, "white_balanced = false", ""])


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("folder", type=Path)
    parser.add_argument("body", choices=sorted(BODIES))
    parser.add_argument("--effects", nargs="*", default=[], metavar="NAME=STRENGTH")
    parser.add_argument("--kind", choices=KINDS, default=PAIRED)
    parser.add_argument("--scenes", default="one")
    parser.add_argument("--pictures", type=Path, help="a folder to take the scenes from")
    parser.add_argument("--size", type=int, default=256)
    parser.add_argument("--count", type=int, default=8)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--frames", type=int, default=1)
    arguments = parser.parse_args()
    effects = {name: int(level) for name, _, level in (word.partition("=") for word in arguments.effects)}
    chosen = scene_set(arguments.scenes, arguments.size, arguments.count, arguments.pictures)
    options = {key: getattr(arguments, key) for key in ("size", "seed", "frames", "count")}
    print(*write(arguments.folder, arguments.body, effects, arguments.kind, chosen, **options))


if __name__ == "__main__":
    main()
