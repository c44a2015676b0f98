"""Files are written completely or not at all."""

from pathlib import Path

import pytest
from strategies import random_scene

from gsc_jax.io.files import atomic
from gsc_jax.io.ply import save_ply
from gsc_jax.scene import InputError


def write_half(path: Path) -> None:
    path.write_text("half")
    raise ValueError("exactly half")


def test_a_failed_write_keeps_the_previous_file(tmp_path):
    path = tmp_path / "new/deep/file.txt"
    with atomic(path) as temporary:
        temporary.write_text("old")
        assert not path.exists()
        assert temporary.suffix == ".txt"
    with pytest.raises(ValueError, match="exactly half"), atomic(path) as temporary:
        write_half(temporary)
    assert path.read_text() == "old"
    assert list(path.parent.iterdir()) == [path]


def test_targets_that_cannot_be_written_are_named(tmp_path):
    (tmp_path / "file").write_text("")
    for path in (tmp_path, tmp_path / "file/scene.ply"):
        with pytest.raises(InputError, match=f"{path}: cannot be written"):
            save_ply(path, random_scene(2))
    assert [path.name for path in tmp_path.iterdir()] == ["file"]
