"""Masks as damaged images, and the check of those that can be read all the same."""

import functools
import io
import zlib
from pathlib import Path
from random import Random

import numpy as np
from fuzz.harness import READER_BYTES
from fuzz.mutate import damaged_bytes
from PIL import Image

from gsc_jax.io.masks import read_probability


@functools.cache
def _masks() -> list[tuple[str, bytes]]:
    levels = (np.arange(12, dtype=np.uint8) * 20).reshape(3, 4)
    grey = Image.fromarray(levels)
    palette = grey.convert("P")
    images = {
        "png": [grey, grey.convert("RGBA"), palette, Image.fromarray(levels * np.uint16(257))],
        "jpg": [grey],
        "tif": [grey, Image.fromarray(levels / np.float32(255))],
        "bmp": [grey],
        "webp": [grey.convert("RGB")],
    }
    files = []
    for suffix, kinds in images.items():
        for image in kinds:
            stream = io.BytesIO()
            image.save(stream, {"jpg": "JPEG", "tif": "TIFF"}.get(suffix, suffix.upper()))
            files.append((f"mask.{suffix}", stream.getvalue()))
    return files


def make_mask(rng: Random | None, folder: Path) -> Path:
    name, data = _masks()[0] if rng is None else rng.choice(_masks())
    if rng is not None:
        data = damaged_bytes(rng, data)
        if name.endswith("png") and rng.random() < 0.7:
            data = _with_checksums(data)
    (folder / name).write_bytes(data)
    return folder / name


def _with_checksums(png: bytes) -> bytes:
    """Correct the checksums of the chunks: a decoder reads no chunk whose checksum is wrong."""
    content, at = bytearray(png), 8
    while at + 12 <= len(content):
        end = at + 8 + int.from_bytes(content[at : at + 4], "big")
        if end + 4 > len(content):
            break
        content[end : end + 4] = zlib.crc32(content[at + 4 : end]).to_bytes(4, "big")
        at = end + 4
    return bytes(content)


def check_mask(path: Path) -> None:
    mask = read_probability(path, max_bytes=READER_BYTES)
    assert mask.ndim == 2
    assert mask.dtype == np.float32
    assert ((mask >= 0) & (mask <= 1)).all()
