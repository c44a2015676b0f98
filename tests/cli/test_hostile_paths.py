"""Pipes, links, paths that no file can have, and escape sequences: one line, nothing is read."""

import json
import os
import threading
from pathlib import Path

import numpy as np
import pytest
from cli_case import FIXTURES, NAMES, contents, given, refused, run, unparsable
from results_folder import write_results

from gsc_jax.cli import main as cli
from gsc_jax.cli.staging import UNFINISHED
from gsc_jax.io.masks import image_path, write_mask

case, found, own_cache = FIXTURES
ESCAPE = "\x1b]0;title\x07"
LONG = "x" * 300


@pytest.fixture
def results(tmp_path) -> Path:
    cameras = write_results(tmp_path / "results")
    for camera in cameras:
        mask = np.zeros((camera.height, camera.width), bool)
        write_mask(image_path(tmp_path / "results" / "masks", camera.name), mask)
        write_mask(image_path(tmp_path / "truth", camera.name), mask)
    return tmp_path / "results"


def pipe(path: Path) -> Path:
    """A pipe; a program that opens it gets an empty file after a while instead of waiting."""
    path.parent.mkdir(parents=True, exist_ok=True)
    path.unlink(missing_ok=True)
    os.mkfifo(path)
    OPENED.pop(path, None)
    threading.Thread(target=_release, args=(path,), daemon=True).start()
    return path


def _release(path: Path) -> None:
    with path.open("wb"):  # blocks until there is a reader
        OPENED[path] = True


OPENED: dict[Path, bool] = {}


def render(case: Path, out: Path, cameras: Path | None = None) -> list[object]:
    return ["render", case / "scene.ply", "--cameras", cameras or case, "--out", out]


class TestPipes:
    @pytest.fixture(autouse=True)
    def no_pipe_is_opened(self):
        OPENED.clear()
        yield
        assert not OPENED, "without a writer, the program would hang"

    @pytest.mark.parametrize("name", ["cameras.json", "cameras.txt", "cameras.bin"])
    def test_cameras(self, case, tmp_path, name):
        cameras = pipe(tmp_path / name)
        (tmp_path / cameras.with_stem("images").name).write_bytes(b"")
        assert f"{cameras}: is a pipe" in refused(*render(case, tmp_path / "out", cameras))

    @pytest.mark.parametrize("name", ["result.json", "labels.npy", "masks/c.png"])
    def test_in_the_place_of_an_output(self, case, tmp_path, name):
        place = pipe(tmp_path / name)
        assert f"{place}: exists" in refused(*given(case), "--out", tmp_path)

    @pytest.mark.parametrize("name", ["journal.json", "views.txt", "journal.part", "views.part"])
    def test_in_the_folder_of_an_unfinished_run(self, case, tmp_path, name):
        pipe(tmp_path / UNFINISHED / name)
        assert run(*given(case, views=1), "--out", tmp_path).code == 0

    def test_scores_and_pages(self, results, tmp_path):
        argv = ["evaluate", results, "--truth", results / "labels.npy"]
        place = pipe(results / "evaluation.json")
        assert f"{place}: exists" in refused(*argv)
        page = pipe(tmp_path / "page.html")
        assert f"{page}: exists" in refused("view", results, "--html", page)

    @pytest.mark.parametrize("name", ["result.json", "views.json", "tamper.ply", "labels.npy"])
    def test_in_results(self, results, tmp_path, name):
        place = pipe(results / name)
        assert f"{place}: is a pipe" in refused("view", results, "--html", tmp_path / "page.html")


class TestLinks:
    @pytest.mark.parametrize("leads", ["outside", "nowhere", "in a circle"])
    @pytest.mark.parametrize(
        "name", ["result.json", "views.json", "tamper.ply", "tamper.npy", "labels.npy", "masks"]
    )
    def test_no_link_out_of_results_is_followed(self, results, tmp_path, name, leads):
        outside = tmp_path / "outside"
        (results / name).rename(outside)
        target = {"outside": outside, "nowhere": tmp_path / "nothing", "in a circle": name}
        (results / name).symlink_to(target[leads])
        message = refused("evaluate", results, "--truth", tmp_path / "truth")
        assert str(results) in message
        assert "a link leads out" in message or leads == "in a circle"

    def test_a_link_inside_and_a_link_to_the_folder_are_followed(self, results, tmp_path):
        (results / "tamper.ply").rename(results / "scene.ply")
        (results / "tamper.ply").symlink_to("scene.ply")
        (tmp_path / "link").symlink_to(results)
        assert run("evaluate", tmp_path / "link", "--truth", tmp_path / "truth").code == 0

    def test_configurations(self, case, found, tmp_path):
        (tmp_path / "result.json").symlink_to(found[0] / "result.json")
        assert "leads out" in refused(*given(case, config=tmp_path), "--out", tmp_path / "out")


