"""Opening an ONNX model with onnxruntime, so that whatever is wrong with it is an `InputError`.

A model is data, and yet it can name files to read: those are looked at first, see
`gsc_jax.detectors.external`.
"""

import hashlib
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from gsc_jax.detectors.external import external_files
from gsc_jax.scene import Camera, InputError

if TYPE_CHECKING:
    from onnxruntime import InferenceSession

CPU = ("CPUExecutionProvider",)
SUFFIX = "ExecutionProvider"


def open_session(
    path: Path, *, providers: Sequence[str] = CPU, threads: int = 0
) -> "InferenceSession":
    """Loads an ONNX model.

    Args:
        path: The .onnx file; tensors outside of it only from its own folder.
        providers: onnxruntime's execution providers, the preferred one first, by their names or as
            people say them ("cuda"). The CPU does what they cannot.
        threads: Threads of one inference, 0 for all the cores.

    Returns:
        The session, which prints nothing.

    Raises:
        InputError: If the file is no model, names files that it should not, or cannot be loaded
            with the providers.
    """
    import onnxruntime

    _check_file(path)
    if threads < 0:
        raise InputError(f"{path}: {threads} threads, expected a number of them or 0 for all cores")
    names = provider_names(providers)
    external_files(path)
    options = _options(threads)
    try:
        session = onnxruntime.InferenceSession(
            path, options, providers=names, enable_fallback=False
        )
    except Exception as trouble:  # onnxruntime's errors have no common base class
        raise InputError(
            f"{path}: onnxruntime cannot load it as an ONNX model ({one_line(trouble)}); export "
            "it again"
        ) from trouble
    # onnxruntime goes on without a provider whose driver is missing.
    idle = [name for name in names if name not in session.get_providers()]
    if idle:
        raise InputError(
            f"{path}: onnxruntime could not start {idle[0]} (is its driver there?), expected "
            f"one of {', '.join(session.get_providers())}"
        )
    return session


def provider_names(providers: Sequence[str]) -> list[str]:
    """The names of onnxruntime's execution providers.

    Args:
        providers: Names in any case, with or without "ExecutionProvider".

    Returns:
        The full names.

    Raises:
        InputError: If the onnxruntime that is installed lacks one; lists those it has.
    """
    import onnxruntime

    available = {
        name.removesuffix(SUFFIX).lower(): name for name in onnxruntime.get_available_providers()
    }
    short = [name.lower().removesuffix(SUFFIX.lower()) for name in providers]
    for name, key in zip(providers, short, strict=True):
        if key not in available:
            raise InputError(
                f"onnxruntime has no provider {name!r} here, expected one of "
                f"{', '.join(available)}; others come with other builds, such as onnxruntime-gpu"
            )
    return [available[key] for key in short]


def fingerprint(path: Path, *facts: object) -> str:
    """What decides the output of a model, as a short text: to find earlier outputs again.

    The version of onnxruntime and the code of this folder are part of it.

    Args:
        path: The .onnx file; what it keeps in other files counts as well.
        facts: What else decides it, with a `repr` that says all: the spec, the providers.

    Returns:
        Hexadecimal digits.

    Raises:
        InputError: If the file is no model, or names files that it should not.
    """
    import onnxruntime

    _check_file(path)
    facts = (onnxruntime.__version__, *facts)
    digest = hashlib.blake2b(repr(facts).encode(), digest_size=16)
    code = sorted(Path(__file__).parent.glob("*.py"))  # what is made of the image and the output
    for part in (*code, path, *external_files(path)):
        with part.open("rb") as file:
            digest.update(hashlib.file_digest(file, hashlib.blake2b).digest())
    return digest.hexdigest()


def some(cameras: Sequence[Camera], model: Path) -> list[Camera]:
    """All the cameras; raises InputError, naming the model, when there are none."""
    if not cameras:
        raise InputError(f"{model}: there are no cameras to run the detector on")
    return list(cameras)


def one_line(trouble: Exception) -> str:
    """The message of an error, however many lines it has."""
    return " ".join(str(trouble).split())


def _check_file(path: Path) -> None:
    if not path.is_file():
        found = "is a folder" if path.is_dir() else "does not exist"
        raise InputError(f"{path}: {found}, expected an ONNX model")


def _options(threads: int) -> Any:
    import onnxruntime

    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = threads
    options.log_severity_level = 4  # what it would print is in the errors raised
    # Or the suffix .ort would have it read another format, which nobody looked into.
    options.add_session_config_entry("session.load_model_format", "ONNX")
    return options
