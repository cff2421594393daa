"""Fit a camera's tone, colour, denoising and sharpening to RAW+JPEG pairs by gradient descent.

The RAW is white-balanced and demosaicked once; what follows is differentiable, with the shift and
scale between the two pictures among the parameters. Half the picture, in a checkerboard of tiles,
is fitted; every held-out figure comes from the other half.
"""

import dataclasses
import functools
import time
from collections.abc import Callable, Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import optax

from jaxisp.camera import WHITE_BALANCE, params_for, shaded_mosaic
from jaxisp.errors import InputError
from jaxisp.fit import model
from jaxisp.fit.align import Alignment, covered, estimate, same_scene, warp
from jaxisp.io import Jpeg, Raw
from jaxisp.losses import border_mask, clip_mask, luma_chroma_loss
from jaxisp.metrics import psnr, ssim_map
from jaxisp.params import to_bounded, to_unbounded
from jaxisp.pipeline import Chain, Params, run
from jaxisp.recipe import Recipe
from jaxisp.stages.balance import ColorMatrix
from jaxisp.stages.optics import Exposure
from jaxisp.stages.tone import Gamma, ZoneCurve
from jaxisp.stages.transfer import srgb_eotf, srgb_oetf

TILE = 64
BORDER = 8
RATE = 0.1
FROM_FILE: dict[str, Any] = {"from_file": [WHITE_BALANCE]}
HOW = f"a checkerboard of {TILE}x{TILE} tiles: half are fitted, the other half reported"

Tick = Callable[[int, int, str], Any]


@dataclasses.dataclass(frozen=True)
class Example:
    """One pair as it was read: a RAW and the picture (H, W, 3) that the camera made of it, encoded sRGB
    in [0, 1], lying as the RAW does; `jpeg` is the file it was decoded from, where there is one."""

    name: str
    raw: Raw
    picture: np.ndarray
    jpeg: Jpeg | None = None


@dataclasses.dataclass(frozen=True)
class Shot:
    """One pair, ready to be fitted.

    `camera_rgb` (H, W, 3) is the demosaicked RAW, `target` (H', W', 3) the camera's own picture in
    encoded sRGB; `alignment` lays the first on the second.
    """

    name: str
    camera_rgb: np.ndarray
    target: np.ndarray
    alignment: Alignment
    fitted: np.ndarray
    held_out: np.ndarray
    jpeg: Jpeg | None


@dataclasses.dataclass(frozen=True)
class PairResult:
    """Figures of one pair, of the fitted and of the held-out tiles. `shift` moves the RAW onto the JPEG."""

    name: str
    psnr: float
    ssim: float
    held_out_psnr: float
    held_out_ssim: float
    shift: tuple[float, float]
    start: np.ndarray = dataclasses.field(repr=False)
    render: np.ndarray = dataclasses.field(repr=False)
    target: np.ndarray = dataclasses.field(repr=False)


@dataclasses.dataclass(frozen=True)
class FitResult:
    """A fitted camera, how well it does, and the loss at each step."""

    camera: Recipe
    pairs: list[PairResult]
    losses: np.ndarray
    seconds: float
    how: str = HOW
    failed: list[tuple[str, str]] = dataclasses.field(default_factory=list)

    def as_dict(self) -> dict[str, Any]:
        """The figures, as `jaxisp fit --json` prints them."""
        pairs = [
            {
                "name": p.name,
                "psnr": p.psnr,
                "ssim": p.ssim,
                "held_out_psnr": p.held_out_psnr,
                "held_out_ssim": p.held_out_ssim,
                "shift_px": list(p.shift),
            }
            for p in self.pairs
        ]
        return {
            "pairs": pairs,
            "held_out": {
                "psnr": float(np.mean([p.held_out_psnr for p in self.pairs])),
                "ssim": float(np.mean([p.held_out_ssim for p in self.pairs])),
                "how": self.how,
            },
            "seconds": round(self.seconds, 2),
            "failed": [{"file": name, "reason": reason} for name, reason in self.failed],
        }


