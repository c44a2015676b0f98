"""The whole job: 100 views, evidence against rendering every iteration, memory, cold start, sweeps.

    python benchmarks/pipeline.py [--parts locate robust native rendered memory cold sweep scaling]

`locate`: 300k Gaussians, 100 views of 640x420, given masks. `robust`: the estimator on that
evidence. `native`: what the Gaussians themselves say. `rendered`: the same optimisation by
rendering and differentiating every iteration. `memory`: 3 million Gaussians and 100 views, peak of
a process of its own. `cold`: import and first view in new processes, with and without the
compilation cache. `sweep`: a hundred configurations on evidence computed once, against one.
`scaling`: time against Gaussians and pixels, drawn to `docs/performance.png`. Writes
`docs/performance.json`.
"""

import contextlib
import dataclasses
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Literal

import common
import jax.numpy as jnp
import numpy as np
import tyro

from gsc_jax import METHODS, RobustConfig, locate
from gsc_jax.estimators import gschecker as method
from gsc_jax.evidence.detector import as_detector
from gsc_jax.evidence.monitor import peak_memory_mib
from gsc_jax.evidence.observation import observe
from gsc_jax.forensics.evidence import native_evidence
from gsc_jax.render.tiles import make_view
from gsc_jax.scene import Camera, Gaussians
from gsc_jax.splat import accumulate

Part = Literal["locate", "robust", "native", "rendered", "memory", "cold", "sweep", "scaling"]
VIEWS, WIDTH, HEIGHT = 100, 640, 420


@dataclasses.dataclass(frozen=True)
class Options:
    """What to measure.

    Attributes:
        parts: Which parts.
        child: Used by `memory` for its own process.
    """

    parts: tuple[Part, ...] = (
        "locate",
        "robust",
        "native",
        "rendered",
        "memory",
        "cold",
        "sweep",
        "scaling",
    )
    child: bool = False


def main(options: Options) -> None:
    """Measure the parts one after the other."""
    if options.child:
        with anonymous_memory() as anonymous:
            seconds = locate_seconds(3_000_000, native=True)["seconds"]
        print(seconds, peak_memory_mib(), max(anonymous))
        return
    for part in options.parts:
        values = PARTS[part]()
        print(f"{part}: {values}", flush=True)
        common.save(part, values)


