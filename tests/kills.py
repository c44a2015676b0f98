"""Kill `gsc-jax locate` at random moments, continue, and compare with a run that was not killed.

    python tests/kills.py --kills 50

The network takes about two seconds a view. A killed run is started again with the same command: it
must use the maps and the evidence that were written, and not write them again. All results must be
the same to the bit, but for times and dates.
"""

import argparse
import json
import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np
from cli_case import contents
from onnx_models import slow_network

from gsc_jax.benchmark.scenes import tampered_room
from gsc_jax.cli.staging import UNFINISHED, VIEWS
from gsc_jax.io.cameras import save_cameras
from gsc_jax.io.ply import save_ply

COUNT, SIZE, CAMERAS = 3_000, (96, 72), 5
STEPS = 1_500_000
"""Steps of the loop of the network: about two seconds."""
TIMES = ("seconds", "stages", "date", "command")
"""Entries of result.json that differ between two runs; report.html shows them, too."""


def main() -> int:
    """Kill as often as asked; print a line each, and how many results were the same."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--kills", type=int, default=50)
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args()
    rng = np.random.default_rng(options.seed)
    with tempfile.TemporaryDirectory() as name:
        command = make_case(Path(name))
        start = time.perf_counter()
        expected = results(finished(command, Path(name) / "expected"))
        seconds = time.perf_counter() - start
        print(f"without a kill {seconds:.1f} s")
        same = sum(
            same_after_kill(command, Path(name) / f"run-{kill}", moment, expected)
            for kill, moment in enumerate(rng.uniform(0, seconds, options.kills))
        )
    print(f"{same} of {options.kills} killed runs continued to the same results")
    return 0 if same == options.kills else 1


def make_case(folder: Path) -> list[str]:
    """Write a scene, cameras and a slow network; the command but for --out."""
    made = tampered_room(count=COUNT, views=CAMERAS, heldout=0, width=SIZE[0], height=SIZE[1])
    save_ply(folder / "scene.ply", made.gaussians)
    save_cameras(folder / "cameras.json", made.cameras)
    network = slow_network(folder / "slow.onnx", STEPS)
    command = [sys.executable, "-m", "gsc_jax", "locate", folder / "scene.ply", "--cameras"]
    command += [folder / "cameras.json", "--detector", network, "--no-cache", "--out"]
    return [str(part) for part in command]


def same_after_kill(command: list[str], out: Path, moment: float, expected: dict) -> bool:
    """Kill a run after so many seconds and run it again; whether work and results are the same."""
    with started(command, out) as process:
        time.sleep(moment)
        process.kill()
    kept = written(out)
    start, rewritten = time.perf_counter(), set()
    with started(command, out) as process:
        while process.poll() is None:
            now = written(out)
            rewritten |= {name for name in kept if now.get(name, kept[name]) != kept[name]}
            time.sleep(0.05)
    same = process.returncode == 0 and results(out) == expected
    maps, seconds = sum(name.startswith("map-") for name in kept), time.perf_counter() - start
    print(
        f"killed after {moment:5.1f} s with {maps} views judged, then {seconds:5.1f} s; "
        f"judged again {len(rewritten)}, results {'the same' if same else 'DIFFERENT'}",
        flush=True,
    )
    return same and not rewritten


def started(command: list[str], out: Path) -> subprocess.Popen:
    """A run that writes to a folder and prints nothing."""
    nothing = subprocess.DEVNULL
    return subprocess.Popen([*command, str(out)], stdout=nothing, stderr=nothing)


def finished(command: list[str], out: Path) -> Path:
    """The folder of a run that was not killed."""
    subprocess.run([*command, str(out)], check=True, stdout=subprocess.DEVNULL)
    return out


def written(out: Path) -> dict[str, int]:
    """Inodes of the maps and the evidence of a run that has not finished."""
    try:
        entries = os.scandir(out / UNFINISHED / VIEWS)
        kinds = ("map-", "evidence-")
        return {
            e.name: e.inode()
            for e in entries
            if e.name.endswith(".npy") and e.name.startswith(kinds)
        }
    except FileNotFoundError:
        return {}


def results(out: Path) -> dict[str, bytes]:
    """All files of a run by name, without the times in the reports."""
    files = contents(out)
    report = json.loads(files.pop("result.json"))
    del files["report.html"], report["outputs"]["report.html"]
    numbers = {name: value for name, value in report.items() if name not in TIMES}
    return {**files, "numbers": json.dumps(numbers, sort_keys=True).encode()}


if __name__ == "__main__":
    sys.exit(main())
