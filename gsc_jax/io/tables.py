"""JSON and TOML files as trees of dictionaries, lists, texts and numbers.

Trees of more than 200 levels and integers of more than 64 bits are refused, so that every tree that
is returned can be printed, validated and converted to floats.
"""

import json
import tomllib
from pathlib import Path
from typing import Any

from gsc_jax.io.files import check_allocation, existing_file
from gsc_jax.io.validation import reported

BYTES_PER_CHARACTER = 40
"""Memory of a parsed tree per byte of text: an empty dictionary has 64 bytes for "{},"."""
MAX_DEPTH = 200
"""Two levels for each of up to 90 halvings in a streamed scene; other files are 8 deep at most."""
PARSERS = {".json": json.loads, ".toml": tomllib.loads}


def read_table(path: Path, *, remedy: str, max_bytes: int | None = None) -> Any:
    """Parse a file in UTF-8 as TOML if its suffix is .toml, else as JSON.

    One that is bad or takes more than `max_bytes` raises InputError, which ends with the `remedy`.
    """
    suffix = ".toml" if path.suffix.lower() == ".toml" else ".json"
    kind = suffix[1:].upper()
    existing_file(path, expected=kind)
    with reported(f"{path}: not valid {kind}", f"; {remedy}"):
        check_allocation(path, BYTES_PER_CHARACTER * path.stat().st_size, max_bytes)
        content = PARSERS[suffix](path.read_text(encoding="utf-8-sig"))
        _check_tree(content, MAX_DEPTH)
    return content


def _check_tree(tree: Any, depth: int) -> None:
    if isinstance(tree, dict | list):
        if not depth:
            raise ValueError(f"more than {MAX_DEPTH} levels deep")
        for entry in tree.values() if isinstance(tree, dict) else tree:
            _check_tree(entry, depth - 1)
    elif isinstance(tree, int) and not -(2**63) <= tree < 2**63:
        raise ValueError("an integer of more than 64 bits")
