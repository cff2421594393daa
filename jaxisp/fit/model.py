"""The camera that is fitted: its stages, the discrete choices among them, and where each fit starts."""

import dataclasses
from collections.abc import Sequence
from typing import Any

import numpy as np

from jaxisp.domains import ENCODED, accepts
from jaxisp.encoder import ENCODER, encoder_of
from jaxisp.errors import InputError, meant, short
from jaxisp.io import Jpeg
from jaxisp.pipeline import Chain, Params, Stage, stage
from jaxisp.recipe import Recipe
from jaxisp.stages import STAGES, choice
from jaxisp.stages.balance import ColorMatrix, Saturation
from jaxisp.stages.choice import HALVED, ChromaSubsampling
from jaxisp.stages.denoise.bilateral import Bilateral
from jaxisp.stages.denoise.median import Median
from jaxisp.stages.detail import UnsharpMask
from jaxisp.stages.optics import Exposure, GeometricDistortion, LateralChromaticAberration, Vignetting
from jaxisp.stages.power import Gamma
from jaxisp.stages.tone import SCurve, ZoneCurve

ZONES = 7
"""Control points of the tone curve, beside a gamma and an s-curve for its overall bend."""

DEMOSAICKERS = (
    "demosaic_malvar",
    "demosaic_ahd",
    "demosaic_menon",
    "demosaic_hibbard",
    "demosaic_hamilton_adams",
    "demosaic_vng",
    "demosaic_edge_aware",
    "demosaic_bilinear",
    "demosaic_ahd_libraw",
    "demosaic_rcd",
    "demosaic_ppg",
    "demosaic_dcb",
    "demosaic_lmmse",
)
_VARIANTS: dict[str, tuple[str, dict[str, Any]]] = {
    "demosaic_ahd_libraw": ("demosaic_ahd", {"delta": 1, "variant": "libraw"}),
}
"""Demosaickers that are a stage with options."""
MIX = "demosaicking"
"""The stage that mixes two demosaickers."""
MEDIANS = (None, "cross", "3x3", "5x5")
PLACES = ("camera", "encoded")

LENS = ("lateral_chromatic_aberration", "geometric_distortion")
"""Stages that bend the picture: among the geometry while it is fitted, see `jaxisp.fit.lens`."""

SAMPLING = "chroma_subsampling"
"""The last stage that is fitted. Where a JPEG file states its sampling it is set while the rest is fitted,
and left to the encoder afterwards."""

SET_FROM_FILE = ("mosaic_white_balance", ENCODER)
"""Stages whose parameters are read, not fitted."""


Inserted = tuple[Stage, str]
"""A stage, and the name of the stage that it follows."""


@dataclasses.dataclass(frozen=True)
class Design:
    """The discrete choices.

    Args:
        demosaic: one of `demosaickers`.
        passes: of the colour-difference median after it.
        median: footprint of the median filter, or None for no such stage.
        place: where denoising is: on square roots of "camera" RGB, where shot noise is even, or on
            "encoded" sRGB, after colour.
        lens: whether radial distortion and lateral colour are among its stages.
        sampling: whether chroma sampling is: where no file states it, for an encoder does it otherwise.
        inserted: stages of the user's own, each after the stage of a name; see `insertion`.
        mixed: another of `DEMOSAICKERS` that is mixed in, and its share; None for none. A mix stands for a
            demosaicker that is not among these.
    """

    demosaic: str = DEMOSAICKERS[0]
    passes: int = 0
    median: str | None = None
    place: str = PLACES[0]
    lens: bool = False
    sampling: bool = False
    inserted: tuple["Inserted", ...] = ()
    mixed: tuple[str, float] | None = None

    @property
    def text(self) -> str:
        passes = f" + {self.passes} colour-difference medians" if self.passes else ""
        median = f", median {self.median}" if self.median else ""
        lens = ", distortion and lateral colour" if self.lens else ""
        own = "".join(f", {node.name}" for node, _ in self.inserted)
        name = self.demosaic.removeprefix("demosaic_")
        if self.mixed:
            name += f" with {self.mixed[1]:.0%} {self.mixed[0].removeprefix('demosaic_')}"
        return f"{name}{passes}{median}, denoised in {self.place} RGB{lens}{own}"