def prepare(example: Example, demosaic: str) -> Shot:
    """Demosaick a RAW, align it with the camera's picture, and split the picture into tiles.

    Raises:
        InputError: the two do not show the same scene.
    """
    camera_rgb = _camera_rgb(example.raw, demosaic)
    target = example.picture
    bright = np.percentile(camera_rgb, 99)
    guess = np.asarray(srgb_oetf(jnp.clip(camera_rgb / max(bright, 1e-6), 0, 1)))
    alignment = estimate(target, guess)
    if not same_scene(alignment, target.shape):
        raise InputError(
            f"{example.name}: the RAW and the JPEG do not show the same scene "
            f"(correlation {float(alignment.correlation):.2f} after alignment)"
        )
    inside = np.asarray(
        covered(alignment, camera_rgb.shape, target.shape) & border_mask(target.shape, BORDER)
    )
    unclipped = np.asarray(clip_mask(jnp.asarray(target), 2 / 255, 253 / 255))
    y, x = np.indices(target.shape[:2])
    even = (y // TILE + x // TILE) % 2 == 0
    fitted, held_out = inside & unclipped & even, inside & ~even
    if not fitted.any() or not held_out.any():
        raise InputError(
            f"{example.name}: nothing to fit: pictures are smaller than two tiles, or all clipped"
        )
    return Shot(example.name, camera_rgb, target, alignment, fitted, held_out, example.jpeg)


def _camera_rgb(raw: Raw, demosaic: str) -> np.ndarray:
    chain = model.head(raw.cfa, demosaic)
    params = params_for(Recipe(chain, chain.init(), meta=FROM_FILE), raw)
    return np.asarray(run(chain, params, jnp.asarray(shaded_mosaic(raw))))


def fit_shots(
    shots: Sequence[Shot], *, steps: int = 250, tick: Tick = lambda done, total, text: None
) -> tuple[Params, list[Alignment], np.ndarray]:
    """Fit one set of parameters to all shots, and each shot's alignment.

    Returns:
        the parameters of `model.tail()`, the refined alignments, and (steps,) losses.
    """
    chain = model.tail()
    optimizer = _optimizer(steps)
    variables = (to_unbounded(start(chain, shots)), jnp.stack([_geometry(s.alignment) for s in shots]))
    state = optimizer.init(variables)
    losses = np.zeros(steps)
    for step in range(steps):
        which = step % len(shots)
        shot = shots[which]
        variables, state, loss = _update(
            optimizer, chain, variables, state, which, shot.camera_rgb, shot.target, shot.fitted
        )
        losses[step] = float(loss)
        if not np.isfinite(losses[step]):
            raise FloatingPointError(f"fit: the loss became {losses[step]} at step {step}")
        tick(step + 1, steps, f"loss {losses[step]:.5f}")
    params, places = variables
    return to_bounded(params), [_alignment(np.asarray(place)) for place in places], losses


def start(chain: Chain, shots: Sequence[Shot]) -> Params:
    """Where the fit begins: exposure and colour matrix by least squares in linear light."""
    params = chain.init()
    pixels = [_blurred_pixels(shot) for shot in shots]
    source, wanted = (np.concatenate(parts) for parts in zip(*pixels))
    gain = float(np.clip(wanted.sum() / max(source.sum(), 1e-9), 2.0**-6, 2.0**6))
    matrix = np.linalg.lstsq(gain * source, wanted, rcond=None)[0].T
    matrix = np.clip(matrix, -3.9, 3.9).astype(np.float32)
    return params | {
        "exposure": Exposure(exposure_ev=np.float32(np.log2(gain))),
        "color_matrix": ColorMatrix(matrix=matrix),
        "gamma_compression": Gamma(gamma=np.float32(1)),
        "zone_curve": ZoneCurve(offsets=np.zeros(model.ZONES, np.float32)),
    }


def _blurred_pixels(shot: Shot, block: int = 8) -> tuple[np.ndarray, np.ndarray]:
    """Means of 8x8 blocks of fitted pixels, source and wanted, in linear light: free of noise and detail."""
    source = np.asarray(warp(jnp.asarray(shot.camera_rgb), shot.alignment, shot.target.shape))
    wanted = np.asarray(srgb_eotf(jnp.asarray(shot.target)))
    h, w = (n // block * block for n in wanted.shape[:2])

    def means(a: np.ndarray) -> np.ndarray:
        return (
            a[:h, :w].reshape(h // block, block, w // block, block, -1).mean((1, 3)).reshape(-1, a.shape[-1])
        )

    whole = means(shot.fitted[..., None].astype(float))[:, 0] == 1
    return means(source)[whole], means(wanted)[whole]


def evaluate(params: Params, shot: Shot, alignment: Alignment) -> PairResult:
    """Render a shot, its file's JPEG tables included, and measure its fitted and its held-out tiles."""
    chain, tables = model.with_jpeg(model.tail(), shot.jpeg)
    first = start(model.tail(), [shot]) | tables
    before = _render(chain, first, _geometry(shot.alignment), shot.camera_rgb, shot.target)
    render = _render(chain, params | tables, _geometry(alignment), shot.camera_rgb, shot.target)
    target = jnp.asarray(shot.target)
    similarity = np.asarray(ssim_map(render, target)).mean(-1)

    def figures(mask: np.ndarray) -> tuple[float, float]:
        return float(psnr(render, target, mask=jnp.asarray(mask))), float(similarity[mask].mean())

    shift = (-float(alignment.dy), -float(alignment.dx))
    pictures = (np.asarray(before), np.asarray(render), shot.target)
    return PairResult(shot.name, *figures(shot.fitted), *figures(shot.held_out), shift, *pictures)


def _geometry(alignment: Alignment) -> jax.Array:
    """(dy, dx, scale_y, scale_x): the four numbers of an alignment that the gradient moves."""
    return jnp.asarray([alignment.dy, alignment.dx, alignment.scale_y, alignment.scale_x], jnp.float32)


def _alignment(place: Any) -> Alignment:
    return Alignment(place[0], place[1], place[2], place[3])


@functools.cache
def _optimizer(steps: int) -> optax.GradientTransformation:
    schedule = optax.cosine_decay_schedule(RATE, steps, alpha=0.02)
    # a step of 1 in a shift is a pixel, in a scale it is the whole picture
    moves = jnp.asarray([1.0, 1.0, 1e-3, 1e-3])
    scale_geometry = optax.stateless(lambda updates, _: (updates[0], updates[1] * moves))
    return optax.chain(optax.adam(schedule), scale_geometry)


def _forward(
    chain: Chain, params: Params, place: jax.Array, camera_rgb: jax.Array, shape: tuple[int, ...]
) -> Any:
    return chain(params, warp(camera_rgb, _alignment(place), shape))


@functools.partial(jax.jit, static_argnums=0)
def _render(
    chain: Chain, params: Params, place: jax.Array, camera_rgb: jax.Array, target: jax.Array
) -> jax.Array:
    return jnp.clip(_forward(chain, params, place, camera_rgb, target.shape), 0, 1)


@functools.partial(jax.jit, static_argnums=(0, 1))
def _update(
    optimizer: Any,
    chain: Chain,
    variables: Any,
    state: Any,
    which: Any,
    camera_rgb: jax.Array,
    target: jax.Array,
    mask: jax.Array,
) -> Any:
    """One step on shot `which`: the camera's parameters and that shot's place move."""

    def loss(variables: Any) -> jax.Array:
        params, places = variables
        render = _forward(chain, to_bounded(params), places[which], camera_rgb, target.shape)
        return luma_chroma_loss(render, target, mask)

    value, grads = jax.value_and_grad(loss)(variables)
    updates, state = optimizer.update(grads, state, variables)
    return optax.apply_updates(variables, updates), state, value


def fit_examples(
    examples: Sequence[Example],
    *,
    steps: int = 250,
    demosaic: str = "demosaic_ahd",
    tick: Tick = lambda done, total, text: None,
) -> FitResult:
    """Fit one camera to RAW+JPEG pairs.

    Args:
        examples: the pairs; all of one camera.
        steps: gradient steps in all.
        demosaic: the demosaicking stage.
        tick: called with (done, total, text).

    Returns:
        the camera, with the figures of each pair; pairs that cannot be fitted are in `failed`.

    Raises:
        InputError: no pair can be fitted.
    """
    clock = time.perf_counter()
    shots, failed = [], []
    for example in examples:
        try:
            shots.append(prepare(example, demosaic))
        except InputError as error:
            failed.append((example.name, str(error)))
    if not shots:
        raise InputError("; ".join(reason for _, reason in failed) or "no RAW+JPEG pair to fit")
    params, alignments, losses = fit_shots(shots, steps=steps, tick=tick)
    pairs = [evaluate(params, s, a) for s, a in zip(shots, alignments)]
    camera = _camera(params, shots, examples[0].raw.cfa, demosaic)
    return FitResult(camera, pairs, losses, time.perf_counter() - clock, failed=failed)


def _camera(params: Params, shots: Sequence[Shot], cfa: str, demosaic: str) -> Recipe:
    whole, tables = model.with_jpeg(model.camera(cfa, demosaic), shots[0].jpeg)
    prior = whole.init() | jax.tree.map(np.asarray, params) | tables
    meta = {**FROM_FILE, "fitted_to": [s.name for s in shots], "held_out": HOW}
    return Recipe(whole, prior, "fitted to RAW+JPEG pairs", meta)
