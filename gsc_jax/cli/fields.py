"""Tables of a file, checked against a dataclass: names, types, and what to write instead.

JSON and TOML know neither paths nor tuples, and JSON writes 1.0 as 1 at times; what a value may be
is told by the annotations of the dataclass, which are few: the plain types, `Literal`, `Path`,
tuples of them, and all of these or None.
"""

import dataclasses
import difflib
import math
import types
import typing
from collections.abc import Mapping
from pathlib import Path
from typing import Any, TypeVar

from gsc_jax.scene import InputError

Instance = TypeVar("Instance")

WORDS: dict[Any, str] = {
    bool: "true or false",
    int: "a whole number",
    float: "a number",
    str: "a text",
    Path: "a path",
    type(None): "null",
}
"""What is expected, for people."""


def checked(table: Any, kind: type, where: str) -> dict[str, Any]:
    """The entries of a table that are to become fields of a dataclass.

    Args:
        table: What a file holds.
        kind: The dataclass.
        where: What the table is called in messages, with its file.

    Returns:
        Values by field name, each of the type that the field has.

    Raises:
        InputError: if this is no table, it has a key that is no field, or a value does not fit.
    """
    hints = typing.get_type_hints(kind)
    known_keys(table, list(hints), where)
    return {name: fitted(value, hints[name], f"{where}.{name}") for name, value in table.items()}


def changed(base: Instance, table: Any, where: str) -> Instance:
    """A dataclass with the fields that a table holds, of which some may be tables themselves.

    Args:
        base: What the fields are that the table leaves out.
        table: What a file holds.
        where: What the table is called in messages, with its file.

    Raises:
        InputError: as `checked`, or if the dataclass refuses a value.
    """
    fields = {field.name for field in dataclasses.fields(typing.cast(Any, base))}
    known_keys(table, sorted(fields), where)
    nested = {name for name in table if dataclasses.is_dataclass(getattr(base, name))}
    flat = {name: value for name, value in table.items() if name not in nested}
    values = checked(flat, type(base), where)
    for name in nested:
        values[name] = changed(getattr(base, name), table[name], f"{where}.{name}")
    try:
        return dataclasses.replace(typing.cast(Any, base), **values)
    except ValueError as error:
        raise InputError(f"{where}: {error}") from error


def known_keys(table: Any, known: list[str], where: str) -> None:
    """Refuses what is no table, or one with other keys than these."""
    if not isinstance(table, Mapping):
        raise InputError(f"{where}: expected a table of keys and values, found {_shown(table)}")
    for key in table:
        if key not in known:
            close = difflib.get_close_matches(str(key).lower(), known, n=1)
            meant = f"did you mean {close[0]!r}? " if close else ""
            raise InputError(
                f"{where}: unknown key {key!r}, {meant}expected some of {', '.join(known)}"
            )


def fitted(value: Any, hint: Any, where: str) -> Any:
    """A value as the type that an annotation names.

    Args:
        value: What a file holds.
        hint: The annotation.
        where: What the value is called in messages, with its file.

    Raises:
        InputError: if it is of another type.
    """
    union = typing.get_origin(hint) in (typing.Union, types.UnionType)
    options = typing.get_args(hint) if union else (hint,)
    for option in options:
        try:
            return _as(value, option)
        except TypeError:
            continue
    expected = " or ".join(_words(option) for option in options)
    raise InputError(f"{where}: expected {expected}, found {_shown(value)}")


def _as(value: Any, hint: Any) -> Any:
    """The value as a type, or a TypeError."""
    origin, parts = typing.get_origin(hint), typing.get_args(hint)
    if origin is tuple:
        return _as_tuple(value, parts)
    if origin is typing.Literal and isinstance(value, str) and value in parts:
        return value
    if hint is Path and isinstance(value, str):
        return Path(value)
    if hint is float and isinstance(value, int | float) and not isinstance(value, bool):
        if math.isfinite(value):
            return float(value)
        raise TypeError
    if hint is not float and type(value) is hint:
        return value
    raise TypeError


def _as_tuple(value: Any, parts: tuple[Any, ...]) -> tuple:
    """A list as a tuple of such parts, or a TypeError."""
    if not isinstance(value, list | tuple):
        raise TypeError
    kinds = parts[:1] * len(value) if parts[1:] == (...,) else parts
    if len(kinds) != len(value):
        raise TypeError
    return tuple(_as(entry, kind) for entry, kind in zip(value, kinds, strict=True))


def _words(hint: Any) -> str:
    parts = typing.get_args(hint)
    if typing.get_origin(hint) is typing.Literal:
        return f"one of {', '.join(parts)}"
    if typing.get_origin(hint) is tuple:
        return f"a list, each {_words(parts[0])}"
    return WORDS[hint]


def _shown(value: Any) -> str:
    text = " ".join(repr(value).split())
    return text if len(text) <= 40 else f"{text[:37]}..."
