"""`jaxisp train`: a denoiser, on pairs degraded on the fly."""

import os
import signal
from argparse import ArgumentTypeError, Namespace
from typing import Any

from jaxisp.cli.common import add_command, positive, print_json, progress, report_failures, say
from jaxisp.cli.devices import add_devices, join, use_cores
from jaxisp.errors import InputError
from jaxisp.process import signals

_OPTIONS: tuple[tuple[str, Any, str], ...] = (
    ("--steps", positive, "updates (default 5000)"),
    ("--batch", positive, "patches in a step (default 32)"),
    ("--patch", positive, "side of a patch in px (default 80)"),
    ("--downsample", positive, "factor by which photographs are first made smaller (default 4)"),
    ("--per-image", positive, "patches of a photograph in an epoch (default 5)"),
    ("--held-out", int, "photographs for validation (default one in ten)"),
    ("--validation", positive, "validation patches (default 64)"),
    ("--lr", float, "learning rate (default 1e-3)"),
    ("--schedule", str, "cosine (default), staircase (the paper's) or constant"),
    ("--warmup", int, "steps of linear warm-up (default 100)"),
    ("--optimizer", str, "adam (default) or amsgrad"),
    ("--weight-decay", float, "default 0"),
    ("--clip-norm", float, "largest norm of the gradient, 0 for no limit (default 1)"),
    ("--ema", float, "decay of the averaged weights, 0 for none (default 0.999)"),
    ("--loss", str, "l1 (default), charbonnier, smooth_l1, l2 or log_rms"),
    ("--light", str, "input of the network: encoded (default) or linear"),
    ("--target", str, "what it gives: photo (default), or camera, what that would show without noise"),
    ("--drawn", int, "drawn pictures beside the photographs (default 0)"),
    ("--pool", int, "patches that are degraded once and used in each epoch (default 0: none)"),
    ("--start", str, "weights that training and its average begin with: a file that save_network wrote"),
    ("--log-every", positive, "steps between lines of the log (default 20)"),
    ("--checkpoint-every", positive, "steps between checkpoints with validation (default 500)"),
    ("--keep", positive, "checkpoints kept besides the best (default 2)"),
)
_SETTINGS = (
    "model", "seed", "fresh_crops", "bf16", "phases", *(flag[2:].replace("-", "_") for flag, _, _ in _OPTIONS)
)  # fmt: skip


def add_commands(commands: Any) -> None:
    command = add_command(commands, "train", run, "train a denoiser on pairs degraded on the fly", draws=True)
    command.set_defaults(seed=None)
    command.add_argument(
        "--clean", nargs="+", metavar="DIR", help="folders of clean photographs, searched recursively"
    )
    command.add_argument(
        "--recipe",
        metavar="RECIPE",
        help="a name (jaxisp recipes), a TOML file, or shares, as phone=0.8,clean=0.2",
    )
    command.add_argument(
        "--one-phase", dest="phases", action="store_false", default=None,
        help="a named recipe's mosaic begins at one photosite (default: at any, drawn for each patch)",
    )  # fmt: skip
    command.add_argument(
        "--model", metavar="NAME",
        help="unet (default), levelnet, weighnet, fast, dncnn6, dncnn17, ffdnet, nafnet, n3net[-stripped]",
    )  # fmt: skip
    command.add_argument("-o", "--out", required=True, metavar="RUN", help="folder of the run")
    command.add_argument("--resume", action="store_true", help="continue from the last checkpoint of the run")
    command.add_argument(
        "--stop-status", type=_stop_status, metavar="N",
        help="exit status if a signal stops the run early (default 130 or 143), for schedulers",
    )  # fmt: skip
    command.add_argument(
        "--grace", type=float, metavar="SECONDS",
        help="time that a signal leaves for the step and a checkpoint (default 1.2; 60 with --coordinator)",
    )  # fmt: skip
    for flag, kind, text in _OPTIONS:
        command.add_argument(flag, type=kind, help=text)
    command.add_argument(
        "--fixed-crops", dest="fresh_crops", action="store_false", default=None,
        help="the same crops each epoch, as in the paper",
    )  # fmt: skip
    command.add_argument("--bf16", action="store_true", default=None, help="compute in bfloat16")
    add_devices(command, "split it into N devices for the batches (default: one per core, at most 8)")


def _stop_status(text: str) -> int:
    value = int(text)
    if not 1 <= value <= 255:
        raise ArgumentTypeError(f"{text} is not from 1 to 255: 0 means that it is finished")
    return value


def run(arguments: Namespace) -> int:
    grace = arguments.grace if arguments.grace is not None else 60 if arguments.coordinator else signals.GRACE
    signals.allow(grace, arguments.stop_status)
    use_cores(arguments.cpu_devices)
    import dataclasses

    from jaxisp.recipes import find_degradation
    from jaxisp.train import TrainConfig, train
    from jaxisp.train.folder import CONFIG, load_settings

    join(arguments)
    given = {n: getattr(arguments, n) for n in _SETTINGS if getattr(arguments, n) is not None}
    if arguments.clean:
        given["clean"] = tuple(arguments.clean)
    if arguments.recipe:
        given["recipe"] = arguments.recipe
    if arguments.resume and os.path.exists(os.path.join(arguments.out, CONFIG)):
        before, recipe = load_settings(arguments.out)
        config = dataclasses.replace(before, **given)
        if arguments.recipe:
            recipe = find_degradation(arguments.recipe, phases=config.phases)
    else:
        for name in ("clean", "recipe"):
            if name not in given:
                raise InputError(f"train needs --{name}, or --resume with a run in {arguments.out}")
        config = TrainConfig(**given)
        recipe = find_degradation(config.recipe, phases=config.phases)
    with progress("training") as tick:
        result = train(config, arguments.out, recipe=recipe, resume=arguments.resume, tick=tick)
    if arguments.json:
        print_json(result.as_dict())
    else:
        _print(result)
    report_failures(result.skipped)  # a warning each: the run is whole without them
    if result.finished:
        return 0
    signals.tell()
    return signals.status_of(signals.came() or signal.SIGINT)


def _print(result: Any) -> None:
    state = "done" if result.finished else "stopped; continue with --resume"
    rate = f"{result.images_per_second:.0f} images/s on " if result.images_per_second else ""
    say(f"{result.run}: {result.step} steps in {result.seconds:.0f} s ({rate}{result.devices}), {state}")
    if result.validation:
        found = result.validation
        say(f"validation: {found['psnr_in']:.2f} dB in, {found['psnr']:.2f} dB out")
