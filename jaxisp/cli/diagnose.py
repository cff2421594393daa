"""`jaxisp diagnose`: where the gap between a simulated and a real camera lies, and which effect causes it."""

from argparse import Namespace
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


def add_commands(commands: Any) -> None:
    command = add_command(
        commands, "diagnose", run, "name the effects that a simulated camera lacks", draws=True
    )
    command.add_argument(
        "dataset", metavar="DATASET", help="a folder of RAW+JPEG, clean+noisy or JPEG+JPEG pairs"
    )
    command.add_argument(
        "-o",
        "--out",
        required=True,
        metavar="DIR",
        help="output folder for report.json, report.html and, without --reference, simulator.toml",
    )
    command.add_argument(
        "--camera", metavar="CAMERA.toml", help="a fitted camera as the simulator (default: fit a plain one)"
    )
    command.add_argument(
        "--recipe", metavar="RECIPE", help="the simulator of clean+noisy pairs: a name or a TOML file"
    )
    command.add_argument(
        "--reference",
        metavar="DATASET",
        help="pairs of the same camera without the effect: its module off, another setting or firmware",
    )
    command.add_argument(
        "--exclude", type=names, default=[], metavar="EFFECT,...", help="effects to leave out"
    )
    command.add_argument(
        "--downstream",
        action="store_true",
        help="train small denoisers with and without the effects found; measure them on held-out pairs",
    )
    command.add_argument(
        "--downstream-steps",
        type=positive,
        default=500,
        metavar="N",
        help="training steps of each denoiser (default 500)",
    )


def run(arguments: Namespace) -> int:
    from jaxisp.gap.diagnose import SIMULATOR
    from jaxisp.gap.report.page import plain
    from jaxisp.io import filled_folder, output_file
    from jaxisp.io.datasets import RAW_JPEG
    from jaxisp.io.locks import locked

    # a fault here should not cost a diagnosis
    with filled_folder(arguments.out) as folder, locked(folder, doing="diagnosing"):
        for name in ("report.json", "report.html", SIMULATOR):
            output_file(folder / name, filter(None, (arguments.camera, arguments.recipe)))
        if arguments.downstream:
            from jaxisp.gap.downstream.denoisers import check_kept  # loads flax

            check_kept(folder / "downstream.json")
        found = _diagnosed(arguments, folder)
        _warn(found.report)
        try:
            page = found.save(folder)
        finally:  # a disk that is full by now takes the files, not the answer
            if arguments.json:
                print_json(plain(found.report))
            else:
                _print(found.report)
    if not arguments.json:
        say(f"{page} in {found.report['seconds']:.0f} s")
        if found.simulator is not None:
            uses = "develop --camera" if found.report["kind"] == RAW_JPEG else "degrade and train"
            say(f"{page.with_name(SIMULATOR)}: the simulator with what was found, for {uses}")
    if found.simulator is None and page.with_name(SIMULATOR).exists():
        warn(f"{page.with_name(SIMULATOR)} is of an earlier diagnosis: this one has none")
    return report_failures((f["file"], f["reason"]) for f in found.report["pairs"]["failed"])


def _diagnosed(arguments: Namespace, folder: Path) -> Any:
    from jaxisp.gap import Downstream, diagnose
    from jaxisp.recipe import Recipe, check_traces
    from jaxisp.recipes import find_degradation

    camera = Recipe.load(arguments.camera) if arguments.camera else None
    recipe = find_degradation(arguments.recipe) if arguments.recipe else None
    for simulator in (camera, recipe):
        if isinstance(simulator, Recipe):  # a mixture is refused below
            check_traces(simulator)
    how = Downstream(arguments.downstream_steps, keep=folder / "downstream.json")
    with progress("diagnosing") as tick:
        return diagnose(
            arguments.dataset,
            camera,
            recipe=recipe,
            reference=arguments.reference,
            exclude=arguments.exclude,
            downstream=how if arguments.downstream else None,
            seed=arguments.seed,
            tick=tick,
        )


def _warn(report: dict[str, Any]) -> None:
    from jaxisp.gap.report.sentences import few_pairs

    if few_pairs(report):
        warn(f"{few_pairs(report)}")
    for pair in report["pairs"]["left_out"]:
        warn(f"{pair['name']}: left out: {pair['reason']}")
    for pair in report["pairs"].get("encoder_not_modelled", ()):
        warn(f"{pair['name']}: its JPEG encoder is not modelled: {pair['reason']}")
    for pair in report["pairs"].get("raw_notes", ()):
        warn(f"{pair['name']}: RAW: {'; '.join(pair['notes'])}")


def _print(report: dict[str, Any]) -> None:
    from jaxisp.gap.report.sentences import next_measurements, sample_of, sentence, unexplained

    gap, left = report["gap"], unexplained(report)
    beside = f"; the reference's gap {gap['reference']:.3g}" if "reference" in gap else ""
    before, after, floor = (f"{gap[name]:.3g}" for name in ("before", "after", "floor"))
    say(
        f"verdict: {report['verdict']}; gap {before} -> {after}, floor {floor}"
        + beside
        + f"; {left}" * bool(left)
    )
    if sample := sample_of(report):
        say(f"diagnosed: {sample}")
    rows = [
        (c["effect"], c["site"], f"{c['probability']:.2f}", f"{c['closed']:.2f}",
         f"{c['ci'][0]:.2f} to {c['ci'][1]:.2f}", ", ".join(c["alternatives"]) or "-")
        for c in report["causes"]
    ]  # fmt: skip
    if rows:
        print_table(("cause", "site", "probability", "closes", "90 % interval", "alternatives"), rows)
    else:
        say(sentence(report))
    for text in next_measurements(report):
        say(text)
    _print_downstream(report.get("downstream"))


def _print_downstream(found: dict[str, Any] | None) -> None:
    if found is None:
        return
    if "skipped" in found:
        say(f"downstream: {found['skipped']}")
        return
    rows = [("no denoiser", f"{found['input']['psnr']:.2f}", "", f"{found['input']['ssim']:.4f}")]
    for name, arm in found["arms"].items():
        rows.append((name, f"{arm['psnr_mean']:.2f}", f"{arm['psnr_spread']:.2f}", f"{arm['ssim_mean']:.4f}"))
    print_table(("trained on pairs", "PSNR [dB]", "spread", "SSIM"), rows)
