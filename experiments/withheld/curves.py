"""The tone curves of the bodies: from light in [0, 1] to encoded values in [0, 1]."""

from collections.abc import Callable

import numpy as np
from scipy.interpolate import PchipInterpolator
from scipy.special import betainc, erf, ndtr

from .numeric import srgb_encode


def power_with_s(x: np.ndarray) -> np.ndarray:
    y = np.power(np.clip(x, 1e-6, 1), 1 / 2.2)
    return y + 0.15 * (y * y * (3 - 2 * y) - y)


def srgb_with_shoulder(x: np.ndarray) -> np.ndarray:
    y = srgb_encode(1.2 * np.clip(x, 0, 1))
    knee, top = 0.7, float(srgb_encode(np.array(1.2)))
    span = (np.clip(y, knee, top) - knee) / (top - knee)
    slope = (top - knee) / (1 - knee)
    bent = knee + (1 - knee) * (1 - (1 - span) ** slope)
    return np.where(y > knee, bent, y)


def filmic(x: np.ndarray) -> np.ndarray:
    """A ratio of quadratics with its encoding in it, scaled to end at one."""

    def ratio(v: np.ndarray | float) -> np.ndarray | float:
        return v * (6.2 * v + 0.5) / (v * (6.2 * v + 1.7) + 0.06)

    return np.asarray(ratio(np.clip(x, 0, 1) * 1.4)) / ratio(1.4)


_KNOTS = np.array([0, 0.002, 0.01, 0.03, 0.08, 0.18, 0.35, 0.6, 0.85, 1.0])
_VALUES = np.array([0, 0.02, 0.09, 0.185, 0.325, 0.485, 0.65, 0.82, 0.945, 1.0])
_PIECES = PchipInterpolator(_KNOTS, _VALUES)


def piecewise(x: np.ndarray) -> np.ndarray:
    return _PIECES(np.clip(x, 0, 1))


def broadcast_with_s(x: np.ndarray) -> np.ndarray:
    x = np.clip(x, 0, 1)
    y = np.where(x < 0.018, 4.5 * x, 1.099 * np.power(np.maximum(x, 1e-6), 0.45) - 0.099)
    return y + 0.05 * np.sin(np.pi * y) ** 2


def power_from_an_offset(x: np.ndarray) -> np.ndarray:
    """A steep but finite slope at black."""

    def raised(v: np.ndarray | float) -> np.ndarray | float:
        return np.power(v, 1 / 2.4)

    black = raised(0.015)
    return (raised(np.clip(x, 0, 1) + 0.015) - black) / (raised(1.015) - black)


def half_logarithmic(x: np.ndarray) -> np.ndarray:
    x = np.clip(x, 0, 1)
    return 0.5 * np.log1p(60 * x) / np.log1p(60.0) + 0.5 * srgb_encode(x)


def srgb_with_contrast(x: np.ndarray) -> np.ndarray:
    y = srgb_encode(np.clip(x, 0, 1))
    return y - 0.04 * np.sin(2 * np.pi * y)


def hybrid_log(x: np.ndarray) -> np.ndarray:
    """A square root up to a twelfth of white, a logarithm above."""
    x = np.clip(x, 0, 1)
    above = 0.17883277 * np.log(np.maximum(12 * x - 0.28466892, 1e-6)) + 0.55991073
    return np.where(x <= 1 / 12, np.sqrt(3 * x) * (1 - 0.25 * np.exp(-150 * x)), above)


def compressed_then_srgb(x: np.ndarray) -> np.ndarray:
    """Light over one plus light, in part, before the display's curve."""
    x = np.clip(x, 0, 1)
    return srgb_encode(x * 1.35 / (1 + 0.35 * x))


def toe_and_power(x: np.ndarray) -> np.ndarray:
    y = np.power(np.clip(x, 1e-6, 1), 1 / 2.0)
    return y * (1 - 0.2 * np.exp(-12 * y)) / (1 - 0.2 * np.exp(-12.0))


def saturating(x: np.ndarray) -> np.ndarray:
    """As film does: an exponential approach to white, encoded by a power."""
    return np.power(-np.expm1(-1.6 * np.clip(x, 0, 1)) / -np.expm1(-1.6), 1 / 2.1)


def broadcast_with_lifted_shadows(x: np.ndarray) -> np.ndarray:
    x = np.clip(x, 0, 1)
    y = np.where(x < 0.018, 4.5 * x, 1.099 * np.power(np.maximum(x, 1e-6), 0.45) - 0.099)
    return y + 0.1 * y * (1 - y) ** 2


