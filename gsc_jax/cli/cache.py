"""The persistent compilation cache: what XLA compiled once, the next process reads."""

import os
import sys
from pathlib import Path

MIN_SECONDS = 0.1
"""What compiles faster is not worth a file."""


def default_cache() -> Path:
    """Where caches of this user belong."""
    if sys.platform == "darwin":
        return Path.home() / "Library" / "Caches" / "gsc_jax"
    if sys.platform == "win32":
        return Path(os.environ.get("LOCALAPPDATA", Path.home() / "AppData" / "Local")) / "gsc_jax"
    return Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "gsc_jax"


def use_cache(folder: Path | str) -> None:
    """Let JAX keep and find its compiled functions in a folder.

    Changes the configuration of JAX in this process: for programs, not for libraries.

    Args:
        folder: Made when something is written; a folder that cannot be written is a warning of JAX.
    """
    import jax

    jax.config.update("jax_compilation_cache_dir", str(folder))
    jax.config.update("jax_persistent_cache_min_compile_time_secs", MIN_SECONDS)
    jax.config.update("jax_persistent_cache_min_entry_size_bytes", 0)
