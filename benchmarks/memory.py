"""Peak memory of `gsc-jax locate` on large scenes, against a bound.

    python benchmarks/memory.py --gaussians 3e6 --views 100 --bound 4
    python benchmarks/memory.py --gaussians 1e7 --views 300 --bound 12

The generated room is resampled to the number of Gaussians, SH degree 3; the masks are those of the
object, missing in 40 % of the views. The scene is written in parts, so that this process is
small; the run is a process of its own, whose largest resident memory the system records.
"""

import argparse
import dataclasses
import json
import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np
from common import of_count
from plyfile import PlyData

from gsc_jax.benchmark.metrics import truth_mask
from gsc_jax.benchmark.scenes import room_cameras, tampered_room
from gsc_jax.benchmark.simulate import REGIMES, simulate
from gsc_jax.io.cameras import save_cameras
from gsc_jax.io.layout import encode
from gsc_jax.io.masks import image_path, write_probability
from gsc_jax.scene import Gaussians

GIB = 2**30
PART = 2**18
"""Gaussians that are resampled and written at once."""


def main() -> int:
    """Make the input, run `locate`, and compare its peak memory with the bound."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--gaussians", type=float, default=3e6)
    parser.add_argument("--views", type=int, default=100)
    parser.add_argument("--size", type=int, nargs=2, default=(640, 480))
    parser.add_argument("--bound", type=float, default=4.0, help="GiB")
    parser.add_argument("--memory", type=float, help="--memory of `locate` in GiB")
    parser.add_argument("--folder", type=Path, help="for the files, by default a temporary one")
    options = parser.parse_args()
    with tempfile.TemporaryDirectory(dir=options.folder) as folder:
        make_input(Path(folder), int(options.gaussians), options.views, tuple(options.size))
        return 0 if measured(Path(folder), options.bound, options.memory) else 1


def make_input(folder: Path, count: int, views: int, size: tuple[int, int]) -> None:
    """Write scene.ply, cameras.json and masks/."""
    made = tampered_room()
    cameras = room_cameras(views, width=size[0], height=size[1])
    save_cameras(folder / "cameras.json", cameras)
    for start in range(0, views, 10):
        batch = cameras[start : start + 10]
        truth = np.stack([truth_mask(made.gaussians, camera, made.labels) for camera in batch])
        maps = simulate(truth, None, seed=start, failures=REGIMES["misses"])
        for camera, probability in zip(batch, maps, strict=True):
            write_probability(image_path(folder / "masks", camera.name), probability)
    write_scene(folder / "scene.ply", made.gaussians, count)


def write_scene(path: Path, gaussians: Gaussians, count: int) -> None:
    """Write a scene resampled to `count` Gaussians, with SH of degree 3."""
    sh = np.zeros((len(gaussians), 16, 3), np.float32)
    sh[:, : gaussians.sh.shape[1]] = gaussians.sh
    gaussians = dataclasses.replace(gaussians, sh=sh)
    with path.open("wb") as file:
        for start in range(0, count, PART):
            part = min(PART, count - start)
            vertices = encode(of_count(gaussians, part, total=count, seed=start))["vertex"]
            if not start:
                header = PlyData([vertices], byte_order="<").header
                file.write(header.replace(f"vertex {part}", f"vertex {count}").encode() + b"\n")
            file.write(vertices.data.tobytes())


def measured(folder: Path, bound: float, memory: float | None) -> bool:
    """Run `locate` in a process of its own; whether its peak memory is below the bound in GiB."""
    command = [sys.executable, "-m", "gsc_jax", "locate", folder / "scene.ply"]
    command += ["--cameras", folder / "cameras.json", "--masks", folder / "masks"]
    command += ["--out", folder / "found", "--no-cache"]
    command += [] if memory is None else ["--memory", memory]
    start = time.perf_counter()
    process = subprocess.Popen([str(part) for part in command])
    _, status, usage = os.wait4(process.pid, 0)
    peak, seconds = usage.ru_maxrss * 2**10 / GIB, time.perf_counter() - start
    print(f"peak {peak:.2f} GiB, bound {bound:g} GiB, {seconds:.0f} s, exit code {status >> 8}")
    stages = json.loads((folder / "found" / "result.json").read_text())["stages"]
    print(
        {name: (round(s["seconds"]), round(s["peak_mib"] / 1024, 2)) for name, s in stages.items()}
    )
    return status == 0 and peak < bound


if __name__ == "__main__":
    sys.exit(main())
