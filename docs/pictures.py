"""Pictures of the README and of the tutorial, made from this repository alone.

    python docs/pictures.py

runs the code blocks of tutorial.md, which save their own pictures, draws teaser.png, opens a report
in Chromium if it is installed, and writes all of them to docs/pictures/. (`make results` and `make
bench` draw the charts of results.md and performance.md.)
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
PALETTE_SIZE = 128
"""Colours of a picture: fewer are visible as bands, more cost bytes."""

BROWSERS = "chromium", "chromium-browser", "google-chrome"
FLAGS = "--headless=new", "--no-sandbox", "--hide-scrollbars", "--window-size=1120,840"
INPUTS = "--cameras", "cameras.json", "--masks", "masks"
TITLES = "edited scene", "mask of a 2D detector", "mask of gsc_jax", "score per Gaussian"
TEASER_VIEWS = 0, 11
"""Views of the teaser: the detector misses the vase in one and flags too much in the other."""
TITLE_BOX = {"boxstyle": "square,pad=0.35", "facecolor": "black", "alpha": 0.7, "linewidth": 0}
"""Background of titles, for contrast on any picture."""
GRID = {"left": 0, "right": 1, "bottom": 0, "top": 1, "wspace": 0.015, "hspace": 0.02}

Case = tuple[MadeScene, Mapping[str, np.ndarray]]
"""A scene, and probability maps of a 2D detector by camera name."""


def main() -> None:
    """Make all pictures."""
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


def blocks(page: str) -> list[tuple[str, str]]:
    """Code blocks of a page in order, each with its documented output."""
    return BLOCK.findall((DOCS / page).read_text(encoding="utf-8"))


def run_tutorial(folder: Path) -> None:
    """Run the blocks of the tutorial in a folder and in one namespace."""
    names: dict = {}
    with contextlib.chdir(folder), contextlib.redirect_stdout(None):
        for code, _ in blocks("tutorial.md"):
            exec(compile(code, "tutorial.md", "exec"), names)


def made_case(*, count: int = 50_000, width: int = 480, height: int = 360) -> Case:
    """Make a room with a pasted vase, and probability maps of a detector with failures."""
    made = tampered_room(count=count, views=16, heldout=0, width=width, height=height)
    decoy_rows = decoy_labels(made.gaussians, made.labels, seed=0)
    truth, decoy = (
        np.stack([truth_mask(made.gaussians, camera, labels) for camera in made.cameras])
        for labels in (made.labels, decoy_rows)
    )
    maps = simulate(truth, decoy, seed=0, failures=REGIMES["mixture"])
    return made, {camera.name: view for camera, view in zip(made.cameras, maps, strict=True)}


def teaser(path: Path, case: Case) -> None:
    """Draw two views of an edited scene, the masks of a detector, and the result."""
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
        axes.text(s=title, color="white", fontsize=15, bbox=TITLE_BOX, **corner)
    figure.savefig(path)


def teaser_rows(made: MadeScene, maps: Mapping[str, np.ndarray]) -> list[list[np.ndarray]]:
    """Pictures of the teaser, a row per view."""
    result = gsc_jax.locate(made.gaussians, made.cameras, maps, prior=False)
    rows = []
    for camera in (made.cameras[i] for i in TEASER_VIEWS):
        rgb = np.asarray(gsc_jax.render(made.gaussians, camera)[0])
        flagged, found = maps[camera.name] > 0.5, result.masks[camera.name]
        score = heat(made.gaussians, camera, result.tamper)
        rows.append([rgb, overlay(rgb, flagged), overlay(rgb, found), score])
    return rows


def report(path: Path, case: Case, folder: Path) -> None:
    """Take a screenshot of the top of report.html; do nothing without a browser."""
    browser = next(filter(None, map(shutil.which, BROWSERS)), None)
    if browser is None:
        return
    made, maps = case
    with contextlib.chdir(folder), contextlib.redirect_stdout(None):
        gsc_jax.save_ply("scene.ply", made.gaussians)
        gsc_jax.save_cameras("cameras.json", made.cameras)
        for name, view in maps.items():
            write_probability(image_path("masks", name), view)
        run_program(["locate", "scene.ply", *INPUTS, "--out", "found", "--no-cache"])
    page = (folder / "found" / "report.html").as_uri()
    options = [*FLAGS, f"--user-data-dir={folder / 'browser'}", f"--screenshot={path}"]
    subprocess.run([browser, *options, page], check=True, capture_output=True)


def heat(gaussians: Gaussians, camera: Camera, tamper: np.ndarray) -> np.ndarray:
    """Render the scene in grey with the scores on top, more opaque where higher."""
    from matplotlib import colormaps

    luma = np.asarray(colors(gaussians.sh, gaussians.means, camera.center)).mean(1, keepdims=True)
    score = tamper[:, None]
    painted = (1 - score) * 0.7 * luma + score * colormaps["plasma"](tamper)[:, :3]
    return np.clip(gsc_jax.render_features(gaussians, camera, painted)[0], 0, 1)


def shrink(picture: Path, path: Path) -> None:
    """Write a picture with a palette, which takes a third of the bytes."""
    from PIL import Image

    with Image.open(picture) as image:
        few = image.convert("RGB").quantize(PALETTE_SIZE, dither=Image.Dither.FLOYDSTEINBERG)
        few.save(path, optimize=True)


if __name__ == "__main__":
    main()
