"""The main job on the package's own data: pairs, fit, degrading, denoiser, diagnosis, one HTML page."""

import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from jaxisp.camera import develop
from jaxisp.cfa import masks
from jaxisp.domains import ENCODED
from jaxisp.fit import fit_dataset
from jaxisp.fit.report import add_fit
from jaxisp.gap import diagnose
from jaxisp.generate import degrade_files
from jaxisp.io import open_dataset, orient, output_folder, write_png
from jaxisp.io.digests import own_folder
from jaxisp.metrics import psnr
from jaxisp.pipeline import Chain, run
from jaxisp.recipe import Recipe
from jaxisp.recipes import CFA, RECIPES
from jaxisp.report import Page
from jaxisp.samples import PHONES, Phone, scene_names, scenes, write_pairs
from jaxisp.stages.transfer import srgb_oetf
from jaxisp.train import TrainConfig, load_denoiser, train

PATCH = 80
SIZE = 192
PHONE = PHONES["a"]
SHOWN_RECIPES = ("awgn", "amwgn", "phone")

Tick = Callable[[int, int, str], Any]


def run_demo(
    out: str | Path,
    *,
    seed: int = 0,
    steps: int = 30,
    training: int = 80,
    tick: Tick = lambda done, total, text: None,
) -> dict[str, Any]:
    """Run the demo into a folder.

    Args:
        out: the folder, new or empty, or of an earlier demo, which is replaced; `report.html` in it shows the
            results.
        seed: of everything that is drawn.
        steps: of the fit.
        training: steps of the denoiser's training: enough to see it learn, not to be good.
        tick: called with (done, total, text).

    Returns:
        {"report", "fit", "degrade", "train", "diagnose", "seconds"}.

    Raises:
        InputError: the folder cannot be written, or holds files that no demo wrote.
    """
    with own_folder(out, "demo.json") as folder:
        return _run(folder, seed, steps, training, tick)


def _run(folder: Path, seed: int, steps: int, training: int, tick: Tick) -> dict[str, Any]:
    clock = time.perf_counter()
    page = Page(
        "jaxisp: a camera in JAX",
        "Made offline from data that comes with the package: a reference phone, written without any of the "
        "simulator's code, takes RAW+JPEG pairs; the simulator is fitted to them, then degrades patches.",
    )
    photographs = list(scenes(SIZE))
    tick(1, 7, "taking pictures with the reference phone")
    pairs = output_folder(folder / "pairs")
    write_pairs(pairs, PHONE, dict(zip(scene_names(), photographs)), seed)
    tick(2, 7, "fitting the camera")
    result = fit_dataset(pairs, steps=steps)
    result.camera.save(folder / "camera.toml")
    tick(3, 7, "stage by stage")
    _add_stages(page, _encoded(photographs[0]), RECIPES["phone"](), seed)
    tick(4, 7, "degrading")
    degraded = _degrade(page, folder, photographs, seed)
    add_fit(page, result)
    _add_develop(page, folder, pairs, result.camera)
    tick(5, 7, "training a denoiser")
    trained = _train(page, folder, photographs, training, seed)
    tick(6, 7, "diagnosing")
    diagnosed = _diagnose(page, folder, pairs, seed)
    page.write(folder / "report.html")
    tick(7, 7, "")
    return {
        "report": str(folder / "report.html"),
        "fit": result.as_dict(),
        "degrade": degraded,
        "train": trained,
        "diagnose": diagnosed,
        "seconds": round(time.perf_counter() - clock, 1),
    }


def _encoded(scene: np.ndarray) -> np.ndarray:
    """A linear scene as an encoded picture."""
    return np.asarray(srgb_oetf(jnp.clip(jnp.asarray(scene, jnp.float32), 0, 1)))


