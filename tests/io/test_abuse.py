"""Files from strangers: bombs refused before memory is taken, nothing run, some of the fuzzer's inputs."""

import pickle
import struct
import sys
import tempfile
import tracemalloc
import zlib
from pathlib import Path

import numpy as np
import pytest
import tifffile
from PIL import Image

from experiments.abuse.fuzz import make_input
from experiments.abuse.limits import SHARES, file_name
from experiments.abuse.seeds import all_seeds
from experiments.abuse.targets import READERS, outcome
from jaxisp.errors import InputError
from jaxisp.io import read_image, read_jpeg, read_raw, read_toml
from jaxisp.io.jpeg import encode_jpeg
from jaxisp.io.tags import HEIGHT, WIDTH
from jaxisp.serialize import decode_node
from tests.io.samples import dng
from tests.io.test_raw import _patched

NOT_HELD = ("recipe", "config", "checkpoint")
"""Kinds that take long."""


def refused(reader, path, words: str, most: float = 40e6) -> None:
    tracemalloc.start()
    try:
        with pytest.raises(InputError) as caught:
            reader(path)
        peak = tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
    text = str(caught.value)
    assert str(path) in text and "\n" not in text and words in text, text
    assert peak < most, f"{peak / 1e6:.0f} MB were taken"


def png(width: int, height: int, body: bytes) -> bytes:
    def chunk(kind: bytes, data: bytes) -> bytes:
        return struct.pack(">L", len(data)) + kind + data + struct.pack(">L", zlib.crc32(kind + data))

    head = struct.pack(">LLBBBBB", width, height, 8, 2, 0, 0, 0)
    return b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", head) + chunk(b"IDAT", body) + chunk(b"IEND", b"")


@pytest.mark.parametrize("size", [(13000, 13000), (20000, 20000), (65536, 300), (2**31 - 1, 2**31 - 1)])
def test_png_bombs(tmp_path, size):
    width, height = size
    path = tmp_path / "bomb.png"
    rows = min(height, 200)
    path.write_bytes(png(width, height, zlib.compress(bytes((3 * min(width, 20000) + 1) * rows), 9)))
    ours = width * height < 2 * Image.MAX_IMAGE_PIXELS  # above that Pillow refuses before it is asked
    refused(read_image, path, f"says it is {width} x {height} pixels" if ours else "says it is larger than")


def test_jpeg_of_absurd_size(tmp_path):
    data = bytearray(encode_jpeg(np.zeros((16, 16, 3), np.uint8)))
    at = data.index(b"\xff\xc0") + 5
    for height, width in ((13000, 13000), (65535, 65535), (0, 16)):  # checked before Pillow sees it
        data[at : at + 4] = struct.pack(">HH", height, width)
        (tmp_path / "bomb.jpg").write_bytes(bytes(data))
        refused(read_jpeg, tmp_path / "bomb.jpg", f"says it is {width} x {height} pixels")


def test_tiff_and_npy_of_absurd_size(tmp_path):
    tifffile.imwrite(
        tmp_path / "bomb.tif", np.zeros((40, 30, 3), np.uint16), photometric="rgb", compression="zlib"
    )
    for code, value in ((WIDTH, 20000), (HEIGHT, 12000)):
        _patched(tmp_path / "bomb.tif", code, struct.pack("<L", value))
    refused(read_image, tmp_path / "bomb.tif", "20000 x 12000")
    np.save(tmp_path / "bomb.npy", np.zeros((4, 4, 3), np.uint8))
    data = (tmp_path / "bomb.npy").read_bytes()
    data = data.replace(b"(4, 4, 3), }         ", b"(400000, 40000, 3), }")
    assert b"(400000" in data
    (tmp_path / "bomb.npy").write_bytes(data)
    refused(read_image, tmp_path / "bomb.npy", "damaged or truncated NumPy file")


def test_raw_of_absurd_size(tmp_path):
    """Compressed, so that the number of bytes does not give it away; LibRaw would take the memory first."""
    path = dng(tmp_path / "bomb.dng")
    for code, value in ((WIDTH, 16000), (HEIGHT, 16000), (259, 7)):
        _patched(path, code, struct.pack("<L", value))
    refused(read_raw, path, "says it is 16000 x 16000 pixels")


@pytest.mark.parametrize("within", [False, True], ids=["chained", "nested"])
def test_directories_that_lead_back_to_others(tmp_path, within):
    """Read one after another they have no end, and take all memory."""
    data = b"II*\0" + struct.pack("<I", 8)
    for after in (26, 44, 26):
        tag = (330, 4, 1, 26) if within else (256, 4, 1, 16)
        data += struct.pack("<HHHIII", 1, *tag, 0 if within else after)
    (tmp_path / "loop.dng").write_bytes(data)
    refused(read_raw, tmp_path / "loop.dng", "TIFF tags cannot be read")


def test_a_byte_count_that_is_no_number(tmp_path):
    """A strip's, as a double."""
    path = dng(tmp_path / "a.dng")
    data = bytearray(path.read_bytes())
    at = data.index(struct.pack("<HHI", 279, 4, 1))
    data[at + 2 : at + 12] = struct.pack("<HIf", 11, 1, float("nan"))
    path.write_bytes(data)
    refused(read_raw, path, "damaged")


