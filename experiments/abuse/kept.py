"""What jaxisp wrote itself and reads again, given back changed: shards, journals, samples, checkpoints.

The seals of texts are made anew after a change, as otherwise it would be refused by its digest at once, and
digests of files are taken away where that is allowed: what is behind them has to stand too.
"""

import contextlib
import functools
import json
import shutil
import tempfile
from collections.abc import Iterator
from pathlib import Path

import jax.numpy as jnp
import numpy as np

from jaxisp.data.shard_source import MANIFEST, ShardSource, shard_name
from jaxisp.data.shards import degrade_shards
from jaxisp.data.unpack import unpack
from jaxisp.data.work import Work
from jaxisp.errors import InputError
from jaxisp.fit.journal import Journal, in_the_way
from jaxisp.fit.state import State as FitState
from jaxisp.generate import degrade_files, is_written
from jaxisp.io import write_png
from jaxisp.io.digests import sealed_json, sealed_toml
from jaxisp.io.files import files_below
from jaxisp.recipes import RECIPES
from jaxisp.train.checkpoints import DIGESTS, Checkpoints
from jaxisp.train.logs import read_rows
from jaxisp.train.step import State


@functools.cache
def _folder() -> Path:
    """A folder of this process, with one of everything that is kept."""
    root = Path(tempfile.mkdtemp(prefix="abuse-kept-"))
    write_png(root / "p.png", np.random.default_rng(0).uniform(size=(12, 14, 3)))
    work = Work([root / "p.png"], RECIPES["awgn"]())
    degrade_files(work.inputs, root / "samples", work.recipe)
    with contextlib.suppress(InputError):  # array_record is not installed
        degrade_shards(work, root / "shards", 1)
    rng = np.random.default_rng(1)
    state = FitState(rng.normal(size=9), (rng.normal(size=9),), ())
    Journal.open(root / "c.toml.partial", "a fit").put("job", state, False)
    store = Checkpoints(root, "a run")
    store.save(_state(), 20.0)
    store.close()
    (root / "checkpoints" / "last" / "3" / DIGESTS).unlink()
    return root


def _state() -> State:
    weights = {"weights": jnp.arange(12, dtype=jnp.float32).reshape(4, 3)}
    return State(jnp.asarray(3), weights, {}, {"mean": jnp.ones(3)}, None)


@contextlib.contextmanager
def _replaced(path: Path, data: bytes) -> Iterator[None]:
    whole = path.read_bytes()
    path.write_bytes(data)
    try:
        yield
    finally:
        path.write_bytes(whole)


def _text(path: Path) -> str:
    """A changed text; what is not UTF-8 is refused before its seal is looked at."""
    try:
        return path.read_bytes().decode()
    except UnicodeDecodeError:
        raise InputError(f"{path}: is not UTF-8 text") from None


@contextlib.contextmanager
def _named(path: Path) -> Iterator[None]:
    """The errors name a file of `_folder`: they have to name the input."""
    try:
        yield
    except InputError as error:
        if str(_folder()) not in str(error):
            raise AssertionError(f"does not name the file: {error}") from None
        raise InputError(f"{path}: {error}") from None


def journal(path: Path) -> None:
    place = _folder() / "changed.partial"
    place.write_text(sealed_json(_text(path)))
    Journal.open(place, "a fit").get("job")
    in_the_way(place)


def sample(path: Path) -> None:
    work = Work([_folder() / "p.png"], RECIPES["awgn"]())
    own = work.sample(0)
    with _replaced(_folder() / "samples" / f"{own.stem}.toml", sealed_toml(_text(path)).encode()):
        is_written(_folder() / "samples", own, work.note(own))


def manifest(path: Path) -> None:
    place, work = _folder() / "shards" / MANIFEST, Work([_folder() / "p.png"], RECIPES["awgn"]())
    with _replaced(place, sealed_json(_text(path)).encode()), _named(path):
        ShardSource(place.parent)
        degrade_shards(work, place.parent, 1)


def note(path: Path) -> None:
    place = _folder() / "shards" / f"{shard_name(0, 1)}.json"
    with _replaced(place, sealed_json(_text(path)).encode()), _named(path):
        source = ShardSource(place.parent)
        if len(source):
            source[0]


def record(path: Path) -> None:
    place = _folder() / "shards" / f"{shard_name(0, 1)}.array_record"
    told, data = place.with_suffix(".json"), path.read_bytes()
    table = json.loads(told.read_text()) | {"bytes": len(data)}
    del table["digest"]
    with (
        _replaced(place, data),
        _replaced(told, sealed_json(json.dumps(table)).encode()),
        _named(path),
    ):
        source = ShardSource(place.parent)
        source[0]
        source.parameters(0)


def checkpoint(path: Path) -> None:
    """The first byte says which file of the checkpoint the others are."""
    data, files = path.read_bytes() or b"\0", _checkpoint_files()
    with _replaced(files[data[0] % len(files)], data[1:]), _named(path):
        store = Checkpoints(_folder(), "a run", reading=True)
        try:
            store.restore(_state())
        finally:
            store.close()


def _checkpoint_files() -> list[Path]:
    return files_below(_folder() / "checkpoints" / "last" / "3")


def log(path: Path) -> None:
    place = path.with_name("log.csv")
    place.write_bytes(path.read_bytes())
    for row in read_rows(place):
        float(row["step"]), float(row["loss"])


def archive(path: Path) -> None:
    """Unpacked into a folder that stands in another: nothing may come to be beside it."""
    root = path.with_name("root")
    shutil.rmtree(root, ignore_errors=True)
    root.mkdir()
    try:
        unpack(path, path.suffix[1:], root / "own")
    finally:
        beside = [p.name for p in root.iterdir() if p.name != "own"]
        links = [p.name for p in root.rglob("*") if p.is_symlink()]
        assert not beside and not links, f"unpacked beside its folder: {beside}, links: {links}"


def seeds() -> Iterator[tuple[str, str, bytes]]:
    """Kind, suffix and bytes of small sound inputs for the readers above."""
    root = _folder()
    yield "journal", ".partial", _unsealed(root / "c.toml.partial")
    (text,) = (root / "samples").glob("*_000.toml")
    yield "sample", ".toml", text.read_bytes().rpartition(b"\n# digest")[0]
    yield (
        "log",
        ".csv",
        b"step,epoch,loss,grad_norm,lr,images_per_second\n1,0,0.5,1.0,1e-3,7.0\n2,0,4e-1,1,1,6\n",
    )
    if (root / "shards" / MANIFEST).exists():
        yield "manifest", ".json", _unsealed(root / "shards" / MANIFEST)
        yield "note", ".json", _unsealed(root / "shards" / f"{shard_name(0, 1)}.json")
        yield "record", ".array_record", (root / "shards" / f"{shard_name(0, 1)}.array_record").read_bytes()
    for i, path in enumerate(_checkpoint_files()):
        yield "checkpoint", "", bytes([i]) + path.read_bytes()


def _unsealed(path: Path) -> bytes:
    table = json.loads(path.read_text())
    del table["digest"]
    return json.dumps(table).encode()
