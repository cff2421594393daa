"""Degradations of the literature, by their published formulas and numbers.

Each function says its source and what it lacks or adds. All take and give encoded sRGB, as the other recipes.
"""

import functools
from collections.abc import Callable
from typing import Any

from jaxisp.pipeline import Chain, Gate, Node, Order, Shuffle, Switch, stage
from jaxisp.priors import Bernoulli, Choice, LogUniform, Normal, PowerUniform, Uniform
from jaxisp.recipe import Recipe
from jaxisp.stages.blur import AnisotropicBlur, IsotropicBlur, MotionBlur
from jaxisp.stages.jpeg import Jpeg
from jaxisp.stages.noise import GaussianNoise, LowLightNoise, ShotReadLaw, ShotReadNoise
from jaxisp.stages.resampling import Resampling
from jaxisp.unprocess import CameraColors, Unprocessed

DARMSTADT = ShotReadLaw(
    shot=LogUniform(1e-4, 0.012), slope=2.18, intercept=1.20, deviation=Normal(0.0, 0.26, -1.3, 1.3)
)
"""Brooks et al. 2019, section 3.1, from the noise levels of the Darmstadt Noise Dataset. Five standard
deviations are kept."""
BROOKS = CameraColors(
    weights=Uniform(0.0, 1.0),
    red=Uniform(1.9, 2.4),
    blue=Uniform(1.5, 1.9),
    dimming=Normal(0.8, 0.1, 0.3, 1.3),
)
"""Brooks et al. 2019, sections 3.2 and 3.4, and their code: weights, gains, and the inverse of
brightening."""

ELD_WHITE, PMN_WHITE = 16383.0 - 800, 16383.0 - 512
"""White less black [DN], as their code has it."""


def unprocessing() -> Recipe:
    """Brooks et al. 2019: a photograph unprocessed to a RAW, noise, and processed again.

    Lacks nothing of the paper's but its loss on RAW. Added: the tone curve that was undone is applied again,
    so that the clean picture is the photograph itself; 8 bits.
    """
    sensor = stage("mosaic", cfa="RGGB"), stage("shot_read_law"), stage("demosaic_bilinear", cfa="RGGB")
    nodes = (
        stage("inverse_smoothstep"),
        stage("gamma22_eotf"),
        Unprocessed(Chain(sensor, "sensor")),
        stage("clip"),
        stage("gamma22_oetf"),
        stage("smoothstep"),
        stage("rounding"),
    )
    prior = {"unprocessed": BROOKS, "shot_read_law": DARMSTADT}
    text = "Brooks et al. 2019: unprocessed to a RAW of the Darmstadt cameras, their noise, processed again"
    return Recipe(Chain(nodes, "unprocessing"), prior, text)


def darmstadt() -> Recipe:
    """The affine noise of Ploetz & Roth 2017, with the levels that Brooks et al. 2019 fit to their cameras.

    Lacks white balance and colour matrix, which `unprocessing` has: noise is that of a sensor whose colours
    are sRGB's.
    """
    sensor = _developed(stage("shot_read_law"), demosaic="demosaic_bilinear")
    text = "shot and read noise of the cameras of the Darmstadt Noise Dataset, bilinear demosaicking"
    return Recipe(Chain(sensor, "darmstadt"), {"shot_read_law": DARMSTADT}, text)


def cbdnet() -> Recipe:
    """Guo et al. 2019 (CBDNet), equations 2 and 3: noise on a mosaic, demosaicking, the response, JPEG.

    `y = JPEG(f(DM(L + n(L))))`, `L = M f**-1(x)`, n of variance `sigma_s**2 L + sigma_c**2`. Lacks their 201
    response curves: f is sRGB's. Their code draws the strengths for each channel; the paper does not, nor is
    it done here.
    """
    chain = (*_developed(stage("shot_read_noise"), demosaic="demosaic_bilinear"), stage("jpeg"))
    prior = {
        "shot_read_noise": ShotReadNoise(shot=PowerUniform(0.0, 0.16, 2), read=Uniform(0.0, 0.06)),
        "jpeg": Jpeg(quality=Uniform(60.0, 100.0)),
    }
    text = "Guo et al. 2019: sigma_s 0 to 0.16, sigma_c 0 to 0.06 on a mosaic, JPEG of quality 60 to 100"
    return Recipe(Chain(chain, "cbdnet"), prior, text)


