"""Time and memory of a view for networks that `experiments/export_network.py` exported.

    python benchmarks/networks.py trufor.onnx pscc-net.onnx safire [--threads 2] [--views 3]

A file is run with the preset of its name, a folder as SAFIRE. Each network has a process of its
own; a view is a random image of 640x480. The first view, which includes the start of the network,
is left out of the time, and the memory is the largest of the process, less what it held before.
"""

import dataclasses
import multiprocessing
import resource
import time
from pathlib import Path

import numpy as np
import tyro

from gsc_jax.benchmark.scenes import room_cameras
from gsc_jax.detectors.onnx import PRESETS, OnnxDetector
from gsc_jax.detectors.safire import SafireDetector


@dataclasses.dataclass(frozen=True)
class Options:
    """What to measure.

    Attributes:
        networks: Files named like their preset, and folders of SAFIRE.
        threads: Threads of the network.
        views: Number of views after the first one.
    """

    networks: tyro.conf.Positional[tuple[Path, ...]]
    threads: int = 2
    views: int = 3


def main(options: Options) -> None:
    """Measure each network in a process of its own and print a table."""
    print("| network | a view of 640x480 | memory |\n|---|---|---|")
    for path in options.networks:
        with multiprocessing.get_context("spawn").Pool(1) as pool:
            seconds, memory = pool.apply(measure, (path, options.threads, options.views))
        print(f"| {path.stem} | {seconds:.1f} s | {memory:.1f} GiB |", flush=True)


def measure(path: Path, threads: int, views: int) -> tuple[float, float]:
    """Median seconds of a view after the first one, and GiB of memory."""
    before = peak()
    images = np.random.default_rng(0).random((views + 1, 480, 640, 3), dtype=np.float32)
    if path.is_dir():
        detect = SafireDetector(path, threads=threads)
    else:
        detect = OnnxDetector(path, PRESETS[path.stem], threads=threads)
    camera, times = room_cameras(1)[0], []
    for image in images:
        start = time.perf_counter()
        probability = detect(image, camera)
        times.append(time.perf_counter() - start)
        assert 0 <= np.min(probability) <= np.max(probability) <= 1, path
    return float(np.median(times[1:])), peak() - before


def peak() -> float:
    """Largest resident memory of this process so far, in GiB."""
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 2**20


if __name__ == "__main__":
    main(tyro.cli(Options, description=__doc__))
