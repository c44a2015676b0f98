"""A folder of results is replaced as a whole, or left unchanged, however the run ends."""

import contextlib
import hmac
import json
import os
import re
import shutil
import signal
from pathlib import Path

import pytest
from cli_case import contents

from gsc_jax.cli import cache, staging
from gsc_jax.cli.options import Locate
from gsc_jax.cli.ownership import refuse_foreign
from gsc_jax.cli.staging import EVALUATION_MARK, OUTPUTS, UNFINISHED, replacing, views_of
from gsc_jax.scene import InputError

NAMES = ("highlight.ply", "labels.npy", "masks/a.png", "report.html", "result.json")
README = (Path(__file__).resolve().parents[2] / "README.md").read_text(encoding="utf-8")


@pytest.fixture(autouse=True)
def own_secret(tmp_path_factory, monkeypatch):
    folder = tmp_path_factory.mktemp("cache")
    monkeypatch.setattr(cache, "cache_folder", lambda: folder)


def write(folder: Path, content: str, names: tuple[str, ...] = NAMES) -> None:
    """Files of one content, and a report that lists them."""
    for name in names:
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_text(content)
    (folder / "result.json").write_text(json.dumps({"run": content}))


@pytest.fixture
def out(tmp_path, own_secret) -> Path:
    """Results of an earlier run with one more view, and their scores."""
    out = tmp_path / "out"
    with replacing(out) as folder:
        write(folder, "old", (*NAMES, "masks/b.png"))
    (out / "evaluation.json").write_text(f"{EVALUATION_MARK}old")
    return out


def test_files_of_the_earlier_run_are_replaced_or_removed(out):
    (out / "mine.txt").write_text("mine")
    with replacing(out) as folder:
        write(folder, "new")
    assert set(contents(out)) == {*NAMES, "mine.txt"}
    assert not (out / UNFINISHED).exists()
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


class Killed(BaseException):
    """Stands for kill -9: nothing is cleaned up after it."""


def stop_at(move, error, monkeypatch):
    """Raise an error instead of moving the file with this number."""
    replace, moved = Path.replace, []

    def counted(path: Path, target: Path) -> Path:
        if not path.name.startswith("."):  # as `atomic` names what is not complete
            if len(moved) == move:
                raise error
            moved.append(target)
        return replace(path, target)

    monkeypatch.setattr(Path, "replace", counted)


@pytest.mark.parametrize("move", range(len(NAMES)))
def test_a_disk_that_is_full_while_files_are_moved(out, monkeypatch, move):
    stop_at(move, OSError(28, "No space left on device"), monkeypatch)
    with pytest.raises(InputError, match="No space left on device"), replacing(out) as folder:
        write(folder, "new")
    assert not (out / "result.json").exists(), "it would describe other files"
    assert (out / "report.html").exists() == (move == len(NAMES) - 1)


@pytest.mark.parametrize("identity", [None, "views of this run"])
@pytest.mark.parametrize("move", range(len(NAMES)))
def test_a_run_that_is_killed_while_files_are_moved_is_finished_by_the_next(
    out, monkeypatch, move, identity
):
    with monkeypatch.context() as patched:
        patched.setattr(staging, "_end", lambda *_: None)
        stop_at(move, Killed, patched)
        with pytest.raises(Killed), replacing(out, identity=identity) as folder:
            write(folder, "killed")
    assert not (out / "result.json").exists()
    with pytest.raises(ZeroDivisionError), replacing(out):
        raise ZeroDivisionError
    assert set(contents(out)) == set(NAMES), "a mask of the run before was left"
    assert {(out / name).read_text() for name in NAMES[:-1]} == {"killed"}


def test_views_are_kept_for_a_run_of_the_same_identity_only(tmp_path):
    def interrupted(identity):
        found = []
        with contextlib.suppress(KeyboardInterrupt), replacing(tmp_path, identity=identity) as new:
            views_of(new).mkdir(exist_ok=True)
            found += [path.name for path in views_of(new).iterdir()]
            (views_of(new) / "a.npy").touch()
            raise KeyboardInterrupt
        return found

    found = [interrupted(identity) for identity in ("one", "one", "two", "two")]
    assert found == [[], ["a.npy"], [], ["a.npy"]]
    with replacing(tmp_path, identity="two") as folder:
        write(folder, "new")
        assert (views_of(folder) / "a.npy").exists()
    assert set(contents(tmp_path)) == set(NAMES)


def test_two_runs_do_not_write_into_one_folder(out):
    before = contents(out)
    with replacing(out) as folder:
        write(folder, "new")
        with pytest.raises(InputError, match="another run is writing"), replacing(out):
            raise AssertionError("both runs write")
        assert {name: contents(out)[name] for name in before} == before
    assert (out / "labels.npy").read_text() == "new"


