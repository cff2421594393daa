"""jaxisp: a differentiable camera pipeline (ISP) in JAX.

Importing the package costs nothing: JAX is loaded with the first name that is used.
"""

import importlib
from typing import Any

__version__ = "0.1.0"

_HOME = {
    "Chain": "jaxisp.strips",  # of jaxisp.pipeline; with it chains run large frames in strips
    "Gate": "jaxisp.pipeline",
    "Shuffle": "jaxisp.pipeline",
    "Stage": "jaxisp.pipeline",
    "register": "jaxisp.pipeline",
    "run": "jaxisp.pipeline",
    "run_batch": "jaxisp.pipeline",
    "stage": "jaxisp.pipeline",
    "STAGES": "jaxisp.stages",
    "Recipe": "jaxisp.recipe",
    "InputError": "jaxisp.errors",
}
_MODULES = {"fit", "io", "metrics", "params", "priors", "recipes", "samples", "stages"}

__all__ = [*sorted(_HOME), *sorted(_MODULES)]


def __getattr__(name: str) -> Any:
    if name in _HOME:
        return getattr(importlib.import_module(_HOME[name]), name)
    if name in _MODULES:
        return importlib.import_module(f"jaxisp.{name}")
    raise AttributeError(f"module 'jaxisp' has no attribute {name!r}")


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
