"""The error for input that somebody can mend."""


class InputError(ValueError):
    """Bad input: names the file, what was expected and found, and what to do about it.

    Readers, detectors and option checks raise it with a one-line message for people; the command
    line prints that line and exits with code 2.
    """
