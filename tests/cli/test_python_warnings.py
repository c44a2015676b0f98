"""Warnings at the end of a run: those of the run itself, and what libraries raise."""

import re
import warnings

import pytest
from cli_case import FIXTURES, given, run

from gsc_jax.cli import locate as app_run
from gsc_jax.cli.python_warnings import caught
from gsc_jax.scene import InputError

case, found, own_cache = FIXTURES
pytestmark = pytest.mark.filterwarnings("default")


def test_each_is_kept_once_and_says_where_it_is_from():
    with caught() as said:
        for _ in range(3):
            warnings.warn("one\n  thing", RuntimeWarning, stacklevel=1)
        warnings.warn("another", UserWarning, stacklevel=1)
        assert said == []
    assert [re.sub(r"\d+", "N", one) for one in said] == [
        "one thing (RuntimeWarning in test_caught.py, line N)",
        "another (UserWarning in test_caught.py, line N)",
    ]


def test_they_are_kept_although_the_block_fails():
    lists = []

    def fail() -> None:
        with caught() as said:
            lists.append(said)
            warnings.warn("before the end", UserWarning, stacklevel=1)
            raise ZeroDivisionError

    with pytest.raises(ZeroDivisionError):
        fail()
    assert len(lists[0]) == 1


def test_what_is_filtered_out_stays_out():
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        with caught() as said:
            warnings.warn("nobody wants to know", UserWarning, stacklevel=1)
    assert said == []


def test_a_run_lists_them_after_its_own(case, tmp_path, monkeypatch):
    really = app_run.write_results

    def warning(*arguments, **options):
        warnings.warn("a library is in doubt", FutureWarning, stacklevel=1)
        return really(*arguments, **options)

    monkeypatch.setattr(app_run, "write_results", warning)
    answer = run(*given(case), "--out", tmp_path / "out")
    assert answer.code == 0
    first, own, other = answer.err.splitlines()
    assert first == "2 warnings:"
    assert "left out 2 of 300" in own
    assert "a library is in doubt (FutureWarning in test_caught.py" in other


def test_a_run_that_fails_does_not_swallow_them(case, tmp_path, monkeypatch):
    def warning(*arguments, **options):
        warnings.warn("a library is in doubt", FutureWarning, stacklevel=1)
        raise InputError("no")

    monkeypatch.setattr(app_run, "write_results", warning)
    answer = run(*given(case), "--out", tmp_path / "out")
    assert (answer.code, answer.out) == (2, "")
    assert "a library is in doubt" in answer.err
    assert answer.err.endswith("gsc-jax: no\n")
