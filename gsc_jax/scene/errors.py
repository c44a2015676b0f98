"""The error for bad input."""


class InputError(ValueError):
    """Bad input; the message names the file, what was expected and found, and what to do.

    Readers, detectors and option checks raise it with a one-line message; the command line prints
    that line and exits with code 2.
    """
