"""Recipes in the training code that people have: BSRGAN and Real-ESRGAN style trainers, PyTorch, Hugging
Face.

`jaxisp.interop.torch` needs torch, which nothing else here does.
"""

from jaxisp.interop.examples import DegradeExamples
from jaxisp.interop.isp_model import IspModel

__all__ = ["DegradeExamples", "IspModel"]
__dir__ = __all__.copy  # what an editor completes
