"""Checkpoints of a run: written whole or not at all, the newest few and the best are kept."""

import contextlib
import datetime
import hashlib
import json
import logging
import os
import shutil
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import jax
import numpy as np
import orbax.checkpoint as ocp

from jaxisp.errors import InputError, one_line
from jaxisp.io.digests import changed_files, is_sealed, note_files, sealed_json
from jaxisp.io.files import reason
from jaxisp.io.silence import silent_libraries
from jaxisp.process import signals
from jaxisp.train.step import State

FOLDERS = ("best", "last")
DIGESTS = "digests.json"
"""In the folder of each checkpoint: of all its files."""
_OVERHEAD = 1 << 20  # bytes of a checkpoint besides its arrays, at the most

_RAISED = ("_SignalingThread.run() raised", "Metadata file does not exist")
"""What orbax logs besides raising it, its threads even after that: it is told once, by an InputError."""
_LATE = 0.3
"""Seconds that tensorstore's threads may still print something, after the error of a damaged file."""


class Checkpoints:
    """The checkpoints of a run, by step, in RUN/checkpoints/last and RUN/checkpoints/best.

    A checkpoint is written into a temporary folder that is renamed when it is whole, and older ones are
    deleted after that: whatever kills the process, the last whole one stands. Its notes, which become whole
    with it, hold the digest of its arrays and which run it is of: one that differs is not read.

    Args:
        run: the folder of the run.
        of: what the run was told (`folder.settings_digest`).
        keep: checkpoints kept besides the best.
        reading: leave the folder as it is, where another process may be training into it. A trainer makes
            its folders, and deletes what a killed one left half written.

    Raises:
        InputError: the folders cannot be made, or read.
    """

    def __init__(self, run: Path, of: str, keep: int = 2, *, reading: bool = False) -> None:
        self.run, self.of = run, of
        logging.getLogger("absl").addFilter(_is_news)  # one filter, however often it is added
        try:
            with silent_libraries():
                self._managers = {
                    name: _manager(run / "checkpoints" / name, count, reading)
                    for name, count in zip(FOLDERS, (1, keep))
                }
            for name in FOLDERS:  # where one cannot be listed orbax finds it empty
                if reading and (folder := run / "checkpoints" / name).is_dir():
                    os.listdir(folder)
        except OSError as error:
            verb = "read" if reading else "written"
            raise InputError(f"{run / 'checkpoints'}: cannot be {verb}: {reason(error)}") from error

    @property
    def best(self) -> tuple[int, float] | None:
        """Step and validation PSNR of the best checkpoint, where there is one that is whole."""
        manager = self._managers["best"]
        for step in sorted(manager.all_steps(), reverse=True):
            try:
                return step, float(self._checked("best", step)["psnr"])
            except Exception:  # damaged: as if there were none
                if signals.came():  # a worse one would replace it
                    raise
        return None

    def save(self, state: State, psnr: float | None) -> None:
        """Write a checkpoint; as the best one too where its validation PSNR is the highest.

        Raises:
            InputError: it cannot be written, as where the disk is full; the ones before it stand.
        """
        step, best = int(state.step), self.best
        if psnr is not None and (best is None or psnr > best[1]):
            self._save("best", step, state, psnr)
        self._save("last", step, state, psnr)

    def _save(self, which: str, step: int, state: State, psnr: float | None) -> None:
        manager = self._managers[which]
        if step in manager.all_steps():
            return
        notes = sealed_json(json.dumps({"run": self.of, "arrays": _digest(state), "psnr": psnr}))
        items = ocp.args.Composite(
            state=ocp.args.StandardSave(state._asdict()), notes=ocp.args.JsonSave(json.loads(notes))
        )
        try:
            _check_room(self.run / "checkpoints" / which, state)
            with silent_libraries():
                manager.save(step, args=items)
                manager.wait_until_finished()
            if jax.process_index() == 0:
                note_files(self.run / "checkpoints" / which / str(step), DIGESTS)
        except Exception as error:  # orbax and tensorstore raise many kinds for a full disk
            for part in (self.run / "checkpoints" / which).glob(f"{step}.*tmp*"):
                shutil.rmtree(part, ignore_errors=True)  # gives the space back
            last = max(self.steps(), default=None)
            stands = f"the one of step {last} is intact" if last else "there is none yet"
            raise InputError(
                f"{self.run}: the checkpoint of step {step} cannot be written ({one_line(error)}); {stands}"
            ) from error

    def steps(self, which: str = "last") -> list[int]:
        """Steps that there are whole checkpoints of."""
        return sorted(self._managers[which].all_steps())

    def restore(self, like: State, which: str = "last") -> State:
        """The newest checkpoint that can be read, in the shapes and on the devices of `like`.

        Raises:
            InputError: there is none, or none fits.
        """
        why = "there is none"
        for step in reversed(self.steps(which)):
            try:
                notes = self._checked(which, step)
                return self._restore(self._managers[which], step, like, notes.get("arrays"))
            except Exception as error:  # damaged after it was written: the one before may be whole
                if signals.came():  # orbax may turn it into another error
                    raise
                why = f"step {step}: {one_line(error)}"
        raise InputError(f"{self.run}: no {which} checkpoint that can be read ({why})")

    def _restore(self, manager: ocp.CheckpointManager, step: int, like: State, digest: str | None) -> State:
        items = ocp.args.Composite(state=ocp.args.StandardRestore(like._asdict()))
        with _silent_restore():
            state = State(**manager.restore(step, args=items)["state"])
        if int(state.step) != step:
            raise InputError(f"it is of step {int(state.step)}")
        if digest is not None and _digest(state) != digest:
            raise InputError("its arrays are not what was written")
        return state

    def _checked(self, which: str, step: int) -> dict[str, Any]:
        """The notes of a checkpoint. InputError where it is not what was written, or is of another run.

        Files are compared first, as libraries crash on some damaged ones. One that was killed before it wrote
        their digests has its arrays' in its notes. One of a version before has nothing but its files'.
        """
        folder = self.run / "checkpoints" / which / str(step)
        listed = os.path.lexists(folder / DIGESTS)
        if listed and (changed := changed_files(folder, DIGESTS)):
            raise InputError(f"{changed[0].relative_to(folder)} is not what was written")
        with silent_libraries():
            items = ocp.args.Composite(notes=ocp.args.JsonRestore())
            notes: dict[str, Any] = self._managers[which].restore(step, args=items)["notes"]
        if listed and notes.keys() == {"psnr"}:
            return notes
        if not is_sealed(json.dumps(notes) + "\n"):
            raise InputError("its notes are not what was written")
        if notes["run"] != self.of:
            raise _AnotherRun("it is of another run")
        return notes

    def begin(self, step: int) -> None:
        """Delete what is in the way of a run that goes on from a step: what is of later ones, or damaged.

        Raises:
            InputError: one is of another run.
        """
        for name, manager in self._managers.items():
            for own in list(manager.all_steps()):
                try:
                    self._checked(name, own)
                    whole = own <= step
                except _AnotherRun as error:
                    place = self.run / "checkpoints" / name / str(own)
                    raise InputError(f"{place}: {error}; move it away") from error
                except Exception:  # damaged
                    if signals.came():
                        raise
                    whole = False
                if not whole:
                    manager.delete(own)

    def close(self) -> None:
        for manager in self._managers.values():
            manager.close()


