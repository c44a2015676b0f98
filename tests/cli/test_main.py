"""The command line: one line for each invalid input, exit codes, help, and failed runs."""

import contextlib
import dataclasses
import errno
import io
import json
import os
import shutil
import subprocess
import sys
import typing
import warnings
from pathlib import Path

import pytest
from cli_case import FIXTURES, contents, given, refused, report, run, unparsable
from plyfile import PlyData

from gsc_jax.benchmark.simulate import REGIMES
from gsc_jax.cli import locate as locate_command
from gsc_jax.cli import main as cli
from gsc_jax.cli import options, outputs
from gsc_jax.cli.staging import UNFINISHED
from gsc_jax.io.cameras import load_cameras, save_cameras
from gsc_jax.scene import InputError

case, found, own_cache = FIXTURES
pytestmark = pytest.mark.usefixtures("own_cache")


def test_cameras_of_another_scene(case, tmp_path):
    cameras = json.loads((case / "cameras.json").read_text())
    for camera in cameras:
        camera["position"] = [1000.0, 1000.0, 1000.0]
    path = tmp_path / "cameras.json"
    path.write_text(json.dumps(cameras))
    message = refused(*given(case, cameras=path), "--out", tmp_path / "out")
    assert f"{path}: the cameras see" in message


@pytest.mark.parametrize(
    ("names", "expected"), [(("../a", "b"), "cannot name a file"), (("a/b", "a\\b"), "slashes")]
)
def test_camera_names_that_cannot_name_files(case, tmp_path, names, expected):
    cameras = load_cameras(case / "cameras.json")
    path = tmp_path / "cameras.json"
    pairs = zip(cameras, names, strict=False)
    save_cameras(path, [dataclasses.replace(camera, name=name) for camera, name in pairs])
    message = refused(*given(case, cameras=path), "--out", tmp_path / "out")
    assert f"{path}: " in message
    assert expected in message


def test_no_detector_or_two_of_the_same_views(case, tmp_path):
    out = "--out", tmp_path / "out"
    for changes in ({"detector": "none"}, {"method": "paper"}):
        assert "no evidence" in refused(*given(case, masks=None, **changes), *out)
    assert "give one of the two" in refused(*given(case, detector="net.onnx"), *out)
    both = refused(*given(case, masks=None), "--detector", "a.onnx", "b.onnx", *out)
    assert "one 2D network" in both
    alone = refused("locate", case / "scene.ply", "--masks", case / "masks", *out)
    assert "needs the cameras" in alone
    official = given(case, detector="native", method="official")
    assert "uses masks only" in refused(*official, *out)


def test_the_attributes_alone(case, tmp_path):
    answer = run(*given(case, masks=None), "--out", tmp_path)
    assert answer.code == 0
    result = report(tmp_path)
    assert result["verdict"] == result["attributes"]["verdict"]
    assert {path.name for path in (tmp_path / "masks").rglob("*.png")}
    assert not (tmp_path / "detector").exists()


@pytest.mark.parametrize(
    ("changes", "expected"),
    [
        ({"scene": "missing.ply"}, ("missing.ply: no such file",)),
        ({"views": 0}, ("--views 0",)),
        ({"epochs": 3}, ("--epochs", "robust")),
        ({"lambda2": -1, "method": "paper"}, ("lambda2 must be",)),
        ({"threshold": 3}, ("threshold", "3")),
        ({"scale": "nan"}, ("--scale nan",)),
        ({"scale": 1000}, ("--scale 1000", "pixels")),
        ({"scale": 0.01}, ("--scale 0.01", "pixels")),
        ({"near": -1}, ("--near -1",)),
        ({"seed": -1}, ("--seed -1",)),
        ({"preset": "trufor"}, ("--preset", "--detector")),
    ],
)
def test_invalid_options(case, tmp_path, changes, expected):
    message = refused(*given(case, **changes), "--out", tmp_path / "out")
    assert all(part in message for part in expected)
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(
    ("changes", "expected"),
    [
        ({"method": "magic"}, ("magic", "--method", "paper", "official")),
        ({"views": "many"}, ("--views", "many")),
        ({"vews": 3}, ("--vews", "--views")),
    ],
)
def test_unparsable_options(case, changes, expected):
    message = unparsable(*given(case, **changes), "--out", "out")
    assert all(part in message for part in expected)


