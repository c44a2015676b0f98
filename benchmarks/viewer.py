"""Seconds between frames of `gsc-jax view --html` in a browser without a graphics card.

    python benchmarks/viewer.py [--counts 20000 250000]

Results of the first scene with as many Gaussians, drawn by Chromium with SwiftShader while the
camera is dragged: the longest time between two frames in six seconds, the median of three times,
at a window of 1280 x 900, which the page draws at half the resolution without a graphics card. At
first the page shows the largest Gaussians only, then all.
"""

import dataclasses
import sys
import tempfile
from pathlib import Path

import common
import numpy as np
import tyro
from selenium.webdriver.support.ui import Select

from gsc_jax.cli.main import main as gsc_jax_command
from gsc_jax.io.ply import save_ply

sys.path.append(str(Path(__file__).resolve().parents[1] / "tests"))
from browser import Browser, opened

DRAG = """
const done = arguments[0], canvas = document.querySelector("canvas"), gaps = [];
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
  if (now - start < 6000) requestAnimationFrame(frame); else done(Math.max(...gaps) / 1000);
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
            first, every = seconds_of_frame(place)
            print(f"{count:,} Gaussians: {first:.2f} s at first, {every:.2f} s all", flush=True)


def run(*argv: object) -> None:
    """Run `gsc-jax` in this process."""
    if code := gsc_jax_command([str(word) for word in argv]):
        sys.exit(code)


def seconds_of_frame(place: Path) -> list[float]:
    """Longest time between two frames while the camera of `place`/page.html is dragged.

    With the Gaussians that the page shows at first, and with all of them.
    """
    for browser in opened(place / "profile"):
        browser.set_script_timeout(120)
        browser.implicitly_wait(60)
        browser.get((place / "page.html").as_uri())
        first = dragged(browser)
        Select(browser.find_element("id", "count")).options[-1].click()
        return [first, dragged(browser)]
    raise RuntimeError("no browser was opened")


def dragged(browser: Browser) -> float:
    """Longest time between two frames of the scene in the frame of a page."""
    browser.switch_to.frame(browser.find_element("tag name", "iframe"))
    browser.find_element("tag name", "canvas")
    browser.execute_async_script("setTimeout(arguments[0], 10000)")  # the first frames
    times = [browser.execute_async_script(DRAG) for _ in range(3)]
    browser.switch_to.default_content()
    return float(np.median(times))


if __name__ == "__main__":
    main(tyro.cli(Options, description=__doc__))
