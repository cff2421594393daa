"""The built-in recipes: the paper's training sets (Jaroensri et al. 2019, table 1 and section 4.1).

Noise ranges are the paper's, drawn uniformly. The ranges of denoising, sharpening and compression
are those of the authors' configuration, which the paper does not print, with the laws stated there.
Where the two disagree (noise), the code's ranges have a recipe of their own, `phone-authors-code`.
Work is done in linear light, as there; what goes in and comes out is encoded sRGB.
"""

import dataclasses
import os
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from jaxisp.domains import MOSAIC
from jaxisp.errors import InputError, meant, short
from jaxisp.io.files import parse_toml, read_text
from jaxisp.mixture import Degradation, Mixture
from jaxisp.node import Around
from jaxisp.phase import AnyPhase, CfaPhase
from jaxisp.pipeline import Chain, Gate, Row, Switch, stage
from jaxisp.priors import Bernoulli, Choice, LogUniform, PowerUniform, Uniform
from jaxisp.published import PUBLISHED
from jaxisp.published import bsrgan as bsrgan
from jaxisp.published import cbdnet as cbdnet
from jaxisp.published import darmstadt as darmstadt
from jaxisp.published import low_light as low_light
from jaxisp.published import rsblur as rsblur
from jaxisp.published import unprocessing as unprocessing
from jaxisp.recipe import Recipe
from jaxisp.stages.balance import Saturation
from jaxisp.stages.balanced_noise import BalancedNoise
from jaxisp.stages.blur import OpticalBlur
from jaxisp.stages.choice import ChromaSubsampling, Demosaicking, EarlierCompression
from jaxisp.stages.denoise.bilateral import Bilateral
from jaxisp.stages.denoise.median import Median
from jaxisp.stages.detail import UnsharpMask
from jaxisp.stages.jpeg import Jpeg, JpegPhotoshop
from jaxisp.stages.noise import GaussianNoise, ShotReadNoise
from jaxisp.stages.resampling import Resampling
from jaxisp.stages.sensor import AdcQuantization
from jaxisp.stages.tone import SCurve
from jaxisp.unprocess import Unprocessed

__all__ = [
    "CLEAN", "PHASES", "RECIPES", "Degradation", "Mixture", "Recipe", "RecipeLike", "amwgn", "any_camera",
    "any_phase", "awgn", "bsrgan", "cbdnet", "darmstadt", "find_degradation", "find_recipe",
    "load_degradation", "low_light", "mix", "phone", "phone_ahd", "phone_any", "phone_authors_code",
    "phone_bilinear", "phone_kodak", "phone_no_demosaic", "phone_no_denoise", "phone_no_post", "phone_shot",
    "read_degradation", "rsblur", "unprocessing",
]  # fmt: skip
__dir__ = __all__.copy  # what an editor completes
CFA = "GRBG"
PHASES = "-phases"
"""How the name of a recipe, or the path of its file, ends whose mosaic begins at any photosite."""
_LISTED = "`jaxisp recipes` lists all"
CLEAN = "clean"
"""The name of pictures as they are, in a mixture."""
RecipeLike = str | Path | Chain | Degradation
"""What stands for a recipe wherever one is taken: itself, a mixture, a built-in name, shares of several, the
path of a TOML file, or a chain, whose parameters are then the defaults."""
PAPER_NOISE = ShotReadNoise(shot=PowerUniform(0.0, 0.02, 2), read=Uniform(0.0, 0.1))
CODE_NOISE = ShotReadNoise(shot=LogUniform(1e-4, 0.04), read=LogUniform(0.01, 0.1))
# Sensors' noise is shot noise but for the darkest tones: phones' calibrated read noise is 0.0001 to 0.007 and
# their Poisson factor 0.0025 to 0.05 (OnePlus 6, Nexus 5 and 5X at ISO 100 to 6400, darktable's
# profiles), which the digital gain of a dim scene multiplies. As a variance the factor is squared.
SHOT_NOISE = ShotReadNoise(shot=LogUniform(0.003, 0.06), read=LogUniform(0.001, 0.03))

