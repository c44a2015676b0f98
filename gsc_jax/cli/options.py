"""Arguments of the commands as frozen dataclasses, from which tyro makes flags and help texts.

The docstrings are the help texts that `--help` prints; tyro keeps the line breaks of indented lines
only. The fields are written to result.json under their names. `Locate` has a file of its own.
"""

import dataclasses
from pathlib import Path
from typing import Annotated, Any, Literal

import tyro

from gsc_jax.benchmark.tamper import Edit, Program
from gsc_jax.render.projection import NEAR

Regime = Literal[
    "none", "clean", "boundary", "misses", "blobs", "consistent", "inverted", "mixture"
]
"""Regimes of `gsc_jax.benchmark.simulate`, or no masks."""


def arg(metavar: str | None = None, default: str = "") -> Any:
    """Placeholder of an option, and its default if that is None, False or empty, in the help."""

    def hint(value: str) -> str:
        shown = default if value in ("None", "False", "") else value
        return f"(default: {shown})" if shown else ""

    return tyro.conf.arg(metavar=metavar, help_behavior_hint=hint)


Switch = Annotated[bool, arg()]
"""An option without a value."""


@dataclasses.dataclass(frozen=True, kw_only=True)
class SceneOptions:
    """Options of all commands that read a scene; subclasses inherit the help texts.

    Attributes:
        scene: Scene: a 3DGS .ply of any exporter; with the extra `formats` also compressed.ply, spz
            and sog.
        out: Folder for the results, created if missing.
        cameras: cameras.json, transforms.json, a COLMAP model, or a folder that holds one of
            them. Without it, cameras are placed on an orbit around the scene.
        views: Use only this many cameras, evenly spaced in their order. On an orbit: the number of
            cameras, by default 24.
        scale: Image size relative to the size in the camera file.
        near: Near plane in world units; anything closer to a camera is not rendered.
        seed: Seed of everything random.
        no_cache: Do not use the cache folder of this user.
        memory: Memory in GiB that a run may use; a file that expands to more is refused.
    """

    scene: Annotated[tyro.conf.Positional[Path], arg("SCENE.ply")]
    out: Annotated[Path, arg("DIR")]
    cameras: Annotated[Path | None, arg("FILE_OR_DIR", "an orbit")] = None
    views: Annotated[int | None, arg("N", "all")] = None
    scale: Annotated[float, arg("S")] = 1.0
    near: Annotated[float, arg("DEPTH")] = NEAR
    seed: Annotated[int, arg("K")] = 0
    no_cache: Switch = False
    memory: Annotated[float | None, arg("GIB", "half of the machine's")] = None


@dataclasses.dataclass(frozen=True, kw_only=True)
class Render(SceneOptions):
    """Render a scene from its cameras: one PNG per camera, named after it.

    for example:
      gsc-jax render scene.ply --cameras cameras.json --out views

    the images are input for a 2D detector of your own:
      `gsc-jax locate --masks DIR` reads the masks that it writes

    Attributes:
        background: Background colour: red, green and blue from 0 to 1.
    """

    background: tuple[float, float, float] = (0.0, 0.0, 0.0)


