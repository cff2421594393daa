"""Checkpoints that were damaged: what orbax and tensorstore print of them is kept back."""

import json
import logging
import os

import jax.numpy as jnp
import pytest

from jaxisp.errors import InputError
from jaxisp.process import signals
from jaxisp.train.checkpoints import DIGESTS, Checkpoints
from jaxisp.train.step import State


@pytest.fixture
def to_standard_error():
    """As outside of tests, where absl's logger prints there."""
    with os.fdopen(2, "w", buffering=1, closefd=False) as stream:
        handler = logging.StreamHandler(stream)
        logging.getLogger("absl").addHandler(handler)
        yield
        logging.getLogger("absl").removeHandler(handler)


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    """A run with one checkpoint that has no digests, as of a version before them: damage reaches orbax."""
    folder = tmp_path_factory.mktemp("run")
    store = Checkpoints(folder)
    store.save(state(), 20.0)
    store.close()
    for which in ("last", "best"):
        (folder / "checkpoints" / which / "3" / DIGESTS).unlink()
    return folder


def state():
    weights = {"weights": jnp.arange(12, dtype=jnp.float32).reshape(4, 3)}
    return State(jnp.asarray(3), weights, {}, {"mean": jnp.ones(3)}, None)


@pytest.mark.parametrize("which", ["last", "best"])
@pytest.mark.parametrize(
    ("name", "damage"),
    [
        ("_CHECKPOINT_METADATA", b""),
        ("_CHECKPOINT_METADATA", json.dumps({"a": 5}).encode()),
        ("_CHECKPOINT_METADATA", b"2"),
        ("_CHECKPOINT_METADATA", json.dumps({"commit_timestamp_nsecs": 10**40}).encode()),
        ("state/_METADATA", b"{"),
        ("state/manifest.ocdbt", b"\x0c\xdb\x3a\x2a" * 14),
        ("notes/metadata", b"\xff"),
    ],
)
def test_a_damaged_checkpoint_is_one_error_or_read_and_nothing_is_printed(
    run, to_standard_error, capfd, which, name, damage
):
    path = run / "checkpoints" / which / "3" / name
    whole = path.read_bytes()
    path.write_bytes(damage)
    try:
        store = Checkpoints(run, reading=True)
        assert store.best is None or store.best == (3, 20.0)
        try:
            found = store.restore(state(), which)
            assert (found.params["weights"] == state().params["weights"]).all()
        except InputError as error:
            assert "\n" not in str(error) and name.startswith("state")
        store.close()
    finally:
        path.write_bytes(whole)
    assert capfd.readouterr().err == ""


def test_damaged_metadata_of_the_newest_leave_the_one_before(tmp_path):
    store = Checkpoints(tmp_path)
    for step in (3, 4):
        store.save(state()._replace(step=jnp.asarray(step)), None)
    store.close()
    (tmp_path / "checkpoints" / "last" / "4" / "_CHECKPOINT_METADATA").write_bytes(b"[]")
    store = Checkpoints(tmp_path, reading=True)
    assert store.steps() == [3, 4] and int(store.restore(state()).step) == 3
    store.close()


def test_what_a_signal_became_is_no_damage(run, monkeypatch):
    """As if there were no best one, a worse one would replace it before the process ends."""
    store = Checkpoints(run, reading=True)

    def interrupted(*_):
        raise RuntimeError("as libraries make of a signal")

    monkeypatch.setattr(store, "_check", interrupted)
    assert store.best is None
    monkeypatch.setattr(signals, "came", lambda: 2)
    with pytest.raises(RuntimeError, match="libraries"):
        _ = store.best
    with pytest.raises(RuntimeError, match="libraries"):
        store.restore(state())
    store.close()
