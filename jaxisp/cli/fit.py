"""`jaxisp fit`: a camera from RAW+JPEG pairs."""

from argparse import Namespace
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any

from jaxisp.cli.common import (
    add_command,
    names,
    positive,
    print_json,
    print_table,
    progress,
    report_failures,
    say,
    warn,
)
from jaxisp.cli.devices import add_devices, join, use_cores
from jaxisp.errors import InputError


def add_commands(commands: Any) -> None:
    command = add_command(commands, "fit", run, "fit a camera to RAW+JPEG pairs")
    command.epilog = (
        "files of DATASET belong together by their names: NAME.dng (or another RAW, or NAME.raw.npy) beside "
        "NAME.jpg (or NAME.png); a RAW that embeds its full-size JPEG may stand alone. dataset.toml, if any, "
        "states what the files do not: camera, iso, [raw] of NAME.raw.npy"
    )
    command.add_argument("dataset", metavar="DATASET", help="a folder of RAW+JPEG pairs")
    command.add_argument(
        "-o", "--out", required=True, metavar="CAMERA.toml",
        help="the camera to write, for develop, recipe and diagnose; what a fit that is stopped has done is "
        "kept beside it, in CAMERA.toml.partial, and the same command goes on from there",
    )  # fmt: skip
    command.add_argument(
        "--report",
        metavar="DIR",
        help="write DIR/report.html, with pictures before and after, and DIR/report.json",
    )
    command.add_argument(
        "--steps", type=positive, default=30, help="most Gauss-Newton steps in each phase (default 30)"
    )
    command.add_argument(
        "--demosaic", default="auto", metavar="STAGE", help="demosaicking stage (default auto: the best fit)"
    )
    command.add_argument(
        "--median", default="auto", metavar="SIZE", help="none, cross, 3x3, 5x5 or auto (default auto)"
    )
    command.add_argument(
        "--starts", type=positive, default=1, help="starting points; the best fit is kept (default 1)"
    )
    command.add_argument(
        "--hold-out",
        choices=("tiles", "scenes"),
        default="tiles",
        help="report tiles of the pairs, or also whole pairs (halves of the only one), which "
        "takes further fits (default tiles)",
    )
    command.add_argument(
        "--per-image",
        type=names,
        default=[],
        metavar="NAMES",
        help="comma-separated parameters to fit for each image: stages, stage.field, tone, colour",
    )
    command.add_argument(
        "--start", metavar="CAMERA.toml", help="go on from a camera that an earlier fit wrote"
    )
    for name, what in (
        ("freeze", "stay where they start"),
        ("free", "are fitted though they are frozen by default (exposure, unsharp_mask.threshold, ...)"),
    ):
        command.add_argument(
            f"--{name}", type=names, default=[], metavar="NAMES", help=f"parameters that {what}"
        )
    command.add_argument(
        "--insert",
        type=names,
        default=[],
        metavar="STAGES",
        help="stages to fit beside the others: STAGE, after the tone curve, or STAGE@NAME, after another",
    )
    command.add_argument(
        "--recipe", metavar="OUT.toml", help="also write a recipe of this camera for `jaxisp degrade`"
    )
    command.add_argument(
        "--noise",
        metavar="NOISE.toml",
        help="the sensor's noise from jaxisp calibrate (default: from the RAWs)",
    )
    add_devices(command, "split it into N devices for the tiles (default: one device, a thread per core)")


def run(arguments: Namespace) -> int:
    if arguments.cpu_devices:
        use_cores(arguments.cpu_devices)
    import jax

    from jaxisp.fit.journal import beside, in_the_way

    join(arguments)
    journal = beside(arguments.out)
    if blocked := in_the_way(journal):
        warn(f"{blocked}")
    with _places(arguments):
        result = _fitted(arguments)
        if jax.process_index():  # the first writes for all
            return report_failures(result.failed)
        result.camera.save(arguments.out)
        if arguments.recipe:
            _recipe(result.camera, arguments).save(arguments.recipe)
        if arguments.report:
            from jaxisp.fit.report import write_report  # draws: slow to import

            write_report(result, arguments.report)
    if not blocked:
        journal.unlink(missing_ok=True)
    for pair in result.pairs:
        for note in pair.notes:
            warn(f"{pair.name}: {note}")
    if arguments.json:
        print_json({"camera": arguments.out, **result.as_dict()})
    else:
        _print(result, arguments.out)
    return report_failures(result.failed)


