"""`jaxisp develop`: render a RAW file."""

from argparse import Namespace
from typing import Any

from jaxisp.cli.common import add_command, print_json, say


def add_commands(commands: Any) -> None:
    command = add_command(commands, "develop", run, "render a RAW file")
    command.add_argument("raw", metavar="RAW", help="a Bayer RAW that LibRaw opens, or NAME.raw.npy")
    command.add_argument("-o", "--out", required=True, metavar="OUT.png")
    command.add_argument(
        "--camera", metavar="CAMERA.toml", help="as jaxisp fit writes it; a plain one unless given"
    )


def run(arguments: Namespace) -> int:
    import jax

    from jaxisp.camera import develop
    from jaxisp.errors import InputError
    from jaxisp.io import read_raw, write_png
    from jaxisp.io.files import check_output, real_paths
    from jaxisp.recipe import Recipe, check_traces

    if not arguments.out.lower().endswith(".png"):
        raise InputError(f"{arguments.out}: only PNG is written; give it a name that ends in .png")
    check_output(arguments.out, real_paths([arguments.raw]))
    camera = Recipe.load(arguments.camera) if arguments.camera else None
    if camera:
        check_traces(camera)
    raw = read_raw(arguments.raw)
    picture = develop(raw, camera, jax.random.key(arguments.seed))
    write_png(arguments.out, picture)
    height, width = picture.shape[:2]
    if arguments.json:
        print_json({"image": arguments.out, "width": width, "height": height, "cfa": raw.cfa})
    else:
        say(f"{arguments.out}: {width} x {height}, {raw.cfa}")
    return 0
