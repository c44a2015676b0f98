"""Ctrl-C, in real processes and at several moments: how it ends, what stays, what goes on."""

import contextlib
import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import onnx
import pytest
from cli_case import FIXTURES, contents, given, report, run, views_asked_of_networks
from onnx import TensorProto, helper, numpy_helper

from gsc_jax.cli import detector_choice as asked
from gsc_jax.cli.interruption import Interruptible, uninterrupted
from gsc_jax.cli.staging import ABANDONED_SECONDS, UNFINISHED, replacing
from gsc_jax.scene import Camera

case, found, own_cache = FIXTURES
ROOT = Path(__file__).resolve().parents[2]
# A shell that runs the tests in the background has them, and their children, ignore SIGINT.
START = (
    "import signal, sys; signal.signal(signal.SIGINT, signal.default_int_handler);"
    "from gsc_jax_command import main; sys.exit(main())"
)
EXIT_SECONDS = 60
"""After which an interrupted process has to be gone, on a busy machine; it takes one or two."""


@contextlib.contextmanager
def started(cache: Path, *argv: object, paths: tuple[Path, ...] = ()) -> Iterator[subprocess.Popen]:
    """`gsc-jax` as a process of its own, with a cache of its own."""
    places = os.pathsep.join(map(str, [*paths, ROOT]))
    environment = {**os.environ, "XDG_CACHE_HOME": str(cache), "PYTHONPATH": places}
    process = subprocess.Popen(
        [sys.executable, "-c", START, *map(str, argv)],
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


def interrupted(process: subprocess.Popen, when: Callable[[], object]) -> str:
    """What a process says when it is interrupted at a moment; twice, as people do."""
    deadline = time.monotonic() + 120
    while not when():
        assert process.poll() is None, process.communicate()
        assert time.monotonic() < deadline, "the moment never came"
        time.sleep(0.02)
    process.send_signal(signal.SIGINT)
    process.send_signal(signal.SIGINT)
    out, err = process.communicate(timeout=EXIT_SECONDS)
    assert process.returncode == 130
    assert out == ""
    assert err.count("\n") == 1, err
    assert err.startswith("gsc-jax: interrupted")
    return err


def slow_network(path: Path, steps: int) -> Path:
    """A model that flags what is red, after a loop that nobody can break into."""
    body = helper.make_graph(
        [
            helper.make_node("Identity", ["go"], ["on"]),
            helper.make_node("Add", ["sum", "nothing"], ["more"]),
        ],
        "step",
        [
            helper.make_tensor_value_info("step", TensorProto.INT64, []),
            helper.make_tensor_value_info("go", TensorProto.BOOL, []),
            helper.make_tensor_value_info("sum", TensorProto.FLOAT, [1]),
        ],
        [
            helper.make_tensor_value_info("on", TensorProto.BOOL, []),
            helper.make_tensor_value_info("more", TensorProto.FLOAT, [1]),
        ],
    )
    weights = np.array([20, 0, -20], np.float32).reshape(1, 3, 1, 1)
    graph = helper.make_graph(
        [
            helper.make_node("Loop", ["steps", "", "nothing"], ["late"], body=body),
            helper.make_node("Conv", ["image", "weights", "bias"], ["red"]),
            helper.make_node("Add", ["red", "late"], ["logit"]),
            helper.make_node("Sigmoid", ["logit"], ["map"]),
        ],
        "slow",
        [helper.make_tensor_value_info("image", TensorProto.FLOAT, [1, 3, "h", "w"])],
        [helper.make_tensor_value_info("map", TensorProto.FLOAT, [1, 1, "h", "w"])],
        [
            numpy_helper.from_array(np.array(steps, np.int64), "steps"),
            numpy_helper.from_array(np.zeros(1, np.float32), "nothing"),
            numpy_helper.from_array(weights, "weights"),
            numpy_helper.from_array(np.array([-2], np.float32), "bias"),
        ],
    )
    opset = [helper.make_opsetid("", 17)]
    onnx.save(helper.make_model(graph, opset_imports=opset, ir_version=8), path)
    return path


def test_while_a_network_judges(case, tmp_path, monkeypatch):
    """The answers so far are kept, the one it is at is not waited for, the next run goes on."""
    cache, out = tmp_path / "cache", tmp_path / "out"
    monkeypatch.setattr(asked, "default_cache", lambda: cache / "gsc_jax")
    model = slow_network(tmp_path / "slow.onnx", 300_000)
    assert run(*given(case), "--out", out).code == 0
    before = contents(out)
    argv = [*given(case, masks=None, detector=model), "--out", out]

    def kept() -> int:
        return len(list(cache.rglob("detections/*.npz")))

    with started(cache, *argv) as process:
        err = interrupted(process, lambda: kept() >= 1)
    judged = kept()
    assert 1 <= judged < 3, "the network is too fast for this test"
    assert f"of {judged} view" in err
    assert f"nothing was changed in {out}" in err
    assert contents(out) == before
    assert not list(out.glob(".*"))
    asked_about = views_asked_of_networks(monkeypatch)
    assert run(*argv).code == 0
    assert len(asked_about) == 3 - judged
    assert report(out)["judged_views"] == 3


def test_while_all_is_imported(tmp_path):
    """A jax that takes a minute to import stands for one that takes two seconds."""
    there = tmp_path / "there"
    (tmp_path / "jax.py").write_text(
        f"import pathlib, time\npathlib.Path({str(there)!r}).touch()\ntime.sleep(60)\n"
    )
    with started(tmp_path, "--version", paths=(tmp_path,)) as process:
        interrupted(process, there.exists)


def test_while_results_are_written(case, tmp_path):
    out = tmp_path / "new" / "out"
    with started(tmp_path / "cache", *given(case), "--out", out) as process:
        interrupted(process, lambda: list(tmp_path.glob(f"new/out/{UNFINISHED}*/tamper.ply")))
    assert not out.exists()


LOSING = """
import os, signal, sys, time, types
class Lost:
    def __del__(self):
        os.kill(os.getpid(), signal.SIGINT)
        sum(range(1000))
def main():
    lost = Lost()
    try:
        del lost
        time.sleep(60)
    except KeyboardInterrupt:
        return 130
for name in ("gsc_jax", "gsc_jax.cli", "gsc_jax.cli.main"):
    sys.modules[name] = types.ModuleType(name)
sys.modules["gsc_jax.cli.main"].main = main
signal.signal(signal.SIGINT, signal.default_int_handler)
import gsc_jax_command
gsc_jax_command.main()
"""


def test_an_interruption_that_hits_a_finalizer_is_not_lost():
    done = subprocess.run(
        [sys.executable, "-c", LOSING],
        capture_output=True,
        text=True,
        env={**os.environ, "PYTHONPATH": str(ROOT)},
        timeout=EXIT_SECONDS,
        check=False,
    )
    assert (done.returncode, done.stdout, done.stderr) == (130, "", "")


def test_what_puts_results_in_place_is_not_interrupted():
    done = []

    def work() -> None:
        with uninterrupted():
            signal.raise_signal(signal.SIGINT)
            done.append("the rest")

    with pytest.raises(KeyboardInterrupt), handling_interrupts():
        work()
    assert done == ["the rest"]
    handler = signal.getsignal(signal.SIGINT)
    with uninterrupted():
        pass
    assert signal.getsignal(signal.SIGINT) is handler


@contextlib.contextmanager
def handling_interrupts() -> Iterator[None]:
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, before)


