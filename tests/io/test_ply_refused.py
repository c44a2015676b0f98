"""Damaged .ply files, and those that promise or take too much, are refused with the reason."""

import bz2
import contextlib
import gzip
import lzma
import time

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from ply_files import assert_same, columns_of, write_columns
from strategies import random_scene

from gsc_jax.io.ply import load_ply, read_ply, save_ply
from gsc_jax.scene import InputError

SMALL = columns_of(random_scene(7, degree=0))
quick = settings(deadline=None, max_examples=30)


@pytest.mark.parametrize(
    ("content", "problem"),
    [
        (b"", "not a PLY file"),
        (b"version https://git-lfs.github.com/spec/v1\n", "pointer of git-lfs; .* git lfs pull"),
        (b"\x89PNG\r\n\x1a\n\xff\xfe", "not a PLY file"),
        (b"ply\nformat binary_little_endian 1.0\n", "not a PLY file"),
        (b"ply\nformat ascii 1.0\nelement vertex 1\nproperty half x\nend_header\n1\n", "half"),
        (b"ply\nformat ascii 1.0\nelement face 0\nproperty int i\nend_header\n", "no vertices"),
        (b"ply\nformat ascii 1.0\nelement vertex 0\nproperty int x\nend_header\n", "no vertices"),
        (
            b"ply\nformat ascii 1.0\nelement vertex 1\nproperty uchar x\nend_header\n300\n",
            "not a PLY file",
        ),
    ],
)
def test_other_files_are_refused(tmp_path, content, problem):
    path = tmp_path / "bad.ply"
    path.write_bytes(content)
    with pytest.raises(InputError, match=problem) as error:
        read_ply(path)
    assert str(error.value).startswith(f"{path}: ")
    assert "\n" not in str(error.value)


@quick
@given(text=st.booleans(), share=st.floats(0, 0.999))
def test_truncated_files_are_refused(tmp_path_factory, text, share):
    path = tmp_path_factory.mktemp("cut") / "cut.ply"
    whole = write_columns(path, SMALL, text=text).read_bytes()
    # At least 25 bytes are cut off: inside the last number, a cut leaves a shorter, valid one.
    path.write_bytes(whole[: int(share * (len(whole) - 25))])
    with pytest.raises(InputError, match=r"cut short .* header promises 7|not a PLY file"):
        read_ply(path)


@settings(deadline=None, max_examples=100)
@given(data=st.data())
def test_a_damaged_header_is_an_error_or_a_scene(tmp_path_factory, data):
    path = tmp_path_factory.mktemp("header") / "scene.ply"
    content = bytearray(write_columns(path, SMALL).read_bytes())
    position = data.draw(st.integers(0, content.index(b"end_header") + 10))
    content[position] = data.draw(st.integers(0, 255))
    path.write_bytes(content)
    with contextlib.suppress(InputError):
        read_ply(path)


@pytest.mark.parametrize(
    "header",
    [
        "format ascii 1.0\nelement vertex 1000000000000\nproperty float x",
        "format ascii 1.0\nelement vertex 1000000000000",
        "format binary_little_endian 1.0\nelement vertex 1000000000000\nproperty list uchar int x",
        "format binary_little_endian 1.0\nelement vertex 1000000000000",
        "format binary_little_endian 1.0\nelement vertex -1\nproperty float x",
        f"format ascii 1.0\nelement vertex {'9' * 5000}\nproperty float x",
    ],
)
def test_headers_that_promise_more_than_the_file_holds_are_refused(tmp_path, header):
    path = tmp_path / "scene.ply"
    path.write_text(f"ply\n{header}\nend_header\n1\n")
    with pytest.raises(InputError, match=r"scene\.ply: not a PLY file") as error:
        read_ply(path)
    assert len(str(error.value)) < 500


def test_a_header_without_an_end_is_not_searched_for_it(tmp_path):
    path = tmp_path / "scene.ply"
    path.write_bytes(b"ply\n" + bytes(10**8))
    began = time.perf_counter()
    with pytest.raises(InputError, match="no header"):
        read_ply(path)
    assert time.perf_counter() - began < 1


@pytest.mark.parametrize("text", [False, True])
def test_scenes_beyond_the_memory_are_refused_before_they_are_read(tmp_path, text):
    path = write_columns(tmp_path / "scene.ply", columns_of(random_scene(1000)), text=text)
    assert len(read_ply(path, max_bytes=10**7).gaussians) == 1000
    with pytest.raises(InputError, match="of memory"):
        read_ply(path, max_bytes=10**5)


@pytest.mark.parametrize(
    ("pack", "program"),
    [(gzip.compress, "gunzip -c"), (bz2.compress, "bunzip2 -c"), (lzma.compress, "xz -dc")],
)
def test_a_packed_file_is_refused_with_the_program_that_unpacks_it(tmp_path, pack, program):
    path = tmp_path / "scene.ply"
    save_ply(path, random_scene(3))
    path.write_bytes(pack(path.read_bytes()))
    with pytest.raises(InputError, match=rf"scene\.ply: is packed; unpack it first: {program}"):
        read_ply(path)


@pytest.mark.parametrize(("size", "valid"), [(60_000, True), (70_000, False)])
def test_a_header_has_at_most_64_kib(tmp_path, size, valid):
    path = write_columns(tmp_path / "scene.ply", SMALL)
    comments = b"comment " + b"x" * 91 + b"\n"
    content = path.read_bytes().replace(b"element", comments * (size // 100) + b"element", 1)
    path.write_bytes(content)
    if valid:
        assert_same(load_ply(path), random_scene(7, degree=0))
    else:
        with pytest.raises(InputError, match="no header"):
            load_ply(path)


def test_a_text_of_short_numbers_takes_more_memory_than_a_binary_file_of_its_size(tmp_path):
    columns = {name: np.zeros(2000, np.int16) for name in SMALL} | {"rot_0": np.ones(2000, "i2")}
    for text, refused in ((False, False), (True, True)):
        path = write_columns(tmp_path / f"{text}.ply", columns, text=text)
        size = path.stat().st_size
        assert read_ply(path, max_bytes=8 * size).total == 2000
        if refused:
            with pytest.raises(InputError, match="of memory"):
                read_ply(path, max_bytes=5 * size)
        else:
            assert read_ply(path, max_bytes=5 * size).total == 2000


def test_empty_lists_take_much_more_memory_than_their_bytes(tmp_path):
    path = write_columns(tmp_path / "scene.ply", SMALL)
    faces = b"element face 5000\nproperty list uchar int ids\nend_header\n"
    path.write_bytes(path.read_bytes().replace(b"end_header\n", faces) + bytes(5000))
    assert read_ply(path, max_bytes=2_000_000).total == 7
    with pytest.raises(InputError, match="of memory"):
        read_ply(path, max_bytes=500_000)


@pytest.mark.parametrize("name", ["scene.splat", "scene.SPZ", "scene.glb"])
def test_a_suffix_of_another_format_is_not_written(tmp_path, name):
    with pytest.raises(InputError, match=rf"{name}: not written: .* another format than \.ply"):
        save_ply(tmp_path / name, random_scene(3))
    assert not list(tmp_path.iterdir())
