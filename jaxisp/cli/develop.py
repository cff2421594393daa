"""`jaxisp develop`: render a RAW file."""

from argparse import Namespace
from typing import Any

from jaxisp.cli.common import add_command, print_json, say, warn


def add_commands(commands: Any) -> None:
    command = add_command(commands, "develop", run, "render a RAW file", draws=True)
    command.add_argument(
        "raw", metavar="RAW", help="a Bayer or X-Trans RAW that LibRaw opens, or NAME.raw.npy"
    )
    command.add_argument("-o", "--out", required=True, metavar="OUT.png", help="the picture to write")
    command.add_argument(
        "--camera", metavar="CAMERA.toml", help="a camera written by jaxisp fit (default: a plain one)"
    )
    command.add_argument(
        "--remosaic", action="store_true", help="render quad Bayer at full size (default: bin each filter)"
    )


def run(arguments: Namespace) -> int:
    from jaxisp.errors import InputError
    from jaxisp.io.files import filled_file

    if not arguments.out.lower().endswith(".png"):
        raise InputError(f"{arguments.out}: only PNG is written; give it a name that ends in .png")
    inputs = [arguments.raw, arguments.camera] if arguments.camera else [arguments.raw]
    with filled_file(arguments.out, inputs):
        return _render(arguments)


def _render(arguments: Namespace) -> int:
    import jax

    from jaxisp.camera import develop
    from jaxisp.cfa import is_xtrans
    from jaxisp.fit.seen import unseen
    from jaxisp.io import read_raw, write_png
    from jaxisp.recipe import Recipe, check_traces

    camera = Recipe.load(arguments.camera) if arguments.camera else None
    if camera:
        check_traces(camera)
    raw = read_raw(arguments.raw, quad="remosaic" if arguments.remosaic else "bin")
    notes = [*raw.notes, *unseen(raw, camera)]
    for note in notes:
        warn(f"{raw.path}: {note}")
    picture = develop(raw, camera, jax.random.key(arguments.seed))
    write_png(arguments.out, picture)
    height, width = picture.shape[:2]
    if arguments.json:
        size = {"width": width, "height": height}
        print_json({"image": arguments.out, **size, "cfa": raw.cfa, "notes": notes})
    else:
        kind = "X-Trans" if is_xtrans(raw.cfa) else raw.cfa
        say(f"{arguments.out}: {width} x {height}, {kind}")
    return 0
