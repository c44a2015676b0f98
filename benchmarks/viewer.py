"""Seconds between frames of `gsc-jax view` in a browser without a graphics card.

    python benchmarks/viewer.py [--counts 20000 250000]

Results of the first scene with as many Gaussians, drawn by Chromium with SwiftShader at a window of
1280 x 900, which the page draws at half the resolution without a graphics card. While the camera is
dragged, the page draws the first 10,000 Gaussians: the longest time between two frames in six
seconds, from the moment at which all were drawn at rest. After that: seconds until all are drawn
again. Medians of three times.
"""

import dataclasses
import sys
import tempfile
from pathlib import Path

import common
import numpy as np
import tyro

from gsc_jax.cli.main import main as gsc_jax_command
from gsc_jax.io.ply import save_ply

sys.path.append(str(Path(__file__).resolve().parents[1] / "tests"))
from browser import opened

DRAG = """
const done = arguments[0], canvas = document.querySelector("canvas[data-engine]"), gaps = [];
const box = canvas.getBoundingClientRect();
const x = box.left + box.width / 2, y = box.top + box.height / 2;
const send = (kind, dx) => canvas.dispatchEvent(new PointerEvent(kind, {
  pointerId: 1, bubbles: true, clientX: x + dx, clientY: y, buttons: 1, isPrimary: true,
}));
send("pointerdown", 0);
const start = performance.now();
let last = start;
const frame = () => {
  const now = performance.now();
  gaps.push(now - last);
  last = now;
  send("pointermove", 100 * Math.sin((now - start) / 500));
  if (now - start < 6000) { requestAnimationFrame(frame); return; }
  send("pointerup", 0);
  const gl = canvas.getContext("webgl2");
  const rest = () => {
    if (view.motion.shown < view.count) { requestAnimationFrame(rest); return; }
    requestAnimationFrame(() => {
      // This waits for the frame.
      gl.readPixels(0, 0, 1, 1, gl.RGBA, gl.UNSIGNED_BYTE, new Uint8Array(4));
      done([Math.max(...gaps) / 1000, (performance.now() - now) / 1000]);
    });
  };
  requestAnimationFrame(rest);
};
requestAnimationFrame(frame);
"""


@dataclasses.dataclass(frozen=True)
class Options:
    """What to measure.

    Attributes:
        counts: Numbers of Gaussians.
    """

    counts: tuple[int, ...] = (20_000, 250_000)


def main(options: Options) -> None:
    """Print the seconds between frames for each number of Gaussians."""
    _, gaussians, _ = next(common.scenes())
    for count in options.counts:
        with tempfile.TemporaryDirectory() as folder:
            place = Path(folder)
            save_ply(place / "scene.ply", common.of_count(gaussians, count))
            run("locate", place / "scene.ply", "--out", place / "found", "--views", 3)
            run("view", place / "found", "--html", place / "page.html")
            motion, rest = seconds_of_frame(place / "page.html")
            print(
                f"{count:,} Gaussians: {motion:.2f} s in motion, {rest:.2f} s to rest", flush=True
            )


def run(*argv: object) -> None:
    """Run `gsc-jax` in this process."""
    if code := gsc_jax_command([str(word) for word in argv]):
        sys.exit(code)


def seconds_of_frame(page: Path) -> np.ndarray:
    """Longest gap between frames in a drag, and seconds from its end until all are drawn."""
    for browser in opened(page.parent / "profile"):
        browser.set_script_timeout(120)
        browser.get(page.as_uri())
        browser.execute_async_script("setTimeout(arguments[0], 15000)")  # the first frames
        return np.median([browser.execute_async_script(DRAG) for _ in range(3)], axis=0)
    raise RuntimeError("no browser was opened")


if __name__ == "__main__":
    main(tyro.cli(Options, description=__doc__))