def many_views(count: int) -> tuple[Gaussians, list[Camera], dict[str, np.ndarray]]:
    """The first scene with `count` Gaussians, 100 cameras between its own, and masks."""
    _, gaussians, cameras = next(common.scenes())
    cameras = [c.resized(WIDTH, HEIGHT) for c in cameras]
    views = []
    for index in range(VIEWS):
        camera = cameras[index % len(cameras)]
        viewmat = np.array(camera.viewmat)
        viewmat[:3, 3] += 0.01 * (index // len(cameras))
        views.append(dataclasses.replace(camera, viewmat=viewmat, name=f"{index:03d}"))
    blob = np.zeros((HEIGHT, WIDTH), np.float32)
    blob[150:270, 250:400] = 1
    masks = {c.name: np.roll(blob, 10 * (i % 7), axis=1) for i, c in enumerate(views)}
    return common.of_count(gaussians, count), views, masks


def locate_seconds(count: int = 300_000, *, native: bool = False) -> dict:
    """Wall time of `locate`, compilation included, and the share of each stage."""
    gaussians, views, masks = many_views(count)
    start = time.perf_counter()
    result = locate(gaussians, views, masks, config=RobustConfig(tolerance=0.0), native=native)
    return {"seconds": time.perf_counter() - start, "stages": result.stages}


def robust_seconds(count: int = 300_000) -> dict:
    """Seconds of `robust` after the evidence, with compilation and without, and of `official`."""
    gaussians, views, masks = many_views(count)
    observation = observe(gaussians, views, as_detector(masks))

    def found(name: str) -> float:
        start = time.perf_counter()
        method.find(gaussians, views, observation, method.CONFIGS[name])
        return time.perf_counter() - start

    first = found("robust")
    again = min(found("robust") for _ in range(3))
    found("official")  # compiles
    return {"first": first, "again": again, "official": min(found("official") for _ in range(3))}


def native_seconds(count: int = 300_000) -> dict:
    """Seconds of the Gaussians' own evidence, its cues and its traces."""
    gaussians = many_views(count)[0]

    def seconds(function: Callable[[], object]) -> float:
        start = time.perf_counter()
        function()
        return time.perf_counter() - start

    first = seconds(lambda: native_evidence(gaussians))
    again = min(seconds(lambda: native_evidence(gaussians)) for _ in range(3))
    alone = min(seconds(lambda: native_evidence(gaussians, exact=False)) for _ in range(3))
    return {"first": first, "again": again, "without_traces": alone}


def rendered_seconds(views_used: int = 20) -> dict:
    """`locate` by both paths, five epochs; all but the optimisation is the same for both."""
    gaussians, views, masks = many_views(300_000)
    seconds = {}
    for path in ("evidence", "rendered"):
        config = dataclasses.replace(METHODS["paper"], path=path, epochs=5)
        for _ in range(2):  # the first run compiles
            start = time.perf_counter()
            locate(gaussians, views[:views_used], masks, config=config)
            seconds[path] = time.perf_counter() - start
    return {
        "views": views_used,
        "epochs": 5,
        **seconds,
        "ratio": seconds["rendered"] / seconds["evidence"],
    }


def memory() -> dict:
    """Seconds and peak memory for 3 million Gaussians, asked themselves, too, and 100 views."""
    done = subprocess.run(
        [sys.executable, __file__, "--child"], capture_output=True, text=True, check=True
    )
    seconds, peak, anonymous = map(float, done.stdout.split())
    return {
        "gaussians": 3_000_000,
        "views": VIEWS,
        "seconds": seconds,
        "peak_gib": peak / 1024,
        "anonymous_gib": anonymous / 1024,
    }


@contextlib.contextmanager
def anonymous_memory() -> Iterator[list[float]]:
    """Memory in MiB that no file stands behind, every quarter of a second (Linux; else 0)."""
    seen, done = [0.0], threading.Event()

    def watch() -> None:
        status = Path("/proc/self/status")
        while status.exists() and not done.wait(0.25):
            lines = dict(line.split(":", 1) for line in status.read_text().splitlines())
            seen.append(int(lines["RssAnon"].split()[0]) / 1024)

    watcher = threading.Thread(target=watch, daemon=True)
    watcher.start()
    yield seen
    done.set()
    watcher.join()


FIRST_VIEW = """
import sys, time
start = time.perf_counter()
import gsc_jax
imported = time.perf_counter()
from gsc_jax.benchmark.scenes import make_room, room_cameras
from gsc_jax.cli.cache import use_cache
room, camera = make_room(), room_cameras(1)[0]
use_cache(sys.argv[1])
begin = time.perf_counter()
rgb, alpha = gsc_jax.render(room, camera)
gsc_jax.accumulate(room, camera, rgb).block_until_ready()
print(imported - start, time.perf_counter() - begin)
"""


def cold() -> dict:
    """Import and first view of two processes in a row that share a compilation cache."""
    with tempfile.TemporaryDirectory() as cache:
        runs = [
            subprocess.run(
                [sys.executable, "-c", FIRST_VIEW, cache],
                capture_output=True,
                text=True,
                check=True,
            )
            for _ in range(2)
        ]
    (imported, first), (_, second) = (map(float, run.stdout.split()) for run in runs)
    return {"import": imported, "first view": first, "first view, cached": second}


def sweep(configurations: int = 100) -> dict:
    """Evidence computed once and optimised under many lambda2, against one such run."""
    gaussians, views, masks = many_views(300_000)
    views = views[:24]
    official = METHODS["official"]
    observation = observe(gaussians, views, as_detector(masks))  # compiles
    start = time.perf_counter()
    observation = observe(gaussians, views, as_detector(masks))
    looked = time.perf_counter() - start

    def fits(count: int) -> None:
        configs = [
            dataclasses.replace(official, loop=dataclasses.replace(official.loop, lambda2=price))
            for price in np.linspace(0.1, 10, count).tolist()
        ]
        assert len(list(method.sweep(gaussians, views, observation, configs))) == count

    fits(1)  # compiles
    one, many = (common.seconds(lambda n=n: fits(n)) for n in (1, configurations))
    return {
        "configurations": configurations,
        "observe": looked,
        "one": one,
        "many": many,
        "ratio": (looked + many) / (looked + one),
    }


def scaling() -> dict:
    """Time of a view against Gaussians and pixels, its slope over the upper decade, and a chart."""
    name, gaussians, cameras = next(common.scenes())
    counts = [10_000, 30_000, 100_000, 300_000, 1_000_000, 3_000_000]
    widths = [160, 320, 640, 1280, 1920]
    by_count = [whole(common.of_count(gaussians, n), of_width(cameras[1], 640)) for n in counts]
    by_pixels = [whole(gaussians, of_width(cameras[1], w)) for w in widths]
    pixels = [w * w * 3 // 4 for w in widths]
    curves = {"Gaussians": (counts, by_count), "pixels": (pixels, by_pixels)}
    slopes = {what: slope(x, y) for what, (x, y) in curves.items()}
    draw(curves, slopes, name)
    return {"scene": name, "curves": curves, "slopes": slopes}


def of_width(camera: Camera, width: int) -> Camera:
    """The camera with a 4:3 image."""
    return camera.resized(width, width * 3 // 4)


def whole(gaussians: Gaussians, camera: Camera) -> float:
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
    "rendered": rendered_seconds,
    "memory": memory,
    "cold": cold,
    "sweep": sweep,
    "robust": robust_seconds,
    "native": native_seconds,
    "scaling": scaling,
}

if __name__ == "__main__":
    main(tyro.cli(Options, description=__doc__))
