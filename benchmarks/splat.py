"""Time per stage of a view, compared with a plain variant and with the limit of the machine.

    python benchmarks/splat.py [--widths 480 640 960] [--repeats 9]

Runs on every real scene (or a synthetic room) and size, interleaved in one process: the library;
the plain JAX variant (`plain.py`); a vectorised NumPy loop over tiles; and, with a C compiler, a C
loop over the same pairs of pixel and Gaussian (`limit.c`), which is the limit. All must give the
same pixels. Writes `docs/performance.json`, unless other widths are given.
"""

import dataclasses
import os
from collections.abc import Callable

import common
import jax
import limit
import numpy as np
import plain
import tyro

from gsc_jax.evidence.monitor import peak_memory_mib
from gsc_jax.render.derivatives import derivatives
from gsc_jax.render.projection import project
from gsc_jax.render.spherical_harmonics import colors
from gsc_jax.render.tiles import TILE, View, bin_view, make_view, splat_table
from gsc_jax.render.walk import MAX_ALPHA, MIN_TRANSMITTANCE
from gsc_jax.scene import Camera, Gaussians
from gsc_jax.splat import accumulate, composite

Runs = dict[str, Callable[[], object]]
STAGES = ("project", "bin", "composite", "accumulate", "whole view")
BACKWARD = {"composite backward": "composite", "project backward": "project"}
"""Backward passes, and the forward passes that they are compared with."""


@dataclasses.dataclass(frozen=True)
class Options:
    """What to measure.

    Attributes:
        widths: Image widths in pixels; the height is three quarters of it.
        view: Index of the camera of each scene.
        repeats: Timed runs of each stage.
    """

    widths: tuple[int, ...] = (480, 640, 960)
    view: int = 1
    repeats: int = 9


