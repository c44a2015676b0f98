"""A folder of results, written aside and put in place when all of it is there.

A run that fails, or is interrupted, leaves the folder as it was. One that succeeds replaces what
the run before wrote: also masks of cameras that are no longer used, so that what lies in the folder
belongs together. Nothing else in the folder is touched, and never what this run was given. What a
run that was killed could not remove, a later one does, once it is so old that nobody works on it.
"""

import contextlib
import json
import shutil
import tempfile
import time
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path, PurePosixPath

from gsc_jax.app.patience import uninterrupted
from gsc_jax.errors import InputError

UNFINISHED = ".unfinished-"
"""How the folders are called in which results are collected."""
ABANDONED_SECONDS = 24 * 3600
"""After which one that nothing was added to is somebody's no longer."""
BY_CAMERA = ("masks", "detector", "render", "overlay")
"""Folders with a picture per camera, of which some may be left over from another run."""

PICTURES = (".png", ".jpg")
"""How the files in them end."""
OUTPUTS = ("tamper.ply", "highlight.ply", *BY_CAMERA)
"""What could be an input as well."""


def refuse_overlap(out: Path, inputs: Sequence[Path], *, written: Sequence[str] = OUTPUTS) -> None:
    """Refuse a folder of results that would overwrite what the run reads.

    Args:
        out: The folder of results.
        inputs: Files and folders that are read.
        written: Names in the folder that are written.

    Raises:
        InputError: naming the input that is in the way.
    """
    results = [(out / name).resolve() for name in written]
    # A folder is read for what is in it: DIR/cameras.json, where that is what the run writes.
    inside = [folder / name for folder in inputs for name in written if folder.is_dir()]
    for path in [*inputs, *(path for path in inside if path.exists())]:
        if any(path.resolve() == one or one in path.resolve().parents for one in results):
            raise InputError(
                f"{path}: is read and would be overwritten by the results; give another --out "
                f"than {out}"
            )


@contextlib.contextmanager
def replacing(
    out: Path,
    *,
    keep: Sequence[Path] = (),
    report: str = "result.json",
    by_camera: Sequence[str] = BY_CAMERA,
) -> Iterator[Path]:
    """A folder to write into, whose files go to `out` when the block ends well.

    Args:
        out: The folder of results, made where missing.
        keep: Files and folders that the run reads; none of them is removed as a leftover.
        report: The file that lists the `outputs`; it comes last, so that it never tells of what is
            not there.
        by_camera: Folders with a picture per camera, of which an earlier run may have left some.

    Yields:
        An empty folder inside `out`.

    Raises:
        InputError: if `out` cannot be written to.
    """
    made = not out.exists()
    try:
        out.mkdir(parents=True, exist_ok=True)
        _remove_abandoned(out)
        folder = Path(tempfile.mkdtemp(prefix=UNFINISHED, dir=out))
    except OSError as error:
        raise InputError(f"{out}: {_cannot(error)}") from error
    try:
        try:
            yield folder
        except KeyboardInterrupt as stop:
            stop.add_note(f"nothing was changed in {out}")
            raise
        with uninterrupted():
            leftovers = set(_earlier(out / report, by_camera)).difference(files_below(folder))
            _publish(folder, out, report)
            _remove(out, leftovers, keep)
    except InputError as error:
        raise InputError(str(error).replace(str(folder), str(out))) from error
    finally:
        shutil.rmtree(folder, ignore_errors=True)
        if made:
            with contextlib.suppress(OSError):  # it holds results
                out.rmdir()


def files_below(folder: Path) -> list[str]:
    """Files below a folder by relative path with slashes."""
    paths = (path.relative_to(folder) for path in folder.rglob("*") if path.is_file())
    return sorted(path.as_posix() for path in paths)


def _publish(folder: Path, out: Path, report: str) -> None:
    """Moves the new files to their places, the report last."""
    try:
        for name in sorted(files_below(folder), key=lambda name: name == report):
            (out / name).parent.mkdir(parents=True, exist_ok=True)
            (folder / name).replace(out / name)
    except OSError as error:
        raise InputError(f"{out}: {_cannot(error)}") from error


def _remove(out: Path, leftovers: Iterable[str], keep: Sequence[Path]) -> None:
    """Removes what an earlier run wrote and this one did not, unless this one reads it."""
    given = [path.resolve() for path in keep]
    try:
        for name in leftovers:
            path = (out / name).resolve()
            if not any(path.is_relative_to(place) for place in given):
                path.unlink(missing_ok=True)
    except OSError as error:
        raise InputError(f"{out}: {_cannot(error)}") from error


def _remove_abandoned(out: Path) -> None:
    """Removes what runs have left that were killed."""
    for folder in out.glob(f"{UNFINISHED}*"):
        with contextlib.suppress(OSError):  # another run may be removing it, too
            if time.time() - folder.stat().st_mtime > ABANDONED_SECONDS:
                shutil.rmtree(folder, ignore_errors=True)


def _earlier(report: Path, by_camera: Sequence[str]) -> list[str]:
    """What an earlier run wrote into the folder and a later one may not write again."""
    try:
        outputs = json.loads(report.read_text(encoding="utf-8"))["outputs"]
        paths = [PurePosixPath(name) for name in outputs]
    except (OSError, ValueError, LookupError, TypeError):
        return []  # there is none, or the file is somebody else's
    own = [path for path in paths if path.parts[0] in by_camera and path.suffix in PICTURES]
    own += [path for path in paths if path == PurePosixPath("cameras.json")]
    return [str(path) for path in own if ".." not in path.parts]


def _cannot(error: OSError) -> str:
    return f"cannot be written to ({error.strerror or error}); choose another place"