def test_no_link_of_an_unfinished_run_is_followed(out, tmp_path):
    (tmp_path / "mine.txt").write_text("mine")
    (out / UNFINISHED).mkdir()
    (out / UNFINISHED / "views.part").symlink_to(tmp_path / "mine.txt")
    with pytest.raises(InputError, match="is a link"), replacing(out, identity="one"):
        raise AssertionError("the run begins")
    assert (tmp_path / "mine.txt").read_text() == "mine"


@pytest.mark.parametrize("linked", ["masks", "masks/left", UNFINISHED])
def test_nothing_outside_of_the_folder_is_removed_or_written(out, tmp_path, linked):
    elsewhere = tmp_path / "holiday"
    write(elsewhere, "mine", ("a.png", "b.png"))
    if linked == "masks":
        (out / "masks").rename(tmp_path / "masks")
    (out / linked).symlink_to(elsewhere)
    before = contents(elsewhere)
    with pytest.raises(InputError, match="is a link"), replacing(out) as folder:
        write(folder, "new", (*NAMES, "masks/left/a.png"))
    assert contents(elsewhere) == before
    assert (out / "labels.npy").read_text() == "old"


@pytest.mark.parametrize("sealed", [b"", b"[]", b'{"moved": [], "removed": ["mine.txt"]}'])
@pytest.mark.parametrize("seal", [b"", b"0123456789abcdef" * 2 + b"\n"])
def test_a_journal_of_somebody_else_is_ignored(tmp_path, seal, sealed):
    write(tmp_path / UNFINISHED / "new", "theirs", ("labels.npy",))
    (tmp_path / "mine.txt").write_text("mine")
    (tmp_path / "labels.npy").write_text("mine")
    (tmp_path / UNFINISHED / "journal.json").write_bytes(seal + sealed)
    with pytest.raises(ZeroDivisionError), replacing(tmp_path):
        raise ZeroDivisionError
    assert contents(tmp_path) == {"mine.txt": b"mine", "labels.npy": b"mine"}
    assert not (tmp_path / UNFINISHED).exists()


def test_a_journal_is_valid_in_its_folder_only(out, tmp_path, monkeypatch):
    with monkeypatch.context() as patched:
        patched.setattr(staging, "_end", lambda *_: None)
        stop_at(0, Killed, patched)
        with pytest.raises(Killed), replacing(out) as folder:
            write(folder, "killed")
    write(tmp_path / "copy", "mine", ("labels.npy",))
    (out / UNFINISHED).rename(tmp_path / "copy" / UNFINISHED)
    with pytest.raises(ZeroDivisionError), replacing(tmp_path / "copy"):
        raise ZeroDivisionError
    assert (tmp_path / "copy" / "labels.npy").read_text() == "mine"


def test_views_of_somebody_else_are_not_used(tmp_path):
    write(tmp_path / UNFINISHED / "views", "theirs", ("map.npy",))
    (tmp_path / UNFINISHED / "views.txt").write_text("identity")
    with replacing(tmp_path, identity="identity") as new:
        assert not views_of(new).exists()


def test_another_command_keeps_the_views_of_an_interrupted_run(tmp_path):
    with contextlib.suppress(KeyboardInterrupt), replacing(tmp_path, identity="one") as new:
        write(views_of(new), "judged", ("map.npy",))
        raise KeyboardInterrupt
    with replacing(tmp_path, report="render.json"):
        pass
    with replacing(tmp_path, identity="one") as new:
        assert (views_of(new) / "map.npy").exists()
    assert not (tmp_path / UNFINISHED).exists()


@pytest.mark.parametrize(
    "listed",
    [
        *("{", "[" * 100_000, "3", '{"outputs": [3, "masks/\\u0000.png"]}'),
        '{"outputs": {"result.json": null, "masks/\\u0000.png": 3, "../a.png": [], "/": {}}}',
    ],
)
def test_a_damaged_report_of_an_earlier_run_is_replaced(out, listed):
    (out / "result.json").write_text(listed)
    with replacing(out) as folder:
        write(folder, "new")
    assert json.loads((out / "result.json").read_text())["run"] == "new"


@pytest.mark.parametrize("listed", ["masks/b.png", "../precious.png", "elsewhere/precious.png"])
def test_only_files_inside_of_the_folder_that_are_as_they_were_written_are_removed(
    out, tmp_path, listed
):
    precious = tmp_path / "precious.png"
    precious.write_text("old")
    (out / "masks" / "b.png").unlink()
    (out / "masks" / "b.png").symlink_to(precious)
    (out / "elsewhere").symlink_to(tmp_path)
    report = json.loads((out / "result.json").read_text())
    report["outputs"] = {"result.json": None, listed: report["outputs"]["masks/b.png"]}
    (out / "result.json").write_text(json.dumps(report))
    with pytest.raises(InputError, match=f"{listed}: has changed"):
        refuse_foreign(out, [], report="result.json")
    with replacing(out) as folder:
        write(folder, "new")
    assert precious.read_text() == "old"
    assert (out / "masks" / "b.png").is_symlink()


