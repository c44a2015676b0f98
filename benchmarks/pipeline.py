"""Time and memory of whole runs: estimators, both paths, large scenes, cold start, sweeps, scaling.

    python benchmarks/pipeline.py [--parts locate robust attributes rendered memory cold ...]

`locate`: 300,000 Gaussians, 100 views of 640x420, masks given. `robust`: the estimators on that
evidence. `sizes`: 24 views of one size, and of 24 sizes, each with what it compiles. `attributes`:
the evidence in the attributes. `rendered`: the optimisation by rendering in every iteration.
`memory`: 3 million Gaussians and 100 views, in a process of its own. `cold`: import and first view
in new processes, with and without the compilation cache, and `gsc-jax locate` of a scene of 200,000
Gaussians without cameras and masks. `sweep`: a hundred configurations on evidence computed once.
`scaling`: seconds against Gaussians and pixels, with the chart `docs/performance.png`. Each part is
written to `docs/performance.json`. As on the command line, XLA has no threads of its own.
"""

import contextlib
import dataclasses
import os
import subprocess
import sys
import tempfile
import threading
from collections.abc import Iterator
from pathlib import Path
from typing import Literal, get_args
from unittest import mock

import common
import jax
import jax.numpy as jnp
import numpy as np
import tyro

import gsc_jax
from gsc_jax.estimators.gschecker import OFFICIAL, PAPER
from gsc_jax.evidence.monitor import peak_memory_mib
from gsc_jax.render.tiles import make_view
from gsc_jax.scene import Camera, Gaussians
from gsc_jax.scene.parallel import compute_in_calling_thread
from gsc_jax.splat import accumulate

Part = Literal[
    "locate", "sizes", "robust", "attributes", "rendered", "memory", "cold", "sweep", "scaling"
]
VIEWS, WIDTH, HEIGHT = 100, 640, 420


@dataclasses.dataclass(frozen=True)
class Options:
    """What to measure.

    Attributes:
        parts: Parts of the benchmark.
        child: Internal: measure the memory of this process.
    """

    parts: tuple[Part, ...] = get_args(Part)
    child: bool = False


def main(options: Options) -> None:
    """Measure the parts one after the other."""
    compute_in_calling_thread()
    if options.child:
        with anonymous_memory() as anonymous:
            seconds = locate_seconds(3_000_000, prior=True)["seconds"]
        print(seconds, peak_memory_mib(), max(anonymous))
        return
    for part in options.parts:
        values = PARTS[part]()
        print(f"{part}: {values}", flush=True)
        common.save(part, values)


