"""A switch of a converter, and what it is in the vocabulary of the diagnosis."""

import dataclasses
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Protocol

NONE, OUTSIDE = "none", "outside the library"
Settings = Mapping[str, Any]
"""What a switch sets, in the converter's own words; values beside JPEG's are strings or numbers."""


@dataclasses.dataclass(frozen=True)
class Switch:
    """One module of a converter that is switched on.

    Attributes:
        truth: the effect; `NONE` where a base takes it up, or a file's header states it; `OUTSIDE` of the
            vocabulary.
        levels: its settings from weak to strong.
        also: effects that are right answers too.
    """

    truth: str
    levels: Sequence[Settings]
    also: tuple[str, ...] = ()


class Converter(Protocol):
    """A program that develops RAW files, driven from outside."""

    SWITCHES: Mapping[str, Switch]

    def develop(self, raws: Sequence[Path], camera: str, settings: Settings, out: Path) -> list[Path]:
        """Develop files with a camera's plain profile and these settings over it, into a folder.

        Returns:
            the pictures, in the order of the files.
        """