class _AnotherRun(InputError):
    """What is no own checkpoint is not read, and not deleted either."""


class _Listed(ocp.path.step.Metadata):  # type: ignore[misc]
    """A checkpoint whose time is its folder's where its own is damaged: restoring says what is wrong."""

    @property
    def commit_timestamp(self) -> datetime.datetime:
        try:
            return super().commit_timestamp
        except Exception:  # a parser on arbitrary bytes
            return datetime.datetime.fromtimestamp(self.path.stat().mtime, tz=datetime.UTC)


class _Names(ocp.path.step.NameFormat[_Listed]):  # type: ignore[misc]
    """Orbax's names of checkpoints; it would open none where the metadata of one of them are damaged."""

    def __init__(self) -> None:
        self._standard = ocp.path.step.standard_name_format()

    def build_name(self, step: int) -> str:
        return self._standard.build_name(step)

    def find_all(self, base_path: Any) -> Iterator[_Listed]:
        return (_Listed(found.step, found.path) for found in self._standard.find_all(base_path))

    def find_step(self, base_path: Any, step: int) -> Any:
        return self._standard.find_step(base_path, step)


@contextlib.contextmanager
def _silent_restore() -> Iterator[None]:
    with silent_libraries():
        try:
            yield
        except Exception:
            time.sleep(_LATE)
            raise


def _is_news(record: logging.LogRecord) -> bool:
    return not any(text in str(record.msg) for text in _RAISED)


def _manager(folder: Path, keep: int, reading: bool) -> ocp.CheckpointManager:
    options = ocp.CheckpointManagerOptions(
        max_to_keep=keep,
        create=not reading,
        cleanup_tmp_directories=not reading,
        enable_async_checkpointing=False,
        step_name_format=_Names(),
    )
    return ocp.CheckpointManager(folder.resolve(), options=options)


def _digest(state: State) -> str:
    """SHA-256 of all arrays, with their names, types and shapes."""
    found = hashlib.sha256()
    for path, leaf in jax.tree_util.tree_leaves_with_path(state):
        array = np.asarray(leaf)
        found.update(f"{jax.tree_util.keystr(path)} {array.dtype} {array.shape}\n".encode())
        found.update(array.tobytes())
    return found.hexdigest()


def _check_room(folder: Path, state: State) -> None:
    """Raise OSError where the disk, or a quota, has no room for a checkpoint.

    Orbax would find out in many threads, each of which prints a traceback, some of them long afterwards.
    """
    if jax.process_index() == 0:
        with tempfile.TemporaryFile(dir=folder) as file:
            for size in (*(leaf.nbytes for leaf in jax.tree.leaves(state)), _OVERHEAD):
                file.write(bytes(size))