def test_unparsable_commands(case):
    assert "locate" in unparsable()
    for word, hint in (
        ("loacte", "did you mean 'locate'"),
        ("xyz", "expected one of locate, scan"),
    ):
        answer = run(word, "scene.ply")
        assert answer.code == 2
        assert answer.err.startswith(f"gsc-jax: {word}: no such command")
        assert hint in answer.err
    assert "--out" in unparsable(*given(case))


@pytest.mark.parametrize("command", ["locate", "render", "tamper", "demo"])
def test_an_output_folder_that_cannot_be_written(case, tmp_path, command):
    (tmp_path / "file").write_text("in the way")
    out = tmp_path / "file" / "out"
    arguments = {
        "locate": given(case),
        "render": ["render", case / "scene.ply", "--cameras", case],
        "tamper": ["tamper", case / "scene.ply", "--cameras", case, "--size", 0.3],
        "demo": ["demo"],
    }
    message = refused(*arguments[command], "--out", out)
    assert str(out) in message
    assert "cannot be written" in message
    assert (tmp_path / "file").read_text() == "in the way"


@pytest.mark.parametrize("clash", ["masks", "detector"])
def test_results_never_overwrite_what_is_read(case, tmp_path, clash):
    shutil.copytree(case / "masks", tmp_path / clash)
    before = sorted(path.read_bytes() for path in (tmp_path / clash).rglob("*.png"))
    message = refused(*given(case, masks=tmp_path / clash), "--out", tmp_path)
    assert "another --out" in message
    assert before == sorted(path.read_bytes() for path in (tmp_path / clash).rglob("*.png"))


def test_a_full_disk_leaves_the_earlier_results(case, tmp_path, monkeypatch):
    out = tmp_path / "out"
    assert run(*given(case), "--out", out).code == 0
    before = contents(out)

    def full(self):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(PlyData, "header", property(full))
    message = refused(*given(case, views=1), "--out", out)
    assert f"{out / 'tamper.ply'}: cannot be written (No space left on device)" in message
    assert contents(out) == before


@pytest.mark.parametrize("new", [True, False])
def test_an_interrupted_run_leaves_the_results_as_they_were(case, tmp_path, monkeypatch, new):
    out = tmp_path / "out"
    if not new:
        out.mkdir()
        (out / "mine.txt").write_text("mine")
    before = contents(out)

    def interrupted(*arguments, **options):
        raise KeyboardInterrupt

    monkeypatch.setattr(outputs, "contact_sheet", interrupted)
    with pytest.raises(KeyboardInterrupt):
        run(*given(case), "--out", out)
    assert contents(out) == before
    assert (out / UNFINISHED / "views").is_dir(), "the next run continues from the views"


@pytest.mark.parametrize(
    "listed",
    [
        *("no list", 3, [3], [""], ["result.json", "masks", "masks/a\0.png"]),
        ["../mine.png", "/mine.png", "masks/../../mine.png", ".png", "notes/x.png"],
    ],
)
def test_a_foreign_result_json_removes_nothing(case, tmp_path, listed):
    out = tmp_path / "out"
    (out / "notes").mkdir(parents=True)
    for mine in (tmp_path / "mine.png", out / "notes" / "x.png"):
        mine.write_bytes(b"mine")
    (out / "result.json").write_text(json.dumps({"outputs": listed}))
    assert "result.json: exists" in refused(*given(case), "--out", out)
    assert json.loads((out / "result.json").read_text()) == {"outputs": listed}
    assert (tmp_path / "mine.png").exists()
    assert (out / "notes" / "x.png").exists()