# The authors filter on a bilateral grid of 2-px cells and 1/32-level bins, cut at one sigma. These are the
# standard deviations that come of it, interpolation in the grid included: 1.0 to 1.8 px and 0.018 to 0.029
# for luma, 2.2 to 34 px for chroma. Theirs for chroma is a product of two draws: the same range and median,
# with fewer at the ends.
BILATERAL = Bilateral(
    luma_sigma_space=LogUniform(1.0, 1.8),
    luma_sigma_range=LogUniform(0.018, 0.029),
    chroma_sigma_space=LogUniform(2.2, 34.0),
    chroma_sigma_range=0.02,
    guide_gamma=0.5,
)


def awgn() -> Recipe:
    """White Gaussian noise in linear light, std 0 to 0.2."""
    prior = {"gaussian_noise": GaussianNoise(std=Uniform(0.0, 0.2))}
    return _recipe("awgn", "white Gaussian noise, std 0 to 0.2", ("gaussian_noise",), prior)


def amwgn() -> Recipe:
    """Additive and multiplicative white Gaussian noise: read 0 to 0.1, Poisson factor 0 to 0.02."""
    text = "white noise whose variance grows with the signal: read std 0 to 0.1, Poisson factor 0 to 0.02"
    return _recipe("amwgn", text, ("shot_read_noise",), {"shot_read_noise": PAPER_NOISE})


def phone() -> Recipe:
    """The paper's phone: noise, mosaic, Kodak demosaicking, median and bilateral, unsharp mask, JPEG."""
    return _phone("phone", "the paper's phone pipeline: noise, demosaicking, denoising, post-processing")


def phone_no_post() -> Recipe:
    """Ablation: no sharpening and no JPEG."""
    return _phone("phone-no-post", "ablation: no post-processing", drop=("unsharp_mask", "jpeg_photoshop"))


def phone_no_denoise() -> Recipe:
    """Ablation: no median and no bilateral filter."""
    return _phone("phone-no-denoise", "ablation: no denoising", drop=("median", "bilateral"))


def phone_no_demosaic() -> Recipe:
    """Ablation: noise on all three channels of every pixel."""
    drop = ("mosaic", "demosaic_hibbard")
    return _phone("phone-no-demosaic", "ablation: no mosaic and no demosaicking", drop=drop)


def phone_kodak() -> Recipe:
    """Demosaicking alone, by Hibbard 1995."""
    return _demosaic_only("phone-kodak", "demosaic_hibbard")


def phone_ahd() -> Recipe:
    """Demosaicking alone, by Hirakawa & Parks 2005."""
    return _demosaic_only("phone-ahd", "demosaic_ahd")


def phone_bilinear() -> Recipe:
    """Demosaicking alone, bilinear."""
    return _demosaic_only("phone-bilinear", "demosaic_bilinear")


def phone_authors_code() -> Recipe:
    """`phone` with the noise of the authors' configuration file: Poisson factor 0.01 to 0.2, log-uniform."""
    text = "phone with the noise ranges of the authors' code: log-uniform, ten times the Poisson factor"
    return _phone("phone-authors-code", text, noise=CODE_NOISE)


def phone_shot() -> Recipe:
    """`phone` with noise that follows the light, as sensors' does: Poisson factor 0.055 to 0.245."""
    text = "phone with mostly shot noise: Poisson factor 0.055 to 0.245, read std 0.001 to 0.03"
    return _phone("phone-shot", text, noise=SHOT_NOISE)


def phone_any() -> Recipe:
    """`phone-shot` that denoises little, much or not at all: cameras differ in nothing more."""
    text = "phone-shot with a median of strength 0 to 1, and the bilateral filter in every other picture only"
    return _phone("phone-any", text, noise=SHOT_NOISE, always=False)


