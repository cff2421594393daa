"""Every stage of the package. Importing this fills `STAGES`, the registry by name."""

from jaxisp.pipeline import REGISTRY
from jaxisp.stages import (
    auto,
    balance,
    balanced_noise,
    choice,
    defects,
    demosaic,
    denoise,
    detail,
    jpeg,
    jpeg_file,
    look,
    noise,
    optics,
    power,
    resampling,
    rounding,
    sensor,
    smoothing,
    spaces,
    tone,
    transfer,
)

STAGES = REGISTRY
"""Stage functions by name; `jaxisp.pipeline.register` adds to it."""

__all__ = [
    "STAGES",
    "auto",
    "balance",
    "balanced_noise",
    "choice",
    "defects",
    "demosaic",
    "denoise",
    "detail",
    "jpeg",
    "jpeg_file",
    "look",
    "noise",
    "optics",
    "power",
    "resampling",
    "rounding",
    "sensor",
    "smoothing",
    "spaces",
    "tone",
    "transfer",
]
