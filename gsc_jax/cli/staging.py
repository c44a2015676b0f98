"""A folder of results that is written aside and moved into place when it is complete.

A run that fails or is interrupted leaves the folder as it was. A run that succeeds replaces the
files of the run before, including masks of cameras that it does not use, so that the files in the
folder belong together. No other file is touched, and no input of the run.

Old reports are removed first and new ones are moved last. If the process is killed while files are
moved, the folder holds no report. A later run removes temporary folders that were left behind.
"""

import contextlib
import json
import shutil
import tempfile
import time
from collections.abc import Iterable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path, PurePosixPath

from gsc_jax.scene import InputError

UNFINISHED = ".unfinished-"
"""Prefix of temporary folders."""
ABANDONED_SECONDS = 24 * 3600
"""Age at which a temporary folder is abandoned: no run takes a day without writing to it."""
OUTPUTS = {
    "overview.png": "a few views side by side",
    "render/": "renders of the views",
    "overlay/": "renders with the final mask",
    "masks/": "final masks, 0 or 255",
    "detector/": "probability maps of the 2D detector, 0 to 255",
    "tamper.ply": "the scene, plus a property tamper",
    "highlight.ply": "for any viewer: tampered red, the rest grey",
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
PICTURES = (".png", ".jpg")
EVALUATION = "evaluation.json"
"""Scores of the results; they do not apply to the results of another run."""


def refuse_overlap(
    out: Path, inputs: Sequence[Path], *, written: Sequence[str] = (*FILES, *BY_CAMERA)
) -> None:
    """Raise InputError if writing the names `written` in the folder `out` overwrites an input."""
    results = [(out / name).resolve() for name in written]
    # A folder is read for the files in it, such as DIR/cameras.json.
    inside = [folder / name for folder in inputs for name in written if folder.is_dir()]
    for path in [*inputs, *(path for path in inside if path.exists())]:
        if any(path.resolve().is_relative_to(result) for result in results):
            raise InputError(f"{path}: the results would overwrite this input; give another --out")


@contextlib.contextmanager
def replacing(
    out: Path,
    *,
    keep: Sequence[Path] = (),
    report: str = "result.json",
    by_camera: Sequence[str] = BY_CAMERA,
) -> Iterator[Path]:
    """Provide a temporary folder whose files are moved to `out` if the block succeeds.

    Args:
        out: The folder of results, created if missing.
        keep: Files and folders that the run reads; none of them is removed as a leftover.
        report: The file that lists the `outputs`; it is moved last, after report.html.
        by_camera: Folders with a picture per camera, in which an earlier run may have left some.

    Raises:
        InputError: if `out` cannot be written to, or a folder exists where a file belongs.
    """
    created = [place for place in (out, *out.parents) if not place.exists()]
    try:
        folder = _temporary_folder(out)
        try:
            yield folder
        except InputError as error:
            raise InputError(str(error).replace(str(folder), str(out))) from error
        else:
            leftovers = _leftovers(out, report, by_camera, keep)
            # In a thread: a signal interrupts the main thread, which then waits for the pool.
            with ThreadPoolExecutor(1) as pool:
                pool.submit(_publish, folder, out, report, leftovers).result()
        finally:
            shutil.rmtree(folder, ignore_errors=True)
    finally:
        with contextlib.suppress(OSError):  # not empty: it holds results
            for place in created:
                place.rmdir()


def files_below(folder: Path) -> list[str]:
    """Files below a folder by relative path with slashes."""
    paths = (path.relative_to(folder) for path in folder.rglob("*") if path.is_file())
    return sorted(path.as_posix() for path in paths)


def _temporary_folder(out: Path) -> Path:
    """A new folder inside the folder of results, from which abandoned ones are removed."""
    try:
        out.mkdir(parents=True, exist_ok=True)
        for folder in out.glob(f"{UNFINISHED}*"):
            with contextlib.suppress(OSError):  # another run may be removing it, too
                if time.time() - folder.stat().st_mtime > ABANDONED_SECONDS:
                    shutil.rmtree(folder, ignore_errors=True)
        return Path(tempfile.mkdtemp(prefix=UNFINISHED, dir=out))
    except OSError as error:
        raise _not_writable(out, error) from error


def _publish(folder: Path, out: Path, report: str, leftovers: Iterable[str]) -> None:
    """Remove old reports and leftovers, then move the new files into place."""
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
        raise _not_writable(out, error) from error


def _refuse_blocked(out: Path, names: Sequence[str]) -> None:
    """Refuse folders where files belong, and files where folders belong."""
    folders = {out / place for name in names for place in PurePosixPath(name).parents}
    blocked = [out / name for name in names if (out / name).is_dir()]
    blocked += [place for place in sorted(folders) if place.exists() and not place.is_dir()]
    if blocked:
        kind = "folder" if blocked[0].is_dir() else "file"
        raise InputError(f"{blocked[0]}: is a {kind}, where the results would go; move it")


def _leftovers(out: Path, report: str, by_camera: Sequence[str], keep: Sequence[Path]) -> list[str]:
    """Pictures and scores of an earlier run, except inputs of this one.

    The old report may be damaged or of another program: only pictures in the folders count.
    """
    try:
        outputs = json.loads((out / report).read_text(encoding="utf-8"))["outputs"]
        paths = [PurePosixPath(name) for name in outputs]
    except (OSError, ValueError, LookupError, TypeError):
        return []
    names = [
        str(path)
        for path in paths
        if path.suffix in PICTURES and path.parts[0] in by_camera and ".." not in path.parts
    ]
    names += [EVALUATION] if PurePosixPath("result.json") in paths else []
    inputs = [path.resolve() for path in keep]
    return [
        name
        for name in names
        if ((out / name).is_file() or (out / name).is_symlink())
        and not any((out / name).resolve().is_relative_to(place) for place in inputs)
    ]


def _not_writable(path: Path, error: OSError) -> InputError:
    reason = error.strerror or error
    return InputError(f"{path}: cannot be written to ({reason}); choose another place")