def any_camera() -> Recipe:
    """Cameras of all kinds, for a denoiser that is told nothing of the camera; a quarter gets white noise."""
    text = (
        "any camera: white balance and colour amplify its noise, each of its filters in some pictures only; "
        "white noise on one picture in four"
    )
    sensor = (
        stage("mosaic", cfa=CFA),
        stage("balanced_noise", cfa=CFA),
        stage("clip", name="sensor_clip"),
        stage("demosaicking", cfa=CFA),
    )
    camera = (
        stage("srgb_eotf"),
        stage("saturation", name="sensor_colour"),
        AnyPhase(Chain(sensor, "sensor")),
        stage("saturation", name="colour_matrix"),
        Gate(stage("median", footprint="cross")),
        Gate(stage("bilateral", chroma_cell=4, chroma_bins=20)),
        Gate(stage("optical_blur", name="wide_filter", radius=4)),
        Gate(stage("resampling")),
        stage("clip", name="clip_light"),
        stage("srgb_oetf"),
        Gate(stage("s_curve")),
        Gate(stage("unsharp_mask", radius=6)),
        stage("clip", name="clip_encoded"),
        stage("rounding", name="camera_rounding"),
        Gate(stage("earlier_compression")),
        Gate(stage("chroma_subsampling")),
        Gate(stage("jpeg", subsampling="4:4:4")),
    )
    nodes = (Gate(Chain(camera, "camera")), Gate(stage("gaussian_noise")), stage("clip"), stage("rounding"))
    prior = {
        "use_camera": Switch(on=Bernoulli(0.85)),
        # at ISO 100 to 25600: luma of 1 to 20 steps of 255 after all that follows
        "balanced_noise": BalancedNoise(
            shot=LogUniform(1e-4, 0.03), read=LogUniform(5e-4, 0.03),
            red_gain=LogUniform(1.0, 2.5), blue_gain=LogUniform(1.0, 2.5),
        ),
        # the colours of a sensor are paler by what its matrix gives back, which amplifies chroma's noise
        "sensor_colour": Saturation(amount=Uniform(0.45, 1.0)),
        "colour_matrix": Saturation(amount=Uniform(1.0, 2.2)),
        "cfa_phase": CfaPhase(row=Bernoulli(0.5), column=Bernoulli(0.5)),
        "demosaicking": Demosaicking(shares=Bernoulli(0.06)),
        "use_median": Switch(on=Bernoulli(0.2)),
        "median": Median(strength=Uniform(0.0, 1.0)),
        "use_bilateral": Switch(on=Bernoulli(0.25)),
        "bilateral": BILATERAL,
        "use_wide_filter": Switch(on=Bernoulli(0.3)),
        "wide_filter": OpticalBlur(sigma=Uniform(0.3, 1.1)),
        "use_resampling": Switch(on=Bernoulli(0.3)),
        "resampling": Resampling(factor=LogUniform(1.05, 2.0)),
        "use_s_curve": Switch(on=Bernoulli(0.5)),
        "s_curve": SCurve(strength=Uniform(-0.2, 0.6)),
        "use_unsharp_mask": Switch(on=Bernoulli(0.6)),
        "unsharp_mask": UnsharpMask(amount=Uniform(0.0, 1.5), sigma=LogUniform(0.5, 2.0), threshold=0.0),
        "use_earlier_compression": Switch(on=Bernoulli(0.1)),
        "earlier_compression": EarlierCompression(
            quality=Uniform(60.0, 98.0), row=Uniform(0.0, 7.0), column=Uniform(0.0, 7.0)
        ),
        "use_chroma_subsampling": Switch(on=Bernoulli(0.6)),
        "chroma_subsampling": ChromaSubsampling(horizontal=1.0, vertical=Bernoulli(0.7)),
        "use_jpeg": Switch(on=Bernoulli(0.75)),
        "jpeg": Jpeg(quality=Uniform(60.0, 98.0)),
        "use_gaussian_noise": Switch(on=Bernoulli(0.25)),
        "gaussian_noise": GaussianNoise(std=Uniform(0.0, 0.15)),
    }  # fmt: skip
    return Recipe(Chain(nodes, "any-camera"), prior, text)


