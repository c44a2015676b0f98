"""Every picture of the README and of the tutorial, made from nothing but this repository.

    python docs/pictures.py

runs the blocks of tutorial.md, which save their own pictures, draws teaser.png, opens a report in
Chromium where it is installed, and puts all of it into docs/pictures/. (The charts of results.md
and performance.md are made by `make results` and `make bench`.)
"""

import contextlib
import re
import shutil
import subprocess
import tempfile
from collections.abc import Mapping
from pathlib import Path

import numpy as np

import gsc_jax
from gsc_jax.benchmark.metrics import truth_mask
from gsc_jax.benchmark.scenes import MadeScene, tampered_room
from gsc_jax.benchmark.simulate import REGIMES, decoy_labels, simulate
from gsc_jax.cli.main import main as run_program
from gsc_jax.cli.pictures import overlay
from gsc_jax.io.masks import image_path, write_probability
from gsc_jax.render.spherical_harmonics import colors
from gsc_jax.scene import Camera, Gaussians

DOCS = Path(__file__).resolve().parent
PICTURES = DOCS / "pictures"
BLOCK = re.compile(r"^```python\n(.*?)^```$(?:\s+^```text\n(.*?)^```$)?", re.DOTALL | re.MULTILINE)
COLOURS = 128
"""In the palette of a picture: fewer show, more cost bytes."""

BROWSERS = "chromium", "chromium-browser", "google-chrome"
FLAGS = "--headless=new", "--no-sandbox", "--hide-scrollbars", "--window-size=1120,840"
GIVEN = "--cameras", "cameras.json", "--masks", "masks"
TITLES = "the edited scene", "what a 2D detector says", "what gsc_jax found", "score per Gaussian"
SHOWN = 0, 11
"""Views of the teaser: in one the detector misses the vase, in the other it flags more."""
PLATE = {"boxstyle": "square,pad=0.35", "facecolor": "black", "alpha": 0.7, "linewidth": 0}
"""What titles stand on, so that they can be read on any picture."""
GRID = {"left": 0, "right": 1, "bottom": 0, "top": 1, "wspace": 0.015, "hspace": 0.02}

Case = tuple[MadeScene, Mapping[str, np.ndarray]]
"""A scene, and what a 2D detector says of each of its views, by camera name."""


def main() -> None:
    """Makes all pictures anew."""
    with tempfile.TemporaryDirectory() as folder:
        made = Path(folder) / "pictures"
        made.mkdir()
        run_tutorial(Path(folder))
        case = made_case()
        teaser(made / "teaser.png", case)
        report(made / "report.png", case, Path(folder))
        PICTURES.mkdir(exist_ok=True)
        for picture in made.glob("*.png"):
            shrink(picture, PICTURES / picture.name)


def blocks() -> list[tuple[str, str]]:
    """The Python of the tutorial in its order, and what the page says that each block prints."""
    return BLOCK.findall((DOCS / "tutorial.md").read_text(encoding="utf-8"))


def run_tutorial(folder: Path) -> None:
    """Runs the blocks of the tutorial in a folder, in one namespace, as a reader would."""
    names: dict = {}
    with contextlib.chdir(folder), contextlib.redirect_stdout(None):
        for code, _ in blocks():
            exec(compile(code, "tutorial.md", "exec"), names)


def made_case(*, count: int = 50_000, width: int = 480, height: int = 360) -> Case:
    """A made room with a vase pasted in, and what a detector that errs says of each view."""
    made = tampered_room(count=count, views=16, heldout=0, width=width, height=height)
    suspicious = decoy_labels(made.gaussians, made.labels, seed=0)
    truth, decoy = (
        np.stack([truth_mask(made.gaussians, camera, labels) for camera in made.cameras])
        for labels in (made.labels, suspicious)
    )
    said = simulate(truth, decoy, seed=0, failures=REGIMES["mixture"])
    return made, {camera.name: view for camera, view in zip(made.cameras, said, strict=True)}


def teaser(path: Path, case: Case) -> None:
    """Two views of an edited scene, what a detector makes of them, and what was found."""
    from matplotlib.figure import Figure

    rows = teaser_rows(*case)
    height, width = rows[0][0].shape[:2]
    figure = Figure(figsize=(12, 3 * height / width * len(rows)), dpi=100, facecolor="grey")
    table = figure.subplots(len(rows), len(TITLES), gridspec_kw=GRID)
    for axes_row, pictures in zip(table, rows, strict=True):
        for axes, picture in zip(axes_row, pictures, strict=True):
            axes.imshow(picture, aspect="auto", interpolation="lanczos")
            axes.set_axis_off()
    for axes, title in zip(table[0], TITLES, strict=True):
        corner = {"x": 0.025, "y": 0.965, "va": "top", "transform": axes.transAxes}
        axes.text(s=title, color="white", fontsize=15, bbox=PLATE, **corner)
    figure.savefig(path)


def teaser_rows(made: MadeScene, said: Mapping[str, np.ndarray]) -> list[list[np.ndarray]]:
    """The pictures of the teaser, a row per view."""
    result = gsc_jax.locate(made.gaussians, made.cameras, said, native=False)
    rows = []
    for camera in (made.cameras[i] for i in SHOWN):
        rgb = np.asarray(gsc_jax.render(made.gaussians, camera)[0])
        flagged, found = said[camera.name] > 0.5, result.masks[camera.name]
        score = heat(made.gaussians, camera, result.tamper)
        rows.append([rgb, overlay(rgb, flagged), overlay(rgb, found), score])
    return rows


def report(path: Path, case: Case, folder: Path) -> None:
    """The top of report.html, as `gsc-jax locate` leaves it; nothing where no browser is."""
    browser = next(filter(None, map(shutil.which, BROWSERS)), None)
    if browser is None:
        return
    made, said = case
    with contextlib.chdir(folder), contextlib.redirect_stdout(None):
        gsc_jax.save_ply("scene.ply", made.gaussians)
        gsc_jax.save_cameras("cameras.json", made.cameras)
        for name, view in said.items():
            write_probability(image_path("masks", name), view)
        run_program(["locate", "scene.ply", *GIVEN, "--out", "found", "--no-cache"])
    page = (folder / "found" / "report.html").as_uri()
    options = [*FLAGS, f"--user-data-dir={folder / 'browser'}", f"--screenshot={path}"]
    subprocess.run([browser, *options, page], check=True, capture_output=True)


def heat(gaussians: Gaussians, camera: Camera, tamper: np.ndarray) -> np.ndarray:
    """The scene in grey, with the colours of the scores, the stronger the higher they are."""
    from matplotlib import colormaps

    luma = np.asarray(colors(gaussians.sh, gaussians.means, camera.center)).mean(1, keepdims=True)
    score = tamper[:, None]
    painted = (1 - score) * 0.7 * luma + score * colormaps["plasma"](tamper)[:, :3]
    return np.clip(gsc_jax.render_features(gaussians, camera, painted)[0], 0, 1)


def shrink(picture: Path, path: Path) -> None:
    """Writes a picture with a palette, which takes a third of the bytes."""
    from PIL import Image

    with Image.open(picture) as image:
        few = image.convert("RGB").quantize(COLOURS, dither=Image.Dither.FLOYDSTEINBERG)
        few.save(path, optimize=True)


if __name__ == "__main__":
    main()
