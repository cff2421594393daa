"""Make docs/gallery.md and its pictures: what the stages and recipes do, each with the lines that make it.

    python -m experiments.gallery           # the page, and every picture
    python -m experiments.gallery lens      # the page, and one picture

The photographs come with scikit-image (public domain and CC0).
"""

import inspect
import sys
import textwrap
from collections.abc import Callable
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
from PIL import Image

import jaxisp
from jaxisp import Chain, run, stage
from jaxisp.color import linear_to_srgb
from jaxisp.data.procedural import KINDS, drawn
from jaxisp.models.apply import shipped_denoiser
from jaxisp.samples import scene
from jaxisp.stages.blur import MotionBlur
from jaxisp.stages.jpeg import Jpeg
from jaxisp.stages.noise import FilmGrain, ShotReadNoise
from jaxisp.stages.optics import GeometricDistortion, LateralChromaticAberration, Vignetting
from jaxisp.train import Classical
from jaxisp.train.target import pair_maker

PAGE, PICTURES = Path("docs/gallery.md"), Path("docs/images/gallery")
GAP, LEAST = 4, 160  # px between tiles, and of the least side that is shown
Tiles = list[np.ndarray]


def photograph(name: str = "astronaut", size: int = 160, window: tuple = (0.35, 0.4, 0.5)) -> np.ndarray:
    """(size, size, 3) float32 encoded sRGB."""
    return linear_to_srgb(scene(name, size, window)).astype(np.float32)


def a_phone() -> Tiles:
    """A photograph, and four draws of the simulated phone."""
    clean = np.repeat(photograph()[None], 4, 0)
    noisy, _, _ = jaxisp.recipes.phone().degrade(jax.random.key(2), clean)
    return [clean[0], *noisy]


def stage_by_stage() -> Tiles:
    """What the phone's stages make of it, one after another."""
    recipe = jaxisp.recipes.phone()
    params, tiles = recipe.draw(jax.random.key(3)), [photograph(size=64, window=(0.3, 0.45, 0.25))]
    for count in (5, 6, 7, 8, 13):
        part = Chain(recipe.chain.nodes[:count], f"first {count}")
        image = run(part, params, tiles[0], jax.random.key(3))
        grey = image if image.ndim == 3 else jnp.repeat(image[..., None], 3, 2)
        tiles.append(grey if count == 13 else run(stage("srgb_oetf"), {}, jnp.clip(grey, 0, 1)))
    return tiles


def demosaicking() -> Tiles:
    """One mosaic, five demosaickers: false colours and zippers at fine detail."""
    fine = scene("coffee", 64, (0.5, 0.5, 0.35))
    tiles = []
    for name in ("bilinear", "malvar", "ahd", "menon", "hibbard"):
        chain = Chain((stage("mosaic"), stage(f"demosaic_{name}"), stage("clip"), stage("srgb_oetf")), name)
        tiles.append(run(chain, chain.init(), fine))
    return tiles


def extreme_low_light() -> Tiles:
    """Light dimmed 100 to 300 times, with the calibrated noise of two cameras."""
    clean, tiles = photograph(), [photograph()]
    for camera in ("eld-sony-a7s2", "eld-nikon-d850"):
        noisy, _, _ = jaxisp.recipes.low_light(camera).degrade(jax.random.key(1), clean[None])
        tiles.append(noisy[0])
    return tiles


def unprocessing() -> Tiles:
    """Unprocessed to a RAW with a camera's colours, noise, and processed again."""
    clean = np.repeat(photograph("chelsea", window=(0.3, 0.6, 0.7))[None], 3, 0)
    noisy, _, _ = jaxisp.recipes.unprocessing().degrade(jax.random.key(5), clean)
    return [clean[0], *noisy]


def jpeg() -> Tiles:
    """libjpeg's own arithmetic: qualities 5, 20 and 60, to the bit."""
    image = run(stage("rounding"), {}, photograph("coffee", window=(0.5, 0.5, 0.6)))
    tiles = [image]
    for quality in (5.0, 20.0, 60.0):
        tiles.append(run(stage("jpeg"), {"jpeg": Jpeg(quality=np.float32(quality))}, image))
    return tiles


def camera_shake() -> Tiles:
    """A path of three segments; clipped highlights were brighter and draw streaks."""
    light = scene("coffee", 160, (0.65, 0.75, 0.4))
    path = {"lengths": np.float32([6, 4, 5]), "directions": np.float32([20, -40, 70])}
    tiles = [light]
    for boost in (0.0, 20.0):
        own = MotionBlur(**path, threshold=np.float32(0.9), boost=np.float32(boost))
        tiles.append(run(stage("motion_blur"), {"motion_blur": own}, light))
    return [run(stage("srgb_oetf"), {}, x) for x in tiles]


def lens() -> Tiles:
    """Distortion, lateral colour and vignetting, all at once and exaggerated."""
    names = "geometric_distortion", "lateral_chromatic_aberration", "vignetting"
    chain = Chain((*map(stage, names), stage("clip"), stage("srgb_oetf")), "lens")
    params = chain.init() | {
        names[0]: GeometricDistortion(k1=np.float32(-0.12)),
        names[1]: LateralChromaticAberration(red_scale=np.float32(1.01), blue_scale=np.float32(0.99)),
        names[2]: Vignetting(a2=np.float32(-0.7)),
    }
    light = scene("coffee", 200)
    return [run(stage("srgb_oetf"), {}, light), run(chain, params, light)]