def any_phase(recipe: RecipeLike) -> Recipe:
    """A recipe whose mosaic begins at any photosite of its pattern's cell, drawn for each image.

    All four patterns are seen, as in the training code of Jaroensri et al. 2019. Nothing is compiled anew
    for a phase. The name of the recipe gets the ending `-phases`. A mosaic is found wherever it stands: also
    within a gate, a shuffle, or `Unprocessed`, which moves as a whole.

    Args:
        recipe: one recipe, in any form that `find_recipe` takes.

    Raises:
        InputError: the recipe has no mosaic that it demosaicks, has several, or draws its phase already.
    """
    recipe = find_recipe(recipe)
    if _draws_phase(recipe):
        raise InputError(f"recipe {recipe.name!r} draws already where its mosaic begins")
    chain, count = _phased(recipe.chain)
    if count != 1:
        what = f"{count} mosaics that it demosaicks" if count else "no mosaic that it demosaicks"
        raise InputError(f"recipe {recipe.name!r} has {what}, so that it has no phase")
    chain = dataclasses.replace(chain, name=f"{recipe.name}{PHASES}")
    prior = recipe.prior | {AnyPhase.name: CfaPhase(row=Bernoulli(0.5), column=Bernoulli(0.5))}
    text = f"{recipe.description}; the mosaic begins at any photosite of its cell"
    return dataclasses.replace(recipe, chain=chain, prior=prior, description=text)


def _phased(node: Any) -> tuple[Any, int]:
    """A pipeline with `AnyPhase` around each part from a mosaic to its demosaicking; how many there are."""
    if isinstance(node, Unprocessed):
        return AnyPhase(node), 1
    if isinstance(node, Around):
        inner, count = _phased(node.node)
        return (dataclasses.replace(node, node=inner), count) if count else (node, 0)
    if not isinstance(node, Row):
        return node, 0
    found, count, start = [], 0, None
    for own, more in map(_phased, node.nodes):
        found.append(own)
        count += more
        if own.domain_in.channels == 3 and own.domain_out == MOSAIC:
            start = len(found) - 1
        elif start is not None and own.domain_in == MOSAIC and own.domain_out.channels == 3:
            found[start:] = [AnyPhase(Chain(tuple(found[start:]), "sensor"))]
            count, start = count + 1, None
    # several would share one name
    return (dataclasses.replace(node, nodes=tuple(found)), count) if count == 1 else (node, count)


def _draws_phase(recipe: Recipe) -> bool:
    return any(isinstance(own, CfaPhase) for own in recipe.prior.values())


RECIPES: dict[str, Callable[[], Recipe]] = {
    make.__name__.replace("_", "-"): make
    for make in (
        awgn,
        amwgn,
        phone,
        phone_no_post,
        phone_no_denoise,
        phone_no_demosaic,
        phone_bilinear,
        phone_ahd,
        phone_kodak,
        phone_authors_code,
        phone_shot,
        phone_any,
        any_camera,
    )
} | PUBLISHED
"""The built-in recipes by the name that the command line takes."""


