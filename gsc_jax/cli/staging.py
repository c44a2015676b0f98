"""A folder of results, written aside and put in place when all of it is there.

A run that fails, or is interrupted, leaves the folder as it was. One that succeeds replaces what
the run before wrote: also masks of cameras that are no longer used, so that what lies in the folder
belongs together. Nothing else in the folder is touched, and never what this run was given.

The reports are the first to go and the last to come. So where a run is killed, or the disk is full,
just while its results are put in place, the folder holds no results, rather than a report of others
than those that lie there. What such a run could not remove, a later one does, once it is so old
that nobody works on it.
"""

import contextlib
import json
import shutil
import tempfile
import time
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path, PurePosixPath

from gsc_jax.cli.interruption import uninterrupted
from gsc_jax.scene import InputError

UNFINISHED = ".unfinished-"
"""How the folders are called in which results are collected."""
ABANDONED_SECONDS = 24 * 3600
"""After which one that nothing was added to is somebody's no longer."""
OUTPUTS = {
    "overview.png": "a few views side by side",
    "render/": "the views as they are",
    "overlay/": "the views with what was found marked",
    "masks/": "final masks, 0 or 255",
    "detector/": "what the 2D detector said, 0 to 255",
    "tamper.ply": "the scene, plus a property tamper",
    "highlight.ply": "for any viewer: tampered red, the rest grey",
    "labels.npy": "bool, by row of the scene",
    "tamper.npy": "score from 0 to 1, by row of the scene",
    "views.json": "the cameras looked from, a cameras.json",
    "report.html": "this page, for people",
    "result.json": "its numbers, for programs",
}
"""What `locate` leaves in its folder, in the order in which people are told."""
FILES = tuple(name for name in OUTPUTS if not name.endswith("/"))
BY_CAMERA = tuple(name.rstrip("/") for name in OUTPUTS if name.endswith("/"))
"""Folders with a picture per camera, of which some may be left over from another run."""
PICTURES = (".png", ".jpg")
"""How the files in them end."""
EVALUATION = "evaluation.json"
"""Scores of the results, of no use beside those of another run."""


def refuse_overlap(
    out: Path, inputs: Sequence[Path], *, written: Sequence[str] = (*FILES, *BY_CAMERA)
) -> None:
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
        report: The file that lists the `outputs`; it comes last, after report.html where there is
            one, so that it never tells of what is not there.
        by_camera: Folders with a picture per camera, of which an earlier run may have left some.

    Yields:
        An empty folder inside `out`.

    Raises:
        InputError: if `out` cannot be written to, or a folder lies where a file belongs.
    """
    made = [place for place in (out, *out.parents) if not place.exists()]
    try:
        folder = _unfinished(out)
        try:
            yield folder
        except KeyboardInterrupt as stop:
            stop.add_note(f"nothing was changed in {out}")
            raise
        except InputError as error:
            raise InputError(str(error).replace(str(folder), str(out))) from error
        else:
            with uninterrupted():
                _publish(folder, out, report, _leftovers(out, report, by_camera, keep))
        finally:
            shutil.rmtree(folder, ignore_errors=True)
    finally:
        with contextlib.suppress(OSError):  # it holds results
            for place in made:
                place.rmdir()


def files_below(folder: Path) -> list[str]:
    """Files below a folder by relative path with slashes."""
    paths = (path.relative_to(folder) for path in folder.rglob("*") if path.is_file())
    return sorted(path.as_posix() for path in paths)


def _unfinished(out: Path) -> Path:
    """A new folder inside the folder of results."""
    try:
        out.mkdir(parents=True, exist_ok=True)
        _remove_abandoned(out)
        return Path(tempfile.mkdtemp(prefix=UNFINISHED, dir=out))
    except OSError as error:
        raise InputError(f"{out}: {_cannot(error)}") from error


def _publish(folder: Path, out: Path, report: str, leftovers: Iterable[str]) -> None:
    """Moves the new files to their places, once what tells of others is gone."""
    names = files_below(folder)
    _refuse_blocked(out, names)
    last = [name for name in ("report.html", report) if name in names]
    try:
        for name in [*reversed(last), *set(leftovers).difference(names)]:
            (out / name).unlink(missing_ok=True)
        for name in [*(name for name in names if name not in last), *last]:
            (out / name).parent.mkdir(parents=True, exist_ok=True)
            (folder / name).replace(out / name)
    except OSError as error:
        raise InputError(f"{out}: {_cannot(error)}") from error


def _refuse_blocked(out: Path, names: Sequence[str]) -> None:
    """Refuses folders where files belong, and files where folders do."""
    files = [out / name for name in names if (out / name).is_dir()]
    parents = {out / place for name in names for place in PurePosixPath(name).parents}
    folders = [place for place in sorted(parents) if place.exists() and not place.is_dir()]
    if blocked := [*files, *folders]:
        found = "folder" if files else "file"
        raise InputError(
            f"{blocked[0]}: is a {found}, which is in the way of the results; move it, or give "
            f"another --out than {out}"
        )


def _remove_abandoned(out: Path) -> None:
    """Removes what runs have left that were killed."""
    for folder in out.glob(f"{UNFINISHED}*"):
        with contextlib.suppress(OSError):  # another run may be removing it, too
            if time.time() - folder.stat().st_mtime > ABANDONED_SECONDS:
                shutil.rmtree(folder, ignore_errors=True)


def _leftovers(out: Path, report: str, by_camera: Sequence[str], keep: Sequence[Path]) -> list[str]:
    """Files of an earlier run, but for those that this one reads."""
    given = [path.resolve() for path in keep]

    def is_given(path: Path) -> bool:
        return any(path.resolve().is_relative_to(place) for place in given)

    earlier = [(name, out / name) for name in _earlier(out / report, by_camera)]
    there = [(name, path) for name, path in earlier if path.is_file() or path.is_symlink()]
    return [name for name, path in there if not is_given(path)]


def _earlier(report: Path, by_camera: Sequence[str]) -> list[str]:
    """What an earlier run wrote into the folder and a later one may not write again."""
    try:
        outputs = json.loads(report.read_text(encoding="utf-8"))["outputs"]
        paths = [PurePosixPath(name) for name in outputs]
    except (OSError, ValueError, LookupError, TypeError):
        return []  # there is none, or the file is somebody else's
    pictures = [path for path in paths if path.suffix in PICTURES and ".." not in path.parts]
    own = [str(path) for path in pictures if path.parts[0] in by_camera]
    return [*own, EVALUATION] if PurePosixPath("result.json") in paths else own


def _cannot(error: OSError) -> str:
    return f"cannot be written to ({error.strerror or error}); choose another place"
