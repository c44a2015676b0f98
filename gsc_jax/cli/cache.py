"""Cache folder of the user, and the persistent compilation cache of JAX."""

from pathlib import Path

import platformdirs

MIN_SECONDS = 0.1
"""Shortest compilation that is stored: reading a file takes a few milliseconds."""


def cache_folder() -> Path:
    """Cache folder of this package for the current user, which need not exist."""
    return platformdirs.user_cache_path("gsc_jax", appauthor=False)


def enable_compilation_cache(folder: Path | str) -> None:
    """Store compiled functions in a folder and reuse them in later processes.

    Changes the configuration of JAX in this process: for programs, not for libraries.
    """
    import jax

    jax.config.update("jax_compilation_cache_dir", str(folder))
    jax.config.update("jax_persistent_cache_min_compile_time_secs", MIN_SECONDS)
    jax.config.update("jax_persistent_cache_min_entry_size_bytes", 0)
