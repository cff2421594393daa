"""The log of a run: CSV files and TensorBoard events, both continued where a run is resumed."""

import csv
import io
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from jaxisp.io.files import write_text, writing

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
        from jaxisp.train.events import Events  # loads PyTorch, for seconds, where that is installed

        self.run = run
        for name, fields in (("log.csv", STEP_FIELDS), ("validation.csv", VALIDATION_FIELDS)):
            _truncate(run / name, fields, step)
        self._events = Events(run / "tensorboard", step + 1)

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
        with writing(path), path.open("a", newline="") as file:
            csv.DictWriter(file, fields).writerows(rows)

    def _scalars(self, group: str, step: int, row: Mapping[str, Any]) -> None:
        self._events.scalars(
            step, {f"{group}/{name}": v for name, v in row.items() if name not in ("step", "epoch")}
        )


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
