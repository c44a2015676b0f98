"""--dry-run: what it says, that it is roughly true, and that nothing is written."""

import re
import types

import numpy as np
import pytest
from cli_case import (
    COUNT,
    FIXTURES,
    contents,
    given,
    network,
    refused,
    run,
    views_asked_of_networks,
)

from gsc_jax.cli import dry_run, trial
from gsc_jax.cli.locate import plan_locate
from gsc_jax.cli.options import Locate
from gsc_jax.estimators.robust.early_stopping import batches

case, found, own_cache = FIXTURES
pytestmark = pytest.mark.usefixtures("own_cache")


def said(out: str) -> dict[str, str]:
    """The lines, by their first words."""
    return {line[:9].strip(): line[9:] for line in out.splitlines()[1:]}


def test_it_says_what_would_be_done_and_does_nothing(case, tmp_path):
    out = tmp_path / "new" / "out"
    answer = run(*given(case), "--out", out, "--dry-run")
    assert answer.code == 0
    assert not out.parent.exists()
    assert answer.out.startswith("A dry run: nothing was written to ")
    lines = said(answer.out)
    assert f"{COUNT - 2} Gaussians" in lines["scene"]
    assert lines["views"] == f"3 of 48 x 40 pixels, from {case / 'cameras.json'}"
    assert lines["asks"] == "the Gaussians themselves"
    assert lines["reads"] == f"the masks of 3 views in {case / 'masks'}"
    assert lines["method"].startswith("robust (threshold 0.5, mask rule share")
    assert lines["writes"].startswith(f"{out}: about ")
    assert lines["writes"].endswith("a new folder")
    assert re.fullmatch(r"about [\d.]+ s \([\d.]+ s to [\d.]+ s\)(: .*)?", lines["time"])
    assert re.fullmatch(r"about [\d.]+ [MG]iB", lines["memory"])
    assert answer.err.startswith("1 warning:\n")
    assert "left out 2 of 300" in answer.err


def test_what_is_there_would_be_replaced_and_is_not(case, found):
    out, _ = found
    before = contents(out)
    answer = run(*given(case, method="paper"), "--out", out, "--dry-run")
    assert "in place of the results there" in said(answer.out)["writes"]
    assert "epochs 5" in said(answer.out)["method"]
    assert contents(out) == before


def test_other_files_stay(case, tmp_path):
    (tmp_path / "notes.txt").write_text("mine")
    (tmp_path / "labels.npy").write_text("mine")
    answer = run(*given(case, masks=None), "--out", tmp_path, "--dry-run")
    assert "in place of 1 file there" in said(answer.out)["writes"]
    assert "reads" not in said(answer.out)
    (tmp_path / "labels.npy").unlink()
    answer = run(*given(case, masks=None), "--out", tmp_path, "--dry-run")
    assert "beside what is there" in said(answer.out)["writes"]


def test_a_network_is_timed_on_one_view_that_is_kept(case, tmp_path, monkeypatch):
    asked = views_asked_of_networks(monkeypatch)
    model = network(tmp_path / "red.onnx")
    argv = [*given(case, masks=None, detector=model), "--out", tmp_path / "out"]
    first = said(run(*argv, "--dry-run").out)
    assert len(asked) == 1
    assert first["shows"].startswith(f"the views to {model}: ")
    assert first["shows"].endswith(" s a view")
    second = said(run(*argv, "--dry-run").out)
    assert len(asked) == 2
    assert "1 of 3 views tried are kept" in second["shows"]
    assert run(*argv).code == 0
    assert len(asked) == 3, "what a dry run asked was asked again"
    assert "3 of 3 views tried are kept" in said(run(*argv, "--dry-run").out)["shows"]
    assert len(asked) == 3
    assert said(run(*argv, "--dry-run", "--no-cache").out)["shows"].endswith(" s a view")


@pytest.mark.parametrize(
    ("changes", "expected"),
    [
        ({"scene": "missing.ply"}, "missing.ply: no such file"),
        ({"masks": "missing"}, "missing: does not exist"),
        ({"near": 50}, "the near plane at 50"),
        ({"masks": None, "detector": "missing.onnx"}, "missing.onnx: does not exist"),
        ({"threshold": 3}, "--threshold 3"),
    ],
)
def test_it_refuses_what_a_run_would(case, tmp_path, changes, expected):
    message = refused(*given(case, **changes), "--out", tmp_path / "out", "--dry-run")
    assert expected in message


def test_a_folder_that_could_not_be_written(case, tmp_path):
    (tmp_path / "file").write_text("in the way")
    message = refused(*given(case), "--out", tmp_path / "file" / "out", "--dry-run")
    assert "cannot be written to" in message


def test_the_network_is_shown_fewer_views_at_least_than_at_most(case, tmp_path):
    options = Locate(
        scene=case / "scene.ply",
        cameras=case / "cameras.json",
        detector=(network(tmp_path / "red.onnx"),),
        out=tmp_path / "out",
    )
    plan = plan_locate(options)
    shown = trial.Network(seconds=2.0, kept=0, tried=3)
    few, many = trial.looks_of(plan, 100, shown)
    assert list(many) == list(batches(100))
    assert list(few) == list(batches(100))[:2]
    assert trial.looks_of(plan, 3, None) == ([3], [3])


def test_seconds_grow_with_the_views_and_with_what_is_asked_of_them():
    tried = types.SimpleNamespace(masks={"a": None, "b": None})
    measured = trial.Round(look=0.5, optimise=3.0, masks=0.25, result=tried)  # type: ignore[arg-type]
    writing = trial.Writing(once=2.0, each=0.1, bytes_once=1000, bytes_each=10)
    network = trial.Network(seconds=4.0, kept=1, tried=4)
    said = trial.seconds_by_stage(40, measured, writing, [8, 16], network)
    assert said == pytest.approx(
        {"look": 16 * (0.5 + 3.0), "optimise": 3.0 * 12, "masks": 10.0, "write": 6.0}
    )
    assert writing.bytes(40) == 1400


def test_durations_and_sizes_are_for_people():
    seconds = [0.04, 9.94, 35.2, 119, 121, 7000, 9000]
    assert [dry_run.duration(s) for s in seconds] == [
        *("0.0 s", "9.9 s", "35 s", "119 s"),
        *("2 min", "117 min", "2.5 h"),
    ]
    assert [dry_run.size(n) for n in (2**20, 37 * 2**20, 3 * 2**30)] == [
        "1 MiB",
        "37 MiB",
        "3.0 GiB",
    ]


def test_the_clock_tells_the_time_between_steps():
    clock = trial.Clock()
    for done in range(4):
        clock("look", done, 3)
    times = clock.times["look"]
    assert clock.since("look", 1) == times[3] - times[1]
    assert clock.since("look", 9) == clock.since("never", 0) == 0.0
    assert np.all(np.diff(times) >= 0)
