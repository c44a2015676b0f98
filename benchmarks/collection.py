"""A scan of a collection against a loop over `gsc-jax locate`, and with 1, 2 and 4 workers.

    python benchmarks/collection.py [--scenes 16] [--workers 1 2 4] [--no-loop] [--part collection]

Made rooms of 20,000 to 250,000 Gaussians, log-uniform. The loop starts a program for each scene, as
a shell does, with a warm compilation cache. A scan is measured twice: rows alone, and with the
folder of `locate` for every scene, which is the same work as the loop. All times are wall times of
whole programs, the start of Ray included; `work` adds up the seconds of the scenes, and `growth` is
the slope of the peak of a scene over the scenes judged before it, its size accounted for. Written
to a part of `docs/performance.json` after each measurement.
"""

import dataclasses
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import TypeVar

import common
import numpy as np
import tyro

import gsc_jax
from gsc_jax.benchmark.scenes import make_room

Value = TypeVar("Value")


@dataclasses.dataclass(frozen=True)
class Options:
    """What to measure.

    Attributes:
        scenes: Number of scenes.
        workers: Numbers of workers, each with one core.
        loop: Whether to measure the loop over `gsc-jax locate`.
        reports: Numbers of workers for scans with the folder of `locate` for every scene.
        part: Part of `docs/performance.json` to write.
    """

    scenes: int = 16
    workers: tuple[int, ...] = (1, 2, 4)
    loop: bool = True
    reports: tuple[int, ...] = (1, 2)
    part: str = "collection"


def main(options: Options) -> None:
    """Measure, print and save."""
    values: dict[str, object] = {"scenes": options.scenes}
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        values["gaussians"] = make(folder / "in", options.scenes)
        program("locate", folder / "in" / "000.ply", folder / "warm")  # fills the cache
        for workers in options.workers:
            values[f"scan{workers}"] = scan(folder, f"scan{workers}", workers)
            common.save(options.part, values)
        for workers in options.reports:
            name = f"reports{workers}"
            values[name] = scan(folder, name, workers, "--report-above", "0")
            common.save(options.part, values)
        if options.loop:
            values["loop"] = report("loop", loop(folder, options.scenes))
            common.save(options.part, values)


def make(folder: Path, scenes: int) -> list[int]:
    """Write the scenes; their numbers of Gaussians, in no order."""
    folder.mkdir()
    counts = np.geomspace(20_000, 250_000, scenes).round().astype(int).tolist()
    counts = [counts[i] for i in np.random.default_rng(0).permutation(scenes)]
    for index, count in enumerate(counts):
        gsc_jax.save_ply(folder / f"{index:03d}.ply", make_room(seed=index, count=count))
    return counts


def program(command: str, source: Path, out: Path, *more: str) -> float:
    """Seconds of a run of `gsc-jax`."""
    arguments = [sys.executable, "-m", "gsc_jax", command, str(source), "--out", str(out), *more]
    start = time.perf_counter()
    subprocess.run(arguments, check=True, capture_output=True)
    return time.perf_counter() - start


def loop(folder: Path, scenes: int) -> float:
    """Seconds of a loop over `gsc-jax locate`."""
    names = [f"{index:03d}" for index in range(scenes)]
    return sum(program("locate", folder / "in" / f"{n}.ply", folder / "loop" / n) for n in names)


def scan(folder: Path, name: str, workers: int, *more: str) -> dict[str, object]:
    """Seconds, work by stage and memory of a scan."""
    out = folder / name
    seconds = program("scan", folder / "in", out, "--workers", str(workers), *more)
    rows = rows_of(out)
    each = np.array([row["seconds"] for row in rows])
    peaks = [max(stage["peak_mib"] for stage in row["stages"]) for row in rows]
    sizes = np.array([row["gaussians"] for row in rows])
    per_gaussian = np.polyfit(sizes, each, 1)
    order = np.argsort(np.argsort([row["id"] for row in rows])) / workers  # as they are judged
    growth = np.linalg.lstsq(np.stack([order, sizes, sizes**0], 1), peaks, rcond=None)[0]
    return report(
        name,
        {
            "seconds": seconds,
            "work": float(each.sum()),
            "mean": float(each.mean()),
            "per_100k": float(per_gaussian[0] * 1e5),
            "fixed": float(per_gaussian[1]),
            "peak_mib": max(peaks),
            "growth_mib_per_100": float(growth[0] * 100),
            "each": [[row["gaussians"], row["seconds"]] for row in rows],
            "stages": stages(rows),
        },
    )


def stages(rows: list[dict]) -> dict[str, float]:
    """Seconds of each stage, over all scenes."""
    total: dict[str, float] = {}
    for stage in (stage for row in rows for stage in row["stages"]):
        total[stage["name"]] = total.get(stage["name"], 0) + stage["seconds"]
    return {name: round(seconds, 2) for name, seconds in total.items()}


def rows_of(out: Path) -> list[dict]:
    """The rows of a scan."""
    from pyarrow import dataset

    return dataset.dataset(out / "scenes", partitioning="hive").to_table().to_pylist()


def report(name: str, value: Value) -> Value:
    """Print a value and return it."""
    print(name, value, flush=True)
    return value


if __name__ == "__main__":
    main(tyro.cli(Options, description=__doc__))
