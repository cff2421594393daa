"""The error that says the input is at fault, not the program. Free of JAX, so that the CLI starts fast."""


class InputError(ValueError):
    """Bad input: one line that names what is wrong and what would be right."""


def one_line(error: BaseException, most: int = 200) -> str:
    """What an error says, as one line of at most so many characters."""
    text = " ".join(str(error).split())
    return text if len(text) <= most else text[: most - 3] + "..."
