"""Errors of pydantic as one line that names the file, the key, what was expected and found."""

import contextlib
import difflib
import reprlib
from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import Any

from pydantic import ValidationError

from gsc_jax.scene import InputError

SHOWN_CHARACTERS, MESSAGE_CHARACTERS = 80, 250
NO_TABLE = ("model_type", "dataclass_type")
UNKNOWN_KEY = ("extra_forbidden", "unexpected_keyword_argument")
Errors = type[Exception] | tuple[type[Exception], ...]


def one_line(error: ValidationError, where: str, given: Any, *, known: Iterable[str] = ()) -> str:
    """Describe the first invalid key of the `given` value for which pydantic raised an error.

    "net.toml: size: expected greater than 0, found 0", or "net.toml: unknown key 'sise' (did you
    mean 'size'?)", which suggests one of the `known` keys. `where` is the file, and the table in it
    if there are several. If the value fits none of several types, the line names all of them.
    """
    problems = error.errors(include_url=False)
    first = problems[0]
    key, found = _located(first["loc"], given)
    if first["type"] in UNKNOWN_KEY:
        return f"{where}: unknown key {shown(key)}{suggestion(str(first['loc'][-1]), list(known))}"
    name = f"{where}: {key}" if key else where
    if first["type"].startswith("missing"):
        last, short = first["loc"][-1], f"expected more values, found {shown(found)}"
        return f"{name}: {short if isinstance(last, int) else f'{last!r} is missing'}"
    reasons = dict.fromkeys(
        "expected an object with keys"
        if problem["type"] in NO_TABLE
        else problem["msg"].removeprefix("Value error, ").replace("Input should be", "expected", 1)
        for problem in problems
        if _located(problem["loc"], given)[0] == key
    )
    whole = not key and first["type"] not in NO_TABLE
    return f"{name}: {' or '.join(reasons)}" + ("" if whole else f", found {shown(found)}")


def shown(value: Any) -> str:
    """The value as in Python code, shortened in the middle to a part of a line."""
    text = " ".join(_REPR.repr(value).split())
    half = SHOWN_CHARACTERS // 2
    return text if len(text) <= SHOWN_CHARACTERS else f"{text[:half]}...{text[-half:]}"


_REPR = reprlib.Repr()
_REPR.maxstring = _REPR.maxother = _REPR.maxlong = SHOWN_CHARACTERS


def printable(text: str) -> str:
    """The text with escapes for what a terminal would not show: it could obey such sequences."""
    return "".join(sign if sign.isprintable() else repr(sign)[1:-1] for sign in text)


def brief(error: Exception) -> str:
    """The message of an exception of another library, on one line that is not too long."""
    text = " ".join(str(error).split()) or type(error).__name__
    return text if len(text) <= MESSAGE_CHARACTERS else f"{text[:MESSAGE_CHARACTERS]}..."


@contextlib.contextmanager
def reported(before: str, after: str) -> Iterator[None]:
    """Report an error of another library as an InputError: its message in brackets between these.

    Decoders raise anything on damaged bytes, and have no common base class of their errors.
    """
    try:
        yield
    except InputError:
        raise
    except Exception as error:
        raise InputError(f"{before} ({brief(error)}){after}") from error


@contextlib.contextmanager
def naming(where: object, *, errors: Errors = InputError, remedy: str = "") -> Iterator[None]:
    """Turn errors in the block into InputErrors whose messages begin with `where`."""
    try:
        yield
    except errors as error:
        raise InputError(f"{where}: {error}{remedy}") from error


def _located(location: Sequence[int | str], given: Any) -> tuple[str, Any]:
    """A location as "loop.rates[2]", without pydantic's names of types, and the value there."""
    key = ""
    for step in location:
        if isinstance(given, Mapping) and step in given:
            given, key = given[step], f"{key}.{step}"
        elif isinstance(given, list | tuple) and isinstance(step, int) and step < len(given):
            given, key = given[step], f"{key}[{step}]"
    return key.removeprefix("."), given


def suggestion(key: str, known: list[str]) -> str:
    """What a mistyped key may mean, or all that are known, as the end of a sentence."""
    if close := difflib.get_close_matches(key.lower(), known, n=1):
        return f" (did you mean {close[0]!r}?)"
    return f", expected one of {', '.join(known)}" if known else ""
