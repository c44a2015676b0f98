"""The README: its Python runs as written, its commands are understood."""

import re
import shlex
from pathlib import Path

import numpy as np
import pytest

from gsc_jax.app.cli import _parse
from gsc_jax.benchmark.scenes import tampered_room
from gsc_jax.io.cameras import save_cameras
from gsc_jax.io.ply import save_ply

README = (Path(__file__).resolve().parents[1] / "README.md").read_text(encoding="utf-8")
COMMANDS = re.findall(r"^    (gsc-jax .*)$", README, flags=re.MULTILINE)


def test_the_python_code_runs_as_written(tmp_path, monkeypatch):
    made = tampered_room(count=2_000, views=3, heldout=1, width=64, height=48)
    save_ply(tmp_path / "scene.ply", made.gaussians)
    save_cameras(tmp_path / "cameras.json", made.cameras)
    np.save(tmp_path / "labels.npy", made.labels)
    monkeypatch.chdir(tmp_path)
    (code,) = re.findall(r"```python\n(.*?)```", README, flags=re.DOTALL)
    names: dict = {}
    exec(compile(code, "README.md", "exec"), names)
    assert names["result"].labels.shape == (2_000,)


@pytest.mark.parametrize("command", COMMANDS)
def test_the_commands_are_understood(command):
    assert _parse(shlex.split(command)[1:]).out.name in ("demo", "edited", "found")


def test_there_are_commands_to_understand():
    assert len(COMMANDS) >= 3


def test_every_page_that_is_linked_is_there():
    root = Path(__file__).resolve().parents[1]
    for page in re.findall(r"\]\(([^)#]+)\)", README):
        assert (root / page).exists(), f"{page} is linked but missing"
