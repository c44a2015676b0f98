"""Cache folder of the user, a secret in it, and the persistent compilation cache of JAX."""

import contextlib
import functools
import hmac
import os
import secrets
from pathlib import Path

import jax
import platformdirs

from gsc_jax.io.files import atomic
from gsc_jax.scene import InputError


def cache_folder() -> Path:
    """Cache folder of this package for the current user, which need not exist."""
    return platformdirs.user_cache_path("gsc_jax", appauthor=False)


def seal(text: str) -> str:
    """Authentication code of a text, which nobody else can make: its key is a secret of this user.

    Where the cache folder cannot be written, the seals of a process are only valid in it.
    """
    return hmac.new(_secret(cache_folder()), os.fsencode(text), "blake2b").hexdigest()[:32]


@functools.cache  # if it cannot be stored, each process draws its own
def _secret(folder: Path) -> bytes:
    file, secret = folder / "secret", secrets.token_bytes(32)
    with contextlib.suppress(OSError, InputError):
        if not file.exists() or file.stat().st_size < len(secret):  # its writer was killed
            with atomic(file) as temporary:
                temporary.touch(mode=0o600)
                temporary.write_bytes(secret)
        secret = file.read_bytes()
    return secret


def enable_compilation_cache(folder: Path | str) -> None:
    """Store compiled functions in a folder and reuse them in later processes.

    Changes the configuration of JAX in this process: for programs, not for libraries.
    """
    jax.config.update("jax_compilation_cache_dir", str(folder))
    jax.config.update("jax_persistent_cache_min_compile_time_secs", 0)  # also short ones add up
    jax.config.update("jax_persistent_cache_min_entry_size_bytes", 0)