def _add_stages(page: Page, picture: np.ndarray, recipe: Recipe, seed: int) -> None:
    """One crop of the photograph after each stage of a recipe, encoded for the screen."""
    page.heading(
        "One photograph, stage by stage",
        f"An {PATCH}x{PATCH} crop through the recipe '{recipe.name}', with one draw of its parameters. "
        "A mosaic is shown with each photosite in its own colour.",
    )
    key = jax.random.key(seed)
    params, image = recipe.draw(key), jnp.asarray(_crop(picture))
    shown, linear = [("clean", _crop(picture))], False
    for node in recipe.chain.nodes:
        image = run(Chain((node,), node.name), params, image, key)
        if not node.domain_out.keeps:
            linear = node.domain_out not in (ENCODED,)
        shown.append((_caption(node.name, params), _for_screen(image, linear)))
    page.figures(shown, magnify=3)


def _caption(name: str, params: dict[str, Any]) -> str:
    values = vars(params[name]) if name in params else {}
    numbers = [f"{field} {np.array2string(np.asarray(v), precision=3)}" for field, v in values.items()]
    return f"{name}: {', '.join(numbers)}" if numbers else name


def _for_screen(image: jax.Array, linear: bool) -> np.ndarray:
    if image.ndim == 2:
        image = jnp.stack(
            [jnp.where(mask, image, 0) for mask in masks((image.shape[0], image.shape[1]), CFA)], -1
        )
    return np.asarray(srgb_oetf(jnp.clip(image, 0, 1)) if linear else image)


