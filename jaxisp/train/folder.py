"""The folder of a run: what it was told, and its model card."""

import dataclasses
import hashlib
import html
import json
import os
import stat
from pathlib import Path
from typing import Any

from jaxisp import __version__
from jaxisp.errors import InputError, printable, printable_lines
from jaxisp.io.digests import check_seal, sealed_toml
from jaxisp.io.files import check_new, files_below, reason, write_text
from jaxisp.mixture import Degradation
from jaxisp.recipes import load_degradation
from jaxisp.train.config import TrainConfig

_LIGHTS = {"encoded": "display-encoded sRGB", "linear": "linear light"}
CONFIG, RECIPE, CARD, POOL = "config.toml", "recipe.toml", "MODEL_CARD.md", "pool"
_WRITTEN = (CARD, "log.csv", "validation.csv", "checkpoints", "tensorboard", POOL)


def check_folder(run: Path, config: TrainConfig, recipe: Degradation, *, resume: bool) -> None:
    """Raise InputError where the folder holds a run and this is not to resume it, or is told something else
    (more steps are allowed); or where it holds no run, but files that a run would replace."""
    if os.path.lexists(run / CONFIG):
        if not resume:
            raise InputError(f"{run}: holds a run already; resume it, or choose another folder")
        _check_same(run, config, recipe)
        return
    for path in (run / name for name in _WRITTEN):
        for file in files_below(path):
            raise InputError(f"{file}: stands there already and would be replaced; choose another folder")
    check_new(run / RECIPE, _text(recipe))  # a run that was killed at its start leaves it


def begin(run: Path, config: TrainConfig, recipe: Degradation) -> None:
    """Write what a run is told."""
    write_text(run / RECIPE, _text(recipe))
    config.save(run / CONFIG)  # the last: where it stands, the run can be resumed


def settings_digest(config: TrainConfig, recipe: Degradation) -> str:
    """The digest of all that a run is told but its number of steps, which may grow."""
    settings = {name: value for name, value in dataclasses.asdict(config).items() if name != "steps"}
    return hashlib.sha256(f"{json.dumps(settings, sort_keys=True)}\n{recipe.to_toml()}".encode()).hexdigest()


def _text(recipe: Degradation) -> str:
    return sealed_toml(recipe.to_toml())


def _check_same(run: Path, config: TrainConfig, recipe: Degradation) -> None:
    told, drawn = load_settings(run)
    before, now = dataclasses.asdict(told), dataclasses.asdict(config)
    for field, value in before.items():
        if value != now[field] and field != "steps":
            raise InputError(f"{run}: was begun with {field} = {value!r}, cannot go on with {now[field]!r}")
    if drawn != recipe:
        raise InputError(f"{run}: was begun with another recipe of the name {recipe.name!r}")


def load_settings(run: str | Path) -> tuple[TrainConfig, Degradation]:
    """What a run was told. Raises InputError where the folder holds none, or it is not what was written."""
    run = Path(run)
    try:
        found = stat.S_ISREG(os.stat(run / CONFIG).st_mode)
    except PermissionError as error:
        raise InputError(f"{run}: cannot be read: {reason(error)}") from error
    except OSError:
        found = False
    if not found:
        raise InputError(f"{run}: holds no run, expected a folder that jaxisp train wrote")
    for name in (CONFIG, RECIPE):
        check_seal(run / name)
    return TrainConfig.load(run / CONFIG), load_degradation(run / RECIPE)


def write_card(
    run: Path, config: TrainConfig, recipe: Degradation, result: dict[str, Any], data: str
) -> None:
    """MODEL_CARD.md: what the network is, what it was trained on, how well it does, what it is not for."""
    best = result["best"]
    figures = f"{best['psnr']:.2f} dB at step {best['step']}, " if best else "none yet, "
    figures += f"noisy input {_psnr_in(result)}"
    settings = "\n".join(f"| {name} | {_said(value)} |" for name, value in dataclasses.asdict(config).items())
    text = f"""# {config.model} trained on `{_said(recipe.name)}`

A denoiser for photographs, which it sees in {_LIGHTS[config.light]}.

- **Network**: {config.model}, {result["parameters"]} parameters, options
  {_said(config.model_options or "none")}.
- **Trained for**: {result["step"]} of {config.steps} steps of {config.batch} patches of {config.patch} px,
  seed {config.seed}{"" if result["finished"] else " (stopped before its end)"}.
- **Clean photographs**: {_said(data)}, {_size(config.downsample)}.
- **Degraded by**: `{_said(recipe.name)}`: {_said(recipe.description or "no description")}. Its text is in
  {RECIPE}.
- **Weights**: {f"averaged with a decay of {config.ema}" if config.ema else "those of the last step"};
  `checkpoints/best` has those of the best validation.
- **Validation**: {figures}, on {config.validation} simulated patches of photographs that
  were held out from training (fixed crops, parameters and noise).
- **Made with**: jaxisp {__version__}, {result["devices"]}.

Noise unlike what the recipe draws, other cameras and other processing are outside what it was trained
for. Figures on simulated patches do not carry over to real photographs: run `jaxisp evaluate`.

| setting | value |
| --- | --- |
{settings}

Recipe:

```toml
{recipe.to_toml()}```
"""
    write_text(run / CARD, printable_lines(text))


def _said(value: Any) -> str:
    """As it may stand in Markdown: names and descriptions are others' texts, not links or pictures."""
    return html.escape(printable(str(value)), quote=False).replace("[", "&#91;").replace("]", "&#93;")


def _size(factor: int) -> str:
    return f"made smaller by {factor} in linear light" if factor > 1 else "used at their own size"


def _psnr_in(result: dict[str, Any]) -> str:
    last = result["validation"]
    return f"{last['psnr_in']:.2f} dB" if last else "not measured"
