"""Atomic writing of files, and the check that an input is a file."""

import contextlib
import uuid
from collections.abc import Iterator
from pathlib import Path

from gsc_jax.scene import InputError


@contextlib.contextmanager
def atomic(path: str | Path) -> Iterator[Path]:
    """Yield a temporary path in the same folder; rename it to `path` when the block succeeds.

    A run that is interrupted leaves the previous file or none, and a file may replace the one that
    it was read from. The temporary name keeps the suffix, by which some writers choose a format.
    Put only the writing into the block: any `OSError` in it is reported as an InputError of `path`.
    """
    path = Path(path)
    # Not longer than the name itself needs to be: file systems limit names to 255 bytes.
    temporary = path.with_name(f".{uuid.uuid4().hex[:12]}{path.suffix}")
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
    """Return the path if it is a file; else raise InputError with the kind of file `expected`.

    Every reader calls this before it opens a file: a pipe or a device could block it for ever.
    """
    path = Path(path)
    if path.is_dir():
        raise InputError(f"{path}: is a folder, expected {expected}; name the file in it")
    if not path.is_file() and path.exists():
        raise InputError(f"{path}: is a pipe or a device, expected {expected}; copy it to a file")
    if not path.is_file():
        raise InputError(f"{path}: no such file, expected {expected}; check the path")
    return path
