"""What was fitted becomes what training data are drawn from: a recipe out of fitted cameras."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from jaxisp.checks import several
from jaxisp.encoder import ENCODER as JPEG
from jaxisp.errors import InputError
from jaxisp.params import Spec, map_specs, specs
from jaxisp.pipeline import Chain, Node, Params, stage
from jaxisp.priors import LogUniform, PowerUniform, Uniform
from jaxisp.recipe import Recipe
from jaxisp.recipes import RecipeLike, find_recipe
from jaxisp.stages.balance import WhiteBalance
from jaxisp.stages.noise import ShotReadNoise
from jaxisp.stages.optics import Exposure

LEFT_OUT = (
    "mosaic_white_balance",
    "vignetting",
    "lateral_chromatic_aberration",
    "geometric_distortion",
    "exposure",
    "color_matrix",
    "srgb_oetf",
    "gamma_compression",
    "s_curve",
    "zone_curve",
    "saturation",
    "rounding",
)
"""Tone, colour and geometry: a denoiser is to take away noise, not to undo a look
(Jaroensri et al. 2019)."""

ANY_NOISE = ShotReadNoise(shot=PowerUniform(0.0, 0.02, 2), read=Uniform(0.0, 0.1))


def prior_from_cameras(
    cameras: RecipeLike | Sequence[RecipeLike],
    *,
    spread: float = 1.25,
    noise_spread: float = 4.0,
    name: str = "fitted-prior",
) -> Recipe:
    """A recipe for training data: the noise, demosaicking, denoising, sharpening and JPEG of fitted cameras.

    The photograph is brought to the level and balance that the camera's RAW would have, gets the RAW's
    noise, is balanced, and goes through the camera's stages; tone and colour are left out. Each number is
    drawn from the range that the cameras span, widened by `spread`. Choices that are no numbers (demosaicker,
    footprint, order, white balance) are those of the first camera, the JPEG tables those of the first that
    has some; the description says so where cameras differ.

    Args:
        cameras: recipes, or the CAMERA.toml files that `jaxisp fit` wrote; or one.
        spread: by which factor a range is widened on either side; on a linear scale, by this share less 1 of
            the largest value.
        noise_spread: the same for the variance of the noise, which goes with the ISO number: 4 is two stops
            more and two less than the pictures that the cameras were fitted to.
        name: of the recipe.

    Returns:
        A recipe from encoded sRGB to encoded sRGB, as `jaxisp degrade --recipe` takes it.

    Raises:
        InputError: no camera, or one that `jaxisp fit` did not make.
    """
    loaded = [find_recipe(camera) for camera in several(cameras)]
    if not loaded:
        raise InputError("a prior needs at least one camera")
    for camera in loaded:
        _check_fitted(camera)
    first = loaded[0]
    left_out = (*LEFT_OUT, *map(str, first.meta.get("inserted", ())), JPEG)
    kept = [node for node in first.chain.nodes if node.name not in left_out]
    encoder = next((c for c in loaded if JPEG in c.prior), None)
    if encoder:
        kept += [node for node in encoder.chain.nodes if node.name == JPEG]
    cfa = dict(next(s for s in first.chain.stages() if s.name.startswith("demosaic")).options)["cfa"]
    encoded = "denoise_encoding" not in first.prior
    chain = Chain(tuple(_nodes(kept, str(cfa), encoded)), name)
    ev = float(np.mean([float(c.prior["exposure"].exposure_ev) for c in loaded]))
    prior: Params = {
        "scene_exposure": Exposure(exposure_ev=-ev),
        "exposure": Exposure(exposure_ev=ev),
        "shot_read_noise": _noise([_stated(camera) for camera in loaded], noise_spread),
    }
    gains = _stated(first)["gains"][0]
    prior |= {"scene_light": WhiteBalance(gains=1 / gains), "mosaic_white_balance": WhiteBalance(gains=gains)}
    for node in kept:
        if node.name.startswith("denoise_"):  # one undoes the other
            prior[node.name] = first.prior[node.name]
        elif node.name in first.prior:
            prior[node.name] = _spanned([c.prior[node.name] for c in loaded if node.name in c.prior], spread)
    if encoder:
        prior[JPEG] = encoder.prior[JPEG]
    text = f"noise and processing of {len(loaded)} fitted cameras, tone and colour left out"
    if len({tuple(_design(camera)) for camera in loaded}) > 1:
        text += f"; they differ in their stages: {', '.join(_design(first))} are those of the first"
    return Recipe(chain, prior, text, {"cameras": [", ".join(c.meta.get("fitted_to", [])) for c in loaded]})


def _check_fitted(camera: Recipe) -> None:
    missing = {"exposure", "unsharp_mask"} - set(camera.prior)
    if camera.chain.domain_in.name != "mosaic" or missing:
        why = f"it has no {' and no '.join(sorted(missing))}" if missing else "it takes no mosaic"
        raise InputError(f"{camera.name!r} is no camera from `jaxisp fit`: {why}")


def _design(camera: Recipe) -> list[str]:
    """Its demosaicker and median, where it has one."""
    stages = [s for s in camera.chain.stages() if s.name.startswith(("demosaic", "median"))]
    return [" ".join([s.name, *(f"{v}" for k, v in s.options.items() if k != "cfa")]) for s in stages]


def _nodes(kept: Sequence[Node], cfa: str, encoded: bool) -> list[Node]:
    """Decode, darken, mosaic, noise; the camera's own stages; encode, sharpen, 8 bits, JPEG."""
    names = [node.name for node in kept]
    split = names.index("unsharp_mask")
    denoising = next((i for i, n in enumerate(names) if n == "bilateral"), split)
    raw, denoise, output = kept[:denoising], kept[denoising:split], kept[split:]
    if not encoded:
        raw, denoise = kept[:split], []
    start = [
        stage("srgb_eotf"),
        stage("exposure", name="scene_exposure"),
        stage("mosaic", cfa=cfa),
        stage("mosaic_white_balance", name="scene_light", cfa=cfa),
        stage("shot_read_noise"),
        stage("mosaic_white_balance", cfa=cfa),
    ]
    jpeg = [node for node in output if node.name == JPEG]
    picture = [node for node in output if node.name != JPEG]
    return [
        *start, *raw, stage("exposure"), stage("clip", name="display_clip"), stage("srgb_oetf"),
        *denoise, *picture, stage("clip", name="output_clip"), stage("rounding"), *jpeg,
    ]  # fmt: skip


