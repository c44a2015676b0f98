"""Damage to headers, text, JSON and arrays, made of the changes to any bytes of `mutate`."""

import json
import re
from collections.abc import Callable
from random import Random

from fuzz.mutate import damaged_bytes, damaged_text, damaged_tree, json_text

Damage = Callable[[Random, bytes], bytes]
"""Function from the bytes of a file to those of a damaged one."""


def damaged_header(rng: Random, data: bytes, end: bytes = b"end_header\n") -> bytes:
    """Damage the words in the header of a file, the bytes after the header, or both."""
    header, found, body = data.partition(end)
    if rng.random() < 0.7:
        text = damaged_text(rng, (header + found).decode("latin-1"))
        header, found = text.encode("utf-8", "replace"), b""
    if rng.random() < 0.4:
        body = damaged_bytes(rng, body)
    return header + found + body


def damaged_utf8(rng: Random, data: bytes) -> bytes:
    return damaged_text(rng, data.decode()).encode("utf-8", "replace")


def damaged_json(rng: Random, data: bytes) -> bytes:
    if rng.random() < 0.2:
        return damaged_utf8(rng, data)
    return json_text(rng, damaged_tree(rng, json.loads(data))).encode("utf-8", "replace")


def damaged_npy(rng: Random, data: bytes) -> bytes:
    if rng.random() < 0.5:
        return damaged_bytes(rng, data)
    header, _, body = data.partition(b"}")
    numbers = (
        "'<f4'",
        "'|O'",
        "'<U9'",
        "(3,)",
        "(16, -1)",
        "(9**99,)",
        "99999999999",
        "None",
        "((",
    )
    text = re.sub(
        r"'<?f4'|'\|b1'|\(16,\)|False", lambda _: rng.choice(numbers), header.decode("latin-1")
    )
    return text.encode("latin-1") + b"}" + body