def head(cfa: str, design: Design) -> Chain:
    """Mosaic to camera RGB: nothing in it is fitted, so it runs once a picture."""
    one = _demosaicker(design.demosaic, cfa)
    if design.mixed:
        algorithm, partner = map(_member, (design.demosaic, design.mixed[0]))
        one = stage(MIX, cfa=cfa, algorithm=algorithm, partner=partner)
    nodes: list[Stage] = [stage("mosaic_white_balance", cfa=cfa), stage("clip"), one]
    if design.passes:
        nodes.append(stage("color_difference_median", passes=design.passes))
    return Chain(tuple(nodes), "raw_to_camera_rgb")


def shares(design: Design) -> Params:
    """The parameters of demosaicking: of two that are mixed, their shares."""
    if design.mixed is None:
        return {}
    partner, share = _member(design.mixed[0]), design.mixed[1]
    own = [share * (name == partner) for name in choice.DEMOSAICKERS]
    return {MIX: choice.Demosaicking(shares=np.asarray(own, np.float32))}


def _member(name: str) -> str:
    """What `choice.DEMOSAICKERS` calls one of `DEMOSAICKERS`."""
    return name.removeprefix("demosaic_").replace("_", "-")


def _mixed_in(node: Stage, params: Params) -> tuple[str, tuple[str, float]]:
    """The two demosaickers of a stage that mixes them, and the share of the second."""
    members = {_member(name): name for name in DEMOSAICKERS}
    partner = str(node.options["partner"])
    share = float(np.asarray(params[MIX].shares)[list(choice.DEMOSAICKERS).index(partner)])
    return members[str(node.options["algorithm"])], (members[partner], share)


def demosaickers() -> list[str]:
    """All that a fit can be told to take."""
    return [*(name for name in STAGES if name.startswith("demosaic_")), *_VARIANTS]


def _demosaicker(name: str, cfa: str) -> Stage:
    own, options = _VARIANTS.get(name, (name, {}))
    return stage(own, cfa=cfa, **options)


def demosaicker_of(node: Stage) -> str:
    """The name of a demosaicking stage among `demosaickers`."""
    for name in _VARIANTS:
        own = _demosaicker(name, str(node.options["cfa"]))
        if (own.fn, own.options) == (node.fn, node.options):
            return name
    return node.fn.__name__


def front(design: Design) -> Chain:
    """Camera RGB up to and with denoising; what follows it is `back`."""
    before, after = around_median(design.place)
    median = (stage("median", footprint=design.median),) if design.median else ()
    return Chain((*before.nodes, *median, *after.nodes), "front")


def around_median(place: str) -> tuple[Chain, Chain]:
    """What stands before and after the median filter in `front`: the fit chooses its size while it runs."""
    if place == "encoded":
        return Chain((*_color(), _bilateral()), "before"), Chain((), "after")
    rooted = stage("gamma_compression", name="denoise_encoding")
    linear = stage("gamma_expansion", name="denoise_decoding")
    return Chain((rooted, _bilateral()), "before"), Chain((linear,), "after")


def back(place: str, inserted: Sequence[Inserted] = ()) -> Chain:
    """What follows denoising: colour where it is not in front, tone, saturation, sharpening, and what is
    inserted."""
    look = stage("saturation"), stage("unsharp_mask", radius=6), stage(SAMPLING)
    chain = Chain((*(() if place == "encoded" else _color()), *tone().nodes, *look), "back")
    for node, after in inserted:
        chain = chain.insert(node, after=after)
    return chain


FOLLOWED = ("gamma_compression", "s_curve", "zone_curve", "saturation", "unsharp_mask")
"""Stages after which others can be inserted, on encoded pictures."""


