"""Everything that a training run is told, as one record that goes to TOML and back."""

import dataclasses
import typing
from pathlib import Path
from typing import Any, Literal

import tomli_w

from jaxisp.checks import several
from jaxisp.errors import InputError, short
from jaxisp.io.digests import sealed_toml
from jaxisp.io.files import read_toml, write_text

Light = Literal["encoded", "linear"]
_CHOICES = {
    "loss": ("l1", "charbonnier", "smooth_l1", "l2", "log_rms"),
    "schedule": ("cosine", "staircase", "constant"),
    "optimizer": ("adam", "amsgrad"),
    "light": ("encoded", "linear"),
    "target": ("photo", "camera"),
}


@dataclasses.dataclass(frozen=True, kw_only=True)
class TrainConfig:
    """A training run.

    Args:
        clean: folders of clean photographs, or one.
        recipe: the name of the recipe, or a mixture, as "phone=0.8,clean=0.2"; its text stands in the run's
            recipe.toml.
        phases: where a built-in recipe has a mosaic, it begins at any photosite of its pattern's cell, drawn
            for each patch; False: at the recipe's own. TOML files and given recipes are used as they are.
        model: one of `jaxisp.models.MODELS`.
        model_options: of its constructor.
        steps: updates.
        batch: patches in a step, over all devices.
        patch: their side [px].
        drawn: pictures that are drawn (`jaxisp.data.procedural`) and used beside the photographs.
        downsample: photographs are made smaller by this factor first.
        per_image: patches of a photograph in an epoch.
        fresh_crops: new crops each epoch; False: the same ones, as in the paper.
        held_out: photographs kept for validation; -1: one in ten, at least one.
        validation: validation patches, the same in each validation.
        lr: learning rate after warm-up.
        schedule: "cosine" to 0; "staircase", down each epoch, to 1e-5 of it, as in the paper; or "constant".
        warmup: steps of linear warm-up.
        optimizer: "adam" or "amsgrad".
        weight_decay: decoupled.
        clip_norm: gradients longer than this are shortened; 0: never.
        ema: decay of the averaged weights, which are those validated and used; 0: the weights themselves.
            Fresh weights are soon forgotten; those of `start` keep their share, ema**steps.
        loss: "l1", "charbonnier" (1e-3), "smooth_l1" (beta 1), "l2", or "log_rms": of each patch's PSNR, so
            that patches with little noise count as much as the others.
        light: what the network sees, "encoded" sRGB or "linear" light.
        target: what it is to give, the clean "photo", or what the "camera" would show of it without noise.
        pool: patches that are degraded once, before the first step, and used in each epoch from then on, each
            time flipped and turned otherwise; 0: each patch is degraded when it is used.
        start: a file of weights (`jaxisp.models.weights`) that training starts from; "": fresh ones.
        bf16: compute the network in bfloat16, weights in float32.
        seed: of everything that is drawn.
        log_every: steps between lines of the log.
        checkpoint_every: steps between checkpoints, each with a validation.
        keep: checkpoints kept besides the best.
    """

    clean: tuple[str, ...]
    recipe: str
    phases: bool = True
    model: str = "unet"
    model_options: dict[str, Any] = dataclasses.field(default_factory=dict)
    steps: int = 5000
    batch: int = 32
    patch: int = 80
    downsample: int = 4
    drawn: int = 0
    per_image: int = 5
    fresh_crops: bool = True
    held_out: int = -1
    validation: int = 64
    lr: float = 1e-3
    schedule: str = "cosine"
    warmup: int = 100
    optimizer: str = "adam"
    weight_decay: float = 0.0
    clip_norm: float = 1.0
    ema: float = 0.999
    loss: str = "l1"
    light: str = "encoded"
    target: str = "photo"
    pool: int = 0
    start: str = ""
    bf16: bool = False
    seed: int = 0
    log_every: int = 20
    checkpoint_every: int = 500
    keep: int = 2

    def __post_init__(self) -> None:
        object.__setattr__(self, "clean", tuple(map(str, several(self.clean))))
        if isinstance(self.recipe, Path):
            object.__setattr__(self, "recipe", str(self.recipe))
        if not isinstance(self.recipe, str):
            raise InputError(
                f"recipe = {short(self.recipe)}: expected a name or a TOML file; "
                "train(config, run, recipe=...) takes recipes and mixtures themselves"
            )
        for field, choices in _CHOICES.items():
            if getattr(self, field) not in choices:
                raise InputError(f"{field} = {getattr(self, field)!r}: expected one of {', '.join(choices)}")
        for field in ("steps", "batch", "patch", "downsample", "per_image", "validation", "log_every",
                      "checkpoint_every", "keep"):  # fmt: skip
            if getattr(self, field) < 1:
                raise InputError(f"{field} = {getattr(self, field)}: expected at least 1")
        # as TOML gives them back
        for own in dataclasses.fields(self):
            if own.type is float:
                object.__setattr__(self, own.name, float(getattr(self, own.name)))
        options = {k: list(v) if isinstance(v, tuple) else v for k, v in self.model_options.items()}
        object.__setattr__(self, "model_options", options)
        if not 0 < self.lr < 10:
            raise InputError(f"lr = {self.lr}: expected a learning rate above 0, as 1e-3")
        if not 0 <= self.ema < 1:
            raise InputError(f"ema = {self.ema}: expected a decay from 0 (no average) to below 1")
        for field in ("warmup", "weight_decay", "clip_norm", "seed", "pool", "drawn"):
            if getattr(self, field) < 0:
                raise InputError(f"{field} = {getattr(self, field)}: expected 0 or more")

    def save(self, path: str | Path) -> None:
        """Write the TOML file, whole or not at all."""
        write_text(path, sealed_toml(tomli_w.dumps(dataclasses.asdict(self))))

    @classmethod
    def load(cls, path: str | Path) -> "TrainConfig":
        """Read a TOML file. Raises InputError that names what is wrong."""
        table = read_toml(path)
        types = typing.get_type_hints(cls)
        unknown = sorted(set(table) - set(types))
        missing = sorted({"clean", "recipe"} - set(table))
        if unknown or missing:
            raise InputError(
                f"{path}: a training run has no {unknown[0]!r}"
                if unknown
                else f"{path}: says no {missing[0]}"
            )
        values = {name: _typed(f"{path}: {name}", types[name], value) for name, value in table.items()}
        try:
            return cls(**values)
        except InputError as error:
            raise InputError(f"{path}: {error}") from None


def _typed(what: str, kind: Any, value: Any) -> Any:
    if typing.get_origin(kind) is tuple:
        if not isinstance(value, list) or not all(isinstance(v, str) for v in value):
            raise InputError(f"{what} = {short(value)}: expected a list of folders")
        return tuple(value)
    wanted = dict if typing.get_origin(kind) is dict else kind
    if wanted is float and type(value) is int and abs(value) < 1 << 53:
        return float(value)
    if type(value) is not wanted:
        raise InputError(f"{what} = {short(value)}: expected {wanted.__name__}")
    return value
