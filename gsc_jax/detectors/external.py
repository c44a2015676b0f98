"""The files in which an ONNX model keeps its larger tensors, found without loading the model.

Such a model names its files itself, and one from a stranger may name any: onnxruntime 1.19 reads
wherever an absolute path, ".." or a link leads, newer ones refuse as `external_files` does. So the
names are read first, by a walk over the protocol buffers of the file along the few fields that
lead to tensors (onnx.proto); weights are stepped over, not copied.
"""

import mmap
from collections.abc import Iterator
from pathlib import Path, PurePosixPath, PureWindowsPath

from gsc_jax.scene import InputError

LEADS_TO = {
    "ModelProto": {7: "GraphProto", 20: "TrainingInfoProto", 25: "FunctionProto"},
    "TrainingInfoProto": {1: "GraphProto", 2: "GraphProto"},
    "FunctionProto": {7: "NodeProto", 11: "AttributeProto"},
    "GraphProto": {1: "NodeProto", 5: "TensorProto", 15: "SparseTensorProto"},
    "NodeProto": {5: "AttributeProto"},
    "AttributeProto": {
        5: "TensorProto",
        6: "GraphProto",
        10: "TensorProto",
        11: "GraphProto",
        22: "SparseTensorProto",
        23: "SparseTensorProto",
    },
    "SparseTensorProto": {1: "TensorProto", 2: "TensorProto"},
    "TensorProto": {13: "StringStringEntryProto"},
}
"""By message, the numbers of the fields on the way to where a tensor says that its data are."""

SKIPPED_BYTES = {1: 8, 5: 4}
"""Sizes of the wire types of fixed size."""


def external_files(path: Path) -> list[Path]:
    """The files that an ONNX model reads besides its own.

    Args:
        path: The model.

    Returns:
        Existing files in the folder of the model, or of the file that it is a link to; sorted,
        without repetition, and without links.

    Raises:
        InputError: If the model cannot be read, or names a file that is elsewhere or missing.
    """
    try:
        with path.open("rb") as file:
            empty = not file.seek(0, 2)  # which cannot be mapped
            data = b"" if empty else mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ)
        locations = {bytes(location).decode() for location in _locations(memoryview(data))}
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror or error})") from error
    except ValueError as error:
        raise InputError(
            f"{path}: cannot load it as an ONNX model (damaged, or of another format); export it "
            "again"
        ) from error
    return sorted({_beside(path, location) for location in locations})


def _beside(path: Path, location: str) -> Path:
    """The file of this name in the folder of the model."""
    homes = (path.parent.resolve(), path.resolve().parent)
    absolute = PurePosixPath(location).is_absolute() or PureWindowsPath(location).anchor
    try:
        found = (path.parent / location).resolve()
        inside = not absolute and any(found.is_relative_to(home) for home in homes)
    except (OSError, RuntimeError, ValueError):  # a loop of links, a name that is none
        inside, found = False, path
    if not inside:
        raise InputError(
            f"{path}: keeps tensors in {location!r}, expected a file in its own folder; such a "
            "model can read any file here: if you trust it, save it again with its data beside it"
        )
    if not found.is_file():
        raise InputError(
            f"{path}: keeps tensors in {location!r}, and there is no such file beside it; copy "
            "it there, it belongs to the model"
        )
    return found


def _locations(model: memoryview) -> Iterator[memoryview]:
    """What the tensors of a model say of where their data are."""
    pending = [(model, "ModelProto")]
    while pending:
        message, kind = pending.pop()
        fields = _fields(message)
        if kind == "StringStringEntryProto":
            entry = dict(fields)
            if entry.get(1) == b"location":
                yield entry.get(2, memoryview(b""))
            continue
        for number, value in fields:
            if number in LEADS_TO[kind]:
                pending.append((value, LEADS_TO[kind][number]))


def _fields(message: memoryview) -> Iterator[tuple[int, memoryview]]:
    """Numbers and bytes of the fields of a message that are strings or messages themselves."""
    at = 0
    while at < len(message):
        tag, at = _varint(message, at)
        wire = tag & 7
        if wire == 0:
            _, at = _varint(message, at)
        elif wire == 2:
            size, at = _varint(message, at)
            # A tag has 32 bits; what is above them, protocol buffers ignore.
            yield (tag & 0xFFFFFFFF) >> 3, message[at : at + size]
            at += size
        elif wire in SKIPPED_BYTES:
            at += SKIPPED_BYTES[wire]
        else:
            raise ValueError(f"wire type {wire}")
    if at > len(message):
        raise ValueError("cut off")


def _varint(message: memoryview, at: int) -> tuple[int, int]:
    """A number of seven bits per byte, the lowest first, and where the next field begins."""
    value = 0
    for count, byte in enumerate(message[at : at + 10]):
        value |= (byte & 127) << 7 * count
        if byte < 128:
            return value, at + count + 1
    raise ValueError("no number")
