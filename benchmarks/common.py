"""Helpers of the benchmarks: scenes, timing, and the file of the results."""

import dataclasses
import json
import os
import platform
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np

import gsc_jax
from gsc_jax.benchmark.scenes import make_room, room_cameras
from gsc_jax.io.files import atomic
from gsc_jax.scene import Camera, Gaussians

DATA = Path(__file__).resolve().parents[2] / "shared" / "data" / "scenes"
DOCS = Path(__file__).resolve().parents[1] / "docs"


def scenes() -> Iterator[tuple[str, Gaussians, list[Camera]]]:
    """Names, Gaussians and cameras of the real scenes, or of a synthetic room without them."""
    for path in sorted(DATA.glob("*.ply")):
        cameras = gsc_jax.load_cameras(path.with_suffix("").with_suffix(".cameras.json"))
        yield path.stem, jax.tree.map(jnp.asarray, gsc_jax.load_ply(path)), cameras
    if not DATA.is_dir():
        yield "synthetic room", jax.tree.map(jnp.asarray, make_room()), room_cameras(24)


def of_count(
    gaussians: Gaussians, count: int, *, total: int | None = None, seed: int = 0
) -> Gaussians:
    """Resample a scene to another number of Gaussians on the same surfaces.

    Rows are drawn with replacement and moved within their own extent; the scales follow the
    spacing, so that the overlap per pixel does not change, also if they are part of a `total`.
    """
    rng = np.random.default_rng(seed)
    rows = rng.choice(len(gaussians), count, replace=count > len(gaussians))
    drawn = jax.tree.map(lambda leaf: np.asarray(leaf)[rows], gaussians)
    shrink = np.float32(0.5 * np.log(len(gaussians) / (total or count)))
    step = rng.normal(0, 0.5, (count, 1)).astype(np.float32) * np.exp(drawn.log_scales)
    moved = dataclasses.replace(
        drawn, means=drawn.means + step, log_scales=drawn.log_scales + shrink
    )
    return jax.tree.map(jnp.asarray, moved)


def seconds(function: Callable[[], object]) -> float:
    """Wall time of a call, including asynchronous computations."""
    start = time.perf_counter()
    jax.block_until_ready(function())
    return time.perf_counter() - start


def medians(functions: dict[str, Callable[[], object]], repeats: int) -> dict[str, float]:
    """Median seconds of each function; interleaved, so that other load affects all of them."""
    times = [{name: seconds(f) for name, f in functions.items()} for _ in range(repeats + 1)]
    return {name: float(np.median([row[name] for row in times[1:]])) for name in functions}


def machine() -> dict[str, object]:
    """Hardware and versions of a measurement."""
    device = jax.devices()[0]
    affinity = getattr(os, "sched_getaffinity", None)
    return {
        "device": device.device_kind if device.platform != "cpu" else _processor(),
        "cores": len(affinity(0)) if affinity else os.cpu_count(),
        "python": platform.python_version(),
        "jax": jax.__version__,
        "numpy": np.__version__,
    }


def _processor() -> str:
    info = Path("/proc/cpuinfo")
    names = info.read_text().split("model name") if info.exists() else []
    return names[1].split(":")[1].split("\n")[0].strip() if len(names) > 1 else platform.processor()


def save(name: str, values: object) -> None:
    """Write one part of `docs/performance.json`, keeping the others."""
    path = DOCS / "performance.json"
    parts = json.loads(path.read_text()) if path.exists() else {}
    parts[name] = {"machine": machine(), "values": values}
    with atomic(path) as temporary:
        temporary.write_text(json.dumps(parts, indent=1) + "\n")