def find_recipe(recipe: RecipeLike, *, phases: bool = False) -> Recipe:
    """One recipe: as it is, by its built-in name, from a TOML file, or of a chain. Raises InputError.

    The name of a recipe with a mosaic, or the path of its file, may end in `-phases`: it is then drawn where
    in its cell it begins. With `phases` all built-in recipes with a mosaic are so.

    Args:
        recipe: all that `RecipeLike` is but mixtures, which are several recipes.

    Example:
        >>> find_recipe("phone").name
        'phone'
    """
    if isinstance(recipe, Recipe):
        return recipe
    if isinstance(recipe, Chain):
        return Recipe(recipe, {})
    if isinstance(recipe, Mixture):
        raise InputError(f"a mixture ({recipe.name}) is several recipes: give one of them")
    if not isinstance(recipe, str | Path):
        raise InputError(
            "a recipe is a Recipe, a Chain, a name as 'phone', or the path of a TOML file, "
            f"got {short(recipe)}"
        )
    name = str(recipe)
    if name in RECIPES:
        found = RECIPES[name]()
        has_phase = phases and not _draws_phase(found) and _phased(found.chain)[1] == 1
        return any_phase(found) if has_phase else found
    if name.endswith(".toml") or (name and os.path.lexists(name)):
        return Recipe.load(name)
    if name.endswith(PHASES):
        return any_phase(find_recipe(name.removesuffix(PHASES)))
    raise InputError(_unknown(name))


def _unknown(name: str) -> str:
    """Why a name is that of no recipe."""
    if not name.strip():
        return f"a recipe is named, as phone, or the path of a TOML file; got {name!r}; {_LISTED}"
    if "=" in name:
        return f"{name!r} is a mixture, several recipes: one is taken here"
    if "," in name:
        return f"{name!r}: several recipes need their shares, which sum to 1, as phone=0.8,clean=0.2"
    if name == CLEAN:
        return (
            f"{CLEAN!r} is a picture as it is, which has a place in a mixture alone, as phone=0.8,clean=0.2"
        )
    return f"no recipe named {name!r}{meant(name, RECIPES) or ';'} {_LISTED}"


def find_degradation(recipe: RecipeLike, *, phases: bool = False) -> Degradation:
    """What `find_recipe` finds, or a mixture: `phone=0.6,awgn=0.2,clean=0.2`, or a TOML file of one.

    Raises:
        InputError: there is no such recipe, or shares that do not sum to 1.

    Example:
        >>> find_degradation("awgn=0.75,clean=0.25")
        mix({'awgn': 0.75, 'clean': 0.25})
    """
    if isinstance(recipe, Mixture) or not isinstance(recipe, str | Path):
        return recipe if isinstance(recipe, Mixture) else find_recipe(recipe)
    name = str(recipe)
    if "=" in name and not os.path.lexists(name):
        shares: dict[str | Recipe, float] = {}
        for part in name.split(","):
            own, _, share = (text.strip() for text in part.rpartition("="))
            try:
                number = float(share) if own else None
            except ValueError:
                number = None
            if number is None:
                raise InputError(f"{name!r}: {part.strip()!r} is no share of a mixture, as phone=0.6")
            found = own if own == CLEAN else find_recipe(own, phases=phases)
            if found in shares:
                raise InputError(f"{name}: {own} has two shares")
            shares[found] = number
        return mix(shares)
    if name not in RECIPES and (name.endswith(".toml") or (name and os.path.lexists(name))):
        return load_degradation(name)
    return find_recipe(name, phases=phases)


def recipe_files(recipe: RecipeLike) -> list[str]:
    """Where what `find_degradation` takes may be read from: names of files, there or not."""
    if not isinstance(recipe, str | Path):
        return []
    name = str(recipe)
    own = [part.rpartition("=")[0].strip() for part in name.split(",")] if "=" in name else []
    return [text.removesuffix(PHASES) for text in (name, *own) if text]


def load_degradation(path: str | Path) -> Degradation:
    """The recipe or the mixture in a TOML file. Raises InputError where there is none."""
    return read_degradation(read_text(path), str(path))


def read_degradation(text: str, source: str = "recipe") -> Degradation:
    """The recipe or the mixture of a TOML text. Raises InputError that names `source` and what is wrong."""
    kind = Mixture if "mixture" in parse_toml(text, source) else Recipe
    return kind.from_toml(text, source)


