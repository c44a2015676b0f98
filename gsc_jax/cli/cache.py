"""Cache folder of the user, a secret in it, and the persistent compilation cache of JAX."""

import contextlib
import functools
import hmac
import os
import secrets
from pathlib import Path

import jax
import platformdirs

MIN_SECONDS = 0.1
"""Shortest compilation that is stored: reading a file takes a few milliseconds."""


def cache_folder() -> Path:
    """Cache folder of this package for the current user, which need not exist."""
    return platformdirs.user_cache_path("gsc_jax", appauthor=False)


def seal(text: str) -> str:
    """Authentication code of a text, which nobody else can make: its key is a secret of this user.

    Where the cache folder cannot be written, each call has another key, so that no seal is valid.
    """
    file, new = cache_folder() / "secret", secrets.token_bytes(32)
    with contextlib.suppress(OSError):
        file.parent.mkdir(parents=True, exist_ok=True)
        private = functools.partial(os.open, mode=0o600)
        with contextlib.suppress(FileExistsError), open(file, "xb", opener=private) as stream:
            stream.write(new)
        new = file.read_bytes()
    return hmac.new(new, os.fsencode(text), "blake2b").hexdigest()[:32]


def enable_compilation_cache(folder: Path | str) -> None:
    """Store compiled functions in a folder and reuse them in later processes.

    Changes the configuration of JAX in this process: for programs, not for libraries.
    """
    jax.config.update("jax_compilation_cache_dir", str(folder))
    jax.config.update("jax_persistent_cache_min_compile_time_secs", MIN_SECONDS)
    jax.config.update("jax_persistent_cache_min_entry_size_bytes", 0)
