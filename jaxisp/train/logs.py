"""The log of a run: CSV files and TensorBoard events, both continued where a run is resumed."""

import csv
import io
import math
import os
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from jaxisp.io.files import open_input, write_text, writing

STEP_FIELDS = ("step", "epoch", "loss", "grad_norm", "lr", "images_per_second")
VALIDATION_FIELDS = ("step", "loss", "psnr", "psnr_in")
_FILES = {"log.csv": STEP_FIELDS, "validation.csv": VALIDATION_FIELDS}


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
        for name in _FILES:
            _truncate(run / name, step)
        self._events = Events(run / "tensorboard", step + 1)

    def steps(self, rows: Sequence[Mapping[str, Any]]) -> None:
        """Append rows, one a step; TensorBoard gets the last one with the mean loss of all."""
        self._append("log.csv", rows)
        mean = sum(row["loss"] for row in rows) / len(rows)
        self._scalars("train", rows[-1]["step"], {**rows[-1], "loss": mean})

    def validation(self, row: Mapping[str, Any]) -> None:
        """Append a validation."""
        self._append("validation.csv", [row])
        self._scalars("validation", row["step"], row)

    def close(self) -> None:
        self._events.close()

    def _append(self, name: str, rows: Sequence[Mapping[str, Any]]) -> None:
        path = self.run / name
        with writing(path), path.open("a", newline="") as file:
            csv.DictWriter(file, _FILES[name]).writerows(rows)

    def _scalars(self, group: str, step: int, row: Mapping[str, Any]) -> None:
        self._events.scalars(
            step, {f"{group}/{name}": v for name, v in row.items() if name not in ("step", "epoch")}
        )


def read_rows(path: Path) -> list[dict[str, str]]:
    """The rows of a log; none where it is missing. Lines that are damaged or were cut off are dropped.

    Raises:
        InputError: it cannot be read.
    """
    if not os.path.lexists(path):
        return []
    with open_input(path) as file:
        lines = file.read().decode(errors="replace").splitlines()
    rows = (dict(zip(_FILES[path.name], line.split(","))) for line in lines if _is_row(line, path.name))
    return list(rows)


def _is_row(line: str, name: str) -> bool:
    values = line.split(",")
    numbers = [_number(value) for value in values]
    return len(values) == len(_FILES[name]) and not any(map(math.isnan, numbers)) and values[0].isdecimal()


def _number(text: str) -> float:
    try:
        return float(text)
    except ValueError:
        return math.nan


def _truncate(path: Path, step: int) -> None:
    kept = [row for row in read_rows(path) if float(row["step"]) <= step]
    text = io.StringIO()
    writer = csv.DictWriter(text, _FILES[path.name])
    writer.writeheader()
    writer.writerows(kept)
    write_text(path, text.getvalue())