def main(options: Options) -> None:
    """Measure everything and print a table per scene and size."""
    blend, rows = limit.compiled(), []
    for name, gaussians, cameras in common.scenes():
        for width in options.widths:
            camera = cameras[options.view].resized(width, width * 3 // 4)
            rows.append({"scene": name, **measure(gaussians, camera, blend, options.repeats)})
            print(described(rows[-1]), flush=True)
    if options.widths == Options().widths:
        common.save("splat", rows)


def measure(gaussians: Gaussians, camera: Camera, blend: limit.Blend | None, repeats: int) -> dict:
    """Seconds of all stages of one view, and its numbers of pairs."""
    rgba, maps = features_and_maps(gaussians, camera)
    compile_time = common.seconds(lambda: accumulate(make_view(gaussians, camera), maps))
    view = make_view(gaussians, camera)
    plain_view = plain.bin_splats(plain.project(gaussians, camera), camera)
    pairs = same_pixels(view, plain_view, rgba, blend)
    runs = stages(gaussians, camera, rgba, maps) | plain_stages(gaussians, camera, rgba, maps)
    runs |= backward_stages(gaussians, camera, rgba)
    if blend is not None:
        runs["C composite, 1 core"] = lambda: blend(view, rgba)
        runs["C composite, all cores"] = lambda: blend(view, rgba, threads=os.cpu_count() or 1)
    return {
        "gaussians": len(gaussians),
        "width": camera.width,
        "height": camera.height,
        **pairs,
        "first view with compilation": compile_time,
        "NumPy composite": common.seconds(lambda: numpy_composite(view, np.asarray(rgba))),
        **common.medians(runs, repeats),
        "peak_mib": peak_memory_mib(),
    }


def features_and_maps(gaussians: Gaussians, camera: Camera) -> tuple[jax.Array, jax.Array]:
    """Colours with an empty column (N, 4), and two random maps (H, W, 2)."""
    rgba = np.pad(colors(gaussians.sh, gaussians.means, camera.center), ((0, 0), (0, 1)))
    maps = np.random.default_rng(0).random((camera.height, camera.width, 2), np.float32)
    return jax.device_put(rgba), jax.device_put(maps)


def same_pixels(
    view: View, plain_view: plain.PlainView, rgba: jax.Array, blend: limit.Blend | None
) -> dict[str, int]:
    """Count pairs of pixel and Gaussian, and require the same pixels of all variants."""
    image = composite(view, rgba)
    require_same(image, plain.composite(plain_view, rgba), "plain")
    require_same(image, numpy_composite(view, np.asarray(rgba)), "NumPy")
    listed = {
        "listed": int(np.sum(view.counts)) * TILE**2,
        "plain listed": int(np.sum(plain_view.counts)) * plain.TILE**2,
    }
    if blend is None:
        return listed
    counted = blend(view, rgba, counting=True)
    require_same(image, counted.image, "C")
    return {**listed, "evaluated": counted.evaluated, "needed": counted.needed}


def stages(gaussians: Gaussians, camera: Camera, rgba: jax.Array, maps: jax.Array) -> Runs:
    """Stages of the library, and the whole view."""
    splats = project(gaussians, camera)
    view = bin_view(splats, camera)
    return {
        "project": lambda: project(gaussians, camera),
        "bin": lambda: bin_view(splats, camera),
        "composite": lambda: composite(view, rgba),
        "accumulate": lambda: accumulate(view, maps),
        "whole view": lambda: accumulate(make_view(gaussians, camera), maps),
    }


def backward_stages(gaussians: Gaussians, camera: Camera, rgba: jax.Array) -> Runs:
    """Colours, and what a gradient by all parameters takes beside the forward pass."""
    view = make_view(gaussians, camera)
    image = composite(view, rgba)
    splats, pullback = jax.vjp(lambda scene: splat_table(project(scene, camera)), gaussians)
    pullback = jax.jit(pullback)
    return {
        "colours": lambda: colors(gaussians.sh, gaussians.means, camera.center),
        "composite backward": lambda: derivatives(view, rgba, image, image),
        "project backward": lambda: pullback(splats),
    }


def plain_stages(gaussians: Gaussians, camera: Camera, rgba: jax.Array, maps: jax.Array) -> Runs:
    """Stages of the plain variant, and the whole view."""
    splats = plain.project(gaussians, camera)
    view = plain.bin_splats(splats, camera)

    def whole():
        binned = plain.bin_splats(plain.project(gaussians, camera), camera)
        return plain.accumulate(binned, maps)

    return {
        "plain project": lambda: plain.project(gaussians, camera),
        "plain bin": lambda: plain.bin_splats(splats, camera),
        "plain composite": lambda: plain.composite(view, rgba),
        "plain accumulate": lambda: plain.accumulate(view, maps),
        "plain whole view": whole,
    }


def numpy_composite(view: View, features: np.ndarray) -> np.ndarray:
    """W c with one vectorised NumPy expression per tile."""
    rows, columns = -(-view.height // TILE), -(-view.width // TILE)
    splats, ids = np.asarray(view.splats), np.asarray(view.ids)
    image = np.zeros((rows * TILE, columns * TILE, features.shape[1]), np.float32)
    lists = (np.asarray(x) for x in (view.tiles, view.starts, view.counts))
    for tile, start, count in zip(*lists, strict=True):
        if not count:
            continue
        listed = ids[start : start + count]
        top, left = TILE * (tile // columns), TILE * (tile % columns)
        x, y, a, b, c, log_opacity = splats[listed].T[..., None]
        dy, dx = np.divmod(np.arange(TILE * TILE, dtype=np.float32), TILE)
        dx, dy = dx[None] + (left + 0.5) - x, dy[None] + (top + 0.5) - y
        alpha = np.minimum(MAX_ALPHA, np.exp(log_opacity - (a * dx + b * dy) ** 2 - (c * dy) ** 2))
        alpha[alpha < 1 / 255] = 0
        behind = np.cumprod(1 - alpha, axis=0)
        weights = np.where(behind >= MIN_TRANSMITTANCE, behind * alpha / (1 - alpha), 0)
        blended = weights.T @ features[listed]
        image[top : top + TILE, left : left + TILE] = blended.reshape(TILE, TILE, -1)
    return image[: view.height, : view.width]


def require_same(ours, theirs, what: str) -> None:
    """Stop unless two images agree up to a few cut-offs that rounding flips."""
    difference = np.abs(np.asarray(ours) - np.asarray(theirs))
    off = np.mean(difference > 1e-3)
    if off > 1e-3 or difference.mean() > 1e-5:
        raise SystemExit(f"{what} differs: {difference.max():.1e} at most, {off:.2%} of the values")


def described(row: dict) -> str:
    """Text with the numbers of one view."""
    lines = [
        f"\n{row['scene']}: {row['gaussians']:,} Gaussians, {row['width']}x{row['height']}",
        f"pairs of pixel and Gaussian: {row['listed']:,} listed ({row['plain listed']:,} plain)",
        f"{'':12}{'ours':>10}{'plain':>10}{'ratio':>8}",
    ]
    for stage in STAGES:
        a, b = row[stage], row[f"plain {stage}"]
        lines.append(f"{stage:12}{1e3 * a:>7.1f} ms{1e3 * b:>7.1f} ms{b / a:>7.1f}x")
    lines.append(f"colours {1e3 * row['colours']:.1f} ms")
    for backward, forward in BACKWARD.items():
        ratio = row[backward] / row[forward]
        lines.append(f"{backward} {1e3 * row[backward]:.1f} ms, {ratio:.1f} times {forward}")
    lines.append(f"NumPy composite {1e3 * row['NumPy composite']:.0f} ms")
    if "needed" in row:
        lines[1] += f", {row['evaluated']:,} until a tile stops, {row['needed']:,} contribute"
        for key in ("C composite, 1 core", "C composite, all cores"):
            ratio = row["composite"] / row[key]
            lines.append(f"{key} {1e3 * row[key]:.1f} ms; ours takes {ratio:.1f} times as long")
    lines.append(f"first view with compilation {row['first view with compilation']:.1f} s")
    return "\n".join(lines)


if __name__ == "__main__":
    main(tyro.cli(Options, description=__doc__))
