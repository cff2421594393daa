"""Data for training: clean patches, degraded batches, shards, sources for grain, public data sets."""

from jaxisp.data.catalogue import SETS, PublicSet, fetch
from jaxisp.data.clean import CleanImages, downsample_linear, load_clean
from jaxisp.data.loader import Batches, batches
from jaxisp.data.shard_source import ShardSource
from jaxisp.data.shards import degrade_shards
from jaxisp.data.sources import CleanPatches, DegradedBatches, degrade_key, patches

__all__ = [
    "SETS",
    "Batches",
    "CleanImages",
    "CleanPatches",
    "DegradedBatches",
    "PublicSet",
    "ShardSource",
    "batches",
    "degrade_key",
    "degrade_shards",
    "downsample_linear",
    "fetch",
    "load_clean",
    "patches",
]
__dir__ = __all__.copy  # what an editor completes
