"""The error that says the input is at fault, not the program. Free of JAX, so that the CLI starts fast."""

import difflib
from collections.abc import Iterable


class InputError(ValueError):
    """Bad input: one line that names what is wrong and what would be right."""


def meant(name: str, known: Iterable[str]) -> str:
    """What an unknown name may stand for, to end an error with; "" where nothing is like it."""
    close = difflib.get_close_matches(name, list(known), 3)
    return f"; is it {' or '.join(close)}?" if close else ""


def one_line(error: BaseException, most: int = 200) -> str:
    """What an error says, as one line of at most so many characters."""
    text = " ".join(str(error).split())
    return text if len(text) <= most else text[: most - 3] + "..."
