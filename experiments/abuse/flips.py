"""Single bits of what is resumed, flipped one at a time: none of it may be taken for what was written.

    python -m experiments.abuse.flips --flips 1000

What `jaxisp degrade --resume` and `--shards` keep, a fit's journal, a run's settings, checkpoints and pool.
"""

import argparse
import json
import tempfile
from collections.abc import Callable, Iterator
from pathlib import Path

import jax.numpy as jnp
import numpy as np

from jaxisp.data.shard_source import read_manifest, shard_name, stands, told_of
from jaxisp.data.shards import degrade_shards
from jaxisp.data.work import Work
from jaxisp.errors import InputError
from jaxisp.fit.journal import Journal
from jaxisp.fit.state import State as FitState
from jaxisp.generate import degrade_files, is_written
from jaxisp.io import write_png
from jaxisp.io.files import files_below
from jaxisp.recipes import RECIPES
from jaxisp.train import TrainConfig
from jaxisp.train.checkpoints import Checkpoints
from jaxisp.train.folder import begin, load_settings
from jaxisp.train.pool import PairPool, is_part_of
from jaxisp.train.step import State

Case = tuple[str, list[Path], Callable[[], bool]]
"""What it is, its files, and whether it is taken for what was written."""


def cases(root: Path) -> Iterator[Case]:
    """Everything that is resumed, written small into folders below `root`."""
    write_png(root / "p.png", np.random.default_rng(0).uniform(size=(24, 30, 3)))
    work = Work([root / "p.png"], RECIPES["awgn"]())
    degrade_files(work.inputs, root / "files", work.recipe)
    sample = work.sample(0)
    yield (
        "degrade --resume",
        files_below(root / "files")[1:],
        lambda: is_written(root / "files", sample, work.note(sample)),
    )
    try:
        degrade_shards(work, root / "shards", 1)
        shard = [p for p in files_below(root / "shards") if p.name.startswith("shard-")]
        told = told_of(read_manifest(root / "shards"), 0)
        yield "shards", shard, lambda: stands(root / "shards", shard_name(0, 1), told)
        manifest = root / "shards" / "manifest.json"
        yield "manifest", [manifest], lambda: _reads(lambda: read_manifest(root / "shards"))
    except InputError:  # array_record is not installed
        pass
    rng, journal = np.random.default_rng(1), root / "c.toml.partial"
    Journal.open(journal, "a fit").put("job", FitState(rng.normal(size=9), (rng.normal(size=9),), ()), False)
    yield "journal", [journal], lambda: Journal.open(journal, "a fit").resumed
    run = root / "run"
    run.mkdir()
    begin(run, TrainConfig(clean=("photos",), recipe="awgn"), work.recipe)
    yield "settings of a run", files_below(run), lambda: _reads(lambda: load_settings(run))
    weights = {"weights": jnp.asarray(rng.normal(size=(40, 30)), jnp.float32)}
    state = State(jnp.asarray(3), weights, {}, {"mean": jnp.ones(7)}, None)
    store = Checkpoints(run, "a run")
    store.save(state, None)
    kept = files_below(run / "checkpoints" / "last" / "3")
    yield "checkpoint", kept, lambda: _reads(lambda: store.restore(state))
    PairPool(run / "pool", "a run", 4, 32, lambda indices: (rng.random((len(indices), 4, 4, 3)),) * 2)
    part = run / "pool" / "00000.npy"
    yield "pool", files_below(part.parent), lambda: is_part_of(part, "a run", 0)


def _reads(read: Callable[[], object]) -> bool:
    try:
        read()
    except InputError:
        return False
    return True


def accepted(case: Case, flips: int, rng: np.random.Generator) -> int:
    """How many of so many flips, each of one bit drawn over all files of a case, are not found."""
    _, files, taken = case
    if not taken():
        raise RuntimeError(f"{case[0]}: what was written is not taken for it")
    sizes, count = np.cumsum([path.stat().st_size for path in files]), 0
    for bit in rng.integers(8 * sizes[-1], size=flips):
        which = int(np.searchsorted(sizes, bit // 8, side="right"))
        path, place = files[which], int(bit - 8 * (sizes[which] - files[which].stat().st_size))
        whole = path.read_bytes()
        data = bytearray(whole)
        data[place // 8] ^= 1 << place % 8
        path.write_bytes(data)
        count += taken()
        path.write_bytes(whole)
    return count


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--flips", type=int, default=1000, help="of each kind")
    parser.add_argument("--seed", type=int, default=0)
    arguments = parser.parse_args()
    rng = np.random.default_rng(arguments.seed)
    with tempfile.TemporaryDirectory() as root:
        found = {case[0]: accepted(case, arguments.flips, rng) for case in cases(Path(root))}
    print(json.dumps({"flips of each": arguments.flips, "accepted": found}))


if __name__ == "__main__":
    main()