def _crop(picture: np.ndarray) -> np.ndarray:
    """The middle of a picture, at an even position so that the CFA keeps its phase."""
    y, x = ((n - PATCH) // 4 * 2 for n in picture.shape[:2])
    return picture[y : y + PATCH, x : x + PATCH]


def _degrade(page: Page, out: Path, photographs: list[np.ndarray], seed: int) -> dict[str, Any]:
    """Degrade patches by several recipes; the phone's are written as a data set too."""
    page.heading(
        "A batch of degraded patches",
        "Each patch has its own draw of noise, denoising, sharpening and JPEG level. White noise is what "
        "most denoisers are trained on; the phone's is what they meet.",
    )
    pictures = np.stack([_encoded(p) for p in photographs])
    clean = np.stack([_crop(p) for p in pictures])
    for name in SHOWN_RECIPES:
        figures = [
            (f"{name}, {float(psnr(n, c)):.1f} dB", n) for n, c in zip(_degraded(name, pictures, seed), clean)
        ]
        page.figures(figures, magnify=3)
    sources = output_folder(out / "clean")
    for name, picture in zip(scene_names(), pictures):
        write_png(sources / f"{name}.png", picture)
    return degrade_files([sources], out / "degraded", RECIPES["phone"](), seed=seed).as_dict()


def _degraded(name: str, pictures: np.ndarray, seed: int) -> np.ndarray:
    """(N, PATCH, PATCH, 3) crops of degraded pictures; `degrade_files` runs the same program."""
    indices = np.arange(len(pictures), dtype=np.int32)
    noisy = RECIPES[name]().degrade(jax.random.key(seed), pictures, indices)[0]
    return np.stack([_crop(picture) for picture in np.asarray(noisy)])


def _train(page: Page, out: Path, photographs: list[np.ndarray], steps: int, seed: int) -> dict[str, Any]:
    """A small denoiser, trained for a moment on patches degraded on the fly, and what it does to new ones."""
    config = TrainConfig(
        clean=(str(out / "clean"),), recipe="phone", phases=False, steps=steps, batch=16, patch=48,
        downsample=1, held_out=1, validation=16, lr=2e-3, warmup=10, ema=0.9, checkpoint_every=steps,
        seed=seed,
    )  # fmt: skip
    result = train(config, out / "run")
    denoiser, _ = load_denoiser(out / "run", "last")
    pictures = np.stack([_encoded(p) for p in photographs])
    clean, noisy = np.stack([_crop(p) for p in pictures]), _degraded("phone", pictures, seed + 1)
    page.heading(
        "A denoiser trained on such patches",
        f"{steps} steps of {config.batch} patches, degraded with new parameters at each step: enough to see "
        "it learn. `jaxisp train` does the same for as long as you like.",
    )
    for n, c in zip(noisy[:2], clean[:2]):
        d = jnp.asarray(denoiser(n))
        shown = [
            ("clean", c),
            (f"degraded, {float(psnr(n, c)):.1f} dB", n),
            (f"denoised, {float(psnr(d, c)):.1f} dB", d),
        ]
        page.figures(shown, magnify=3)
    return {"step": result.step, "loss": result.loss, "validation": result.validation}


def _diagnose(page: Page, out: Path, pairs: Path, seed: int) -> dict[str, Any]:
    """What a plain camera lacks of the reference phone, and whether that is true; the diagnosis has a page of
    its own."""
    found = diagnose(pairs, seed=seed)
    found.save(out / "diagnosis")
    gap, causes = found.report["gap"], found.report["causes"]
    right, told = judged([{c["effect"], *c["alternatives"]} for c in causes], lacking(PHONE))
    page.heading(
        "What a plain camera lacks of this phone",
        f"Verdict: {found.verdict}. {told} The gap, a mean square in 8-bit steps on pairs left out, goes"
        f" from {gap['before']:.1f} to {gap['after']:.1f}; rounding and JPEG leave {gap['floor']:.1f}.",
    )
    page.link("The whole diagnosis", "diagnosis/report.html")
    rows = [(c["effect"], f"{100 * c['closed']:.0f} %", ", ".join(c["alternatives"])) for c in causes]
    if rows:
        page.table(("effect", "closes", "not told from"), rows)
    return {"verdict": found.verdict, "causes": found.causes, "gap": gap, "right": right}


def lacking(phone: Phone) -> set[str]:
    """The effects that the phone has between RAW and JPEG and a plain camera has not, by how it was made.

    Its matrix, saturation and tone are fitted in the plain camera; its encoder is read from its files.
    """
    has = {
        "luma_denoising": phone.luma_strength,
        "chroma_denoising": phone.chroma_sigma,
        "sharpening": phone.sharpening,
        "vignetting": phone.corrects_vignetting,
        "demosaicking": phone.demosaicking != "bilinear",  # the others are not of the library
    }
    return {name for name, strength in has.items() if strength}


def judged(named: Sequence[set[str]], truth: set[str]) -> tuple[bool, str]:
    """Whether a verdict is right, and a sentence that says so.

    Args:
        named: of each cause, its effect and those that the pairs cannot tell from it.
        truth: the effects that are there.
    """
    wrong = [alike for alike in named if not alike & truth]
    missed = truth.difference(*named)
    if not named:
        return (
            not truth,
            "Wrong: it names none of the phone's effects." if truth else "Right: nothing is there.",
        )
    if wrong:
        each = "; ".join(" or ".join(sorted(alike)) for alike in wrong)
        return False, f"Wrong: the phone has no {each.replace('_', ' ')}."
    rest = f" It also has {', '.join(sorted(missed))}, which is not named." if missed else ""
    return True, f"Right: the phone was made with all that is named.{rest.replace('_', ' ')}"


def _add_develop(page: Page, out: Path, pairs: Path, camera: Recipe) -> None:
    """One RAW, developed plainly and by the fitted camera."""
    pair = open_dataset(pairs).pairs[0].load()
    assert pair.raw is not None, "the reference phone wrote it"
    page.heading("The fitted camera on a RAW file", "As `jaxisp develop RAW --camera CAMERA.toml` does it.")
    plain, fitted = develop(pair.raw), develop(pair.raw, camera)
    write_png(out / "developed-plain.png", plain)
    write_png(out / "developed-fitted.png", fitted)
    theirs = orient(pair.picture, pair.raw.orientation)
    page.figures([("plain", plain), ("fitted camera", fitted), ("the phone's JPEG", theirs)])
