"""`jaxisp fit`: a camera from RAW+JPEG pairs."""

from argparse import Namespace
from pathlib import Path
from typing import Any

from jaxisp.cli.common import add_command, positive, print_json, print_table, progress, report_failures


def add_commands(commands: Any) -> None:
    command = add_command(commands, "fit", run, "fit a camera to RAW+JPEG pairs")
    command.add_argument("dataset", metavar="DATASET", help="a folder of RAW+JPEG pairs")
    command.add_argument("-o", "--out", required=True, metavar="CAMERA.toml")
    command.add_argument(
        "--report", metavar="DIR", help="write DIR/report.html, with pictures before and after"
    )
    command.add_argument("--steps", type=positive, default=250, help="gradient steps (default 250)")
    command.add_argument("--demosaic", default="demosaic_ahd", metavar="STAGE", help="default demosaic_ahd")


def run(arguments: Namespace) -> int:
    from jaxisp.fit import fit_dataset
    from jaxisp.fit.report import write_report
    from jaxisp.io import output_folder

    output_folder(Path(arguments.out).parent)  # a fault here should not cost a fit
    with progress("fitting") as tick:
        result = fit_dataset(arguments.dataset, steps=arguments.steps, demosaic=arguments.demosaic, tick=tick)
    result.camera.save(arguments.out)
    if arguments.report:
        write_report(result, arguments.report)
    if arguments.json:
        print_json({"camera": arguments.out, **result.as_dict()})
        return report_failures(result.failed)
    rows = [
        (p.name, f"{p.psnr:.2f}", f"{p.ssim:.4f}", f"{p.held_out_psnr:.2f}", f"{p.held_out_ssim:.4f}",
         f"{p.shift[0]:+.2f} {p.shift[1]:+.2f}")
        for p in result.pairs
    ]  # fmt: skip
    print_table(("pair", "PSNR fitted", "SSIM", "PSNR held out", "SSIM", "shift [px]"), rows)
    print(f"{arguments.out} in {result.seconds:.0f} s; held out: {result.how}")
    return report_failures(result.failed)