def rsblur() -> Recipe:
    """Rim et al. 2022 (RSBlur): blur with saturated highlights, RAW noise of RealBlur's camera, Malvar.

    Lacks: frames of real motion (a path of three segments draws it), the camera's own matrix (that of
    `unprocessing`) and response (sRGB's), and the rule that keeps noise out of saturated pixels; one CFA
    phase. An image alone differs from the same one in a batch by rounding: XLA draws a single path in other
    steps, and about one value in 200,000 then moves by a step of 8 bits.
    """
    sensor = stage("mosaic", cfa="RGGB"), stage("shot_read_noise"), stage("demosaic_malvar", cfa="RGGB")
    nodes = (
        stage("srgb_eotf"),
        stage("motion_blur"),
        Unprocessed(Chain(sensor, "sensor"), preserve=False),
        stage("clip"),
        stage("srgb_oetf"),
        stage("rounding"),
    )
    prior = {
        "motion_blur": MotionBlur(
            lengths=Uniform(0.0, 8.0), directions=Uniform(-180.0, 180.0), boost=Uniform(0.25, 1.75)
        ),
        "unprocessed": CameraColors(weights=BROOKS.weights, red=BROOKS.red, blue=BROOKS.blue, dimming=1.0),
        "shot_read_noise": ShotReadNoise(shot=8.8915e-05, read=2.9430e-05**0.5),
    }
    text = "Rim et al. 2022: motion blur with bright highlights, RAW noise of one camera, demosaicking"
    return Recipe(Chain(nodes, "rsblur"), prior, text)


def bsrgan() -> Recipe:
    """Zhang et al. 2021 (BSRGAN), at the photograph's own size: blurs, resampling, noises and JPEG, shuffled.

    Widths, noise and quality are those of scale 4. Lacks: the smaller picture (it is enlarged again), noise
    that is grey or correlated between channels, nearest and bilinear resampling, and their sensor pipeline,
    in whose place `darmstadt` stands with Malvar's demosaicking. Blurs and JPEG before the last are each left
    out for some images, as there.
    """
    camera = _developed(stage("shot_read_law"), demosaic="demosaic_malvar")[:-1]
    shuffled: tuple[Node, ...] = (
        stage("isotropic_blur"),
        stage("anisotropic_blur"),
        stage("resampling", method="bicubic"),
        stage("gaussian_noise"),
        Gate(stage("jpeg", name="first_jpeg")),
        Gate(Chain(camera, "camera")),
    )
    nodes = (Shuffle(shuffled, "order"), stage("clip", name="output_clip"), stage("rounding"), stage("jpeg"))
    prior: dict[str, Any] = {
        "order": Order(priority=Uniform(0.0, 1.0)),
        "isotropic_blur": IsotropicBlur(sigma=Uniform(0.1, 2.8)),
        "anisotropic_blur": AnisotropicBlur(
            along=Uniform(0.5, 8.0), across=Uniform(0.5, 8.0), angle=Uniform(0.0, 180.0)
        ),
        "resampling": Resampling(factor=Uniform(1.0, 2.0)),
        "gaussian_noise": GaussianNoise(std=Uniform(1 / 255, 25 / 255)),
        "use_first_jpeg": Switch(on=Bernoulli(0.75)),
        "first_jpeg": Jpeg(quality=Uniform(30.0, 95.0)),
        "use_camera": Switch(on=Bernoulli(0.25)),
        "shot_read_law": DARMSTADT,
        "jpeg": Jpeg(quality=Uniform(30.0, 95.0)),
    }
    text = "Zhang et al. 2021: blurs, resampling, noise, camera noise and JPEG in random order, then JPEG"
    return Recipe(Chain(nodes, "bsrgan"), prior, text)


def low_light(camera: str) -> Recipe:
    """Wei et al. 2020 (ELD) or Feng et al. 2022 (PMN): extreme low light, dimmed 100 to 300 times.

    Photons, read noise of Tukey's lambda distribution, row noise and rounding, by the published calibration
    of a camera. Lacks its colour bias (ELD), its dark shading (PMN), white balance and colour matrix;
    bilinear demosaicking and 8 bits are added.

    Args:
        camera: a name of `LOW_LIGHT`.
    """
    log_gain, read, row, shapes, white = LOW_LIGHT[camera]
    (low, high), (read_spread, row_spread) = log_gain, (read[2], row[2])
    noise = LowLightNoise(
        gain=LogUniform(low, high),
        read_slope=read[0],
        read_intercept=read[1],
        read_deviation=Normal(0.0, read_spread, -5 * read_spread, 5 * read_spread),
        read_shape=Choice(shapes),
        row_slope=row[0],
        row_intercept=row[1],
        row_deviation=Normal(0.0, row_spread, -5 * row_spread, 5 * row_spread),
        ratio=Uniform(100.0, 300.0),
        white=white,
    )
    nodes = _developed(stage("low_light_noise"), demosaic="demosaic_bilinear")
    source = "Feng et al. 2022" if camera.startswith("pmn") else "Wei et al. 2020"
    text = f"{source}: noise in extreme low light, {camera.partition('-')[2]}, dimmed 100 to 300 times"
    return Recipe(Chain(nodes, camera), {"low_light_noise": noise}, text)


