"""The error for bad input."""


class InputError(ValueError):
    """Bad input; its one-line message names the file, what was expected, found, and what to do."""
