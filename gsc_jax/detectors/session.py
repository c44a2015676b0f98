"""Open ONNX models with onnxruntime, report every failure as an `InputError`, and digest them.

A model can keep tensors in other files. onnxruntime refuses files outside the folder of the model
(absolute paths, "..", links), which the package relies on: pyproject.toml requires 1.27 or newer.
Older versions read such files as values of sparse tensors.
"""

import hashlib
import mmap
import re
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from gsc_jax.io.files import content_digest, existing_file
from gsc_jax.io.validation import reported
from gsc_jax.scene import InputError

CPU = ("CPUExecutionProvider",)
SUFFIX = "ExecutionProvider"


def open_session(path: Path, *, providers: Sequence[str] = CPU, threads: int = 0) -> Any:
    """Load an ONNX model as an `InferenceSession` of onnxruntime, which prints nothing.

    The execution providers are in order of preference, by full or short name ("cuda"); the CPU runs
    the operations that they lack. An inference has `threads`, 0 for all cores. InputError if the
    model is not valid, has tensors outside its folder, or does not run with the providers.
    """
    import onnxruntime as ort

    existing_file(path, expected="an ONNX model")
    if threads < 0:
        raise InputError(f"{path}: {threads} threads, expected 0 (all cores) or more")
    names = provider_names(providers)
    options = ort.SessionOptions()
    options.intra_op_num_threads = threads
    options.enable_mem_pattern = False  # it would keep the memory of each shape of SAFIRE
    options.log_severity_level = 4  # the raised errors contain the messages
    # Otherwise onnxruntime reads a file with the suffix .ort as another format.
    options.add_session_config_entry("session.load_model_format", "ONNX")
    remedy = "; export it again, with external tensors in the same folder"
    with reported(f"{path}: onnxruntime cannot load it as an ONNX model", remedy):
        session = ort.InferenceSession(path, options, providers=names, enable_fallback=False)
    # onnxruntime silently drops a provider without a driver.
    if missing := [name for name in names if name not in session.get_providers()]:
        raise InputError(
            f"{path}: onnxruntime could not start {missing[0]} (is its driver installed?), "
            f"expected one of {', '.join(session.get_providers())}"
        )
    return session


def provider_names(providers: Sequence[str]) -> list[str]:
    """Full names of execution providers; case and the suffix "ExecutionProvider" are optional.

    If the installed onnxruntime lacks one, raises InputError, which lists the available ones.
    """
    import onnxruntime as ort

    available = {name.removesuffix(SUFFIX).lower(): name for name in ort.get_available_providers()}
    short = [name.lower().removesuffix(SUFFIX.lower()) for name in providers]
    for name, key in zip(providers, short, strict=True):
        if key not in available:
            raise InputError(
                f"onnxruntime has no provider {name!r} here, expected one of "
                f"{', '.join(available)}; other builds have others, such as onnxruntime-gpu"
            )
    return [available[key] for key in short]


LOCATION_ENTRY = re.compile(rb"\n\x08location\x12([\x80-\xff]?)([\x00-\x7f])", re.DOTALL)
"""An entry "location" of a tensor in protocol buffers: tag, length, key, tag, length of the value
as one or two base-128 digits, lowest first. The value follows."""


def fingerprint(path: Path, *facts: object) -> str:
    """Digest of everything that determines the output of a model for an image.

    This is the model, which onnxruntime has loaded, with its external tensors, the version of
    onnxruntime, the code of this folder and the given facts, such as the spec and the providers.
    """
    import onnxruntime

    parts = (*sorted(Path(__file__).parent.glob("*.py")), path, *external_files(path))
    facts = (onnxruntime.__version__, *facts, *map(content_digest, parts))
    return hashlib.blake2b(repr(facts).encode(), digest_size=16).hexdigest()


def external_files(path: Path) -> list[Path]:
    """Existing files in which a model stores external tensors, sorted.

    Their names are found by a byte pattern; onnxruntime validated them when it loaded the model.
    """
    with path.open("rb") as file, mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ) as model:
        names = set()
        for entry in LOCATION_ENTRY.finditer(model):
            low, high = (int.from_bytes(digit) for digit in entry.groups())
            length = (low & 127) + (high << 7) if entry[1] else high
            names.add(model[entry.end() : entry.end() + length].decode(errors="replace"))
    return sorted(path.parent / name for name in names if (path.parent / name).is_file())
