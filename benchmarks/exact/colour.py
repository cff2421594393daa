"""Transfer functions, colour spaces and stages against colour-science; automatic ones by closed forms."""

from collections.abc import Iterator
from importlib.metadata import version

import jax
import jax.numpy as jnp
import numpy as np
from scipy.stats import gmean, pmean

from benchmarks.exact.row import Row, largest
from jaxisp.pipeline import Chain, run, stage
from jaxisp.stages import STAGES
from jaxisp.stages.auto import AutoExposure, AutoLevel, GrayWorld, WhitePatch
from jaxisp.stages.balance import HueRotation, Saturation, WhiteBalanceTemperature
from jaxisp.testing import smooth_image
from tests.stages import test_spaces as spaces
from tests.stages import test_transfer as transfer
from tests.stages.test_balance import exact_rgb, ycbcr

COLOUR = f"colour-science {version('colour-science')}"
WEIGHTS = np.array([0.299, 0.587, 0.114])


def rows() -> Iterator[Row]:
    yield curves()
    yield curves_there_and_back()
    yield slopes()
    yield conversions()
    yield conversions_there_and_back()
    yield saturation_and_hue()
    yield temperatures()
    yield from automatic()


def of(module: str) -> list[str]:
    """All stages of a module: one without a reference is an error."""
    return sorted(n for n, fn in STAGES.items() if fn.__module__ == f"jaxisp.stages.{module}")


def ramp() -> np.ndarray:
    """Without 0.018, where Rec. 709's constants step by 2.5e-4: its nearest single lies just below."""
    values = np.concatenate([np.geomspace(1e-6, 1, 5001), np.linspace(0, 1, 5001)]).astype(np.float32)
    return values[values != np.float32(0.018)]


def curves() -> Row:
    names, values = of("transfer"), ramp()
    worst = [
        largest(transfer.curve(name, values), transfer.REFERENCES[name](values.astype(np.float64)))
        for name in names
    ]
    ran = f"{', '.join(names)}: 10001 values of [0, 1] less Rec. 709's knee, single precision"
    return Row("transfer functions", COLOUR, ran, max(worst), 1e-6)


def curves_there_and_back() -> Row:
    values = np.concatenate([-ramp(), ramp()])
    values = values[np.abs(np.abs(values) - 0.0812) > 3e-4]  # signals that Rec. 709 gives to no light
    pairs = [*transfer.PAIRS, *((b, a) for a, b in transfer.PAIRS)]
    worst = [largest(transfer.curve(b, transfer.curve(a, values)), values) for a, b in pairs]
    ran = "each pair in both orders, values of [-1, 1] less Rec. 709's step, single precision"
    return Row("transfer functions, there and back", "the identity", ran, max(worst), 1e-6)


def slopes() -> Row:
    at = jnp.float32([0.0, 1.0, -1.0, 1e-30, -1e-30, 4.0])
    wrong = 0
    for name in of("transfer"):
        node = stage(name)
        slope = jax.jit(jax.vmap(jax.grad(lambda x, node=node: node({}, jnp.full((1, 1, 3), x))[0, 0, 0])))
        wrong += int(np.sum(~np.isfinite(slope(at)) | (slope(at) <= 0)))
    ran = "slopes at 0, 1, -1, 4 and 1e-30 either side of 0"
    return Row("transfer functions, gradients", "finite and positive", ran, wrong, 0, "slopes that are not")


def colours() -> np.ndarray:
    """Corners of the cube and random colours inside it."""
    image = np.random.default_rng(0).uniform(0, 1, (64, 65, 3)).astype(np.float32)
    image[0, :8] = [[i >> 2 & 1, i >> 1 & 1, i & 1] for i in range(8)]
    return image


def conversions() -> Row:
    names, image = of("spaces"), colours()
    worst = [
        largest(run(stage(name), {}, image), spaces.REFERENCES[name](image.astype(np.float64)))
        for name in names
    ]
    ran = f"{', '.join(names)}: 4160 colours and corners of [0, 1], single precision"
    return Row("colour spaces", COLOUR, ran, max(worst), 1e-6)


