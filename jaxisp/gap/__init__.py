"""The sim-to-real gap: where it lies, which unmodelled effect causes it, and how far it shrinks."""

from jaxisp.gap.diagnose import Diagnosis, diagnose, diagnose_folder
from jaxisp.gap.downstream.options import Downstream
from jaxisp.gap.simulator.effects import EFFECTS, Effect, Move, register_effect

__all__ = [
    "EFFECTS",
    "Diagnosis",
    "Downstream",
    "Effect",
    "Move",
    "diagnose",
    "diagnose_folder",
    "register_effect",
]
__dir__ = __all__.copy  # what an editor completes
