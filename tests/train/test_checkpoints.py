"""Checkpoints that were damaged: what orbax and tensorstore print of them is kept back."""

import json
import logging
import os
import shutil

import jax.numpy as jnp
import pytest

from jaxisp.errors import InputError
from jaxisp.io.digests import note_files
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
    """A run with one checkpoint that was killed before the digests of its files: damage reaches orbax."""
    folder = tmp_path_factory.mktemp("run")
    store = Checkpoints(folder, "a run")
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
        store = Checkpoints(run, "a run", reading=True)
        assert store.best is None or store.best == (3, 20.0)
        try:
            found = store.restore(state(), which)
            assert (found.params["weights"] == state().params["weights"]).all()
        except InputError as error:
            assert "\n" not in str(error) and name.startswith(("state", "notes"))
        store.close()
    finally:
        path.write_bytes(whole)
    assert capfd.readouterr().err == ""


def test_damaged_metadata_of_the_newest_leave_the_one_before(tmp_path):
    store = Checkpoints(tmp_path, "a run")
    for step in (3, 4):
        store.save(state()._replace(step=jnp.asarray(step)), None)
    store.close()
    (tmp_path / "checkpoints" / "last" / "4" / "_CHECKPOINT_METADATA").write_bytes(b"[]")
    store = Checkpoints(tmp_path, "a run", reading=True)
    assert store.steps() == [3, 4] and int(store.restore(state()).step) == 3
    store.close()


def other(step):
    """As `state`, later and with other weights."""
    return State(jnp.asarray(step), {"weights": -state().params["weights"]}, {}, {"mean": jnp.ones(3)}, None)


@pytest.mark.parametrize("digests", [True, False])
def test_a_checkpoint_of_another_run_is_not_taken(tmp_path, digests):
    for name, what in (("one", state()), ("two", other(4))):
        store = Checkpoints(tmp_path / name, name)
        store.save(what, 20.0)
        store.close()
    for which in ("last", "best"):
        place = tmp_path / "one" / "checkpoints" / which
        shutil.copytree(tmp_path / "two" / "checkpoints" / which / "4", place / "4")
        if not digests:
            (place / "4" / DIGESTS).unlink()
    store = Checkpoints(tmp_path / "one", "one", reading=True)
    assert store.best == (3, 20.0) and int(store.restore(state()).step) == 3
    shutil.rmtree(tmp_path / "one" / "checkpoints" / "last" / "3")
    store.close()
    store = Checkpoints(tmp_path / "one", "one", reading=True)
    with pytest.raises(InputError, match="step 4: it is of another run"):
        store.restore(state())
    store.close()


@pytest.mark.parametrize(
    ("part", "said"), [("state", "its arrays are not"), ("notes", "its notes are not")]
)  # fmt: skip
def test_without_digests_of_files_what_is_read_is_what_was_written(tmp_path, part, said):
    """Files that orbax takes for whole, as where a bit of a weight is another."""
    for name, what in (("one", other(3)), ("two", state())):
        store = Checkpoints(tmp_path / name, "a run")
        store.save(what, 20.0)
        store.close()
    place = tmp_path / "one" / "checkpoints" / "last" / "3"
    (place / DIGESTS).unlink()
    store = Checkpoints(tmp_path / "one", "a run", reading=True)
    assert (store.restore(state()).params["weights"] == other(3).params["weights"]).all()
    store.close()
    if part == "state":
        shutil.rmtree(place / part)
        shutil.copytree(tmp_path / "two" / "checkpoints" / "last" / "3" / part, place / part)
    else:
        notes = json.loads((place / part / "metadata").read_text())
        (place / part / "metadata").write_text(json.dumps({**notes, "psnr": 99.0}))
    store = Checkpoints(tmp_path / "one", "a run", reading=True)
    with pytest.raises(InputError, match=said):
        store.restore(state())
    store.close()


def test_one_of_a_version_before_is_read_by_the_digests_of_its_files(tmp_path):
    store = Checkpoints(tmp_path, "a run")
    store.save(state(), 20.0)
    store.close()
    for which in ("last", "best"):
        place = tmp_path / "checkpoints" / which / "3"
        (place / "notes" / "metadata").write_text('{"psnr": 20.0}')
        note_files(place, DIGESTS)
    store = Checkpoints(tmp_path, "a run", reading=True)
    assert store.best == (3, 20.0) and int(store.restore(state()).step) == 3
    (tmp_path / "checkpoints" / "last" / "3" / DIGESTS).unlink()
    with pytest.raises(InputError, match="its notes are not what was written"):
        store.restore(state())
    store.close()


def test_what_a_signal_became_is_no_damage(run, monkeypatch):
    """As if there were no best one, a worse one would replace it before the process ends."""
    store = Checkpoints(run, "a run", reading=True)

    def interrupted(*_):
        raise RuntimeError("as libraries make of a signal")

    monkeypatch.setattr(store, "_checked", interrupted)
    assert store.best is None
    monkeypatch.setattr(signals, "came", lambda: 2)
    with pytest.raises(RuntimeError, match="libraries"):
        _ = store.best
    with pytest.raises(RuntimeError, match="libraries"):
        store.restore(state())
    store.close()
