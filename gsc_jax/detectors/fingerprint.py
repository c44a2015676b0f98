"""Fingerprint of a model: the key under which `CachedDetector` stores its outputs."""

import hashlib
import mmap
import re
from pathlib import Path

LOCATION_ENTRY = re.compile(rb"\n\x08location\x12([\x80-\xff]?)([\x00-\x7f])", re.DOTALL)
"""An entry "location" of a tensor in protocol buffers: tag, length, key, tag, length of the value
as one or two base-128 digits, lowest first. The value follows."""


def fingerprint(path: Path, *facts: object) -> str:
    """Digest of everything that determines the output of a model for an image.

    This is the model, which onnxruntime has loaded, with its external tensors, the version of
    onnxruntime, the code of this folder and the given facts, such as the spec and the providers.
    """
    import onnxruntime

    facts = (onnxruntime.__version__, *facts)
    digest = hashlib.blake2b(repr(facts).encode(), digest_size=16)
    for part in (*sorted(Path(__file__).parent.glob("*.py")), path, *external_files(path)):
        with part.open("rb") as file:
            digest.update(hashlib.file_digest(file, hashlib.blake2b).digest())
    return digest.hexdigest()


def external_files(path: Path) -> list[Path]:
    """Existing files in which a model stores external tensors, sorted.

    The entries that name these files are found by their byte pattern, without parsing the model.
    onnxruntime has validated them when it loaded the model.
    """
    with path.open("rb") as file, mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ) as model:
        names = set()
        for entry in LOCATION_ENTRY.finditer(model):
            low, high = (int.from_bytes(digit) for digit in entry.groups())
            length = (low & 127) + (high << 7) if entry[1] else high
            names.add(model[entry.end() : entry.end() + length].decode(errors="replace"))
    return sorted(path.parent / name for name in names if (path.parent / name).is_file())
