"""`jaxisp adapt`: a recipe, and a network, for the camera of a folder of noisy pictures, or of pairs."""

import contextlib
import os
import signal
from argparse import Namespace
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

from jaxisp.cli.common import add_command, positive, print_json, print_table, progress, report_failures, say
from jaxisp.cli.devices import use_cores
from jaxisp.errors import InputError
from jaxisp.process import signals

STRANGE = 0.2
"""Share of crops beyond which it is said."""
STEPS, DRAWS, PER_IMAGE = 2000, 2048, 8


class _Adapted(NamedTuple):
    """The recipe; what is found, for JSON; what prints it; (file, reason) of what was not used."""

    recipe: Any
    table: dict[str, Any]
    lines: Callable[[], None]
    skipped: Sequence[tuple[str, str]]


def add_commands(commands: Any) -> None:
    command = add_command(
        commands, "adapt", run, "narrow a recipe, and a denoiser, to the camera of noisy pictures"
    )
    command.add_argument(
        "noisy", nargs="+", metavar="NOISY",
        help="pictures of one camera at one setting, or folders of them; or a folder of clean+noisy pairs",
    )  # fmt: skip
    command.add_argument("-o", "--out", required=True, metavar="RECIPE.toml", help="the narrowed recipe")
    command.add_argument(
        "--recipe", metavar="RECIPE",
        help="what is narrowed: a name (jaxisp recipes) or a TOML file (default any-camera); of pairs: the "
        "simulator that is diagnosed (default: a plain camera)",
    )  # fmt: skip
    command.add_argument(
        "--clean", nargs="+", metavar="DIR",
        help="folders of clean photographs (default: the noisy ones, made smaller, and drawn pictures)",
    )  # fmt: skip
    command.add_argument(
        "--downsample", type=positive, default=3, metavar="N",
        help="factor by which clean photographs are first made smaller (default 3)",
    )  # fmt: skip
    command.add_argument(
        "--draws", type=positive, metavar="N", help="cameras that are drawn (default 2048); not of pairs"
    )
    command.add_argument(
        "--per-image", type=positive, metavar="N", help="crops of a picture (default 8); not of pairs"
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
    from jaxisp.data.procedural import DRAWN
    from jaxisp.io.files import filled_file, filled_folder, find_images
    from jaxisp.recipes import recipe_files
    from jaxisp.train.finetune import beginning, clean_from, fine_tune
    from jaxisp.train.folder import CONFIG, RECIPE

    pictures = find_images([*arguments.noisy, *(arguments.clean or [])], recursive=True)
    find = _from_pairs if _are_pairs(arguments) else _from_pictures
    with contextlib.ExitStack() as stack:
        if arguments.folder:  # what cannot be trained is told before minutes of adapting
            stack.enter_context(filled_folder(arguments.folder))
            stack.enter_context(beginning(arguments.start))
        elif arguments.start or arguments.steps:
            raise InputError("--start and --steps say how a network is trained: give --run RUN too")
        own = [*recipe_files(arguments.recipe), *([arguments.start] if arguments.start else [])]
        if arguments.folder:  # that of the run is another file
            own += [os.path.join(arguments.folder, name) for name in (CONFIG, RECIPE)]
        stack.enter_context(filled_file(arguments.out, [*pictures, *own]))
        tick = stack.enter_context(progress("adapting"))
        recipe, table, lines, skipped = find(arguments, tick)
        recipe.save(arguments.out)
    result = None
    if arguments.folder:
        with progress("training") as tick:
            clean, drawn, factor = arguments.clean, 0, arguments.downsample
            if not clean:
                folder = os.path.join(arguments.folder, "clean")
                clean = clean_from(
                    arguments.noisy, folder, start=arguments.start, downsample=factor, tick=tick
                )
                drawn, factor = DRAWN, 1
            result = fine_tune(
                arguments.out, clean, arguments.folder, start=arguments.start, downsample=factor, drawn=drawn,
                steps=arguments.steps or STEPS, seed=arguments.seed, tick=tick,
            )  # fmt: skip
    if arguments.json:
        told = [{"file": name, "reason": reason} for name, reason in skipped]
        run = result.as_dict() if result else None
        print_json({"recipe": arguments.out, **table, "skipped": told, "run": run})
    else:
        lines()
        if result:
            state = "done" if result.finished else "stopped; the same command goes on with it"
            say(f"{result.run}: {result.step} steps, {state}; jaxisp denoise --run {result.run} ...")
            say("compare it with the package's own network (without --run) before you rely on it")
    report_failures(skipped)  # a warning each: the rest was used
    if result is None or result.finished:
        return 0
    signals.tell()
    return signals.status_of(signals.came() or signal.SIGINT)


def _are_pairs(arguments: Namespace) -> bool:
    """Whether what is given is one folder of clean+noisy pairs."""
    from jaxisp.io.datasets import CLEAN_NOISY, open_dataset

    if len(arguments.noisy) > 1 or not os.path.isdir(arguments.noisy[0]):
        return False
    names = os.listdir(arguments.noisy[0])
    if not any(os.path.splitext(name)[0].lower().endswith(".clean") for name in names):
        return False  # pictures alone, which need not be a data set
    return open_dataset(arguments.noisy[0]).kind == CLEAN_NOISY


def _from_pictures(arguments: Namespace, tick: Any) -> _Adapted:
    from jaxisp.adapt import adapt

    found = adapt(
        arguments.noisy, arguments.recipe or "any-camera", clean=arguments.clean,
        downsample=arguments.downsample, draws=arguments.draws or DRAWS,
        per_image=arguments.per_image or PER_IMAGE, seed=arguments.seed, tick=tick,
    )  # fmt: skip
    priors = [
        {"name": one.name, "before": repr(one.before), "after": repr(one.after), "told": one.told}
        for one in found.priors
    ]
    table = {"crops": found.crops, "effects": found.effects, "strange": found.strange, "priors": priors}
    return _Adapted(found.recipe, table, lambda: _print(arguments, found), found.skipped)


def _from_pairs(arguments: Namespace, tick: Any) -> _Adapted:
    from jaxisp.gap import diagnose
    from jaxisp.gap.report.page import plain

    if arguments.draws or arguments.per_image:
        raise InputError(
            "--draws and --per-image say how pictures without clean ones are compared; "
            f"{arguments.noisy[0]} holds clean+noisy pairs, which are diagnosed"
        )
    found = diagnose(
        arguments.noisy[0], recipe=arguments.recipe, seed=arguments.seed, tick=tick,
    )  # fmt: skip
    report = found.report
    table = {name: report[name] for name in ("verdict", "gap", "causes")}
    failed = [(one["file"], one["reason"]) for one in report["pairs"]["failed"]]
    assert found.simulator is not None, "clean+noisy pairs without a reference have one"
    return _Adapted(found.simulator, plain(table), lambda: say(f"{arguments.out}: {found!r}"), failed)


def _print(arguments: Namespace, found: Any) -> None:
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