def insertion(given: str | Stage) -> Inserted:
    """`STAGE`, `STAGE@NAME` or a stage as one that follows another: by default the tone curve.

    Raises:
        InputError: no such stage, one that is drawn or reads other pixels, or one that is fitted already.
    """
    if not isinstance(given, str | Stage):
        raise InputError(f"insert takes names of stages, or stages, got {short(given)}")
    name, _, after = given.partition("@") if isinstance(given, str) else (given.name, "", "")
    after = after or FOLLOWED[2]
    if after not in FOLLOWED:
        raise InputError(f"insert {given!r}: a stage can follow {', '.join(FOLLOWED)}, not {after!r}")
    if isinstance(given, str) and name not in STAGES:
        hint = meant(name, STAGES) or f"; there are {', '.join(insertable())}"
        raise InputError(f"insert: no stage named {name!r}{hint}")
    node = stage(name) if isinstance(given, str) else given
    if why := _unfit(node):
        raise InputError(f"insert: {name} {why}; there are {', '.join(insertable())}")
    return node, after


def insertable() -> list[str]:
    """The library's stages that a fit can insert."""
    return sorted(name for name in STAGES if not _unfit(stage(name)))


def _unfit(node: Stage) -> str:
    """Why a stage cannot be inserted; "" where it can."""
    if not (accepts(node.domain_in, ENCODED) and accepts(ENCODED, node.domain_out)):
        return f"takes {node.domain_in.name}, expected a stage on encoded sRGB"
    if node.stochastic:
        return "draws noise, which is not fitted so"
    if node.reach != 0:
        return "reads other pixels, expected a stage that acts on each pixel for itself"
    if not node.init():
        return "has no parameter to fit"
    if node.name in start():
        return "is fitted already"
    own = camera("RGGB", Design(passes=1, median=MEDIANS[-1], lens=True, sampling=True)).names()
    return "is in the camera already" if node.name in own else ""


def inserted_in(camera: Recipe) -> tuple[Inserted, ...]:
    """The stages that the fit of a camera inserted, in the order that `back` takes."""
    names = camera.meta.get("inserted", ())
    found: list[Inserted] = []
    after = ""
    for node in camera.chain.nodes:
        after = node.name if node.name in FOLLOWED else after
        if node.name in names and isinstance(node, Stage) and after:
            found.append((node, after))
    return tuple(reversed(found))


def tone() -> Chain:
    """The curve on encoded channels, which three stages share."""
    curve = stage("gamma_compression"), stage("s_curve"), stage("zone_curve", on="channels")
    return Chain(curve, "tone")


def _bilateral() -> Stage:
    return stage("bilateral", chroma_radius=8)  # phones smooth chroma widely


def _color() -> tuple[Stage, ...]:
    return stage("exposure"), stage("color_matrix"), stage("srgb_oetf")


def fitted(design: Design) -> Chain:
    """All that the fit moves: camera RGB to encoded sRGB, before rounding and the encoder."""
    lens = tuple(stage(name) for name in LENS) if design.lens else ()
    tail = back(design.place, design.inserted)
    tail = tail if design.sampling else tail.without(SAMPLING)
    nodes = (stage("vignetting"), *lens, *front(design).nodes, *tail.nodes)
    return Chain(nodes, "camera_rgb_to_picture")


def camera(cfa: str, design: Design) -> Chain:
    """The whole: `jaxisp.camera.develop` runs it on a RAW."""
    return Chain((*head(cfa, design).nodes, *fitted(design).nodes, stage("rounding")), "fitted")


