"""jaxisp: a differentiable camera pipeline (ISP) in JAX.

Importing the package costs nothing: JAX is loaded with the first name that is used.
"""

import importlib
import importlib.util
from typing import Any

__version__ = "0.1.0"

_HOME = {
    "AnyPhase": "jaxisp.phase",
    "Chain": "jaxisp.pipeline",
    "Gate": "jaxisp.pipeline",
    "Shuffle": "jaxisp.pipeline",
    "Unprocessed": "jaxisp.unprocess",
    "Stage": "jaxisp.pipeline",
    "register": "jaxisp.pipeline",
    "run": "jaxisp.pipeline",
    "run_batch": "jaxisp.pipeline",
    "run_in_strips": "jaxisp.pipeline",
    "stage": "jaxisp.pipeline",
    "STAGES": "jaxisp.stages",
    "Recipe": "jaxisp.recipe",
    "InputError": "jaxisp.errors",
    "keep_compiled": "jaxisp.process.cache",
    "compile_times": "jaxisp.process.programs",
    "forget_compiled": "jaxisp.process.memory",
    "keep_freed": "jaxisp.process.memory",
}
_MODULES = {
    "adapt", "calibrate", "camera", "data", "explore", "fit", "gap", "interop", "io", "losses", "metrics",
    "models", "params", "priors", "recipes", "samples", "stages", "train",
}  # fmt: skip

__all__ = [*sorted(_HOME), *sorted(_MODULES)]


def __getattr__(name: str) -> Any:
    if name in _HOME:
        return getattr(importlib.import_module(_HOME[name]), name)
    if name in _MODULES or (not name.startswith("_") and importlib.util.find_spec(f"jaxisp.{name}")):
        return importlib.import_module(f"jaxisp.{name}")
    raise AttributeError(f"module 'jaxisp' has no attribute {name!r}")


def __dir__() -> list[str]:
    return [*__all__, "__version__"]
