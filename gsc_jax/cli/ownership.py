"""Which files in a folder of results are from an earlier run; all others are refused.

A report (result.json, render.json, edit.json) lists the files of its run with their digests. A file
is an output of that run as long as it is a regular file with this digest, behind no link. The
journal of a run that was killed names files before they are moved; it counts only with a seal.
"""

import contextlib
import hmac
import json
import os
from collections.abc import Mapping, Sequence
from pathlib import Path, PurePosixPath
from typing import Any

from gsc_jax.cli.cache import seal
from gsc_jax.io.files import content_digest, existing_file
from gsc_jax.io.tables import read_table
from gsc_jax.scene import InputError

UNFINISHED, JOURNAL = ".unfinished", "journal.json"
"""Folder for everything unfinished, inside the folder of results, and the journal in it."""
REPORTS = ("result.json", "render.json", "edit.json")
"""Their own digests cannot be in them: what lists itself counts as a report."""


def refuse_overlap(out: Path, inputs: Sequence[Path], *, written: Sequence[str]) -> None:
    """Raise InputError if writing the names `written` in the folder `out` changes an input.

    Also for a folder of inputs with `out` inside: the next run would read the results as inputs.
    """
    results = [os.path.realpath(out / name) for name in written]
    for path in inputs:
        place = Path(os.path.realpath(path))
        if any(place.is_relative_to(result) for result in results):
            raise InputError(f"{path}: the results would overwrite this input; give another --out")
        if place.is_dir() and Path(os.path.realpath(out)).is_relative_to(place):
            raise InputError(
                f"{out}: lies in {path}, where the next run would read the results as input; give "
                "another --out"
            )


def refuse_foreign(out: Path, names: Sequence[str], *, report: str) -> None:
    """Raise InputError if a file in the way is not an output of an earlier run as it was written.

    In the way are the `names` to be written, outputs of that run, and what `refuse_blocked` finds.
    """
    refuse_blocked(out, names)
    digests, finished = listed_outputs(out, report), read_journal(out)
    own = {*finished["moved"], *finished["removed"]}
    for name in dict.fromkeys([*names, *digests]):
        if os.path.lexists(out / name) and name not in own and not is_output(out, name, digests):
            problem = f"exists, and {report} does not list it as the output of an earlier run"
            if name in digests:
                problem = "has changed since an earlier run wrote it"
            raise InputError(f"{out / name}: {problem}; give another --out")


def listed_outputs(out: Path, report: str) -> dict[str, Any]:
    """Digests of the files that the report of an earlier run lists; that of itself is None."""
    with contextlib.suppress(InputError, LookupError, TypeError):
        digests = read_table(out / report, remedy="")["outputs"] if is_inside(out, report) else {}
        if isinstance(digests, dict) and digests[report] is None:
            return digests
    return {}


def is_output(out: Path, name: str, digests: Mapping[str, Any]) -> bool:
    """Whether a file in a folder of results is as it was written, by the digests in the report."""
    listed = name in digests and is_inside(out, name)
    return listed and (name in REPORTS or content_digest(out / name) == digests[name])


def is_inside(out: Path, name: str) -> bool:
    """Whether a name is that of a regular file in a folder, reached through no link inside it."""
    if not os.path.lexists(out / name):
        return False
    root, path = Path(os.path.realpath(out)), Path(os.path.realpath(out / name))
    return path.is_relative_to(root) and path == root / name and path.is_file()


def refuse_foreign_file(path: Path, mark: str) -> None:
    """Raise InputError for a file that exists and `has_mark` does not recognise."""
    if os.path.lexists(path) and not path.is_dir() and not has_mark(path, mark):
        raise InputError(f"{path}: exists and is not from an earlier run; choose another name")


def has_mark(path: Path, mark: str) -> bool:
    """Whether a file exists and has a text at its beginning, as all of its kind have."""
    with contextlib.suppress(InputError, OSError), existing_file(path, expected="").open("rb") as f:
        return mark.encode() in f.read(4096)
    return False


def refuse_links(out: Path, places: Sequence[Path]) -> None:
    """Raise InputError for a link among these places in a folder of results."""
    if link := next(filter(Path.is_symlink, places), None):
        raise InputError(f"{link}: is a link, and results are written inside {out} only; remove it")


def refuse_blocked(out: Path, names: Sequence[str]) -> None:
    """Raise InputError for links to folders where files are to be written: they may lead anywhere.

    Also for a folder where a file is to be written, or a file where a folder is.
    """
    folders = {out / place for name in names for place in PurePosixPath(name).parents}
    refuse_links(out, sorted(folders - {out}))
    blocked = [out / name for name in names if (out / name).is_dir()]
    blocked += [place for place in sorted(folders) if place.exists() and not place.is_dir()]
    if blocked:
        kind = "folder" if blocked[0].is_dir() else "file"
        raise InputError(f"{blocked[0]}: is a {kind}, where the results would go; move it")


def read_journal(out: Path) -> dict[str, list[str]]:
    """What a killed run of this user has still to move and remove; empty lists if nothing."""
    with contextlib.suppress(OSError, ValueError):
        content = existing_file(out / UNFINISHED / JOURNAL, expected="").read_bytes()
        text = content.partition(b"\n")[2].decode("utf-8")
        # A journal from elsewhere could remove or replace anything in the folder.
        if hmac.compare_digest(content, sealed(out, text)):
            return json.loads(text)
    return {"moved": [], "removed": []}


def sealed(out: Path, text: str) -> bytes:
    """A text that is valid for this user and this folder only, after a line with its seal."""
    return f"{seal(f'{os.path.realpath(out)} {text}')}\n{text}".encode()