def _stated(camera: Recipe) -> dict[str, np.ndarray]:
    """Shot, read and gains as `jaxisp fit` noted them; without noise where it found none."""
    noted = camera.meta.get("raw_noise", {"shot": [], "read": []})
    try:
        found: dict[str, np.ndarray] = {
            name: np.asarray(noted[name], np.float32).reshape(-1) for name in ("shot", "read")
        }
        found["gains"] = np.asarray(noted.get("gains") or [(1, 1, 1)], np.float32).reshape(-1, 3)
    except (KeyError, TypeError, AttributeError, ValueError):
        raise InputError(f"{camera.name!r}: meta.raw_noise is not as `jaxisp fit` writes it") from None
    if not (found["gains"] > 0).all():
        raise InputError(f"{camera.name!r}: meta.raw_noise.gains are not positive")
    return found


def _noise(noted: Sequence[dict[str, np.ndarray]], spread: float) -> ShotReadNoise:
    """The noise of the RAW files, or any where nothing is known of it."""
    found: dict[str, Any] = {}
    for field, wider in ("shot", spread), ("read", spread**0.5):
        values = np.maximum(np.concatenate([noise[field] for noise in noted]), 1e-7)
        if not values.size:
            return ANY_NOISE
        most = specs(ShotReadNoise)[field].bounds[1]
        found[field] = LogUniform(float(values.min()) / wider, min(float(values.max()) * wider, most))
    return ShotReadNoise(**found)


def _spanned(values: Sequence[Any], spread: float) -> Any:
    """A prior over parameters of one stage: ranges for numbers, the first camera's for vectors and tables."""

    def one(spec: Spec, *leaves: Any) -> Any:
        numbers = np.asarray([np.asarray(leaf, float) for leaf in leaves])
        low, high = float(numbers.min()), float(numbers.max())
        if numbers.ndim > 1:
            return np.asarray(leaves[0], np.float32)
        if spec.scale == "log":
            low, high = max(low / spread, spec.bounds[0]), min(high * spread, spec.bounds[1])
            return LogUniform(low, high) if high > low else np.float32(low)
        margin = (spread - 1) * max(abs(low), abs(high))
        low, high = max(low - margin, spec.bounds[0]), min(high + margin, spec.bounds[1])
        return Uniform(low, high) if high > low else np.float32(low)

    return map_specs(one, values[0], *values[1:])
