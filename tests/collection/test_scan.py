"""Scans on a real local Ray cluster of two workers: results, failures, kills and continuations."""

import contextlib
import json
import os
import shutil
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from cli_case import refused, run

from gsc_jax.benchmark.scenes import make_room
from gsc_jax.cli.staging import UNFINISHED, locked
from gsc_jax.io.ply import save_ply

pytest.importorskip("ray", reason="needs the extra `cluster`, which has no wheel here")
pytest.importorskip("ray.data", reason="needs the extra `cluster`")

import ray
import ray.data

from gsc_jax.collection import ScanSettings, scan, worker
from gsc_jax.collection.judge import result_digest

pytestmark = [
    pytest.mark.slow,
    # Ray, its dependencies and the sockets of its processes, none of them ours.
    pytest.mark.filterwarnings("ignore"),
]

COUNT = 1_500
SECONDS = 90


@pytest.fixture(scope="module", autouse=True)
def cluster() -> Iterator[None]:
    """A local cluster, on which all scans of this file run."""
    paths = os.pathsep.join([str(Path(__file__).resolve().parents[2]), *sys.path])
    ray.init(
        address="local",
        num_cpus=2,
        include_dashboard=False,
        log_to_driver=False,
        runtime_env={"env_vars": {"PYTHONPATH": paths}},
    )
    yield
    ray.shutdown()


def scene(path: Path, seed: int, count: int = COUNT) -> Path:
    path.parent.mkdir(exist_ok=True, parents=True)
    save_ply(path, make_room(seed=seed, count=count))
    return path


def rows_of(out: Path) -> dict[str, dict]:
    """Rows of a scan by id, as any program reads the dataset."""
    from pyarrow import dataset

    table = dataset.dataset(out / "scenes", partitioning="hive").to_table()
    return {row["id"]: row for row in table.to_pylist()}


def scanned(source: Path, out: Path, *options: object) -> dict[str, dict]:
    answer = run("scan", source, "--out", out, "--workers", 2, *options)
    assert answer.code == 0, answer.err
    assert (out / "collection.html").is_file()
    return rows_of(out)