def test_a_large_flat_picture_is_no_bomb(tmp_path):
    Image.new("RGB", (4000, 3000), (40, 80, 120)).save(tmp_path / "flat.png")
    assert read_image(tmp_path / "flat.png").shape == (3000, 4000, 3)


def test_npy_files_are_never_unpickled(tmp_path):
    class Code:
        def __reduce__(self):
            return (sys.modules["os"].mkdir, (str(tmp_path / "ran"),))

    array = np.empty(1, object)
    array[0] = Code()
    np.save(tmp_path / "a.npy", array, allow_pickle=True)
    (tmp_path / "b.npy").write_bytes(pickle.dumps(Code()))
    for name in ("a.npy", "b.npy"):
        refused(read_image, tmp_path / name, "damaged or truncated NumPy file")
    assert not (tmp_path / "ran").exists()


@pytest.mark.parametrize(
    "text",
    ["a = " + "[" * 5000, "a = " + "[" * 300 + "]" * 300, ".".join("a" * 900) + " = 1", "a = " + "9" * 5000,
     "a = 0001-01-01T00:00:00+99:99", "a = 2" + "\0"],
)  # fmt: skip
def test_toml_that_is_deep_or_odd(tmp_path, text):
    (tmp_path / "a.toml").write_text(text)
    refused(read_toml, tmp_path / "a.toml", "is not valid TOML")


def test_toml_that_is_too_large(tmp_path):
    with (tmp_path / "a.toml").open("wb") as file:
        file.truncate(1 << 40)
    refused(read_toml, tmp_path / "a.toml", "is larger than 16 MiB")


def test_stages_nested_without_end():
    table = {"stage": "clip"}
    for _ in range(5000):
        table = {"gate": table}
    with pytest.raises(InputError, match="nested too deeply"):
        decode_node(table)
    for name in ("__import__", "os.system", "jaxisp.cli:main", "eval"):
        with pytest.raises(InputError, match="no stage named"):
            decode_node({"stage": name})


@pytest.fixture(scope="module")
def seeds(tmp_path_factory):
    return all_seeds(tmp_path_factory.mktemp("seeds"))


@pytest.mark.parametrize("kind", [kind for kind in SHARES if kind not in NOT_HELD])
def test_some_of_the_fuzzers_inputs(seeds, kind):
    with tempfile.TemporaryDirectory() as folder:
        for index in range(30 if kind in ("sample", "manifest") else 120):
            seed, data = make_input(seeds, kind, index)
            path = Path(folder) / file_name(kind, seed.suffix)
            path.write_bytes(data)
            assert outcome(kind, path) in ("accepted", "refused"), (kind, index)
    assert set(READERS) == set(SHARES)


def test_the_sound_files_are_accepted(seeds, tmp_path):
    for seed in seeds:
        path = tmp_path / file_name(seed.kind, seed.suffix)
        path.write_bytes(seed.data)
        assert outcome(seed.kind, path) == "accepted", (seed.kind, seed.suffix)


def test_a_checkpoint_unpickles_nothing(tmp_path):
    """What orbax reads is arrays and JSON; the interpreter reports every class that an unpickler looks up."""
    import jax.numpy as jnp
    import optax

    from jaxisp.train.checkpoints import Checkpoints
    from jaxisp.train.step import State

    params = {"w": jnp.arange(4.0)}
    state = State(jnp.ones((), jnp.int32), params, {}, optax.adam(1e-3).init(params), None)
    store = Checkpoints(tmp_path, "a run")
    store.save(state, 20.0)
    store.close()
    looked_up: list[tuple] = []
    watching = [True]
    sys.addaudithook(lambda event, args: watching and event == "pickle.find_class" and looked_up.append(args))
    store = Checkpoints(tmp_path, "a run")
    assert store.restore(state).params["w"].tolist() == [0, 1, 2, 3] and store.best == (1, 20.0)
    store.close()
    pickle.loads(pickle.dumps(State))  # the watch works
    watching.clear()
    assert [args for args in looked_up if args[1] != "State"] == [] and looked_up


def test_nothing_in_the_package_runs_what_a_file_says():
    import ast

    import jaxisp

    forbidden = {"eval", "exec", "compile", "__import__"}
    for path in Path(jaxisp.__file__).parent.rglob("*.py"):
        for node in ast.walk(ast.parse(path.read_text())):
            names = {a.name.split(".")[0] for a in node.names} if isinstance(node, ast.Import) else set()
            names |= {node.module} if isinstance(node, ast.ImportFrom) else set()
            assert not names & {"pickle", "marshal", "shelve", "yaml", "dill", "cloudpickle"}, path
            if isinstance(node, ast.Call) and isinstance(node.func, ast.Name):
                assert node.func.id not in forbidden, (path, node.lineno)
            if isinstance(node, ast.keyword) and node.arg == "allow_pickle":
                assert isinstance(node.value, ast.Constant) and node.value.value is False, path
            if isinstance(node, ast.Attribute) and node.attr in ("load", "loads"):
                assert not (isinstance(node.value, ast.Name) and node.value.id in ("pickle", "torch")), path
