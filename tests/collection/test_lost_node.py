"""Nodes of a cluster that disappear in the middle of a scan: a cluster of processes here."""

import subprocess
import sys
import time
from pathlib import Path

import pytest

pytest.importorskip("ray", reason="needs the extra `cluster`, which has no wheel here")
pytest.importorskip("ray.data", reason="needs the extra `cluster`")

from ray.cluster_utils import Cluster

from gsc_jax import save_ply
from gsc_jax.benchmark.scenes import make_room

pytestmark = [
    pytest.mark.slow,
    # Ray, its dependencies and the sockets of its processes, none of them ours.
    pytest.mark.filterwarnings("ignore"),
]
SCENES, SECONDS = 8, 180


@pytest.fixture
def cluster():
    """A head that judges nothing, and two nodes of one core."""
    cluster = Cluster(initialize_head=True, head_node_args={"num_cpus": 0})
    nodes = [cluster.add_node(num_cpus=1) for _ in range(2)]
    yield cluster, nodes
    cluster.shutdown()


def rows(out: Path) -> list[Path]:
    return list(out.rglob("*-*.parquet"))


def test_scenes_of_lost_nodes_are_judged_by_others(cluster, tmp_path):
    from pyarrow import dataset

    made, nodes = cluster
    out = tmp_path / "out"
    for seed in range(SCENES):
        (tmp_path / "in").mkdir(exist_ok=True)
        save_ply(tmp_path / "in" / f"{seed}.ply", make_room(seed=seed, count=3_000))
    command = ["scan", str(tmp_path / "in"), "--out", str(out), "--workers", "2"]
    program = [sys.executable, "-m", "gsc_jax", *command, "--address", made.address]
    driver = subprocess.Popen(program, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    end = time.monotonic() + SECONDS
    while len(rows(out)) < 2 and driver.poll() is None and time.monotonic() < end:
        time.sleep(0.05)
    assert 2 <= len(rows(out)) < SCENES
    for node in nodes:  # all but the head, where the driver and so the ledger are
        made.remove_node(node, allow_graceful=False)
        made.add_node(num_cpus=1)  # as an operator such as KubeRay replaces it
    printed, errors = driver.communicate(timeout=SECONDS)
    assert driver.returncode == 0, errors
    assert f"scenes   {SCENES} " in printed
    table = dataset.dataset(out / "scenes", partitioning="hive").to_table().to_pylist()
    assert {row["id"] for row in table} == {f"{seed}.ply" for seed in range(SCENES)}
    assert not [row["error"] for row in table if row["error_class"]]