@pytest.mark.filterwarnings("default")
@pytest.mark.parametrize("fails", [False, True])
def test_warnings_of_libraries_are_listed_last_and_once(case, tmp_path, monkeypatch, fails):
    write_results = locate_command.write_results

    def warn(*arguments, **options):
        for _ in range(2):
            warnings.warn("a library\nwarns", FutureWarning, stacklevel=1)
        if fails:
            raise InputError("on purpose")
        return write_results(*arguments, **options)

    monkeypatch.setattr(locate_command, "write_results", warn)
    answer = run(*given(case), "--out", tmp_path / "out")
    assert answer.code == (2 if fails else 0)
    assert answer.err.count("a library warns (FutureWarning in test_main.py") == 1
    assert answer.err.endswith("gsc-jax: on purpose\n") == fails


def help_of(*command: str) -> str:
    with pytest.raises(SystemExit) as stop, contextlib.redirect_stdout(io.StringIO()) as printed:
        cli.main([*command, "--help"])
    assert not stop.value.code
    return printed.getvalue()


@pytest.mark.parametrize("command", cli.COMMANDS)
def test_help_has_examples_and_fits_a_terminal(command, monkeypatch):
    monkeypatch.setenv("COLUMNS", "80")
    text = help_of(command)
    assert f"gsc-jax {command}" in text
    assert "for example:" in text
    assert all(len(line) <= 80 for line in text.splitlines()[1:])  # tyro does not wrap the usage
    assert "default: None" not in text
    assert "default: False" not in text
    assert "(required)" in text


def test_the_help_of_the_program_lists_the_commands(monkeypatch):
    monkeypatch.setenv("COLUMNS", "80")
    text = help_of()
    assert len(text.splitlines()) < 40
    assert "130 interrupted" in text
    assert all(f"• {name} " in text for name in cli.COMMANDS)
    assert "gsc-jax --version" in text
    assert "for example" not in text


def test_the_choices_of_masks_are_complete():
    assert typing.get_args(options.Regime) == ("none", *REGIMES)


def test_the_console_script_runs():
    script = Path(sys.executable).parent / "gsc-jax"
    command = [str(script)] if script.exists() else [sys.executable, "-m", "gsc_jax"]
    done = subprocess.run([*command, "--version"], capture_output=True, text=True, check=False)
    assert (done.returncode, done.stderr) == (0, "")
    assert done.stdout.startswith("gsc-jax ")


@pytest.mark.parametrize(
    ("number", "name", "refused_with"),
    [
        (errno.ENOENT, "scene.ply", "scene.ply: No such file"),  # removed while it is read
        (errno.ENOSPC, None, "a file: No space left"),
        (errno.EACCES, "/elsewhere", "/elsewhere: Permission denied"),
        (errno.ENOENT, "/elsewhere", None),
        (errno.ENOENT, None, None),
        (errno.EBADF, None, None),
        (errno.ENOTEMPTY, None, None),
    ],
)
def test_errors_of_this_program_are_not_reported_as_bad_input(
    tmp_path, monkeypatch, number, name, refused_with
):
    scene = tmp_path / "scene.ply"

    def fail(*arguments, **options):
        raise OSError(number, os.strerror(number), str(scene) if name == "scene.ply" else name)

    monkeypatch.setattr(cli, "run_render", fail)
    argv = ["render", scene, "--out", tmp_path / "out"]
    if refused_with:
        assert refused_with in refused(*argv)
    else:
        with pytest.raises(OSError, match=os.strerror(number)):
            run(*argv)


def test_an_error_without_a_number_is_of_this_program(tmp_path, monkeypatch):
    def fail(*arguments, **options):
        raise OSError("cannot write mode F as PNG")

    monkeypatch.setattr(cli, "run_render", fail)
    with pytest.raises(OSError, match="cannot write mode F"):
        run("render", tmp_path / "scene.ply", "--out", tmp_path / "out")


def test_an_empty_argument_is_refused():
    for words in (("--out", ""), ("--out=",), ("--out", "x", "--cameras=")):
        assert "an argument is empty" in refused("locate", "scene.ply", *words)
