"""Every command of the command line, small, and what of its output is the same in every run."""

import functools
import hashlib
import http.server
import threading
import time
from pathlib import Path

import numpy as np

from experiments.abuse.kill import in_child
from jaxisp.io import read_image, write_png
from jaxisp.io.files import files_below, read_json, read_toml

_TRAIN = """--recipe awgn --model fast --steps 12 --batch 2 --patch 16 --downsample 1 --validation 2
    --checkpoint-every 2 --log-every 1 --cpu-devices 1 --resume"""
COMMANDS = {
    "stages": "stages --json",
    "effects": "effects --json",
    "recipes": "recipes --json",
    "data list": "data list --json",
    "data fetch": "data fetch kodak",
    "develop": "develop {data}/pairs/scene0.dng -o {out}/a.png",
    "recipe": "recipe phone -o {out}/b.toml --noise {data}/noise.toml",
    "calibrate": "calibrate {data}/flats {data}/darks -o {out}/noise.toml --report {out}",
    "fit": "fit {data}/pairs -o {out}/camera.toml --steps 4 --demosaic demosaic_bilinear --median none",
    "degrade": "degrade {data}/clean -o {out} --recipe awgn --count 10 --resume",
    "shards": "degrade {data}/clean -o {out} --recipe awgn --count 10 --shards 5",
    "train": f"train --clean {{data}}/clean -o {{out}} {_TRAIN}",
    "adapt": "adapt {data}/photos -o {out}/a.toml --recipe awgn --downsample 1 --draws 64",
    "denoise": "denoise --run {data}/run {data}/clean -o {out}",
    "evaluate": "evaluate --run {data}/run {data}/noisy",
    "diagnose": "diagnose {data}/pairs -o {out}",
    "downstream": "diagnose {data}/noisy -o {out} --downstream --downstream-steps 20",
    "demo": "demo --out {out}",
}
NAMES = tuple(COMMANDS)
_TIMES = (
    "log.csv",
    "validation.csv",
    "report.json",
    "report.html",
    "MODEL_CARD.md",
    "manifest.json",
    "demo.json",
)
_LONG = ("demo", "diagnose", "downstream")
_FORKED = ("data fetch",)  # its server is known to this process, and to those that are forked from it


class Job:
    """A command by name, with `data` to work on."""

    def __init__(self, name: str, data: Path) -> None:
        self.name, self.data = name, data

    @property
    def ends(self) -> bool:
        """Whether it is run to its end: others take minutes."""
        return self.name not in _LONG

    @property
    def anew(self) -> bool:
        """Whether it may run in a process that begins anew."""
        return self.name not in _FORKED

    def command(self, out: Path) -> list[str]:
        return [w.format(data=self.data, out=out) for w in COMMANDS[self.name].split()]

    def results(self, out: Path) -> dict[str, str]:
        """Digests of the output; what states times or dates is left out, and containers of no fixed bytes."""
        found = {}
        for path in files_below(out):
            inside = str(path.relative_to(out))
            if path.name in _TIMES or path.suffix in (".array_record", ".json"):
                continue
            if not inside.startswith((".", "checkpoints", "tensorboard")):
                found[inside] = hashlib.sha256(path.read_bytes()).hexdigest()
        if self.name == "train":
            rows = (out / "log.csv").read_text().splitlines()
            found["log.csv"] = "\n".join(row.rsplit(",", 1)[0] for row in rows)
        return found

    def check_left(self, out: Path) -> str:
        """What is half-written under its own name after a signal, or was left behind; "" where nothing is."""
        for path in files_below(out):
            inside = path.relative_to(out)
            if "checkpoints" in inside.parts or "tensorboard" in inside.parts:
                continue  # orbax's own: a run that goes on reads them
            if path.name.endswith((".tmp", ".part")) and self.name != "data fetch":
                return f"{inside} was left"
            try:
                if path.suffix == ".png":
                    read_image(path)
                elif path.suffix == ".toml":
                    read_toml(path)
                elif path.suffix in (".json", ".partial") and path.is_file():
                    read_json(path)
            except Exception as error:
                return f"{inside} is not whole: {error}"
        return ""


def make_data(data: Path) -> None:
    """What all commands work on; in a child, as devices are started."""
    data.mkdir()
    in_child(functools.partial(_make_data, data))


def _make_data(data: Path) -> None:
    from jaxisp.cli import main
    from jaxisp.samples import PHONES, scenes, write_pairs
    from tests.calibrate import sensor

    (data / "clean").mkdir()
    for i in range(6):
        shape = (66, 78, 3) if i % 2 else (70, 64, 3)  # 64 px a side are the least that is diagnosed
        write_png(data / "clean" / f"photo {i}.png", np.random.default_rng(i).uniform(size=shape))
    (data / "photos").mkdir()
    for i in range(2):
        write_png(data / "photos" / f"{i}.png", np.random.default_rng(i).uniform(size=(136, 144, 3)))
    (data / "pairs").mkdir()
    write_pairs(data / "pairs", PHONES["a"], list(scenes((96, 128)))[:2])
    flats, darks = sensor.frames(size=(128, 128))
    sensor.write(data, "flats", flats[:10])
    sensor.write(data, "darks", darks[:4])
    calls = (
        "calibrate {data}/flats {data}/darks -o {data}/noise.toml",
        "degrade {data}/clean -o {data}/noisy --recipe awgn",
        COMMANDS["train"],
    )
    for call in calls:
        if main([w.format(data=data, out=data / "run") for w in call.split()]):
            raise RuntimeError(call)


def serve() -> None:
    """A server on this machine that takes 3 s for a small set, which stands in for a public one."""
    from jaxisp.data.catalogue import SETS, PublicSet, RemoteFile

    body, piece = bytes(range(256)) * 4096, 1 << 15

    class Slow(http.server.BaseHTTPRequestHandler):
        def do_GET(self) -> None:
            first = int(self.headers.get("Range", "bytes=0-").removeprefix("bytes=").rstrip("-"))
            self.send_response(206 if first else 200)
            self.send_header("ETag", '"one"')
            self.send_header("Content-Length", str(len(body) - first))
            self.end_headers()
            for at in range(first, len(body), piece):
                self.wfile.write(body[at : at + piece])
                time.sleep(0.1)

        def log_message(self, *_: object) -> None:
            pass

    server = http.server.ThreadingHTTPServer(("127.0.0.1", 0), Slow)
    threading.Thread(target=server.serve_forever, daemon=True).start()
    digest = f"sha256:{hashlib.sha256(body).hexdigest()}"
    file = RemoteFile(f"http://127.0.0.1:{server.server_port}/a.bin", "a.bin", digest)
    SETS["kodak"] = PublicSet("kodak", "A small set", "tests", "CC0", "1 MB", "https://example.org", (file,))
