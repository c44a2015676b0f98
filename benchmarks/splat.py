"""Time per stage of a view, ours against the plain variant, in one process and on the same scene.

    python benchmarks/splat.py [--scene SCENE.ply --cameras FILE] [--width 640] [--repeats 9]

Runs are interleaved, so that whatever else the machine does falls on both; the median is printed.
Before anything is timed, both must give the same pixels and the same sums.
"""

import dataclasses
import time
from collections.abc import Callable
from pathlib import Path

import jax
import numpy as np
import plain
import tyro

import gsc_jax
from gsc_jax.benchmark.scenes import make_room, room_cameras
from gsc_jax.projection import project
from gsc_jax.sh import colors
from gsc_jax.splat import accumulate, composite
from gsc_jax.tiles import bin_view

DATA = Path(__file__).resolve().parents[2] / "shared" / "data" / "scenes"


@dataclasses.dataclass(frozen=True)
class Options:
    """Compare the stages of a view with the plain variant.

    Attributes:
        scene: A .ply; by default a real scene beside the repository, else a room that is made.
        cameras: Its cameras.
        view: Which of them.
        width: Image width in pixels.
        height: Image height in pixels.
        repeats: Runs of each stage.
    """

    scene: Path | None = None
    cameras: Path | None = None
    view: int = 0
    width: int = 640
    height: int = 480
    repeats: int = 9


def main(options: Options) -> None:
    """Print the table."""
    gaussians, camera, name = load(options)
    rng = np.random.default_rng(0)
    maps = jax.device_put(rng.random((camera.height, camera.width, 2), np.float32))
    rgb = colors(gaussians.sh, gaussians.means, camera.center)
    ours, theirs = project(gaussians, camera), plain.project(gaussians, camera)
    view, plain_view = bin_view(ours, camera), plain.bin_splats(theirs, camera)
    require_same(composite(view, rgb), plain.composite(plain_view, rgb), "pixels")
    require_same(accumulate(view, maps), plain.accumulate(plain_view, maps), "sums")

    def whole():
        return accumulate(bin_view(project(gaussians, camera), camera), maps)

    def plain_whole():
        projected = plain.project(gaussians, camera)
        return plain.accumulate(plain.bin_splats(projected, camera), maps)

    stages: dict[str, tuple[Callable, Callable]] = {
        "project": (lambda: project(gaussians, camera), lambda: plain.project(gaussians, camera)),
        "bin": (lambda: bin_view(ours, camera), lambda: plain.bin_splats(theirs, camera)),
        "composite": (lambda: composite(view, rgb), lambda: plain.composite(plain_view, rgb)),
        "accumulate": (lambda: accumulate(view, maps), lambda: plain.accumulate(plain_view, maps)),
        "whole view": (whole, plain_whole),
    }
    listed = int(view.counts.sum()) * 64, int(plain_view.counts.sum()) * plain.TILE**2
    print(f"{name}: {len(gaussians):,} Gaussians, {camera.width}x{camera.height}")
    print(f"listed pairs of pixel and Gaussian: {listed[0]:,} ours, {listed[1]:,} plain")
    print(f"{'stage':12}{'ours':>10}{'plain':>10}{'ratio':>8}")
    for stage, (mine, other) in stages.items():
        a, b = medians([mine, other], options.repeats)
        print(f"{stage:12}{1e3 * a:>7.1f} ms{1e3 * b:>7.1f} ms{b / a:>7.1f}x")


def load(options: Options):
    """Scene, camera and what it is called."""
    scene, cameras = options.scene, options.cameras
    if scene is None and DATA.is_dir():
        scene, cameras = DATA / "kitchen.ply", DATA / "kitchen.cameras.json"
    if scene is None or cameras is None:
        gaussians, views, name = make_room(), room_cameras(8), "made room"
    else:
        gaussians, views = gsc_jax.load_ply(scene), gsc_jax.load_cameras(cameras)
        name = scene.name
    camera = views[options.view]
    zoom = np.array([options.width / camera.width, options.height / camera.height, 1], np.float32)
    camera = dataclasses.replace(
        camera, K=np.asarray(camera.K) * zoom[:, None], width=options.width, height=options.height
    )
    return jax.device_put(gaussians), camera, name


def require_same(ours, theirs, what: str) -> None:
    """Stop unless both variants compute the same; rounding may flip a cut-off here and there."""
    difference = np.abs(np.asarray(ours) - np.asarray(theirs))
    off = np.mean(difference > 1e-3 * max(1.0, float(np.abs(theirs).max())))
    if off > 1e-3 or difference.mean() > 1e-4:
        raise SystemExit(f"{what} differ: {difference.max():.1e} at most, {off:.1%} of them")


def medians(functions: list[Callable], repeats: int) -> list[float]:
    """Median seconds of each, run in turns."""
    times = []
    for _ in range(repeats + 1):
        times.append([seconds(function) for function in functions])
    return np.median(times[1:], axis=0).tolist()


def seconds(function: Callable) -> float:
    """Wall time until the result is there."""
    start = time.perf_counter()
    jax.block_until_ready(function())
    return time.perf_counter() - start


if __name__ == "__main__":
    main(tyro.cli(Options))
