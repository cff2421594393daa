"""Clean patches and degraded batches: plain iterators, and sources for grain."""

from jaxisp.data.clean import CleanImages, downsample_linear, load_clean
from jaxisp.data.sources import CleanPatches, DegradedBatches, degrade_key, patches

__all__ = [
    "CleanImages",
    "CleanPatches",
    "DegradedBatches",
    "degrade_key",
    "downsample_linear",
    "load_clean",
    "patches",
]
