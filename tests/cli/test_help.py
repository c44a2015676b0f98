"""The command line: its help, and the console script."""

import contextlib
import io
import subprocess
import sys
import typing
from pathlib import Path

import pytest

from gsc_jax.benchmark.simulate import REGIMES
from gsc_jax.cli import main as cli
from gsc_jax.cli import options
from gsc_jax.evidence.masks import MaskRule


@pytest.fixture(autouse=True)
def narrow(monkeypatch) -> None:
    monkeypatch.setenv("COLUMNS", "80")


def help_of(*command: str) -> str:
    with pytest.raises(SystemExit) as stop, contextlib.redirect_stdout(io.StringIO()) as printed:
        cli.main([*command, "--help"])
    assert not stop.value.code
    return printed.getvalue()


@pytest.mark.parametrize("command", cli.NAMES)
def test_help_teaches(command):
    text = help_of(command)
    assert f"gsc-jax {command}" in text
    assert "for example:" in text
    assert all(len(line) <= 80 for line in text.splitlines())
    assert "default: None" not in text
    assert "default: False" not in text
    if command == "locate":
        assert "{robust,paper,official}" in text
        assert "0.2" in text
        assert "world units" in text
        for flag in ("--config FILE", "--dry-run", "--mask-rule share|attribute|per-view"):
            assert flag in text


def test_all_commands_are_told_of_in_a_sentence_each():
    text = help_of()
    assert len(text.splitlines()) < 30
    assert "130 interrupted" in " ".join(text.split())
    for name, kind in cli.NAMES.items():
        first = (kind.__doc__ or "").partition("\n")[0]
        assert f"• {name} " in text
        assert first.split()[0] in text
        assert "for example" not in text


def test_rules_in_the_help_are_those_that_there_are():
    assert " ".join(typing.get_args(MaskRule)) == "share attribute per-view"


def test_the_masks_of_tamper_are_the_regimes():
    assert typing.get_args(options.Regime) == ("none", *REGIMES)


def test_the_console_script_runs():
    script = Path(sys.executable).parent / "gsc-jax"
    command = [str(script)] if script.exists() else [sys.executable, "-m", "gsc_jax.cli.main"]
    done = subprocess.run([*command, "--version"], capture_output=True, text=True, check=False)
    assert (done.returncode, done.stderr) == (0, "")
    assert done.stdout.startswith("gsc-jax ")
    done = subprocess.run([*command, "locate"], capture_output=True, text=True, check=False)
    assert done.returncode == 2
    assert done.stderr.count("\n") == 1