@pytest.mark.parametrize("changed", ["labels.npy", "masks/b.png"])
def test_a_changed_file_is_refused_and_a_copied_folder_is_not(out, tmp_path, changed):
    refuse_foreign(shutil.copytree(out, tmp_path / "copy"), NAMES, report="result.json")
    (out / changed).write_text("corrected by hand")
    with pytest.raises(InputError, match=f"{changed}: has changed since.*another --out"):
        refuse_foreign(out, NAMES, report="result.json")
    if changed not in NAMES:
        with replacing(out) as folder:
            write(folder, "new")
        assert (out / changed).read_text() == "corrected by hand"


def test_scores_of_somebody_else_are_kept(out):
    (out / "evaluation.json").write_text('{"mine": 1}')
    with replacing(out) as folder:
        write(folder, "new")
    assert (out / "evaluation.json").read_text() == '{"mine": 1}'


@pytest.mark.parametrize("error", [InputError, KeyboardInterrupt, ZeroDivisionError])
def test_created_folders_are_removed_if_the_run_fails(tmp_path, error):
    (tmp_path / "there").mkdir()
    with pytest.raises(error), replacing(tmp_path / "there" / "new" / "deep" / "out"):
        raise error("on purpose")
    assert list(tmp_path.rglob("*")) == [tmp_path / "there"]


def test_results_of_tamper_do_not_remove_a_report(tmp_path):
    write(tmp_path, "mine", ("report.html", "evaluation.json"))
    (tmp_path / "result.json").unlink()
    for _ in range(2):
        with replacing(tmp_path, report="edit.json") as folder:
            (folder / "edit.json").write_text('{"outputs": {}}')
    assert (tmp_path / "report.html").read_text() == "mine"
    assert (tmp_path / "evaluation.json").read_text() == "mine"


def test_help_and_readme_list_every_output():
    listed = (Locate.__doc__ or "").partition("written to the folder")[2].partition("\n\n")[0]
    assert sorted(re.findall(r"(\w+(?:/|\.\w+))(?:,| {2})", listed)) == sorted(OUTPUTS)
    table = README.partition("[start:outputs]")[2].partition("[end:outputs]")[0]
    assert set(OUTPUTS) <= set(re.findall(r"`(.+?)`", table))


@pytest.mark.parametrize("move", range(len(NAMES)))
def test_a_signal_does_not_interrupt_moving_files(out, monkeypatch, move):
    replace, sent = Path.replace, []

    def interrupted(path: Path, target: Path) -> Path:
        if not path.name.startswith("."):  # as `atomic` names what is not complete
            sent.append(path)
            if len(sent) == move + 1:
                os.kill(os.getpid(), signal.SIGINT)
        return replace(path, target)

    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    monkeypatch.setattr(Path, "replace", interrupted)
    try:
        with pytest.raises(KeyboardInterrupt), replacing(out) as folder:
            write(folder, "new")
    finally:
        signal.signal(signal.SIGINT, before)
    assert set(contents(out)) == set(NAMES)
    assert {(out / name).read_text() for name in NAMES[:-1]} == {"new"}


def test_results_are_published_where_the_secret_cannot_be_kept(tmp_path, monkeypatch):
    (tmp_path / "file").touch()  # no folder can be made in it
    monkeypatch.setattr(cache, "cache_folder", lambda: tmp_path / "file" / "cache")
    for content in ("first", "second"):
        with replacing(tmp_path / "out") as folder:
            write(folder, content)
        assert {(tmp_path / "out" / name).read_text() for name in NAMES[:-1]} == {content}


def test_what_a_killed_run_has_not_finished_writing_goes(out):
    (out / UNFINISHED).mkdir()
    (out / UNFINISHED / ".0123456789ab.json").write_text("half")
    with replacing(out) as folder:
        write(folder, "new")
    assert not (out / UNFINISHED).exists()


def test_a_secret_that_was_not_written_to_its_end_is_replaced(tmp_path, monkeypatch):
    monkeypatch.setattr(cache, "cache_folder", lambda: tmp_path)
    (tmp_path / "secret").touch()
    known = hmac.new(b"", b"text", "blake2b").hexdigest()[:32]
    assert cache.seal("text") != known
    assert len((tmp_path / "secret").read_bytes()) == 32
