"""A folder of results that is written aside and moved into place when it is complete.

A run that fails leaves the results in the folder as they were. One that succeeds replaces the
files of the run before, including masks of cameras that it does not use, and touches no others.

Everything unfinished lies in `OUT/.unfinished`: a lock, so that one run at a time writes; the new
results; arrays of views, with which a run of the same input continues; and, when all results are
written, a journal of the files to move, with which the next run continues after a kill.
"""

import contextlib
import hmac
import json
import shutil
from collections.abc import Iterator
from pathlib import Path

import filelock

from gsc_jax.cli import ownership
from gsc_jax.cli.ownership import JOURNAL, UNFINISHED
from gsc_jax.io.files import atomic, content_digest, writing_to
from gsc_jax.scene import InputError

LOCK, NEW, VIEWS, IDENTITY = "lock", "new", "views", "views.txt"
"""In it: the lock, the new results, the arrays of views and what they belong to."""
OUTPUTS = {
    "overview.png": "a few views side by side",
    "render/": "renders of the views",
    "overlay/": "renders with the final mask",
    "masks/": "final masks, 0 or 255",
    "scores/": "rendered scores of the Gaussians, 16 bits",
    "detector/": "probability maps of the 2D detector, 16 bits",
    "tamper.ply": "the scene, plus a property tamper",
    "highlight.ply": "for any viewer: tampered red, or candidates blue, the rest grey",
    "labels.npy": "bool, by row of the scene",
    "tamper.npy": "score from 0 to 1, by row of the scene",
    "views.json": "the cameras of the masks, a cameras.json",
    "report.html": "this page, for people",
    "result.json": "the same numbers, for programs",
}
"""What `locate` writes, in the order of the report."""
FILES = tuple(name for name in OUTPUTS if not name.endswith("/"))
BY_CAMERA = tuple(name.rstrip("/") for name in OUTPUTS if name.endswith("/"))
"""Folders with a picture per camera."""
EVALUATION, EVALUATION_MARK = "evaluation.json", '{\n  "folder": '
"""Scores of the results, and their beginning; they do not apply to the results of another run."""


@contextlib.contextmanager
def replacing(
    out: Path, *, report: str = "result.json", identity: str | None = None
) -> Iterator[Path]:
    """Provide a temporary folder whose files are moved to `out` if the block succeeds.

    The `outputs` of the `report`, which is moved last, get a digest of every file. Arrays in the
    folder `views_of` stay for the next run of the same `identity` if the block fails. InputError if
    `out` cannot be written to, another run writes to it, or a folder or link is in the way.
    """
    work = out / UNFINISHED
    ownership.refuse_links(out, [work, *work.rglob("*")])
    created = [place for place in (out, *out.parents) if not place.exists()]
    try:
        with locked(work):
            with writing_to(out):
                _begin(work, out, identity)
            try:
                yield work / NEW
                with writing_to(out):
                    _commit(work, out, report)
                    if identity is not None:
                        shutil.rmtree(work / VIEWS, ignore_errors=True)
            except InputError as error:
                raise InputError(str(error).replace(str(work / NEW), str(out))) from error
            finally:
                _end(work, out)
    finally:
        for place in (work, *created):
            with contextlib.suppress(OSError):  # not empty: it holds results, or arrays of views
                place.rmdir()


def views_of(folder: Path) -> Path:
    """The folder for the arrays of views of a run, given what `replacing` provides."""
    return folder.with_name(VIEWS)


def files_below(folder: Path) -> list[str]:
    """Files below a folder by relative path with slashes."""
    return sorted(p.relative_to(folder).as_posix() for p in folder.rglob("*") if p.is_file())


@contextlib.contextmanager
def locked(work: Path) -> Iterator[None]:
    """Hold the lock of a folder of results; the system releases that of a process that ends."""
    lock = filelock.FileLock(work / LOCK, timeout=0)
    with writing_to(work.parent):
        work.mkdir(parents=True, exist_ok=True)
        try:
            lock.acquire()
        except filelock.Timeout:
            raise InputError(
                f"{work.parent}: another run is writing its results there; wait for it, or give "
                "another --out"
            ) from None
    try:
        yield
    finally:
        with contextlib.suppress(OSError):  # somebody removed the folder
            if not any(path.name != LOCK for path in work.iterdir()):
                (work / LOCK).unlink(missing_ok=True)
                work.rmdir()
        lock.release()


def _begin(work: Path, out: Path, identity: str | None) -> None:
    """Finish what a killed run has begun to move, and keep its views unless this run has others."""
    _publish(work, out)
    shutil.rmtree(work / NEW, ignore_errors=True)
    for partial in work.glob(".*"):  # of a run that was killed in `atomic`
        partial.unlink()
    (work / NEW).mkdir()
    if identity is None:
        return
    known, content = work / IDENTITY, ownership.sealed(out, identity)
    if not known.is_file() or not hmac.compare_digest(known.read_bytes(), content):
        if (work / VIEWS).exists():
            shutil.rmtree(work / VIEWS)
        with atomic(known) as temporary:
            temporary.write_bytes(content)


def _commit(work: Path, out: Path, report: str) -> None:
    """Write the journal, from which on the run cannot fail any more, and move the files."""
    names = files_below(work / NEW)
    ownership.refuse_blocked(out, names)
    if report in names:  # with the digests by which the next run recognises the files
        content = json.loads((work / NEW / report).read_text("utf-8"))
        digests = {name: content_digest(work / NEW / name) for name in names if name != report}
        content["outputs"] = {name: digests.get(name) for name in names}
        text = json.dumps(content, indent=2, ensure_ascii=False)
        (work / NEW / report).write_text(text + "\n", "utf-8")
    last = [name for name in ("report.html", report) if name in names]
    moved = [*(name for name in names if name not in last), *last]
    # Also pictures and scores of an earlier run that this one does not replace.
    digests = ownership.listed_outputs(out, report)
    old = [name for name in digests if name not in names and name.endswith((".png", ".jpg"))]
    removed = [*reversed(last), *(name for name in old if ownership.is_output(out, name, digests))]
    if "result.json" in digests and ownership.has_mark(out / EVALUATION, EVALUATION_MARK):
        removed.append(EVALUATION)
    with atomic(work / JOURNAL) as temporary:
        text = json.dumps({"moved": moved, "removed": removed})
        temporary.write_bytes(ownership.sealed(out, text))
    _publish(work, out)


def _publish(work: Path, out: Path) -> None:
    """Do what the journal says, or what is left of it."""
    # Old reports are removed first and new ones moved last: a folder with a report is complete.
    moved, removed = ownership.read_journal(out).values()
    ownership.refuse_blocked(out, [*moved, *removed])
    waiting = [name for name in moved if (work / NEW / name).exists()]
    for name in removed:
        if name in waiting or name not in moved:
            (out / name).unlink(missing_ok=True)
    for name in waiting:
        (out / name).parent.mkdir(parents=True, exist_ok=True)
        (work / NEW / name).replace(out / name)
    (work / JOURNAL).unlink(missing_ok=True)


def _end(work: Path, out: Path) -> None:
    """Remove what is not needed to continue."""
    with contextlib.suppress(OSError):  # a full disk: the journal stays for the next run
        _publish(work, out)
        shutil.rmtree(work / NEW, ignore_errors=True)
        if not (work / VIEWS).exists():
            (work / IDENTITY).unlink(missing_ok=True)
