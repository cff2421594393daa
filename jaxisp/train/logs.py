"""The log of a run: CSV files and TensorBoard events, both continued where a run is resumed."""

import contextlib
import csv
import io
import time
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from tensorboardX.event_file_writer import EventsWriter
from tensorboardX.proto.event_pb2 import Event, SessionLog
from tensorboardX.summary import scalar

from jaxisp.errors import InputError
from jaxisp.io.files import reason, write_text

STEP_FIELDS = ("step", "epoch", "loss", "grad_norm", "lr", "images_per_second")
VALIDATION_FIELDS = ("step", "loss", "psnr", "psnr_in")


class Log:
    """RUN/log.csv has a row for each step, RUN/validation.csv for each validation, RUN/tensorboard both.

    Args:
        run: the folder.
        step: the log goes on after this one: rows of later steps, of a run that was killed, are dropped.

    Raises:
        InputError: a file cannot be written, as where the disk is full; all methods raise it.
    """

    def __init__(self, run: Path, step: int) -> None:
        self.run = run
        for name, fields in (("log.csv", STEP_FIELDS), ("validation.csv", VALIDATION_FIELDS)):
            _truncate(run / name, fields, step)
        self._events = _Events(run / "tensorboard", step + 1)

    def steps(self, rows: Sequence[Mapping[str, Any]]) -> None:
        """Append rows, one a step; TensorBoard gets the last one with the mean loss of all."""
        self._append("log.csv", STEP_FIELDS, rows)
        mean = sum(row["loss"] for row in rows) / len(rows)
        self._scalars("train", rows[-1]["step"], {**rows[-1], "loss": mean})

    def validation(self, row: Mapping[str, Any]) -> None:
        """Append a validation."""
        self._append("validation.csv", VALIDATION_FIELDS, [row])
        self._scalars("validation", row["step"], row)

    def close(self) -> None:
        self._events.close()

    def _append(self, name: str, fields: Sequence[str], rows: Sequence[Mapping[str, Any]]) -> None:
        path = self.run / name
        with _writing(path), path.open("a", newline="") as file:
            csv.DictWriter(file, fields).writerows(rows)

    def _scalars(self, group: str, step: int, row: Mapping[str, Any]) -> None:
        self._events.scalars(
            step, {f"{group}/{name}": v for name, v in row.items() if name not in ("step", "epoch")}
        )


class _Events:
    """A file of TensorBoard events, written where it is called: `SummaryWriter` writes in a thread, whose
    errors are lost to the caller and printed.

    Args:
        folder: gets the file; made where it is missing.
        step: the first one: TensorBoard drops later ones of files before.
    """

    def __init__(self, folder: Path, step: int) -> None:
        self.folder = folder
        with _writing(folder):
            folder.mkdir(parents=True, exist_ok=True)
            self._writer = EventsWriter(str(folder / "events"))
            self._write(step, session_log=SessionLog(status=SessionLog.START))
            self._writer.flush()

    def scalars(self, step: int, values: Mapping[str, float]) -> None:
        with _writing(self.folder):
            for name, value in values.items():
                self._write(step, summary=scalar(name, value))
            self._writer.flush()

    def close(self) -> None:
        with _writing(self.folder):
            self._writer.close()

    def _write(self, step: int, **content: Any) -> None:
        self._writer.write_event(Event(wall_time=time.time(), step=step, **content))


@contextlib.contextmanager
def _writing(path: Path) -> Iterator[None]:
    """InputError that names the path for what the system says."""
    try:
        yield
    except OSError as error:
        raise InputError(f"{path}: cannot be written: {reason(error)}") from error


def read_rows(path: Path) -> list[dict[str, str]]:
    """The rows of a CSV file; none where it is missing. A last line that was cut off is dropped."""
    if not path.exists():
        return []
    with path.open(newline="") as file:
        rows = list(csv.DictReader(file))
    return [row for row in rows if None not in row.values() and row["step"].isdigit()]


def _truncate(path: Path, fields: Sequence[str], step: int) -> None:
    kept = [row for row in read_rows(path) if int(row["step"]) <= step]
    text = io.StringIO()
    writer = csv.DictWriter(text, fields)
    writer.writeheader()
    writer.writerows(kept)
    write_text(path, text.getvalue())