@pytest.fixture(scope="module")
def collection(tmp_path_factory) -> Path:
    """Eight scenes, two of them copies, and two broken files: a fifth."""
    folder = tmp_path_factory.mktemp("collection")
    for seed in range(6):
        scene(folder / f"sub{seed % 2}" / f"{seed}.ply", seed, COUNT + 100 * (seed % 3))
    for name in ("copy.ply", "again.ply"):
        shutil.copy(folder / "sub0" / "0.ply", folder / name)
    whole = (folder / "sub1" / "1.ply").read_bytes()
    (folder / "broken.ply").write_bytes(whole[: len(whole) // 2])
    (folder / "text.ply").write_text("this is no model")
    return folder


@pytest.fixture(scope="module")
def done(collection, tmp_path_factory) -> tuple[Path, dict[str, dict]]:
    out = tmp_path_factory.mktemp("done") / "out"
    return out, scanned(collection, out, "--report-above", "0")


def test_results_equal_those_of_single_runs_to_the_bit(collection, done, tmp_path):
    for name in ("sub0/0.ply", "sub1/5.ply"):
        assert run("locate", collection / name, "--out", tmp_path / "one").code == 0
        single, row = json.loads((tmp_path / "one" / "result.json").read_text()), done[1][name]
        tamper, labels = (np.load(tmp_path / "one" / f"{n}.npy") for n in ("tamper", "labels"))
        assert row["result_sha256"] == result_digest(tamper, labels)
        assert row["scene_probability"] == single["verdict"]
        assert row["labelled"] == single["counts"]["tampered"]
        assert row["traces"] == list(single["attributes"]["traces"])
        assert row["warnings"] == single["warnings"]
        folder = done[0] / "reports" / Path(row["report"]).parent
        for file in ("tamper.npy", "labels.npy", "masks/orbit_003.png", "tamper.ply"):
            assert (folder / file).read_bytes() == (tmp_path / "one" / file).read_bytes()


def test_a_broken_file_is_a_row(collection, done):
    out, rows = done
    assert len(rows) == 10
    failed = {name: row for name, row in rows.items() if row["error_class"]}
    assert set(failed) == {"broken.ply", "text.ply"}
    for name, row in failed.items():
        assert row["error_class"] == "InputError"
        assert row["error"].startswith(str(collection / name))
        assert row["scene_probability"] is None
        assert "\n" not in row["error"]
    assert len(list((out / "reports").iterdir())) == 6, "copies and broken files have no report"


def test_copies_are_judged_once(done):
    same = [done[1][name] for name in ("sub0/0.ply", "copy.ply", "again.ply")]
    judged = [row for row in same if not row["duplicate_of"]]
    assert len(judged) == 1
    assert {row["duplicate_of"] for row in same} == {None, judged[0]["id"]}
    assert len({(row["result_sha256"], row["scene_probability"]) for row in same}) == 1


def test_a_finished_scan_judges_nothing_again(collection, done):
    before = {path: path.stat().st_mtime_ns for path in (done[0] / "scenes").rglob("*.parquet")}
    answer = run("scan", collection, "--out", done[0], "--report-above", "0")
    assert "(10 finished)" in answer.out
    after = {path: path.stat().st_mtime_ns for path in (done[0] / "scenes").rglob("*.parquet")}
    assert before == after


def test_another_configuration_is_judged_anew_and_a_new_content_replaces_the_old(tmp_path):
    scene(tmp_path / "in" / "a.ply", 0)
    first = scanned(tmp_path / "in", tmp_path / "out")["a.ply"]
    scene(tmp_path / "in" / "a.ply", 1)
    second = scanned(tmp_path / "in", tmp_path / "out")
    assert list(second) == ["a.ply"]
    assert second["a.ply"]["sha256"] != first["sha256"]
    answer = run("scan", tmp_path / "in", "--out", tmp_path / "out", "--threshold", "0.9")
    assert "(1 judged)" in answer.out


def test_two_scans_into_one_folder_are_refused(collection, done):
    out = done[0]
    with locked(out / UNFINISHED):
        assert "another run" in refused("scan", collection, "--out", out)


def test_a_scene_beyond_the_timeout_is_a_row_and_is_tried_again_later(tmp_path):
    # Large enough to take seconds, while it is found and read in much less than the timeout.
    scene(tmp_path / "in" / "a.ply", 0, count=150_000)
    options = ("--timeout", "2", "--retries", "1")
    row = scanned(tmp_path / "in", tmp_path / "out", *options)["a.ply"]
    assert (row["error_class"], row["attempts"]) == ("TimeoutError", 2)
    assert "longer than 2 s" in row["error"]
    row = scanned(tmp_path / "in", tmp_path / "out")["a.ply"]
    assert row["error_class"] is None
    assert row["scene_probability"] is not None


def processes() -> set[int]:
    """Ids of the processes in which workers of this cluster judge scenes, from their start on."""
    found = set()
    for place in Path("/proc").glob("[0-9]*/cmdline"):
        pid = int(place.parent.name)
        with contextlib.suppress(OSError):
            if b"ray::_Judge" in place.read_bytes() and os.getpid() in ancestors(pid):
                found.add(pid)
    return found


def ancestors(pid: int) -> Iterator[int]:
    """Ids of the processes that started a process: another test may have a cluster, too."""
    while pid > 1:
        yield pid
        pid = int(Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[1])


@contextlib.contextmanager
def killing(most: int, others: set[int]) -> Iterator[list[int]]:
    """Kill processes of workers as the kernel does for memory: so many, as they appear."""
    killed, stop = list[int](), threading.Event()

    def watch() -> None:
        while not stop.wait(0.02) and len(killed) < most:
            for pid in processes() - others - set(killed):
                with contextlib.suppress(ProcessLookupError):
                    os.kill(pid, signal.SIGKILL)
                    killed.append(pid)
                    break

    watcher = threading.Thread(target=watch)
    watcher.start()
    try:
        yield killed
    finally:
        stop.set()
        watcher.join()


@pytest.mark.skipif(not Path("/proc").is_dir(), reason="finds processes in /proc")
@pytest.mark.parametrize(("most", "error"), [(1, None), (2, "WorkerLost")])
def test_a_killed_process_is_tried_again_and_then_a_row(tmp_path, most, error):
    scene(tmp_path / "in" / "a.ply", 0)
    with killing(most, processes()) as killed:
        row = scanned(tmp_path / "in", tmp_path / "out", "--retries", 1)["a.ply"]
    assert len(killed) == most
    assert (row["error_class"], row["attempts"]) == (error, 2)


@pytest.mark.skipif(not Path("/proc").is_dir(), reason="finds processes in /proc")
def test_a_killed_scan_continues(tmp_path):
    for seed in range(6):
        scene(tmp_path / "in" / f"{seed}.ply", seed)
    command = ["scan", str(tmp_path / "in"), "--out", str(tmp_path / "out")]
    program = [sys.executable, "-m", "gsc_jax", *command, "--workers", "1"]
    driver = subprocess.Popen(program, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    end = time.monotonic() + SECONDS
    while len(list((tmp_path / "out").rglob("*-*.parquet"))) < 2 and time.monotonic() < end:
        assert driver.poll() is None, "the scan ended before it was killed"
        time.sleep(0.05)
    driver.kill()
    driver.wait()
    time.sleep(2)  # its cluster ends with it
    finished = list((tmp_path / "out").rglob("*-*.parquet"))
    assert 2 <= len(finished) < 6
    answer = run("scan", tmp_path / "in", "--out", tmp_path / "out", "--workers", 2)
    assert f"({len(finished)} finished, {6 - len(finished)} judged)" in answer.out
    rows = rows_of(tmp_path / "out")
    assert set(rows) == {f"{seed}.ply" for seed in range(6)}
    assert not [row for row in rows.values() if row["error_class"]]


def test_a_scan_is_a_stage_of_a_pipeline(tmp_path):
    path = scene(tmp_path / "a.ply", 0)
    entries = [
        {"id": "x", "path": str(path), "court": "north"},
        {"id": "y", "path": str(tmp_path / "missing.ply"), "court": "south"},
    ]
    dataset = ray.data.from_items(entries, override_num_blocks=2)
    settings = ScanSettings(workers=1)
    found = scan(dataset, settings=settings).map(lambda row: {**row, "next": True}).take_all()
    rows = {row["id"]: row for row in found}
    assert [rows[name]["court"] for name in "xy"] == ["north", "south"]
    assert all(row["next"] for row in found)
    assert rows["x"]["error_class"] is None
    assert rows["x"]["gaussians"] == COUNT
    assert rows["y"]["error_class"] == "FileNotFoundError"
    assert str(tmp_path / "missing.ply") in rows["y"]["error"]


def test_a_pipeline_progresses_where_workers_could_take_every_core(tmp_path):
    from pyarrow import Table, parquet

    path = scene(tmp_path / "a.ply", 0)
    paths = [str(path), str(tmp_path / "missing.ply")]
    parquet.write_table(Table.from_pydict({"path": paths}), tmp_path / "manifest.parquet")
    dataset = ray.data.read_parquet(str(tmp_path / "manifest.parquet")).repartition(2)
    found = scan(dataset, settings=ScanSettings(workers=64)).filter(lambda row: row["gaussians"])
    found.write_parquet(str(tmp_path / "found"))
    (row,) = parquet.read_table(tmp_path / "found").to_pylist()
    assert (row["id"], row["gaussians"]) == (str(path), COUNT)


def test_a_later_scan_writes_the_reports_that_are_missing(tmp_path):
    scene(tmp_path / "in" / "a.ply", 0)
    before = scanned(tmp_path / "in", tmp_path / "out")["a.ply"]
    assert before["report"] is None
    after = scanned(tmp_path / "in", tmp_path / "out", "--report-above", "0")["a.ply"]
    assert (tmp_path / "out" / "reports" / after["report"]).is_file()
    assert after["result_sha256"] == before["result_sha256"]
    third = run("scan", tmp_path / "in", "--out", tmp_path / "out", "--report-above", "0")
    assert "(1 finished)" in third.out


@pytest.mark.parametrize(
    ("option", "value", "expected"),
    [("--workers", 0, "workers 0: expected a number of at least 1")],
)
def test_impossible_settings_are_refused(tmp_path, option, value, expected):
    scene(tmp_path / "in" / "a.ply", 0)
    assert expected in refused("scan", tmp_path / "in", "--out", tmp_path / "out", option, value)


def test_an_address_without_a_cluster_is_refused_at_once(tmp_path, monkeypatch):
    monkeypatch.setattr(ray, "is_initialized", lambda: False)  # the cluster of this file
    scene(tmp_path / "in" / "a.ply", 0)
    command = ["scan", tmp_path / "in", "--out", tmp_path / "out", "--address", "127.0.0.1:9"]
    assert "--address 127.0.0.1:9: no answer" in refused(*command)


def test_a_process_is_replaced_before_what_libraries_keep_adds_up(tmp_path, monkeypatch):
    monkeypatch.setattr(worker, "MAX_SCENES", 2)
    path = scene(tmp_path / "a.ply", 0)
    ledger = ray.remote(worker.Ledger).options(num_cpus=0).remote({})
    judge, used, rows = worker.SceneWorker(ScanSettings(), "", ledger), [], []
    others = processes()
    for _ in range(4):
        rows.append(judge._judged_once({"scene": path, "out": tmp_path / "out"}, None))
        used.append(judge._judge)
    assert used[0] is not None
    assert used[1] is None
    assert used[2] not in (None, used[0])
    assert used[3] is None
    assert len({row["result_sha256"] for row in rows}) == 1
    used.clear()
    end = time.monotonic() + SECONDS
    while processes() - others and time.monotonic() < end:
        time.sleep(0.1)
    assert not processes() - others, "a process that was replaced goes on"


def test_an_address_is_downloaded(tmp_path):
    fsspec = pytest.importorskip("fsspec")
    scene(tmp_path / "a.ply", 0)
    (tmp_path / "list.txt").write_text(f"file://{tmp_path / 'a.ply'}\nfile:///nowhere/b.ply\n")
    assert fsspec.url_to_fs(f"file://{tmp_path}")
    rows = scanned(tmp_path / "list.txt", tmp_path / "out")
    good, bad = rows[f"file://{tmp_path / 'a.ply'}"], rows["file:///nowhere/b.ply"]
    assert good["gaussians"] == COUNT
    assert bad["error_class"] == "FileNotFoundError"
