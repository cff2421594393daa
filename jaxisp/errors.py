"""The error that says the input is at fault, not the program. Free of JAX, so that the CLI starts fast."""

import difflib
from collections.abc import Iterable
from typing import Any

_LONGEST = 10_000
"""Characters of a message, which may hold two paths, of 4096 at the most, or what stands in a file."""
_BEGINNING = 4
"""The fewest letters that say what is meant."""


class InputError(ValueError):
    """Bad input: one line that names what is wrong and what would be right.

    Example:
        >>> import jaxisp
        >>> try:
        ...     jaxisp.recipes.amwgn().without("mosaic")
        ... except jaxisp.InputError as error:
        ...     print(type(error).__mro__[1].__name__)
        ValueError
    """

    def __init__(self, text: str = "") -> None:
        lines = text.splitlines()
        text = text if len(lines) < 2 else " ".join(line.strip() for line in lines)
        if len(text) > _LONGEST:  # a path may be long, and what is wrong comes after it
            text = f"{text[: _LONGEST // 2]}...{text[3 - _LONGEST // 2 :]}"
        super().__init__(text)


class UnknownStage(InputError, KeyError):
    """There is no stage of that name; a KeyError too, as the registry is a dict."""

    __str__ = Exception.__str__  # a KeyError shows its text in quotes


def meant(name: str, known: Iterable[str]) -> str:
    """What an unknown name may stand for, to end an error with; "" where nothing is like it.

    Capitals, and `_` for `-`, make no difference; a name may be the beginning of another.
    """
    same = {_plain(own): own for own in known}
    given = _plain(name)
    close = difflib.get_close_matches(given, same, 3) if given not in same else [given]
    if not close and len(given) >= _BEGINNING:
        close = [own for own in same if own.startswith(given[: _beginning(given)])][:3]
    return f"; is it {' or '.join(same[own] for own in close)}?" if close else ""


def _plain(name: str) -> str:
    return name.lower().replace("-", "_")


def _beginning(name: str) -> int:
    """Letters that another name has to begin with likewise."""
    return max(_BEGINNING, -(-3 * len(name) // 4))


def printable(text: str) -> str:
    """A text, of files and their names perhaps, without what a terminal would act on.

    What is no letter, sign or blank (control characters, directions of writing, bytes that are no UTF-8)
    stands as an escape like `\\x1b`; line breaks and other blanks are spaces.
    """
    return "".join(c if c.isprintable() else " " if c.isspace() else _escape(c) for c in text)


def printable_lines(text: str) -> str:
    """`printable` of each line of a text, as of a page that shows names of others."""
    return "\n".join(line if line.isprintable() else printable(line) for line in text.split("\n"))


def _escape(character: str) -> str:
    return character.encode("unicode_escape").decode()


def one_line(error: BaseException, most: int = 200) -> str:
    """What an error says, as one line of at most so many characters."""
    text = " ".join(str(error).split())
    return text if len(text) <= most else text[: most - 3] + "..."


def short(value: Any) -> str:
    """A value from anybody as it may stand in one line of an error."""
    try:
        text = repr(value)
    except RecursionError:
        text = "tables nested too deeply"
    return text if len(text) < 120 else text[:120] + "..."