def ratio_of_powers(x: np.ndarray) -> np.ndarray:
    """A power over itself plus a constant, as photographic receptors respond."""
    x = np.clip(x, 0, 1)
    return 1.45 * x**0.62 / (x**0.62 + 0.45)


def white_point_then_broadcast(x: np.ndarray) -> np.ndarray:
    """Light compressed so that four times white would be white, then the broadcast curve."""
    x = np.clip(x, 0, 1)
    y = x * (1 + x / 16) / (1 + x) * 32 / 17
    return np.where(y < 0.018, 4.5 * y, 1.099 * np.power(np.maximum(y, 1e-6), 0.45) - 0.099)


def arc_tangent(x: np.ndarray) -> np.ndarray:
    return srgb_encode(np.arctan(1.3 * np.clip(x, 0, 1)) / np.arctan(1.3))


def hyperbolic_sine(x: np.ndarray) -> np.ndarray:
    """Its inverse, as astronomers compress light: a line near black, a logarithm above."""
    return np.arcsinh(25 * np.clip(x, 0, 1)) / np.arcsinh(25.0)


def half_displaced_root(x: np.ndarray) -> np.ndarray:
    """Half the display's curve, half a square root that is moved to be steep but finite at black."""
    x = np.clip(x, 0, 1)
    return 0.5 * srgb_encode(x) + 0.5 * (np.sqrt(1 + 24 * x) - 1) / 4


def hyperbolic_tangent(x: np.ndarray) -> np.ndarray:
    return srgb_encode(np.tanh(1.4 * np.clip(x, 0, 1)) / np.tanh(1.4))


def two_powers(x: np.ndarray) -> np.ndarray:
    x = np.clip(x, 1e-6, 1)
    return 0.6 * x ** (1 / 2.6) + 0.4 * x ** (1 / 1.6)


def quarter_sine(x: np.ndarray) -> np.ndarray:
    """Light bent by a quarter of a sine in part, flat at white, before the display's curve."""
    x = np.clip(x, 0, 1)
    return srgb_encode(0.5 * x + 0.5 * np.sin(np.pi / 2 * x))


def extended_reinhard(x: np.ndarray) -> np.ndarray:
    """Reinhard's ratio with its white at 1, of light lifted by a half, before the display's curve."""
    x = np.clip(x, 0, 1)
    return srgb_encode(1.5 * x * (1 + x / 2) / (1 + 1.5 * x) / 0.9)


def steep_in_the_middle(x: np.ndarray) -> np.ndarray:
    """An arc tangent of the encoded values, steep in the middle of the tones."""
    y = srgb_encode(np.clip(x, 0, 1)) - 0.45

    def bent(v: np.ndarray | float) -> np.ndarray | float:
        return np.arctan(1.4 * v)

    return np.asarray((bent(y) - bent(-0.45)) / (bent(0.55) - bent(-0.45)))


def lightness(x: np.ndarray) -> np.ndarray:
    """CIE 1976 lightness: a line up to 0.9 % of white, a cube root above."""
    x = np.clip(x, 0, 1)
    return np.where(x > 216 / 24389, 1.16 * np.cbrt(x) - 0.16, 24389 / 27 * x / 100)


def _from_black_to_white(share: Callable[[np.ndarray | float], np.ndarray], x: np.ndarray) -> np.ndarray:
    """A share of the light that is 0 at black and 1 at white."""
    return (share(np.clip(x, 0, 1)) - share(0.0)) / (share(1.0) - share(0.0))


def film_density(x: np.ndarray) -> np.ndarray:
    """A normal distribution's share of the logarithm of light, as film darkens: toe, middle, shoulder."""

    def share(v: np.ndarray | float) -> np.ndarray:
        return np.asarray(ndtr((np.log2(v + 0.03) + 2.2) / 1.9))

    return _from_black_to_white(share, x)


def beta_share(x: np.ndarray) -> np.ndarray:
    """A beta distribution's share of the light, a little of it added to the dark."""

    def share(v: np.ndarray | float) -> np.ndarray:
        return np.asarray(betainc(0.55, 1.25, (v + 0.006) / 1.006))

    return _from_black_to_white(share, x)


def error_of_root(x: np.ndarray) -> np.ndarray:
    """The error function of a root that is displaced: steep in the dark, a shoulder above."""

    def share(v: np.ndarray | float) -> np.ndarray:
        return np.asarray(erf(1.15 * (v + 0.008) ** 0.55))

    return _from_black_to_white(share, x)
