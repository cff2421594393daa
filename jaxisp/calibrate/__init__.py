"""The noise of a sensor from flat and dark frames: photon transfer, as EMVA Standard 1288 defines it."""

from jaxisp.calibrate.measure import calibrate
from jaxisp.calibrate.noise import FIGURES, Calibrated, Figure, Noise, with_noise

__all__ = ["FIGURES", "Calibrated", "Figure", "Noise", "calibrate", "with_noise"]
__dir__ = __all__.copy  # what an editor completes