def test_other_threads_have_nothing_to_be_interrupted():
    ran = []

    def work() -> None:
        with uninterrupted():
            ran.append(True)

    thread = threading.Thread(target=work)
    thread.start()
    thread.join()
    assert ran


class Slow:
    """A detector that takes its time, and says what was odd."""

    needs_image = True
    warnings = ("odd",)

    def __init__(self) -> None:
        self.notes = {"v": 1}
        self.ended = threading.Event()

    def select(self, cameras):
        return list(cameras)[:1]

    def __call__(self, image, camera):
        assert self.ended.wait(30), camera
        return image[..., 0]


CAMERA = Camera(viewmat=np.eye(4), K=np.eye(3), width=2, height=2, name="v")


def test_nobody_waits_for_a_detector_that_is_no_longer_wanted():
    slow = Slow()
    patient = Interruptible(slow)
    timer = threading.Timer(0.1, lambda: os.kill(os.getpid(), signal.SIGINT))
    timer.start()
    begin = time.monotonic()
    with pytest.raises(KeyboardInterrupt), handling_interrupts():
        patient(np.ones((2, 2, 3)), CAMERA)
    assert time.monotonic() - begin < 5
    assert patient.judged == 0
    slow.ended.set()
    np.testing.assert_array_equal(patient(np.ones((2, 2, 3)), CAMERA), np.ones((2, 2)))
    assert patient.judged == 1


def test_an_interruptible_detector_is_the_detector_in_all_else():
    patient = Interruptible(Slow())
    assert (patient.needs_image, patient.warnings, patient.notes) == (True, ("odd",), {"v": 1})
    assert patient.select([CAMERA, CAMERA]) == [CAMERA]

    class Broken(Slow):
        def __call__(self, image, camera):
            raise ZeroDivisionError(image, camera)

    with pytest.raises(ZeroDivisionError):
        Interruptible(Broken())(None, CAMERA)


def test_what_a_killed_run_left_is_removed_once_it_is_old(tmp_path):
    old, new = tmp_path / f"{UNFINISHED}old", tmp_path / f"{UNFINISHED}new"
    for folder in (old, new):
        folder.mkdir()
        (folder / "tamper.ply").write_bytes(b"half of it")
    before = time.time() - ABANDONED_SECONDS - 60
    os.utime(old, (before, before))
    with replacing(tmp_path) as folder:
        (folder / "labels.npy").write_bytes(b"labels")
    assert not old.exists()
    assert new.exists(), "another run may be at work in it"
    assert (tmp_path / "labels.npy").exists()
