"""Train denoisers on pairs degraded on the fly, apply them, and measure them."""

from jaxisp.data.loader import degrader
from jaxisp.models.apply import Denoiser, denoise_files
from jaxisp.train.classical import Classical, noise_level
from jaxisp.train.config import TrainConfig
from jaxisp.train.denoiser import load_denoiser
from jaxisp.train.devices import make_mesh, replicate, spread
from jaxisp.train.evaluate import AlignedPair, align_dataset, evaluate_dataset, evaluate_pairs
from jaxisp.train.finetune import fine_tune
from jaxisp.train.optimizer import make_optimizer, schedule
from jaxisp.train.step import LOSSES, State, init_state, make_step, weights
from jaxisp.train.trainer import TrainResult, train

__all__ = [
    "LOSSES",
    "AlignedPair",
    "Classical",
    "Denoiser",
    "State",
    "TrainConfig",
    "TrainResult",
    "align_dataset",
    "degrader",
    "denoise_files",
    "evaluate_dataset",
    "evaluate_pairs",
    "fine_tune",
    "init_state",
    "load_denoiser",
    "make_mesh",
    "make_optimizer",
    "make_step",
    "noise_level",
    "replicate",
    "schedule",
    "spread",
    "train",
    "weights",
]
__dir__ = __all__.copy  # what an editor completes