class TestPaths:
    @pytest.mark.parametrize("path", [LONG, "a\0b", "\ud800", "loop"])
    @pytest.mark.parametrize(
        "argv",
        [
            ["render", "SCENE", "--out", "PATH"],
            ["render", "PATH", "--out", "out"],
            ["tamper", "SCENE", "--out", "PATH"],
            ["locate", "SCENE", "--out", "PATH"],
            ["locate", "--config", "PATH", "--out", "out"],
            ["demo", "--out", "PATH"],
            ["evaluate", "PATH", "--truth", "truth.npy"],
            ["evaluate", "results", "--truth", "PATH"],
            ["evaluate", "results", "--truth", "truth.npy", "--out", "PATH"],
            ["view", "PATH"],
            ["view", "results", "--html", "PATH"],
        ],
    )
    def test_of_arguments(self, case, tmp_path, monkeypatch, argv, path):
        monkeypatch.chdir(tmp_path)
        Path("loop").symlink_to("loop")
        words = {"SCENE": str(case / "scene.ply"), "PATH": path}
        refused(*(words.get(word, word) for word in argv))
        assert list(tmp_path.iterdir()) == [tmp_path / "loop"]

    @pytest.mark.parametrize("path", [LONG, "a\0b", "\ud800"])
    @pytest.mark.parametrize("key", ["scene", "out"])
    def test_of_a_configuration(self, case, tmp_path, key, path):
        table = {"scene": str(case / "scene.ply"), "out": str(tmp_path / "out"), key: path}
        (tmp_path / "run.json").write_text(json.dumps({"command": table}))
        message = refused("locate", "--config", tmp_path / "run.json")
        assert "run.json" in message, "the path was not typed"


class TestEscapeSequences:
    @pytest.mark.parametrize("sign", [ESCAPE, "\x9b2J", "\u202e", "\u2028x", "\r"])
    def test_in_paths(self, tmp_path, sign):
        message = refused("render", tmp_path / f"a{sign}b.ply", "--out", tmp_path / "out")
        assert message.rstrip("\n").isprintable()

    def test_in_configurations(self, tmp_path):
        for table in ({"scene": ESCAPE, "out": "out"}, {ESCAPE: 1}, {"method": ESCAPE}):
            (tmp_path / "run.json").write_text(json.dumps({"command": table}))
            message = refused("locate", "--config", tmp_path / "run.json", "--out", tmp_path / "o")
            assert message.rstrip("\n").isprintable()
            assert "\x1b]" not in refused("locate", "--config", tmp_path / "run.json", "--help")

    @pytest.mark.parametrize("words", [("x", f"a\n{ESCAPE}"), ("x", "--out", "o", f"--{ESCAPE}")])
    def test_in_messages_about_the_options(self, words):
        message = unparsable("locate", *words)
        assert "\\x1b" in message
        assert message.replace("\n", "").isprintable()

    def test_in_the_folder_of_results(self, case, tmp_path):
        out = tmp_path / "out"
        out.mkdir()
        for content in ("[" * 200_000, "[]", "{", '{"command": {"scene": "' + 5000 * "x" + '"}}'):
            (out / "result.json").write_text(content)
            assert len(refused(*given(case), "--out", out)) < 1000
            assert (out / "result.json").read_text() == content
        pipe(out / "result.json")
        refused(*given(case), "--out", out)

    def test_in_results_and_warnings(self, case, tmp_path):
        scene = tmp_path / f"{ESCAPE}.ply"
        scene.write_bytes((case / "scene.ply").read_bytes())
        out = tmp_path / f"out{ESCAPE}"
        answer = run("render", scene, "--cameras", case, "--out", out)
        assert answer.code == 0
        assert "\\x1b]0;title\\x07.ply: left out 2" in answer.err
        assert "\\x1b" in answer.out
        assert (answer.out + answer.err).replace("\n", "").isprintable()
        assert image_path(out, NAMES[0]).is_file()

    def test_in_lines_of_the_viewer(self, capsys):
        cli._say(f"view {ESCAPE}")
        assert capsys.readouterr().out == "view \\x1b]0;title\\x07\n"


class TestFoldersOfInputs:
    @pytest.mark.parametrize("place", [".", "found", "left/found"])
    def test_results_do_not_become_masks_of_the_next_run(self, case, tmp_path, place):
        masks = tmp_path / "masks"
        for name in NAMES:
            write_mask(image_path(masks, name), np.eye(40, 48) > 0)
        before = contents(masks)
        message = refused(*given(case, masks=masks), "--out", masks / place)
        assert "would read the results as input" in message
        assert contents(masks) == before
