"""`jaxisp degrade`: noisy training images out of clean ones."""

from argparse import Namespace
from typing import Any

from jaxisp.cli.common import add_command, positive, print_json, progress, report_failures, say
from jaxisp.errors import InputError


def add_commands(commands: Any) -> None:
    command = add_command(
        commands, "degrade", run, "make noisy training images out of clean ones", draws=True
    )
    command.add_argument("inputs", nargs="+", metavar="IN", help="clean images, or folders of them")
    command.add_argument(
        "-o", "--out", required=True, metavar="DIR", help="output folder, a data set of one recipe and seed"
    )
    command.add_argument(
        "--recipe",
        required=True,
        metavar="RECIPE",
        help="a name (jaxisp recipes), a TOML file, or shares of several: phone=0.8,clean=0.2",
    )
    command.add_argument(
        "--count", type=positive, default=1, metavar="N", help="versions of each image (default 1)"
    )
    command.add_argument(
        "--start", type=int, default=0, metavar="I", help="index of the first sample (default 0)"
    )
    command.add_argument(
        "--resume", action="store_true", help="keep samples already written by the same command"
    )
    command.add_argument(
        "--shards", type=positive, metavar="N", help="write N array-record files instead of pictures"
    )
    command.add_argument(
        "--shard", metavar="I", help="with --shards: write only these, counted from 0: 3, 0-7 or 0,4,8-11"
    )


def run(arguments: Namespace) -> int:
    if arguments.shard is not None and not arguments.shards:
        raise InputError("--shard needs --shards N, the number of all shards")
    with progress("degrading") as tick:
        done = _degrade(arguments, tick)
    result = done.as_dict()
    if arguments.json:
        print_json(result)
    elif done.images or done.kept:
        rate = f"{done.seconds:.1f} s ({done.images_per_second:.1f} a second)"
        kept = f", {done.kept} kept" if done.kept else ""
        say(f"{done.images} images in {rate}{kept} -> {arguments.out}")
    return report_failures(done.failed)


def _degrade(arguments: Namespace, tick: Any) -> Any:
    from jaxisp.data.work import Work
    from jaxisp.generate import degrade_files

    options = {"count": arguments.count, "seed": arguments.seed, "start": arguments.start}
    if not arguments.shards:
        return degrade_files(
            arguments.inputs, arguments.out, arguments.recipe, **options, resume=arguments.resume, tick=tick
        )
    from jaxisp.data.shards import degrade_shards, parse_shards

    only = parse_shards(arguments.shard, arguments.shards) if arguments.shard is not None else None
    work = Work(arguments.inputs, arguments.recipe, **options)
    return degrade_shards(work, arguments.out, arguments.shards, only=only, tick=tick)
