"""Seconds on 1, 2, 4, ... cores, with XLA's own threads and without them, and on an accelerator.

    python benchmarks/cores.py [--views 32] [--gaussians 300000] [--threads 2]

Each row is a process of its own, held to its cores, in which nothing but the row is computed: the
stages of one view of 640x420; `observe` of many views with given masks, which renders and lifts
them; `robust` on that; the evidence in the attributes. All without compilation. Rows *without* are
as on the command line, after `compute_in_calling_thread`. Prints a table like that of
`docs/performance.md` and writes it to `docs/performance.json`. Rows with an accelerator are left
out where JAX finds none.
"""

import dataclasses
import json
import os
import subprocess
import sys
from unittest import mock

import common
import jax
import jax.numpy as jnp
import pipeline
import tyro

import gsc_jax
from gsc_jax.render.projection import project
from gsc_jax.render.tiles import bin_view, make_view
from gsc_jax.scene.parallel import ViewThreads, compute_in_calling_thread
from gsc_jax.splat import accumulate, composite

CPU, ACCELERATOR = "cpu", "accelerator"


@dataclasses.dataclass(frozen=True)
class Options:
    """What to measure.

    Attributes:
        gaussians: Number of Gaussians.
        views: Views of `observe`.
        repeats: Timed runs of each part; the median counts.
        threads: Threads for views instead of the usual ones.
        alone: Internal: without the threads of XLA.
        child: Internal: measure in this process.
    """

    gaussians: int = 300_000
    views: int = 32
    repeats: int = 3
    threads: int = 0
    alone: bool = False
    child: bool = False


def main(options: Options) -> None:
    """Measure each row of the table in a new process, print it, and save all rows."""
    if options.child:
        if options.alone:
            compute_in_calling_thread()
        cores = range(options.threads or len(os.sched_getaffinity(0)))
        with mock.patch("gsc_jax.scene.parallel.usable_cores", return_value=cores):
            print(json.dumps(measure(options)))
        return
    rows = []
    for platform, cores, alone in plans(len(os.sched_getaffinity(0))):
        values = in_process(dataclasses.replace(options, alone=alone), platform, cores)
        rows.append({"platform": platform, "alone": alone, **values})
        print(described(rows[-1]), flush=True)
        common.save("cores", rows)


def plans(cores: int) -> list[tuple[str, int, bool]]:
    """Platform, cores, and whether without the threads of XLA, of each row."""
    counts = [count for count in (1, 2, 4, 8, 16, 32, 64) if count <= cores]
    rows = [(CPU, count, alone) for count in counts for alone in (False, True)]
    found = pipeline.output_of("-c", "import jax; print(jax.default_backend())").strip() != CPU
    return [*rows, *([(ACCELERATOR, cores, False)] if found else [])]


def in_process(options: Options, platform: str, cores: int) -> dict:
    """The times of a new process on some of the cores of this one."""
    own = {"JAX_PLATFORMS": CPU} if platform == CPU else {}
    numbers = [f.name for f in dataclasses.fields(options) if f.type is int]
    flags = [f"--{name}={getattr(options, name)}" for name in numbers]
    flags += ["--alone"] if options.alone else []
    allowed = os.sched_getaffinity(0)
    os.sched_setaffinity(0, sorted(allowed)[:cores])  # the child inherits it
    try:
        with mock.patch.dict(os.environ, own):
            command = [sys.executable, __file__, "--child", *flags]
            done = subprocess.run(command, stdout=subprocess.PIPE, text=True, check=True)
    finally:
        os.sched_setaffinity(0, allowed)
    return json.loads(done.stdout.splitlines()[-1])


def measure(options: Options) -> dict:
    """Median seconds of the parts, compiled, and the machine."""
    gaussians, views, masks = pipeline.many_views(options.gaussians)
    views, camera = views[: options.views], views[1]
    splats = jax.block_until_ready(project(gaussians, camera))
    view, maps = make_view(gaussians, camera), jnp.ones((camera.height, camera.width, 2))
    rgba = jnp.ones((len(gaussians), 4))
    observation = gsc_jax.observe(gaussians, views, masks)
    runs = {
        "project": lambda: project(gaussians, camera),
        "bin": lambda: bin_view(splats, camera),
        "composite": lambda: composite(view, rgba),
        "accumulate": lambda: accumulate(view, maps),
        "observe": lambda: gsc_jax.observe(gaussians, views, masks).evidence.weight,
        "robust": lambda: gsc_jax.estimate(gaussians, views, observation, method="robust"),
        "attributes": lambda: gsc_jax.forensic_evidence(gaussians, with_traces=False).probability,
    }
    seconds = common.medians(runs, options.repeats)
    with ViewThreads(len(gaussians)) as pool:
        threads = pool.count
    return {**seconds, "views": len(views), "threads": threads, **common.machine()}


def described(row: dict) -> str:
    """One row of the table."""
    where = row["device"] if row["platform"] == ACCELERATOR else "CPU"
    small = [f"{1e3 * row[x]:.0f} ms" for x in ("project", "bin", "composite", "accumulate")]
    large = [f"{row[x]:.2f} s" for x in ("observe", "robust", "attributes")]
    counts = [str(row["cores"]), "without" if row["alone"] else "with", str(row["threads"])]
    return "| " + " | ".join([where, *counts, *small, *large]) + " |"


if __name__ == "__main__":
    main(tyro.cli(Options, description=__doc__))
