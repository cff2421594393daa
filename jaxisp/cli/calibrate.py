"""`jaxisp calibrate`: the noise of a sensor from flat and dark frames."""

from argparse import Namespace
from contextlib import ExitStack
from pathlib import Path
from typing import Any

from jaxisp.cli.common import add_command, print_json, print_table, progress, report_failures, say, warn


def add_commands(commands: Any) -> None:
    command = add_command(commands, "calibrate", run, "measure a sensor's noise from flat and dark frames")
    command.add_argument(
        "flats",
        metavar="FLATS",
        help="a folder of RAW frames of an even light, two or more of each light and exposure",
    )
    command.add_argument(
        "darks", metavar="DARKS", help="a folder of RAW frames with the lens covered, two or more"
    )
    command.add_argument("-o", "--out", required=True, metavar="NOISE.toml", help="the noise by ISO number")
    command.add_argument("--report", metavar="DIR", help="write DIR/report.html, with plots")


def run(arguments: Namespace) -> int:
    from jaxisp.calibrate import calibrate
    from jaxisp.calibrate.frames import raw_files
    from jaxisp.calibrate.page import figure_rows, write_page
    from jaxisp.io import filled_folder, output_file
    from jaxisp.io.files import filled_file

    inputs = [p for folder in (arguments.flats, arguments.darks) for p in raw_files(folder)]
    failed: list[tuple[str, str]] = []
    with ExitStack() as stack, progress("calibrating") as tick:
        stack.enter_context(filled_file(arguments.out, [*inputs, *_settings(inputs)]))
        if arguments.report:
            output_file(stack.enter_context(filled_folder(arguments.report)) / "report.html")
        found = calibrate(arguments.flats, arguments.darks, failed=failed, tick=tick)
        found.save(arguments.out)
        if arguments.report:
            write_page(found, arguments.report)
    for note in found.notes:
        warn(note)
    if arguments.json:
        noise = [
            {
                "iso": n.iso,
                "figures": {name: f._asdict() for name, f in n.figures.items()},
                "electrons": n.electrons,
                "stated": n.stated,
                "frames": n.frames,
            }
            for n in found.noise
        ]
        about = {"noise_file": arguments.out, "camera": found.camera, "notes": found.notes}
        left_out = [{"file": name, "reason": reason} for name, reason in failed]
        print_json({**about, "noise": noise, "failed": left_out})
        return report_failures(failed)
    for one in found.noise:
        say("without an ISO number" if one.iso is None else f"ISO {one.iso:g}")
        print_table(("  figure", "value", "standard error", "unit", ""), list(figure_rows(one)))
    say(arguments.out)
    return report_failures(failed)


def _settings(inputs: list[Path]) -> list[Path]:
    return sorted({path.parent / "dataset.toml" for path in inputs})
