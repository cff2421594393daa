"""Every case: a converter, a camera, a switch, a strength; and which half it is in."""

import dataclasses
from collections.abc import Iterator

from . import darktable, libraw, rawtherapee
from .cameras import CAMERAS
from .chance import half_of, order
from .switches import NONE, Converter, Switch

CONVERTERS: dict[str, Converter] = {"rawtherapee": rawtherapee, "darktable": darktable, "libraw": libraw}
PLAIN, LOSSLESS = "plain", "plain_lossless"
_CAMERAS_EACH = 2
_LEVELS = (3, 5, 1, 4, 2)
"""In which order strengths are made: a part of a run has the middle ones."""
_EVERY_CAMERA = (PLAIN, LOSSLESS)


@dataclasses.dataclass(frozen=True)
class Case:
    """A data set to be made.

    Attributes:
        converter, camera, switch: by name.
        level: strength from 1 on; 0 of a plain profile.
    """

    converter: str
    camera: str
    switch: str
    level: int
    half: str

    @property
    def name(self) -> str:
        """The folder."""
        level = f"-{self.level}" if self.level else ""
        return f"{self.converter}-{self.camera}-{self.switch}{level}"

    @property
    def what(self) -> Switch:
        if self.switch == PLAIN:
            return Switch(NONE, [{}])
        if self.switch == LOSSLESS:
            return Switch(NONE, [{"lossless": 100}])
        return CONVERTERS[self.converter].SWITCHES[self.switch]

    @property
    def plain(self) -> "Case":
        """The same camera with the switch off."""
        lost = any("lossless" in own for own in self.what.levels)
        return dataclasses.replace(self, switch=LOSSLESS if lost else PLAIN, level=0)

    @property
    def settings(self) -> dict[str, object]:
        return dict(self.what.levels[max(self.level, 1) - 1])


def cases(half: str) -> Iterator[Case]:
    """All cases of a half, each camera's plain profile first; a camera and a switch are in one half."""
    found = [
        Case(converter, camera, switch, level, half)
        for converter, driver in CONVERTERS.items()
        for switch, what in driver.SWITCHES.items()
        for camera in _seen_by(converter, switch)
        if half_of(converter, camera, switch) == half
        for level in range(1, 1 + len(what.levels))
    ]
    found.sort(key=lambda case: (_LEVELS.index(case.level), order(case.name)))
    plain = dict.fromkeys(case.plain for case in found)
    yield from sorted(plain, key=lambda case: (case.switch, case.name))
    yield from found


def sample(half: str) -> list[Case]:
    """A part of a half that is chosen before anything is run: every switch once, at its middle strength, and
    every camera's plain profile once, shuffled, so that a run that is cut short is a sample as well."""
    found: dict[tuple[str, ...], Case] = {}
    for case in sorted(cases(half), key=lambda case: order("sample", case.name)):
        if case.switch != LOSSLESS and case.level in (0, _middle(case)):
            found.setdefault((case.converter, case.switch) if case.level else (case.camera,), case)
    return list(found.values())


def _middle(case: Case) -> int:
    return (1 + len(case.what.levels)) // 2


def _seen_by(converter: str, switch: str) -> list[str]:
    return sorted(CAMERAS, key=lambda camera: order(converter, switch, camera))[:_CAMERAS_EACH]