def denoising() -> Tiles:
    """Noise, and what a median, a bilateral filter and wavelet coring leave of it."""
    light, key = scene("chelsea", 128, (0.3, 0.6, 0.5)), jax.random.key(0)
    noise = {"shot_read_noise": ShotReadNoise(shot=np.float32(0.004), read=np.float32(0.02))}
    noisy = run(stage("shot_read_noise"), noise, light, key)
    tiles = [light, noisy]
    for name in ("median", "bilateral", "wavelet_coring"):
        tiles.append(run(stage(name), stage(name).init(), noisy))
    return [run(stage("srgb_oetf"), {}, jnp.clip(x, 0, 1)) for x in tiles]


def the_denoiser() -> Tiles:
    """A phone's noise; total variation, non-local means and the package's network, all blind; and no noise.

    The scene is drawn, and no network has seen it.
    """
    quarters = [drawn(kind, 1000, 96) for kind in KINDS]
    scene = np.concatenate([np.concatenate(quarters[:2], 1), np.concatenate(quarters[2:], 1)])
    pairs = pair_maker(jaxisp.recipes.phone(), jax.random.key(4), "camera")
    noisy, target = (np.asarray(picture[0]) for picture in pairs(scene[None], np.int32([0])))
    network, _ = shipped_denoiser()
    return [noisy, *(denoise(noisy) for denoise in (Classical("tv"), Classical("nlm"), network)), target]


def exposure_and_tone() -> Tiles:
    """A dark picture: an s-curve, the paper's curve, and tones mapped locally."""
    dark = photograph("coffee", window=(0.5, 0.5, 0.8)) * 0.7
    tiles = [dark]
    for name in ("s_curve", "tone_curve", "local_tone_mapping"):
        tiles.append(jnp.clip(run(stage(name), stage(name).init(), dark), 0, 1))
    return tiles


def film_grain() -> Tiles:
    """Grain after the tone curve: none in black and white, most in mid-grey."""
    image, tiles = photograph(window=(0.35, 0.35, 0.35)), []
    for sigma in (0.4, 0.9, 1.8):
        grain = {"film_grain": FilmGrain(std=np.float32(0.08), sigma=np.float32(sigma))}
        tiles.append(jnp.clip(run(stage("film_grain"), grain, image, jax.random.key(0)), 0, 1))
    return tiles


def gradients() -> Tiles:
    """Through demosaicking, filters and JPEG: how a loss on the file moves each photosite."""
    recipe, clean = jaxisp.recipes.phone(), photograph(size=96)
    key = jax.random.key(1)
    params = recipe.draw(key)
    found = jax.grad(lambda x: ((run(recipe.chain, params, x, key) - clean) ** 2).sum())(clean)
    return [clean, 0.5 + 0.5 * found / jnp.percentile(jnp.abs(found), 99)]


PICTURES_OF: dict[str, Callable[[], Tiles]] = {
    make.__name__: make
    for make in (
        a_phone, stage_by_stage, demosaicking, extreme_low_light, unprocessing, jpeg, camera_shake, lens,
        denoising, the_denoiser, exposure_and_tone, film_grain, gradients,
    )
}  # fmt: skip


def page() -> str:
    """docs/gallery.md: every picture with its lines."""
    lines = ["# Gallery", "", f"{len(PICTURES_OF)} pictures, each with the lines that make it."]
    lines += ["Photographs: scikit-image (public domain, CC0). Made by `python -m experiments.gallery`.", ""]
    for name, make in PICTURES_OF.items():
        doc = inspect.getdoc(make) or ""
        body = inspect.getsource(make).split('"""\n', 1)[1]
        lines += [f"## {name.replace('_', ' ').capitalize()}", "", f"![{doc}](images/gallery/{name}.jpg)", ""]
        lines += [doc, "", "```python", textwrap.dedent(body).rstrip(), "```", ""]
    lines += ["`photograph` gives a crop as encoded sRGB:", "", "```python"]
    lines += [inspect.getsource(photograph).rstrip(), "```", ""]
    return "\n".join(lines)


def picture(tiles: Tiles) -> Image.Image:
    """The tiles in a row, small ones magnified without smoothing."""
    times = max(1, LEAST // min(np.shape(t)[0] for t in tiles))
    levels = [np.round(255 * np.clip(np.asarray(t), 0, 1)).astype(np.uint8) for t in tiles]
    pad = [(0, 0), (0, GAP), (0, 0)]
    row = [np.pad(t.repeat(times, 0).repeat(times, 1), pad, constant_values=255) for t in levels]
    return Image.fromarray(np.concatenate(row, 1)[:, :-GAP])


def main(names: list[str]) -> None:
    PICTURES.mkdir(parents=True, exist_ok=True)
    PAGE.write_text(page())
    for name in names or PICTURES_OF:
        picture(PICTURES_OF[name]()).save(PICTURES / f"{name}.jpg", quality=88)
        print(PICTURES / f"{name}.jpg", flush=True)


if __name__ == "__main__":
    main(sys.argv[1:])
