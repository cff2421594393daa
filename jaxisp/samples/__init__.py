"""The package's own sample data: scenes, and a reference phone that photographs them."""

from jaxisp.samples.phone import PHONES, Phone, shoot, write_clean_noisy, write_pairs
from jaxisp.samples.scenes import scene, scene_names, scenes

__all__ = ["PHONES", "Phone", "scene", "scene_names", "scenes", "shoot", "write_clean_noisy", "write_pairs"]
__dir__ = __all__.copy  # what an editor completes
