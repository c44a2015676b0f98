"""A folder of results is replaced as a whole, or left unchanged."""

import json
import os
import re
import signal
import time
from pathlib import Path

import pytest
from cli_case import contents

from gsc_jax.cli.locate_options import Locate
from gsc_jax.cli.staging import ABANDONED_SECONDS, OUTPUTS, UNFINISHED, replacing
from gsc_jax.scene import InputError

NAMES = ("highlight.ply", "labels.npy", "masks/a.png", "report.html", "result.json")
README = (Path(__file__).resolve().parents[2] / "README.md").read_text(encoding="utf-8")


def write(folder: Path, content: str, names: tuple[str, ...] = NAMES) -> None:
    """Files of one content, and a report that lists them."""
    for name in names:
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_text(content)
    (folder / "result.json").write_text(json.dumps({"run": content, "outputs": names}))


@pytest.fixture
def out(tmp_path) -> Path:
    """Results of an earlier run with one more view, and their scores."""
    out = tmp_path / "out"
    write(out, "old", (*NAMES, "masks/b.png"))
    (out / "evaluation.json").write_text("old")
    return out


def test_files_of_the_earlier_run_are_replaced_or_removed(out):
    (out / "mine.txt").write_text("mine")
    with replacing(out) as folder:
        write(folder, "new")
    assert set(contents(out)) == {*NAMES, "mine.txt"}
    assert {(out / name).read_text() for name in NAMES[:-1]} == {"new"}


@pytest.mark.parametrize("blocked", ["labels.npy", "result.json", "masks/a.png", "masks"])
def test_a_folder_or_file_in_the_way_leaves_everything_old(tmp_path, blocked):
    mine = tmp_path / blocked if blocked == "masks" else tmp_path / blocked / "mine"
    mine.parent.mkdir(parents=True, exist_ok=True)
    mine.write_text("mine")
    with pytest.raises(InputError, match="is a f") as refused, replacing(tmp_path) as folder:
        write(folder, "new")
    assert str(refused.value).startswith(f"{tmp_path / blocked}: ")
    assert contents(tmp_path) == {str(mine.relative_to(tmp_path)): b"mine"}


@pytest.mark.parametrize("moves", range(len(NAMES)))
def test_a_disk_that_is_full_leaves_no_report_of_others(out, monkeypatch, moves):
    """As being killed does: a report is only there beside the files that it is about."""
    replace, moved = Path.replace, []

    def full(path: Path, target: Path) -> Path:
        if len(moved) == moves:
            raise OSError(28, "No space left on device")
        moved.append(target)
        return replace(path, target)

    monkeypatch.setattr(Path, "replace", full)
    with pytest.raises(InputError, match="No space left on device"), replacing(out) as folder:
        write(folder, "new")
    assert not (out / "result.json").exists()
    assert (out / "report.html").exists() == (moves == len(NAMES) - 1)
    assert not list(out.glob(".*"))


def test_the_target_of_a_link_is_kept(out, tmp_path):
    precious = tmp_path / "precious.png"
    precious.write_text("mine")
    (out / "masks" / "b.png").unlink()
    (out / "masks" / "b.png").symlink_to(precious)
    with replacing(out) as folder:
        write(folder, "new")
    assert precious.read_text() == "mine"
    assert not (out / "masks" / "b.png").is_symlink()


def test_inputs_of_the_run_are_kept(out):
    with replacing(out, keep=[out / "masks"]) as folder:
        write(folder, "new")
    assert (out / "masks" / "b.png").read_text() == "old"
    assert not (out / "evaluation.json").exists()


@pytest.mark.parametrize("error", [InputError, KeyboardInterrupt, ZeroDivisionError])
def test_created_folders_are_removed_if_the_run_fails(tmp_path, error):
    (tmp_path / "there").mkdir()
    with pytest.raises(error), replacing(tmp_path / "there" / "new" / "deep" / "out"):
        raise error("on purpose")
    assert list(tmp_path.rglob("*")) == [tmp_path / "there"]


def test_results_of_tamper_do_not_remove_a_report(tmp_path):
    write(tmp_path, "mine", ("report.html", "evaluation.json"))
    (tmp_path / "result.json").rename(tmp_path / "edit.json")
    with replacing(tmp_path, report="edit.json", by_camera=("masks",)) as folder:
        (folder / "edit.json").write_text("new")
    assert (tmp_path / "report.html").read_text() == "mine"
    assert (tmp_path / "evaluation.json").read_text() == "mine"


def test_help_and_readme_list_every_output():
    listed = (Locate.__doc__ or "").partition("written to the folder")[2].partition("\n\n")[0]
    assert sorted(re.findall(r"(\w+(?:/|\.\w+))(?:,| {2})", listed)) == sorted(OUTPUTS)
    table = README.partition("[start:outputs]")[2].partition("[end:outputs]")[0]
    assert set(OUTPUTS) <= set(re.findall(r"`(.+?)`", table))


def test_a_signal_does_not_interrupt_moving_files(out, monkeypatch):
    replace, sent = Path.replace, []

    def slow(path: Path, target: Path) -> Path:
        if not sent:
            sent.append(True)
            os.kill(os.getpid(), signal.SIGINT)
        return replace(path, target)

    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    monkeypatch.setattr(Path, "replace", slow)
    try:
        with pytest.raises(KeyboardInterrupt), replacing(out) as folder:
            write(folder, "new")
    finally:
        signal.signal(signal.SIGINT, before)
    assert set(contents(out)) == set(NAMES)
    assert {(out / name).read_text() for name in NAMES[:-1]} == {"new"}


def test_abandoned_temporary_folders_are_removed(tmp_path):
    old, new = tmp_path / f"{UNFINISHED}old", tmp_path / f"{UNFINISHED}new"
    for folder in (old, new):
        folder.mkdir()
        (folder / "tamper.ply").write_bytes(b"half of it")
    before = time.time() - ABANDONED_SECONDS - 60
    os.utime(old, (before, before))
    with replacing(tmp_path) as folder:
        (folder / "labels.npy").write_bytes(b"labels")
    assert not old.exists()
    assert new.exists(), "another run may be using it"
    assert (tmp_path / "labels.npy").exists()