def mix(shares: Mapping[Any, float]) -> Mixture:
    """A mixture: each image is degraded by one of several recipes.

    `mix({"phone": 0.6, "awgn": 0.2, "clean": 0.2})`; `clean` leaves an image as it is.

    Args:
        shares: of the images, by recipe in any form that `find_recipe` takes, or "clean". They sum to 1.

    Raises:
        InputError: no such recipe, two of one name, one that is not for photographs, or other shares.

    Example:
        >>> import jax, numpy as np
        >>> mixture = mix({"amwgn": 0.5, "awgn": 0.5})
        >>> _, _, params = mixture.degrade(jax.random.key(0), np.full((8, 8, 8, 3), 0.5, np.float32))
        >>> params["recipe"].shape, mixture.names
        ((8,), ('amwgn', 'awgn'))
    """
    if not isinstance(shares, Mapping):
        raise InputError(
            f"mix takes shares by recipe, as {{'phone': 0.8, 'clean': 0.2}}, got {short(shares)}"
        )
    recipes: dict[str, Recipe] = {}
    for given in shares:
        recipe = _clean() if given == CLEAN else find_recipe(given)
        if recipe.name in recipes:
            raise InputError(
                f"two recipes of a mixture are named {recipe.name!r}: name one otherwise, as "
                f"recipe.named('other')"
            )
        recipes[recipe.name] = recipe
    return Mixture(recipes, tuple(shares.values()))


def _clean() -> Recipe:
    return Recipe(Chain((), CLEAN), {}, "pictures as they are")


def _recipe(name: str, description: str, middle: tuple[Any, ...], prior: dict[str, Any]) -> Recipe:
    """Stages in linear light between decoding and encoding, and 8 bits at the end."""
    named = (stage(s) if isinstance(s, str) else s for s in middle)
    nodes = (stage("srgb_eotf"), *named, stage("clip"), stage("srgb_oetf"), stage("rounding"))
    return Recipe(Chain(nodes, name), prior, description)


def _phone(
    name: str,
    description: str,
    *,
    drop: tuple[str, ...] = (),
    noise: ShotReadNoise = PAPER_NOISE,
    always: bool = True,
) -> Recipe:
    bilateral = stage("bilateral", chroma_cell=4, chroma_bins=20)
    nodes = (
        stage("srgb_eotf"),
        stage("mosaic", cfa=CFA),
        stage("shot_read_noise"),
        stage("clip", name="sensor_clip"),
        stage("adc_quantization"),
        stage("demosaic_hibbard", cfa=CFA),
        stage("median", footprint="cross"),
        bilateral if always else Gate(bilateral),
        stage("unsharp_mask"),
        stage("clip"),
        stage("srgb_oetf"),
        stage("rounding"),
        stage("jpeg_photoshop"),
    )
    prior = {
        "shot_read_noise": noise,
        "adc_quantization": AdcQuantization(bits=14.0),
        "bilateral": BILATERAL,
        "unsharp_mask": UnsharpMask(amount=Uniform(0.0, 0.25), sigma=4.0, threshold=3 / 255),
        "jpeg_photoshop": JpegPhotoshop(level=Choice((4, 5, 6, 7))),
    }
    if not always:
        prior["median"] = Median(strength=Uniform(0.0, 1.0))
        prior["use_bilateral"] = Switch(on=Choice((0.0, 1.0)))
    kept = {name: values for name, values in prior.items() if name not in drop}
    return Recipe(Chain(tuple(n for n in nodes if n.name not in drop), name), kept, description)


def _demosaic_only(name: str, demosaic: str) -> Recipe:
    middle = (
        stage("mosaic", cfa=CFA),
        stage("shot_read_noise"),
        stage("clip", name="sensor_clip"),
        stage(demosaic, cfa=CFA),
    )
    text = f"noise and {demosaic.removeprefix('demosaic_')} demosaicking alone, 8 bits"
    return _recipe(name, text, middle, {"shot_read_noise": PAPER_NOISE})