def many_views(count: int = 300_000) -> tuple[Gaussians, list[Camera], dict[str, np.ndarray]]:
    """The first scene with `count` Gaussians, 100 cameras near its own, and masks."""
    _, gaussians, cameras = next(common.scenes())
    cameras = [c.resized(WIDTH, HEIGHT) for c in cameras]
    views = []
    for index in range(VIEWS):
        camera = cameras[index % len(cameras)]
        viewmat = np.array(camera.viewmat)
        viewmat[:3, 3] += 0.01 * (index // len(cameras))
        views.append(dataclasses.replace(camera, viewmat=viewmat, name=f"{index:03d}"))
    gaussians = common.of_count(gaussians, count)
    means = np.asarray(gaussians.means)
    center = np.median(means, axis=0)
    radius = np.quantile(np.linalg.norm(means - center, axis=1), 0.02)
    return gaussians, views, {view.name: ball_mask(view, center, radius) for view in views}


def ball_mask(view: Camera, center: np.ndarray, radius: float) -> np.ndarray:
    """Mask (H, W) of a ball, given in world units; what lies before it is ignored."""
    x, y, z = np.asarray(view.viewmat)[:3] @ np.append(center, 1)
    K = np.asarray(view.K)
    u, v = K[0, 0] * x / z + K[0, 2], K[1, 1] * y / z + K[1, 2]
    rows, columns = np.mgrid[:HEIGHT, :WIDTH]
    return np.hypot(columns - u, rows - v) <= K[0, 0] * radius / z


def locate_seconds(count: int = 300_000, *, prior: bool = False) -> dict:
    """Seconds of `locate` on all views, with compilation, in total and of each stage."""
    gaussians, views, masks = many_views(count)
    all_views = gsc_jax.RobustEstimator(tolerance=0.0)
    result = gsc_jax.locate(gaussians, views, masks, config=all_views, prior=prior)
    return {"seconds": result.seconds, "stages": result.stages}


def sizes(count: int = 24) -> dict:
    """Seconds of `locate` with what it compiles, on views of one size and of as many sizes."""
    gaussians, views, masks = many_views()  # maps are resized to their views
    seconds = {}
    for name, step in (("one", 0.0), ("many", 0.02)):
        jax.clear_caches()
        scales = 1 + step * (np.arange(count) - (count - 1) / 2)  # of the same area in the mean
        own = [view.scaled(scale) for view, scale in zip(views, scales.tolist(), strict=False)]
        seconds[name] = gsc_jax.locate(gaussians, own, masks, prior=False).seconds
    return {"views": count, **seconds}


def robust_seconds() -> dict:
    """Seconds of `robust` on the evidence, with compilation and without, and of `official`."""
    gaussians, views, masks = many_views()
    observation = gsc_jax.observe(gaussians, views, masks)

    def seconds(method: Literal["robust", "official"]) -> float:
        estimate = gsc_jax.estimate
        return common.seconds(lambda: estimate(gaussians, views, observation, method=method))

    first = seconds("robust")
    again = min(seconds("robust") for _ in range(3))
    seconds("official")  # compiles
    return {"first": first, "again": again, "official": min(seconds("official") for _ in range(3))}


def attributes_seconds() -> dict:
    """Seconds of the evidence in the attributes, with and without traces."""
    gaussians = many_views()[0]

    def seconds(*, with_traces: bool) -> float:
        evidence = gsc_jax.forensic_evidence
        return common.seconds(lambda: evidence(gaussians, with_traces=with_traces))

    first = seconds(with_traces=True)
    again = min(seconds(with_traces=True) for _ in range(3))
    without = min(seconds(with_traces=False) for _ in range(3))
    return {"first": first, "again": again, "without_traces": without}


def rendered_seconds(views_used: int = 20) -> dict:
    """Seconds of `locate` on both paths; all but the optimisation is the same."""
    gaussians, views, masks = many_views()
    views, seconds = views[:views_used], {}
    for path in ("evidence", "rendered"):
        config = dataclasses.replace(PAPER, path=path, epochs=5)
        for _ in range(2):  # the first run compiles
            found = gsc_jax.locate(gaussians, views, masks, method="paper", config=config)
            seconds[path] = found.seconds
    ratio = seconds["rendered"] / seconds["evidence"]
    return {"views": views_used, "epochs": 5, **seconds, "ratio": ratio}


def output_of(*arguments: str) -> str:
    """Output of a new Python process."""
    command = [sys.executable, *arguments]
    return subprocess.run(command, capture_output=True, text=True, check=True).stdout


def memory() -> dict:
    """Seconds and peak memory of `locate` with the prior, 3 million Gaussians and 100 views."""
    seconds, peak, anonymous = map(float, output_of(__file__, "--child").split())
    gib = {"peak_gib": peak / 1024, "anonymous_gib": anonymous / 1024}
    return {"gaussians": 3_000_000, "views": VIEWS, "seconds": seconds, **gib}


@contextlib.contextmanager
def anonymous_memory() -> Iterator[list[float]]:
    """Sample the memory without a file behind it, in MiB, four times a second (Linux; else 0)."""
    samples, done = [0.0], threading.Event()

    def watch() -> None:
        status = Path("/proc/self/status")
        while status.exists() and not done.wait(0.25):
            lines = dict(line.split(":", 1) for line in status.read_text().splitlines())
            samples.append(int(lines["RssAnon"].split()[0]) / 1024)

    watcher = threading.Thread(target=watch, daemon=True)
    watcher.start()
    yield samples
    done.set()
    watcher.join()


FIRST_VIEW = """
import sys, time
start = time.perf_counter()
import gsc_jax
imported = time.perf_counter()
from gsc_jax.benchmark.scenes import make_room, room_cameras
from gsc_jax.cli.cache import enable_compilation_cache
room, camera = make_room(), room_cameras(1)[0]
enable_compilation_cache(sys.argv[1])
begin = time.perf_counter()
rgb, alpha = gsc_jax.render(room, camera)
gsc_jax.accumulate(room, camera, rgb).block_until_ready()
print(imported - start, time.perf_counter() - begin)
"""


def cold() -> dict:
    """Seconds of import, first view and a whole command, in two processes that share a cache."""
    with tempfile.TemporaryDirectory() as cache:
        outputs = [output_of("-c", FIRST_VIEW, cache) for _ in range(2)]
    (imported, first), (_, second) = (map(float, output.split()) for output in outputs)
    command, cached = command_seconds()
    views = {"first view": first, "first view, cached": second}
    return {"import": imported, **views, "command": command, "command, cached": cached}


def command_seconds(count: int = 200_000) -> list[float]:
    """Seconds of `gsc-jax locate scene.ply` to the finished report, in two new processes."""
    with tempfile.TemporaryDirectory() as folder:
        scene, out = Path(folder) / "scene.ply", Path(folder) / "found"
        gsc_jax.save_ply(scene, common.of_count(next(common.scenes())[1], count))
        arguments = ["-m", "gsc_jax", "locate", str(scene), "--out", str(out)]
        with mock.patch.dict(os.environ, XDG_CACHE_HOME=folder):  # no compiled functions
            return [common.seconds(lambda: output_of(*arguments)) for _ in range(2)]


def sweep(configurations: int = 100) -> dict:
    """Seconds of one and of many optimisations, with different lambda2, on the same evidence."""
    gaussians, views, masks = many_views()
    views = views[:24]
    observation = gsc_jax.observe(gaussians, views, masks)  # compiles
    observe = common.seconds(lambda: gsc_jax.observe(gaussians, views, masks))

    def optimise(count: int) -> None:
        loops = [
            dataclasses.replace(OFFICIAL.loop, lambda2=lambda2)
            for lambda2 in np.linspace(0.1, 10, count).tolist()
        ]
        configs = [dataclasses.replace(OFFICIAL, loop=loop) for loop in loops]
        assert len(list(gsc_jax.sweep(observation, configs))) == count

    optimise(1)  # compiles
    one, many = (common.seconds(lambda n=n: optimise(n)) for n in (1, configurations))
    times = {"observe": observe, "one": one, "many": many}
    return {"configurations": configurations, **times, "ratio": (observe + many) / (observe + one)}


def scaling() -> dict:
    """Seconds of a view against Gaussians and pixels, the slopes, and a chart."""
    name, gaussians, cameras = next(common.scenes())
    counts = [10_000, 30_000, 100_000, 300_000, 1_000_000, 3_000_000]
    widths = [160, 320, 640, 1280, 1920]
    by_count = [
        view_seconds(common.of_count(gaussians, n), of_width(cameras[1], 640)) for n in counts
    ]
    by_pixels = [view_seconds(gaussians, of_width(cameras[1], w)) for w in widths]
    pixels = [w * w * 3 // 4 for w in widths]
    curves = {"Gaussians": (counts, by_count), "pixels": (pixels, by_pixels)}
    slopes = {what: slope(x, y) for what, (x, y) in curves.items()}
    draw(curves, slopes, name)
    return {"scene": name, "curves": curves, "slopes": slopes}


def of_width(camera: Camera, width: int) -> Camera:
    """The camera with an image of this width and an aspect of 4:3."""
    return camera.resized(width, width * 3 // 4)


def view_seconds(gaussians: Gaussians, camera: Camera) -> float:
    """Median seconds of project + bin + accumulate."""
    maps = jnp.ones((camera.height, camera.width, 2))
    run = {"view": lambda: accumulate(make_view(gaussians, camera), maps)}
    return common.medians(run, 5)["view"]


def slope(x: list[int], y: list[float]) -> float:
    """Fitted slope in log-log over the upper decade of x."""
    top = np.array(x) >= max(x) / 10.01
    return float(np.polyfit(np.log(np.array(x)[top]), np.log(np.array(y)[top]), 1)[0])


def draw(curves: dict, slopes: dict, name: str) -> None:
    """The chart of docs/performance.md."""
    import matplotlib as mpl

    mpl.use("Agg")
    from matplotlib import pyplot as plt

    figure, panels = plt.subplots(1, 2, figsize=(9, 3.6), layout="constrained")
    for panel, (what, (x, y)) in zip(panels, curves.items(), strict=True):
        panel.loglog(x, y, "o-", color="#0b6e99")
        panel.set(xlabel=what, ylabel="seconds per view", title=f"slope {slopes[what]:.2f}")
        panel.grid(visible=True, which="both", alpha=0.25)
    figure.suptitle(f"project + bin + accumulate, {name}")
    figure.savefig(common.DOCS / "performance.png", dpi=130)


PARTS = {
    "locate": locate_seconds,
    "sizes": sizes,
    "robust": robust_seconds,
    "attributes": attributes_seconds,
    "rendered": rendered_seconds,
    "memory": memory,
    "cold": cold,
    "sweep": sweep,
    "scaling": scaling,
}

if __name__ == "__main__":
    main(tyro.cli(Options, description=__doc__))