def _recipe(camera: Any, arguments: Namespace) -> Any:
    """Of the camera; with calibrated noise, all of it at the ISO number of the pairs, where that is one."""
    from jaxisp.calibrate import Calibrated, with_noise
    from jaxisp.fit import prior_from_cameras

    recipe = prior_from_cameras([camera])
    if arguments.noise is None:
        return recipe
    known = Calibrated.load(arguments.noise)
    return with_noise(recipe, known.at()) if len(known.noise) == 1 else recipe


@contextmanager
def _places(arguments: Namespace) -> Iterator[None]:
    """Where results go is tried first: a fault there should not cost a fit."""
    import jax

    from jaxisp.io import filled_folder, output_file
    from jaxisp.io.files import filled_file
    from jaxisp.io.locks import locked

    with ExitStack() as stack:
        inputs = _inputs(arguments)
        stack.enter_context(filled_file(arguments.out, inputs))
        if arguments.recipe:
            stack.enter_context(filled_file(arguments.recipe, [*inputs, arguments.out]))
        if arguments.report:
            report = stack.enter_context(filled_folder(arguments.report))
            if jax.process_index() == 0:
                stack.enter_context(locked(report, name=".report.lock", doing="fitting"))
            output_file(report / "report.html")
        yield


def _inputs(arguments: Namespace) -> list[Path]:
    """The files that are read, which no result may replace."""
    from jaxisp.io import open_dataset

    inputs = [Path(arguments.dataset, "dataset.toml")]
    inputs += [Path(given) for given in (arguments.start, arguments.noise) if given]
    try:
        pairs = open_dataset(arguments.dataset, kind="raw+jpeg").pairs
    except InputError:  # told where it is fitted
        return inputs
    return inputs + [path for pair in pairs for path in (pair.raw, pair.output) if path]


def _fitted(arguments: Namespace) -> Any:
    from jaxisp.fit import fit_dataset
    from jaxisp.fit.journal import beside

    with progress("fitting") as tick:
        return fit_dataset(
            arguments.dataset,
            steps=arguments.steps,
            demosaic=arguments.demosaic,
            median=arguments.median,
            starts=arguments.starts,
            hold_out=arguments.hold_out,
            per_image=arguments.per_image,
            start=arguments.start,
            freeze=arguments.freeze,
            free=arguments.free,
            insert=arguments.insert,
            noise=arguments.noise,
            journal=beside(arguments.out),
            mesh=_mesh(bool(arguments.cpu_devices)),
            tick=tick,
        )


def _mesh(wanted: bool) -> Any:
    """All devices, where they are several; the parts of one CPU only where they are wanted."""
    import jax
    import numpy as np
    from jax.sharding import Mesh

    devices = jax.devices()
    several = jax.process_count() > 1 or jax.default_backend() != "cpu" or wanted
    return Mesh(np.asarray(devices), ("tiles",)) if several and len(devices) > 1 else None


def _print(result: Any, out: str) -> None:
    if result.scenes:
        own = zip(result.scenes.names, result.scenes.psnr, result.scenes.ssim)
        print_table(("scene held out", "PSNR", "SSIM"), [(n, f"{p:.2f}", f"{s:.4f}") for n, p, s in own])
        say(f"{result.scenes.how}")
    rows = [
        (p.name, f"{p.psnr:.2f}", f"{p.ssim:.4f}", f"{p.held_out_psnr:.2f}", f"{p.held_out_ssim:.4f}",
         f"{p.shift[0]:+.2f} {p.shift[1]:+.2f}")
        for p in result.pairs
    ]  # fmt: skip
    print_table(("pair", "PSNR fitted", "SSIM", "PSNR held out", "SSIM", "shift [px]"), rows)
    say(f"{out} in {result.seconds:.0f} s: {result.design}; held out: {result.how}")
    if result.unidentified:
        say(f"not identified by these pairs: {', '.join(result.unidentified)}")
    if result.at_bound:
        say(f"at a bound: {', '.join(result.at_bound)}")
