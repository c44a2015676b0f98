"""Exit codes of real processes: SIGINT and SIGTERM at several moments, errors of the program."""

import contextlib
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
from camera_files import write_colmap
from cli_case import FIXTURES, contents, given, record_network_views, report, run
from onnx_models import slow_network

from gsc_jax.cli import cache as user_cache
from gsc_jax.cli import detector_choice
from gsc_jax.cli.staging import UNFINISHED
from gsc_jax.io.cameras import load_cameras

case, found, own_cache = FIXTURES
ROOT = Path(__file__).resolve().parents[2]
# A shell that runs the tests in the background makes them, and their children, ignore SIGINT.
START = (
    "import signal, sys; signal.signal(signal.SIGINT, signal.default_int_handler);"
    "from gsc_jax.__main__ import main; sys.exit(main())"
)
SLOW_REPORT = (
    "import time, gsc_jax.cli.outputs as outputs;"
    "outputs.report_page = lambda *given, **options: time.sleep(600);"
)
"""Stands for a report that takes long, so that a signal always arrives before the end of a run."""
INTERRUPTED_CALLBACK = """
import gc, os, signal, time
import gsc_jax.cli.main as cli
def callback(*_):
    gc.callbacks.remove(callback)
    os.kill(os.getpid(), signal.SIGINT)
    for _ in range(1000): pass
def run():
    gc.callbacks.append(callback)
    gc.collect()
    try:
        time.sleep(600)
    finally:
        print("cleaned up")
cli.main = run
"""
"""Replaces the command: Python calls `callback` as it collects garbage, and ignores its errors."""
FAILING_COMMAND = """
import gsc_jax.cli.main as cli
def fail(*_, **options):
    raise RuntimeError("an error of this program")
cli.run_render = fail
"""
"""Makes `render` fail with an error that no input is to blame for."""
EXIT_SECONDS = 60
"""Longest time to exit after a signal on a busy machine; usually one or two seconds."""


@contextlib.contextmanager
def started(
    cache: Path, *argv: object, paths: tuple[Path, ...] = (), first: str = ""
) -> Iterator[subprocess.Popen]:
    """`gsc-jax` as a process with its own cache, after the statements `first`."""
    places = os.pathsep.join(map(str, [*paths, ROOT]))
    environment = {**os.environ, "XDG_CACHE_HOME": str(cache), "PYTHONPATH": places}
    process = subprocess.Popen(
        [sys.executable, "-c", first + START, *map(str, argv)],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        env=environment,
    )
    try:
        yield process
    finally:
        process.kill()
        process.communicate()


def interrupt(
    process: subprocess.Popen, when: Callable[[], object], number: int = signal.SIGINT
) -> None:
    """Send a signal twice at a moment, and check the exit code and the message."""
    deadline = time.monotonic() + 120
    while not when():
        assert process.poll() is None, process.communicate()
        assert time.monotonic() < deadline, "the moment never came"
        time.sleep(0.02)
    process.send_signal(number)
    process.send_signal(number)
    out, err = process.communicate(timeout=EXIT_SECONDS)
    assert process.returncode == 128 + number
    assert out == ""
    assert err == "gsc-jax: interrupted; no file is left half written\n"


def test_while_a_network_runs(case, tmp_path, monkeypatch):
    """Outputs of the network so far are cached, and the next run continues from them."""
    cache, out = tmp_path / "cache", tmp_path / "out"
    for module in (detector_choice, user_cache):  # which holds the secret of the user, too
        monkeypatch.setattr(module, "cache_folder", lambda: cache / "gsc_jax")
    model = slow_network(tmp_path / "slow.onnx", 300_000)
    assert run(*given(case), "--out", out).code == 0
    before = contents(out)
    argv = [*given(case, masks=None, detector=model), "--out", out]
    with started(cache, *argv) as process:
        interrupt(process, lambda: list(cache.rglob("probability-maps/*")) and list(out.glob(".*")))
    assert contents(out).keys() >= before.keys()
    assert {name: contents(out)[name] for name in before} == before
    judged = record_network_views(monkeypatch)
    assert run(*argv).code == 0
    assert len(judged) <= 3
    assert report(out)["judged_views"] == 3


def test_while_the_package_is_imported(tmp_path):
    """A jax that takes a minute to import stands for one that takes two seconds."""
    started_importing = tmp_path / "started"
    (tmp_path / "jax.py").write_text(
        f"import pathlib, time\npathlib.Path({str(started_importing)!r}).touch()\ntime.sleep(60)\n"
    )
    with started(tmp_path, "--version", paths=(tmp_path,)) as process:
        interrupt(process, started_importing.exists)


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_while_results_are_written(case, tmp_path, number):
    out = tmp_path / "new" / "out"
    argv = [*given(case), "--out", out]
    with started(tmp_path / "cache", *argv, first=SLOW_REPORT) as process:
        pattern = f"new/out/{UNFINISHED}/new/tamper.ply"
        interrupt(process, lambda: list(tmp_path.glob(pattern)), number)
    assert [path.name for path in out.glob("*")] == [UNFINISHED], "the views stay for the next run"


def test_with_cameras_of_colmap(case, tmp_path):
    """The library of COLMAP replaces the handler of SIGTERM where it is imported."""
    model = write_colmap(tmp_path / "model", load_cameras(case))
    argv = given(case, cameras=model)
    with started(tmp_path / "cache", *argv, "--out", tmp_path / "out") as process:
        reading = (tmp_path / "out" / UNFINISHED).exists
        interrupt(process, reading, signal.SIGTERM)


def test_inside_a_callback_that_ignores_errors(tmp_path):
    with started(tmp_path / "cache", first=INTERRUPTED_CALLBACK) as process:
        out, err = process.communicate(timeout=EXIT_SECONDS)
    assert (process.returncode, out) == (128 + signal.SIGINT, "cleaned up\n")
    assert err == "gsc-jax: interrupted; no file is left half written\n"


def test_an_error_of_this_program_gives_exit_code_1_and_a_traceback(tmp_path):
    argv = ["render", tmp_path / "scene.ply", "--out", tmp_path / "out"]
    with started(tmp_path / "cache", *argv, first=FAILING_COMMAND) as process:
        out, err = process.communicate(timeout=EXIT_SECONDS)
    assert (process.returncode, out) == (1, "")
    assert err.startswith("Traceback (most recent call last):\n")
    assert err.endswith("RuntimeError: an error of this program\n")
