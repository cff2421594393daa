"""`jaxisp adapt`: a recipe, and a network, for the camera of a folder of noisy pictures."""

import contextlib
import signal
from argparse import Namespace
from typing import Any

from jaxisp.cli.common import add_command, positive, print_json, print_table, progress, report_failures, say
from jaxisp.cli.devices import use_cores
from jaxisp.errors import InputError
from jaxisp.process import signals

STRANGE = 0.2
"""Share of crops beyond which it is said."""
STEPS = 2000


def add_commands(commands: Any) -> None:
    command = add_command(
        commands, "adapt", run, "narrow a recipe, and a denoiser, to the camera of noisy pictures"
    )
    command.add_argument(
        "noisy", nargs="+", metavar="NOISY", help="pictures of one camera at one setting, or folders of them"
    )
    command.add_argument("-o", "--out", required=True, metavar="RECIPE.toml", help="the narrowed recipe")
    command.add_argument(
        "--recipe", default="any-camera", metavar="RECIPE",
        help="what is narrowed: a name (jaxisp recipes) or a TOML file (default any-camera)",
    )  # fmt: skip
    command.add_argument(
        "--clean", nargs="+", metavar="DIR",
        help="folders of clean photographs (default: the noisy ones, made smaller)",
    )  # fmt: skip
    command.add_argument(
        "--downsample", type=positive, default=3, metavar="N",
        help="factor by which clean photographs are first made smaller (default 3)",
    )  # fmt: skip
    command.add_argument("--draws", type=positive, default=2048, help="cameras that are drawn (default 2048)")
    command.add_argument(
        "--per-image", type=positive, default=8, metavar="N", help="crops of a picture (default 8)"
    )
    command.add_argument(
        "--run", dest="folder", metavar="RUN",
        help="also train a network on the recipe, for jaxisp denoise --run RUN; resumed where it was stopped",
    )  # fmt: skip
    command.add_argument(
        "--start", metavar="FILE",
        help="weights that it begins with (default: the network that comes with jaxisp)",
    )  # fmt: skip
    command.add_argument(
        "--steps", type=positive, metavar="N", help=f"updates of 16 patches of 64 px (default {STEPS})"
    )


def run(arguments: Namespace) -> int:
    use_cores()
    from jaxisp.adapt import adapt
    from jaxisp.io.files import filled_file, filled_folder, find_images
    from jaxisp.recipes import PHASES
    from jaxisp.train.finetune import beginning, fine_tune

    pictures = find_images([*arguments.noisy, *(arguments.clean or [])], recursive=True)
    with contextlib.ExitStack() as stack:
        if arguments.folder:  # what cannot be trained is told before minutes of adapting
            stack.enter_context(filled_folder(arguments.folder))
            stack.enter_context(beginning(arguments.start))
        elif arguments.start or arguments.steps:
            raise InputError("--start and --steps say how a network is trained: give --run RUN too")
        stack.enter_context(filled_file(arguments.out, [*pictures, arguments.recipe.removesuffix(PHASES)]))
        tick = stack.enter_context(progress("adapting"))
        found = adapt(
            arguments.noisy, arguments.recipe, clean=arguments.clean, downsample=arguments.downsample,
            draws=arguments.draws, per_image=arguments.per_image, seed=arguments.seed, tick=tick,
        )  # fmt: skip
        found.recipe.save(arguments.out)
    result = None
    if arguments.folder:
        with progress("training") as tick:
            result = fine_tune(
                arguments.out, arguments.clean or arguments.noisy, arguments.folder, start=arguments.start,
                downsample=arguments.downsample, steps=arguments.steps or STEPS, seed=arguments.seed,
                tick=tick,
            )  # fmt: skip
    if arguments.json:
        _as_json(arguments, found, result)
    else:
        _print(arguments, found, result)
    report_failures(found.skipped)  # a warning each: the rest was used
    if result is None or result.finished:
        return 0
    signals.tell()
    return signals.status_of(signals.came() or signal.SIGINT)


def _as_json(arguments: Namespace, found: Any, result: Any) -> None:
    priors = [
        {"name": one.name, "before": repr(one.before), "after": repr(one.after), "told": one.told}
        for one in found.priors
    ]
    skipped = [{"file": name, "reason": reason} for name, reason in found.skipped]
    print_json(
        {
            "recipe": arguments.out, "crops": found.crops, "effects": found.effects,
            "strange": found.strange, "priors": priors,
            "skipped": skipped, "run": result.as_dict() if result else None,
        }
    )  # fmt: skip


def _print(arguments: Namespace, found: Any, result: Any) -> None:
    from jaxisp.shown import value_text

    told = sorted(found.priors, key=lambda one: -one.told)
    print_table(
        ("parameter", "told", "before", "after"),
        [
            (one.name, f"{one.told:.2f}", value_text(one.before), value_text(one.after))
            for one in told
            if one.told > 0.1
        ],
    )
    for name, value in found.effects.items():
        say(f"{name}: {value:.2f}")
    say(f"{arguments.out}: by {found.crops} crops, {found.strange:.0%} of them unlike all that was drawn")
    if found.strange > STRANGE:
        say("the recipe lacks an effect of this camera: jaxisp diagnose says which")
    if result:
        state = "done" if result.finished else "stopped; the same command goes on with it"
        say(f"{result.run}: {result.step} steps, {state}; jaxisp denoise --run {result.run} ...")
