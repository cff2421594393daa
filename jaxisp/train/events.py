"""A file of TensorBoard events."""

import time
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from tensorboardX.event_file_writer import EventsWriter
from tensorboardX.proto.event_pb2 import Event, SessionLog
from tensorboardX.summary import scalar

from jaxisp.io.files import writing


class Events:
    """A file of TensorBoard events, written where it is called: `SummaryWriter` writes in a thread, whose
    errors are lost to the caller and printed.

    Args:
        folder: gets the file; made where it is missing.
        step: the first one: TensorBoard drops later ones of files before.
    """

    def __init__(self, folder: Path, step: int) -> None:
        self.folder = folder
        with writing(folder):
            folder.mkdir(parents=True, exist_ok=True)
            self._writer = EventsWriter(str(folder / "events"))
            self._write(step, session_log=SessionLog(status=SessionLog.START))
            self._writer.flush()

    def scalars(self, step: int, values: Mapping[str, float]) -> None:
        with writing(self.folder):
            for name, value in values.items():
                self._write(step, summary=scalar(name, value))
            self._writer.flush()

    def close(self) -> None:
        with writing(self.folder):
            self._writer.close()

    def _write(self, step: int, **content: Any) -> None:
        self._writer.write_event(Event(wall_time=time.time(), step=step, **content))
