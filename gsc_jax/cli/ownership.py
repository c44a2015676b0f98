"""Which files in a folder of results are from an earlier run; all others are refused.

A report (result.json, render.json, edit.json) lists the files of its run. The list counts only with
a seal for this user and this folder, so that a report that was edited, copied or made by others
lets no file be replaced or removed. The same holds for the journal of a run that was killed.
"""

import contextlib
import hmac
import json
import os
from collections.abc import Sequence
from pathlib import Path, PurePosixPath

from gsc_jax.cli.cache import seal
from gsc_jax.io.files import existing_file
from gsc_jax.io.tables import read_table
from gsc_jax.scene import InputError

UNFINISHED, JOURNAL = ".unfinished", "journal.json"
"""Folder for everything unfinished, inside the folder of results, and the journal in it."""


def refuse_overlap(out: Path, inputs: Sequence[Path], *, written: Sequence[str]) -> None:
    """Raise InputError if writing the names `written` in the folder `out` changes an input.

    This is so for an input that would be overwritten, and for a folder of inputs with `out` inside:
    the next run would read the results as inputs.
    """
    folder = Path(os.path.realpath(out))
    results = [os.path.realpath(out / name) for name in written]
    for path in inputs:
        place = Path(os.path.realpath(path))
        if any(place.is_relative_to(result) for result in results):
            raise InputError(f"{path}: the results would overwrite this input; give another --out")
        if place.is_dir() and folder.is_relative_to(place):
            raise InputError(
                f"{out}: lies in {path}, where the next run would read the results as input; give "
                "another --out"
            )


def refuse_foreign(out: Path, names: Sequence[str], *, report: str) -> None:
    """Raise InputError if one of the files exists and is not from an earlier run."""
    own = set(earlier_outputs(out, report))
    for name in names:
        if os.path.lexists(out / name) and name not in own:
            raise InputError(
                f"{out / name}: exists, and {report} does not list it as the output of an earlier "
                "run of this user in this folder; give another --out"
            )


def refuse_foreign_file(path: Path, mark: str) -> None:
    """Raise InputError if a file exists and does not have a text at its beginning, as ours have."""
    own = path.is_dir() or not os.path.lexists(path)  # a folder is refused later
    with contextlib.suppress(InputError, OSError), existing_file(path, expected="").open("rb") as f:
        own = mark.encode() in f.read(4096)
    if not own:
        raise InputError(f"{path}: exists and is not from an earlier run; choose another name")


def refuse_blocked(out: Path, names: Sequence[str]) -> None:
    """Raise InputError for a folder where a file is to be written, or a file where a folder is."""
    folders = {out / place for name in names for place in PurePosixPath(name).parents}
    blocked = [out / name for name in names if (out / name).is_dir()]
    blocked += [place for place in sorted(folders) if place.exists() and not place.is_dir()]
    if blocked:
        kind = "folder" if blocked[0].is_dir() else "file"
        raise InputError(f"{blocked[0]}: is a {kind}, where the results would go; move it")


def earlier_outputs(out: Path, report: str) -> list[str]:
    """Files that earlier runs of this user have written to a folder, by its report and journal."""
    names = read_journal(out)["moved"]
    with contextlib.suppress(InputError, OSError, LookupError, TypeError):
        content = read_table(out / report, remedy="")
        valid = report_seal(out, report, content["outputs"])
        if hmac.compare_digest(content["seal"], valid):
            return [*names, *content["outputs"]]
    return names


def read_journal(out: Path) -> dict[str, list[str]]:
    """What a killed run of this user has still to move and remove; empty lists if nothing."""
    with contextlib.suppress(OSError, ValueError):
        path = existing_file(out / UNFINISHED / JOURNAL, expected="a journal")
        content = path.read_bytes()
        text = content.partition(b"\n")[2].decode("utf-8")
        # A journal from elsewhere could remove or replace anything in the folder.
        if hmac.compare_digest(content, sealed(out, text)):
            return json.loads(text)
    return {"moved": [], "removed": []}


def sealed(out: Path, text: str) -> bytes:
    """A text that is valid for this user and this folder only, after a line with its seal."""
    return f"{_seal(out, text)}\n{text}".encode()


def report_seal(out: Path, report: str, outputs: Sequence[str]) -> str:
    """The seal of the list of files of a report, for this user and this folder only."""
    return _seal(out, json.dumps([report, outputs]))


def _seal(out: Path, text: str) -> str:
    return seal(f"{os.path.realpath(out)} {text}")
