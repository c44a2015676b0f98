"""Damaged copies of valid bytes, texts and trees; the generator `rng` draws all choices."""

import copy
import json
import re
import struct
from random import Random
from typing import Any

DEEP, LONG = "@deep@", "@long@"
"""Texts in a tree that stand for a deeply nested list, and for an integer of many digits: the
encoder of JSON can write neither."""
NUMBERS = (0, -1, 1, 2, 255, 256, 65_535, 2**31 - 1, 2**31, 2**32 - 1, 2**32, 2**63, 2**64 - 1)
FLOATS = (0.0, -0.0, -1.5, 1e-300, 1e39, 1e300, -1e300, float("nan"), float("inf"), float("-inf"))
TEXTS = ("", ".", "..", "../a", "/", "/etc", "a\0b", "\ud800", "a\nb", "x" * 300, "a/" * 1500, "é")
WORDS = (
    *("nan", "-inf", "1e999", "1e300", "-1", "0", "1" * 30, "9" * 5000, "0x" + "f" * 5000, "1_0"),
    *("list", "uchar", "double", "element", "property", "end_header", "comment", "ascii", "sem:x"),
    *("vertex", "true", "null", "''", "", "[", "{", '"', "#", "PINHOLE", "é", "\r", "\0", "a.b.c"),
)
PACKED = [struct.pack("<Q", n % 2**64) for n in NUMBERS] + [
    struct.pack("<I", n % 2**32) for n in NUMBERS
]
PACKED += [struct.pack("<d", x) for x in FLOATS]
PACKED += [struct.pack("<f", x) for x in FLOATS if not 1e38 < abs(x) < 1e308]


def damaged_bytes(rng: Random, data: bytes) -> bytes:
    """One to four flips, cuts, insertions, copies, or numbers written over the data."""
    content = bytearray(data)
    for _ in range(rng.choice((1, 1, 2, 4))):
        at, size = rng.randrange(len(content) + 1), rng.choice((1, 2, 4, 8, 30))
        match rng.randrange(7):
            case 0 if at < len(content):
                content[at] ^= 1 << rng.randrange(8)
            case 1 if at < len(content):
                content[at] = rng.choice((0, 1, 127, 128, 255, 10, 32))
            case 2:
                del content[at:]
            case 3:
                del content[at : at + size]
            case 4:
                content[at:at] = rng.randbytes(size)
            case 5:
                other = rng.randrange(len(content) + 1)
                content[at : at + size] = content[other : other + size]
            case _:
                number = rng.choice(PACKED)
                content[at : at + len(number)] = number
    return bytes(content)


def damaged_text(rng: Random, text: str) -> str:
    """One to three words replaced, or lines removed, repeated or exchanged."""
    for _ in range(rng.choice((1, 1, 2, 3))):
        lines = text.split("\n")
        one, other = rng.randrange(len(lines)), rng.randrange(len(lines))
        match rng.randrange(8):
            case 0:
                del lines[one]
            case 1:
                lines.insert(one, lines[other])
            case 2:
                lines[one], lines[other] = lines[other], lines[one]
            case _:
                words = re.split(r"(\W)", lines[one])
                if rng.random() < 0.5:  # a whole number, with sign, point and exponent
                    words = re.split(r"(\s)", lines[one])
                words[rng.randrange(len(words))] = rng.choice((*WORDS, *map(str, NUMBERS)))
                lines[one] = "".join(words)
        text = "\n".join(lines)
    return text


def damaged_tree(rng: Random, tree: Any) -> Any:
    """A copy in which one to three values or keys are replaced, removed, repeated or wrapped."""
    tree = copy.deepcopy(tree)
    for _ in range(rng.choice((1, 1, 2, 3))):
        tree = _damaged_tree(rng, tree)
    return tree


def _damaged_tree(rng: Random, tree: Any) -> Any:
    if not isinstance(tree, dict | list) or not tree or rng.random() < 0.1:
        return _strange(rng, tree)
    key = rng.choice(list(tree)) if isinstance(tree, dict) else rng.randrange(len(tree))
    if rng.random() < 0.75:
        tree[key] = _damaged_tree(rng, tree[key])
    elif isinstance(tree, list):
        tree[key:key] = [copy.deepcopy(tree[key])] * rng.choice((1, 3)) if key % 2 else []
        del tree[-1 if rng.random() < 0.5 else 0]
    elif rng.random() < 0.5:
        tree[rng.choice((*TEXTS[:4], f"{key}x", str(key).upper()))] = tree.pop(key)
    else:
        del tree[key]
    return tree


def _strange(rng: Random, value: Any) -> Any:
    wrapped = ([value], {"a": value}, [value, value], str(value), [], {}, DEEP, LONG, None, True)
    return rng.choice(rng.choice((wrapped, NUMBERS, FLOATS, TEXTS)))


def json_text(rng: Random, tree: Any) -> str:
    """A tree as JSON."""
    return _expanded(rng, json.dumps(tree))


def toml_text(rng: Random, tree: Any) -> str:
    """A tree as TOML; what TOML cannot hold becomes something that is not TOML."""
    if not isinstance(tree, dict):
        return _expanded(rng, _toml(tree))
    plain = {key: value for key, value in tree.items() if not isinstance(value, dict)}
    lines = [f"{_toml_key(key)} = {_toml(value)}" for key, value in plain.items()]
    for name in tree.keys() - plain.keys():
        lines += [f"[{_toml_key(name)}]"]
        lines += [f"{_toml_key(key)} = {_toml(value)}" for key, value in tree[name].items()]
    return _expanded(rng, "\n".join(lines))


def _toml(value: Any) -> str:
    if isinstance(value, dict):
        entries = (f"{_toml_key(key)} = {_toml(entry)}" for key, entry in value.items())
        return "{" + ", ".join(entries) + "}"
    if isinstance(value, list | tuple):
        return "[" + ", ".join(map(_toml, value)) + "]"
    return str(value) if isinstance(value, float) else json.dumps(value)


def _toml_key(key: str) -> str:
    return key if re.fullmatch(r"[A-Za-z_]+", key) else json.dumps(key)


def _expanded(rng: Random, text: str) -> str:
    depth = rng.choice((20, 150, 900, 20_000))
    pair = rng.choice(("[]", "{}")) if depth == 20 else "[]"
    inner = '"a":' if pair == "{}" else ""
    nested = (pair[0] + inner) * depth + "1" + pair[1] * depth
    digits = rng.choice(("9" * 30, "9" * 400, "9" * 5000, "0x" + "f" * 5000, "1e999"))
    return text.replace(f'"{DEEP}"', nested).replace(f'"{LONG}"', digits)