@dataclasses.dataclass(frozen=True, kw_only=True)
class Tamper(SceneOptions):
    r"""Edit a scene for tests, with the truth of every Gaussian and every pixel.

    for example:
      gsc-jax tamper scene.ply --cameras cameras.json --edit removal \
              --out edited
      gsc-jax tamper scene.ply --object statue.ply --out edited

    edits, each placed where the cameras see it:
      incorporation            pastes an object into the scene
      modification             changes colour, texture, size or shape
                               of a region
      removal                  removes a region and fills the hole
      optimisation             a modification as editors make it: the
                               views are edited, and the region is
                               trained for them (minutes)
      inpainting               a removal likewise: the hole is inpainted
                               in the views, and new Gaussians trained
      Rows are shuffled. The file may still reveal the edit, for
      example by the precision of its numbers.

    written to the folder of --out:
      overview.png             before, after, and the tampered pixels
      scene.ply, cameras.json  input for `locate`, together with
      masks/                   masks of a simulated detector
      labels.npy, truth/       truth by row and by view
      edit.json                description and numbers of the edit

    Attributes:
        edit: Kind of edit.
        object: Object to paste: a .ply that holds nothing else, upright with -y up, of any position
            and size. By default a generated vase.
        size: Share of the pixels that the edit should cover, as the median over the views that show
            it.
        masks: Failures of the simulated detector: none at all (clean), a single kind (boundary,
            misses, blobs, consistent, inverted) or all of them (mixture), with the strengths of
            docs/results.md. `none` writes no masks.
    """

    edit: Edit | Program = "incorporation"
    object: Annotated[Path | None, arg("OBJECT.ply", "a vase")] = None
    size: Annotated[float, arg("SHARE")] = 0.05
    masks: Regime = "mixture"


@dataclasses.dataclass(frozen=True, kw_only=True)
class Demo:
    """Generate a scene, tamper with it, locate the edit, and compare with the truth.

    for example:
      gsc-jax demo --out demo

    the scene:
      A room with a vase pasted onto the table, and masks of a
      simulated 2D detector. Nothing is downloaded.

    Attributes:
        out: Folder for the scene, the masks and the results, created if missing.
        seed: Seed of the room, the cameras and the failures of the detector.
        no_cache: Do not use the cache folder of this user.
    """

    out: Annotated[Path, arg("DIR")]
    seed: Annotated[int, arg("K")] = 0
    no_cache: Switch = False


@dataclasses.dataclass(frozen=True, kw_only=True)
class View:
    """Show the results of `locate` in 3D in a browser. Needs the extra `viewer`.

    for example:
      gsc-jax view found
      gsc-jax view found --html found.html --most 200000

    the page shows:
      the scene in its own colours, a heat map of the scores, or only
      the tampered Gaussians, and a list of cameras; if it is served,
      also a slider for the threshold

    Attributes:
        folder: Folder with the results of `locate`.
        html: Write a page that needs no server to this file, instead of serving one.
        port: Port of the server.
        host: Address of the server; 0.0.0.0 lets other machines connect, if they are given the
            printed address, which contains a random key.
        most: Maximum number of Gaussians: the tampered ones, then the largest and most opaque ones.
        no_browser: Do not open the page in a browser, only print its address.
        memory: Memory in GiB that may be used; a file that expands to more is refused.
    """

    folder: Annotated[tyro.conf.Positional[Path], arg("DIR")]
    html: Annotated[Path | None, arg("FILE.html", "serve it")] = None
    port: Annotated[int, arg("PORT")] = 8080
    host: Annotated[str, arg("HOST")] = "localhost"
    most: Annotated[int, arg("N")] = 500_000
    no_browser: Switch = False
    memory: Annotated[float | None, arg("GIB", "half of the machine's")] = None


@dataclasses.dataclass(frozen=True, kw_only=True)
class Evaluate:
    """Compare the results of `locate` with the truth, by Gaussian, by view, or both.

    for example:
      gsc-jax evaluate found --truth edited/labels.npy edited/truth

    The masks of the 2D detector are compared with the same truth.

    Attributes:
        folder: Folder with the results of `locate`.
        truth: labels.npy, bool by row of the scene file; a folder with a mask per camera,
            CAMERA.png; or both, as `gsc-jax tamper` writes them.
        out: File for the scores.
        memory: Memory in GiB that may be used; a file that expands to more is refused.
    """

    folder: Annotated[tyro.conf.Positional[Path], arg("DIR")]
    truth: Annotated[tuple[Path, ...], arg("labels.npy|MASKS ...")]
    out: Annotated[Path | None, arg("FILE.json", "DIR/evaluation.json")] = None
    memory: Annotated[float | None, arg("GIB", "half of the machine's")] = None