def conversions_there_and_back() -> Row:
    image, worst = colours(), []
    for pair in spaces.PAIRS:
        for names in (pair, pair[::-1]):
            worst.append(largest(run(Chain(tuple(map(stage, names))), {}, image), image))
    ran = "each pair in both orders, the same colours, single precision"
    return Row("colour spaces, there and back", "the identity", ran, max(worst), 1e-6)


def saturation_and_hue() -> Row:
    image, worst = colours(), []
    before = ycbcr(image.astype(np.float64))
    for amount in (0.0, 0.5, 1.0, 1.5):
        out = run(stage("saturation"), {"saturation": Saturation(amount=np.float32(amount))}, image)
        worst.append(largest(ycbcr(np.asarray(out, np.float64)), before * [1, amount, amount]))
    for angle in (-180.0, -30.0, 7.0, 120.0):
        out = run(stage("hue_rotation"), {"hue_rotation": HueRotation(angle=np.float32(angle))}, image)
        after = ycbcr(np.asarray(out, np.float64))
        turned = (before[..., 1] + 1j * before[..., 2]) * np.exp(1j * np.deg2rad(angle))
        want = np.stack([before[..., 0], turned.real, turned.imag], -1)
        worst.append(largest(after, want))
    ran = "amounts 0 to 1.5, angles of -180 to 120 degrees, single precision, seen in Y'CbCr"
    return Row("saturation, hue rotation", COLOUR, ran, max(worst), 1e-6)


def temperatures() -> Row:
    """Relative: gains from and to D65 of illuminants whose channels are all inside sRGB's."""
    node, worst = stage("white_balance_temperature"), []
    d65 = exact_rgb(6504.0, 0.0032)
    for temperature in np.geomspace(2000, 12000, 13):
        for tint in (-0.03, -0.01, 0.0, 0.01, 0.03):
            illuminant = exact_rgb(temperature, tint)
            if illuminant.min() < 0.01:  # outside sRGB: the library bends it, nobody else has a value
                continue
            here = {"temperature": np.float32(temperature), "tint": np.float32(tint)}
            there = {f"source_{k}": v for k, v in here.items()}
            for values, want in ((here, illuminant / d65), (there, d65 / illuminant)):
                params = {node.name: WhiteBalanceTemperature(**values)}
                gains = np.asarray(run(node, params, np.ones((1, 1, 3), np.float32)))[0, 0]
                worst.append(largest(gains / want, 1.0))
    ran = f"{len(worst)} gains of 2000 to 12000 K, Duv -0.03 to 0.03, single precision, relative"
    return Row("white balance by temperature", f"{COLOUR}, Planck's law at 1 nm", ran, max(worst), 1e-4)


def automatic() -> Iterator[Row]:
    image = (smooth_image((61, 48, 3)) * [0.5, 1.0, 0.8] * 0.6).astype(np.float32)
    exact = image.astype(np.float64)
    luma = exact @ WEIGHTS

    def row(name: str, params: object, want: np.ndarray, ran: str, **static: str) -> Row:
        got = run(stage(name, **static), {name: params}, image)
        return Row(name, "closed form in NumPy, SciPy", f"{ran}, single precision", largest(got, want), 1e-4)

    for average, mean in (("log", gmean), ("mean", np.mean)):
        params = AutoExposure(target=np.float32(0.4))
        want = exact * np.float32(0.4) / mean(np.maximum(luma, 1e-4), axis=None)
        yield row("auto_exposure", params, want, f"target 0.4, {average} average", average=average)
    low, high = np.percentile(luma, [2, 95])
    params = AutoLevel(black=np.float32(2), white=np.float32(95), max_gain=np.float32(16))
    yield row("auto_level", params, (exact - low) / (high - low), "percentiles 2 and 95")
    for norm in (1.0, 6.0):
        means = pmean(exact.reshape(-1, 3), norm)
        params = GrayWorld(norm=np.float32(norm))
        yield row("gray_world", params, exact * means[1] / means, f"Minkowski norm {norm:g}")
    tops = np.percentile(exact, 97.5, axis=(0, 1))
    patch = WhitePatch(percentile=np.float32(97.5))
    yield row("white_patch", patch, exact * tops[1] / tops, "percentile 97.5")
