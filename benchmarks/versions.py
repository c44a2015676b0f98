"""Time per stage of a view with the JAX of another environment, in units of that of this one.

    python benchmarks/versions.py .venv-3.12/bin/python [--width 480] [--rounds 5] [--scenes 3]

Two versions cannot share a process, so their processes take turns, and the median ratio of two
consecutive ones is printed. CPU time is compared, because it depends less on other load.
"""

import itertools
import json
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Annotated

import common
import jax
import numpy as np
import splat
import tyro
from tqdm import trange

REPEATS = 9
"""Timed runs of a stage in a process."""


def main(
    other: Annotated[Path, tyro.conf.Positional],
    width: int = 480,
    rounds: int = 5,
    scenes: int | None = None,
) -> None:
    """Measure in turns and print the ratios.

    Args:
        other: The interpreter of an environment in which gsc_jax and tyro are installed.
        width: Image width in pixels; the height is three quarters of it.
        rounds: Processes of each version.
        scenes: Number of scenes; default all.
    """
    turns = [
        [measured_by(python, width, scenes) for python in (Path(sys.executable), other)]
        for _ in trange(rounds, desc="rounds", disable=None)
    ]
    (name, own), (other_name, _) = turns[0]
    print(f"{other_name} in units of {name}: CPU time of a view ({width}x{width * 3 // 4})")
    for stage in own:
        times = np.array([[seconds[stage] for _, seconds in turn] for turn in turns])
        ratio = np.median(times[:, 1] / times[:, 0])
        spread = " to ".join(f"{x:.2f}" for x in np.quantile(times[:, 1] / times[:, 0], (0, 1)))
        here, there = 1e3 * np.median(times, axis=0)
        print(f"{stage:24}{here:8.1f} ms{there:8.1f} ms{ratio:8.2f}  ({spread})")


def measured_by(python: Path, width: int, scenes: int | None) -> tuple[str, dict[str, float]]:
    """Version of JAX and median CPU seconds of each stage, in a process of an interpreter."""
    # Absolute, as the process runs in another folder, but without following the link of a venv.
    command = [python.absolute(), "-c", f"import versions; versions.measure({width}, {scenes})"]
    output = subprocess.run(
        command, check=True, capture_output=True, text=True, cwd=Path(__file__).parent
    )
    version, stages = json.loads(output.stdout.splitlines()[-1])
    return version, stages


def measure(width: int, scenes: int | None) -> None:
    """Print what `measured_by` reads."""
    totals: dict[str, list[float]] = {}
    for _, gaussians, cameras in itertools.islice(common.scenes(), scenes):
        camera = cameras[1].resized(width, width * 3 // 4)
        rgba, maps = splat.features_and_maps(gaussians, camera)
        runs = splat.stages(gaussians, camera, rgba, maps)
        runs |= splat.backward_stages(gaussians, camera, rgba)
        for stage, run in runs.items():
            run()
            totals.setdefault(stage, []).append(cpu_seconds(run))
    print(json.dumps([f"JAX {jax.__version__}", {k: float(np.mean(v)) for k, v in totals.items()}]))


def cpu_seconds(run: Callable[[], object]) -> float:
    """Median CPU time of a call."""
    times = []
    for _ in range(REPEATS):
        start = time.process_time()
        jax.block_until_ready(run())
        times.append(time.process_time() - start)
    return float(np.median(times))


if __name__ == "__main__":
    tyro.cli(main, description=__doc__)