def _developed(noise: Node, demosaic: str) -> tuple[Node, ...]:
    """Noise on a mosaic of linear light, demosaicked and encoded to 8 bits."""
    return (
        stage("srgb_eotf"),
        stage("mosaic", cfa="RGGB"),
        noise,
        stage("clip", name="sensor_clip"),
        stage(demosaic, cfa="RGGB"),
        stage("clip"),
        stage("srgb_oetf"),
        stage("rounding"),
    )


Line = tuple[float, float, float]
"""Slope, intercept and standard deviation about a line of logarithms."""
LOW_LIGHT: dict[str, tuple[tuple[float, float], Line, Line, tuple[float, ...], float]] = {
    "eld-canon-5d4": (
        (0.21819, 13.964), (0.65588, 1.0927, 0.28605), (0.47128, -0.8079, 0.24362),
        (0.1571, 0.1429, 0.08571, 0.08571, 0.2, 0.2, 0.1, 0.08571, 0.05714, 0.07143, 0.02857, 0.02857,
        0.01429, 0.02857, 0.08571, 0.07143, 0.1143, 0.1143), ELD_WHITE,
    ),
    "eld-canon-700d": (
        (0.44763, 28.648), (0.59824, 1.537, 0.38882), (0.62206, -0.77565, 0.24848),
        (0.1286, 0.1286, 0.1, 0.1, 0.01429, 0.01429, -0.08571, -0.1, -0.1429, -0.1571, -0.1286, -0.1286,
        -0.02857, -0.02857, 0.01429, 0.01429), ELD_WHITE,
    ),
    "eld-canon-70d": (
        (0.4075, 26.08), (0.48681, 1.4643, 0.38201), (0.72922, -0.93706, 0.25022),
        (0.1429, 0.1429, 0.1143, 0.1143, 0.02857, 0.02857, -0.1, -0.08571, -0.1714, -0.1714, -0.1571,
        -0.1571, -0.08571, -0.08571, -0.02857, -0.02857), ELD_WHITE,
    ),
    "eld-nikon-d850": (
        (0.41504, 26.563), (0.47739, -0.090445, 0.2392), (0.44829, -1.7977, 0.23218),
        (-0.1143, -0.1143, -0.2, -0.2, -0.2143, -0.2143, -0.2286, -0.2286, -0.2429, -0.2429, -0.1714,
        -0.1714, -0.1429, -0.1429, -0.1, -0.1), ELD_WHITE,
    ),
    "eld-sony-a7s2": (
        (0.093916, 6.0106), (0.4621, 0.56571, 0.26337), (0.52754, -0.5917, 0.29429),
        (0.1143, 0.1286, 0.05714, 0.04286, 0.0, 0.0, -0.04286, -0.05714, -0.08571, -0.08571, -0.08571,
        -0.08571, -0.1143, -0.1143, -0.1429, -0.1286, -0.1429, -0.1429), ELD_WHITE,
    ),
    "pmn-sony-a7s2-low": (
        (0.18784, 1.5254), (0.74043, 0.86182, 0.00712),
        (0.78782, -0.34227, 0.02832), (-0.026,), PMN_WHITE,
    ),
    "pmn-sony-a7s2-high": (
        (1.9073, 12.38), (0.74901, -0.12348, 0.00638),
        (0.62945, -1.5104, 0.02609), (-0.025,), PMN_WHITE,
    ),
}  # fmt: skip
"""By name: gains from and to [DN/e-], lines of read and row noise over the gain, Tukey's lambdas, white less
black [DN].

ELD: the authors' released `camera_params`, Kmin, Kmax, and of Profile-1 G_scale and R_scale, G_shape, to five
digits. PMN: `data_process/process.py` of the authors' code, SonyA7S2_lowISO and SonyA7S2_highISO (ISO up to
1600, and above); its gains are stated as logarithms.
"""

PUBLISHED: dict[str, Callable[[], Recipe]] = {
    "unprocessing": unprocessing,
    "darmstadt": darmstadt,
    "cbdnet": cbdnet,
    **{name: functools.partial(low_light, name) for name in LOW_LIGHT},
    "rsblur": rsblur,
    "bsrgan": bsrgan,
}
"""Recipes of the literature by name."""