def start(inserted: Sequence[Inserted] = ()) -> Params:
    """Where a fit begins, before exposure and colour are set: mild denoising and sharpening, no bend.

    It holds the parameters of every design. What is inserted begins at its defaults.
    """
    own = {name: values for node, _ in inserted for name, values in node.init().items()}
    return own | {
        "vignetting": Vignetting(),
        "lateral_chromatic_aberration": LateralChromaticAberration(),
        "geometric_distortion": GeometricDistortion(),
        "bilateral": Bilateral(luma_sigma_range=0.02, chroma_sigma_space=1.5, chroma_sigma_range=0.05),
        "median": Median(strength=0.5),
        "denoise_encoding": Gamma(gamma=2.0),
        "denoise_decoding": Gamma(gamma=2.0),
        "exposure": Exposure(exposure_ev=0.0),
        "color_matrix": ColorMatrix(matrix=np.eye(3)),
        "gamma_compression": Gamma(gamma=1.0),
        "s_curve": SCurve(strength=0.0, midpoint=0.5),
        "zone_curve": ZoneCurve(offsets=np.zeros(ZONES)),
        "saturation": Saturation(amount=1.0),
        "unsharp_mask": UnsharpMask(amount=0.3, sigma=1.2, threshold=0.0),
        SAMPLING: ChromaSubsampling(horizontal=0.5, vertical=0.5),
    }


def of_camera(camera: Recipe, inserted: Sequence[Inserted] = ()) -> tuple[dict[str, Any], Params]:
    """The choices of a camera that `jaxisp fit` wrote, as fields of `Design`, and its parameters, those of
    the inserted stages included.

    Raises:
        InputError: it is no such camera.
    """
    stages = {s.name: s for s in camera.chain.stages()}
    found = [demosaicker_of(s) for s in stages.values() if s.fn.__name__.startswith("demosaic_")]
    mixed = None
    if MIX in stages:
        own, mixed = _mixed_in(stages[MIX], camera.prior)
        found.append(own)
    missing = sorted({"exposure", "color_matrix", "unsharp_mask"} - set(camera.prior))
    if len(found) != 1 or missing:
        why = f"it has no {', '.join(missing)}" if missing else f"it demosaicks {len(found)} times"
        raise InputError(f"start: {camera.name!r} is no camera from `jaxisp fit`: {why}")
    again = stages.get("color_difference_median")
    median = stages.get("median")
    choices = {
        "demosaic": found[0],
        "mixed": mixed,
        "passes": int(str(again.options["passes"])) if again else 0,
        "median": str(median.options["footprint"]) if median else None,
        "lens": all(name in stages for name in LENS),
    }
    kept = {n: v for n, v in start(inserted).items() if isinstance(camera.prior.get(n), type(v))}
    return choices, {n: camera.prior[n] for n in kept}


def starts() -> list[Params]:
    """What differs from `start` in each setting that a fit may begin at; the first is `start` itself."""
    strong = Bilateral(
        luma_sigma_space=3.0, luma_sigma_range=0.1, chroma_sigma_space=4.0, chroma_sigma_range=0.2
    )
    weak = Bilateral(
        luma_sigma_space=0.6, luma_sigma_range=0.01, chroma_sigma_space=0.8, chroma_sigma_range=0.02
    )
    return [
        {},
        {"bilateral": strong, "unsharp_mask": UnsharpMask(amount=1.0, sigma=1.0, threshold=0.0)},
        {"bilateral": weak, "unsharp_mask": UnsharpMask(amount=0.1, sigma=2.0, threshold=0.0)},
        {"gamma_compression": Gamma(gamma=1.4), "s_curve": SCurve(strength=0.5, midpoint=0.35)},
    ]


def sampled(jpeg: Jpeg | None) -> Params:
    """The parameters of chroma sampling as a JPEG file states it; none where it is full."""
    horizontal, vertical = HALVED.get(jpeg.subsampling, (0.0, 0.0)) if jpeg else (0.0, 0.0)
    return {SAMPLING: ChromaSubsampling(horizontal=horizontal, vertical=vertical)}


def with_jpeg(chain: Chain, jpeg: Jpeg | None) -> tuple[Chain, Params]:
    """The chain with the JPEG encoder that wrote `jpeg` at its end, and its parameters, which are set and not
    fitted. No encoder where there is no file or its own is not modelled."""
    own = encoder_of(jpeg)
    if own is None:
        return chain, {}
    return Chain((*chain.nodes, own[0]), chain.name), own[1]
