"""Files that take more memory than is allowed are refused before it is allocated."""

import pytest

from gsc_jax.io import files
from gsc_jax.io.files import GIB, check_allocation, memory_limit
from gsc_jax.scene import InputError


def test_the_bound_is_half_of_the_machine_or_of_the_container(tmp_path, monkeypatch):
    monkeypatch.setattr(files, "CGROUP_LIMIT", tmp_path / "memory.max")
    machine = 2 * memory_limit()
    assert 0.1 * GIB < machine < 2**50
    (tmp_path / "memory.max").write_text("max\n")
    assert 2 * memory_limit() == machine
    (tmp_path / "memory.max").write_text(f"{machine // 4}\n")
    assert memory_limit() == machine // 8
    assert memory_limit(1.5) == 3 * GIB // 2


def test_more_than_the_bound_is_refused():
    check_allocation("a.ply", 3 * GIB, 3 * GIB)
    with pytest.raises(InputError, match=r"^a\.ply: takes 4 GiB .* 3 GiB.*--memory"):
        check_allocation("a.ply", 4 * GIB, 3 * GIB)
    with pytest.raises(InputError, match="takes"):
        check_allocation("a.ply", 2**60, None)
