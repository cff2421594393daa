"""Pairs on disk: each once an epoch, both turned alike, made once; a run with them is resumed to the bit."""

import dataclasses
import os
import shutil

import jax
import numpy as np
import pytest
from flax import nnx
from PIL import Image

from jaxisp.errors import InputError
from jaxisp.testing import smooth_image
from jaxisp.train import TrainConfig, load_denoiser, train
from jaxisp.train.pool import PairPool
from jaxisp.train.step import weights
from tests.train.test_trainer import SMALL, fingerprint, interrupt_at


def numbered(indices):
    """Pairs that say their index, with a gradient from which turns can be told."""
    ramp = np.arange(16).reshape(1, 4, 4, 1) / 255
    noisy = np.asarray(indices).reshape(-1, 1, 1, 1) / 255 + ramp + np.zeros((1, 1, 1, 3))
    return noisy, noisy / 2


@pytest.fixture
def parts(monkeypatch):
    monkeypatch.setattr("jaxisp.train.pool.PART", 8)


def test_each_pair_comes_once_an_epoch_and_both_are_turned_alike(tmp_path, parts):
    pool = PairPool(tmp_path / "pool", "a run", 4, 12, numbered, batch=4)
    assert len(pool) == 16 and sorted(p.name for p in (tmp_path / "pool").iterdir()) == [
        "00000.json",
        "00000.npy",
        "00001.json",
        "00001.npy",
    ]
    for epoch in range(2):
        pairs = pool.batch(range(16 * epoch, 16 * epoch + 16))
        assert pairs.shape == (16, 2, 4, 4, 3) and pairs.dtype == np.uint8
        assert sorted(pairs[:, 0].min((1, 2, 3))) == list(range(16))
        np.testing.assert_allclose(pairs[:, 1], pairs[:, 0] / 2, atol=0.5)
    first, second = pool.batch(range(16)), pool.batch(range(16, 32))
    assert (first != second).any()
    np.testing.assert_array_equal(pool.batch([3, 20]), np.stack([first[3], second[4]]))


def test_what_is_whole_is_not_made_again(tmp_path, parts):
    asked = []

    def make(indices):
        asked.append(indices)
        return numbered(indices)

    PairPool(tmp_path / "pool", "a run", 4, 16, make, batch=8)
    (tmp_path / "pool" / "00001.npy").unlink()
    PairPool(tmp_path / "pool", "a run", 4, 16, make, batch=8)
    assert asked == [range(0, 8), range(8, 16), range(8, 16)]


@pytest.mark.parametrize("damage", ["flipped", "zeros", "cut", "no note", "another run's", "another place's"])
def test_what_is_not_as_it_was_written_is_made_again(tmp_path, parts, damage):
    whole = PairPool(tmp_path / "whole", "a run", 4, 16, numbered, batch=8).batch(range(16))
    shutil.copytree(tmp_path / "whole", tmp_path / "pool")
    path = tmp_path / "pool" / "00000.npy"
    data = bytearray(path.read_bytes())
    if damage == "flipped":
        data[-1] ^= 1
    if damage == "zeros":
        data[128:] = bytes(len(data) - 128)
    path.write_bytes(data[:-9] if damage == "cut" else data)
    if damage == "no note":
        path.with_suffix(".json").unlink()
    if damage == "another run's":
        PairPool(tmp_path / "other", "another", 4, 16, lambda i: numbered(np.add(i, 9)), batch=8)
        for suffix in (".npy", ".json"):
            shutil.copy(tmp_path / "other" / f"00000{suffix}", tmp_path / "pool")
    if damage == "another place's":
        for suffix in (".npy", ".json"):
            shutil.copy(tmp_path / "whole" / f"00001{suffix}", path.with_suffix(suffix))
    again = PairPool(tmp_path / "pool", "a run", 4, 16, numbered, batch=8)
    np.testing.assert_array_equal(again.batch(range(16)), whole)
    assert (tmp_path / "pool" / "00000.npy").read_bytes() == (tmp_path / "whole" / "00000.npy").read_bytes()


def test_a_file_that_is_cut_while_it_is_used_is_one_error(tmp_path, parts):
    pool = PairPool(tmp_path / "pool", "a run", 4, 8, numbered, batch=8)
    os.truncate(tmp_path / "pool" / "00000.npy", 300)
    with pytest.raises(InputError, match=r"00000\.npy: was cut short while it was in use"):
        pool.batch(range(8))


def test_a_run_with_a_pool_is_resumed_to_the_bit_and_goes_on_from_weights(tmp_path, parts):
    (tmp_path / "clean").mkdir()
    for i in range(3):
        Image.fromarray(np.uint8(255 * smooth_image((36, 40, 3), i))).save(tmp_path / "clean" / f"{i}.png")
    options = {
        **SMALL,
        "model": "levelnet",
        "model_options": {"features": (8, 8), "depth": 1, "estimator": 4},
    }
    config = TrainConfig(
        clean=(str(tmp_path / "clean"),), **{**options, "patch": 32, "pool": 8, "target": "camera"}
    )
    whole = train(config, tmp_path / "whole")
    assert whole.finished and np.isfinite(whole.loss)
    stopped = train(config, tmp_path / "stopped", tick=interrupt_at(2))
    assert stopped.step == 2
    rest = train(config, tmp_path / "stopped", resume=True)
    assert fingerprint(rest.state) == fingerprint(whole.state)

    from jaxisp.models import make_model, save_network

    save_network(
        tmp_path / "start.npz", make_model("levelnet", seed=9, **options["model_options"]), "levelnet", {}
    )
    other = train(dataclasses.replace(config, start=str(tmp_path / "start.npz")), tmp_path / "begun")
    leaves = [jax.tree.leaves(run.state.params)[0] for run in (other, whole)]
    assert np.abs(leaves[0] - leaves[1]).max() > 1e-3
    (tmp_path / "start.npz").unlink()  # a trained run has its own weights
    denoiser, _ = load_denoiser(other.run, "last")
    kept = jax.tree.leaves(nnx.state(denoiser.model, nnx.Param))
    for leaf, wanted in zip(kept, jax.tree.leaves(weights(other.state)[0]), strict=True):
        np.testing.assert_array_equal(leaf, wanted)
