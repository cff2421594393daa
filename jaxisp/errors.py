"""The error that says the input is at fault, not the program. Free of JAX, so that the CLI starts fast."""


class InputError(ValueError):
    """Bad input: one line that names what is wrong and what would be right."""
