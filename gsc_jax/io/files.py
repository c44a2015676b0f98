"""Writing files so that nobody ever sees half of one.

Everything this package writes goes to a temporary name in the folder of the target and is renamed
when it is complete: an interrupted run leaves the old file or none, and a file may be written over
the one it was read from.
"""

import contextlib
import uuid
from collections.abc import Iterator
from pathlib import Path

from gsc_jax.scene import InputError


@contextlib.contextmanager
def atomic(path: str | Path) -> Iterator[Path]:
    """A temporary path to write to, which takes the place of `path` when the block ends well.

    The folder is made where it is missing. The temporary name keeps the suffix, for writers that
    go by it. Nothing but the writing belongs into the block: its `OSError`s are reported as those
    of `path`.

    Args:
        path: The file to write or to replace.

    Yields:
        A path in the same folder at which nothing is yet.

    Raises:
        InputError: if the file cannot be written (no permission, no space, a folder is there).
    """
    path = Path(path)
    temporary = path.with_name(f".{path.stem}.{uuid.uuid4().hex[:12]}{path.suffix}")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        yield temporary
        temporary.replace(path)
    except OSError as error:
        reason = error.strerror or str(error)
        raise InputError(f"{path}: cannot be written ({reason}); choose another place") from error
    finally:
        with contextlib.suppress(OSError):
            temporary.unlink(missing_ok=True)


def existing_file(path: str | Path, *, expected: str) -> Path:
    """The path, once it is known to be a file.

    Args:
        path: What somebody gave.
        expected: What it should be, for the message: "a scene (.ply)".

    Raises:
        InputError: if there is nothing, or no file, at the path.
    """
    path = Path(path)
    if path.is_dir():
        raise InputError(f"{path}: is a folder, expected {expected}; name the file in it")
    if not path.is_file():
        raise InputError(f"{path}: no such file, expected {expected}; check the path")
    return path
