"""Arguments of the commands as frozen dataclasses, from which tyro makes flags and help texts.

The docstrings are the help texts that `--help` prints; tyro keeps the line breaks of indented lines
only. The fields are written to result.json under their names.
"""

import dataclasses
from pathlib import Path
from typing import Annotated, Any, Literal

import tyro

from gsc_jax.benchmark.tamper import Edit
from gsc_jax.estimators import Method
from gsc_jax.evidence.masks import MaskRule
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
        scene: Scene: a 3DGS .ply of any exporter, .splat, .ksplat or .glb; with the extra
            `formats` also compressed.ply, spz and sog.
        out: Folder for the results, created if missing.
        cameras: cameras.json, transforms.json, a COLMAP model, or a folder that holds one of
            them. Without it, cameras are placed on an orbit around the scene.
        views: Use only this many cameras, evenly spaced in their order. On an orbit: the number of
            cameras, by default 24, or 12 without a 2D detector.
        up: Up direction for an orbit: x, -x, y, -y, z, -z, or three numbers as 0,0,1. By default +y
            for .glb, else that of the floor, or -y if no floor stands out.
        scale: Image size relative to that in the camera file.
        near: Near plane in world units; anything closer to a camera is not rendered.
        seed: Seed of everything random.
        no_cache: Do not use the cache folder of this user.
        memory: Memory in GiB that a run may use; a file that expands to more is refused.
    """

    scene: Annotated[tyro.conf.Positional[Path], arg("SCENE.ply")]
    out: Annotated[Path, arg("DIR")]
    cameras: Annotated[Path | None, arg("FILE_OR_DIR", "an orbit")] = None
    views: Annotated[int | None, arg("N", "all")] = None
    up: Annotated[str | None, arg("AXIS", "that of the floor")] = None
    scale: Annotated[float | None, arg("S", "1, or less for a width of 1600")] = None
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
        object: Object to paste: a .ply with nothing else, upright with -y up, of any size.
        size: Share of the pixels that the edit should cover, the median over views that show it.
        masks: Failures of the simulated detector: none at all (clean), a single kind (boundary,
            misses, blobs, consistent, inverted) or all of them (mixture), with the strengths of
            docs/results.md. `none` writes no masks.
    """

    edit: Edit = "incorporation"
    object: Annotated[Path | None, arg("OBJECT.ply", "a generated vase")] = None
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
      the scene with the labelled Gaussians marked, or without marks, a
      heat map of the scores, or only one of both groups, by a threshold;
      its cameras; values and traces of a Gaussian at a click; a
      selection (boxes, a brush); and it writes parts as .ply

    Attributes:
        folder: Folder with the results of `locate`.
        html: Write a page that needs no server to this file, instead of serving one.
        port: Port of the server.
        host: Address of the server; 0.0.0.0 lets other machines connect, if they are given the
            printed address, which contains a random key.
        most: Maximum number of Gaussians: the largest and most opaque ones, half of them tampered.
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


@dataclasses.dataclass(frozen=True, kw_only=True)
class Locate(SceneOptions):
    r"""Find the tampered Gaussians of a scene.

    for example:
      gsc-jax locate scene.ply --out found
      gsc-jax locate scene.ply --masks masks --out found \
              --cameras cameras.json
      gsc-jax locate scene.ply --cameras sparse/0 --out found \
              --detector native net.onnx --preset iml-vit

    evidence:
      By default the attributes of the Gaussians alone. A 2D detector
      adds evidence from the views: either its masks are read, or an
      ONNX model runs on the rendered views. A mask is a grey image
      named after its camera; white is tampered.

    repeat a run with another threshold:
      gsc-jax locate --config found/result.json --threshold 0.7 \
              --out stricter

    a file for --config; every line is optional:
      [command]                # these options, with _ instead of -
      scene = "scene.ply"
      all_views = true
      [config]                 # fields of RobustEstimator, or of
      classes = [4, 8, 12]     # GSChecker for official and paper
      smoothing = 5.0

    written to the folder of --out:
      report.html              start here
      overview.png             a few views side by side
      render/, overlay/        renders, and renders with the mask
      tamper.ply               the scene, plus the property tamper
      highlight.ply            tampered red, or candidates blue, the rest grey
      labels.npy, tamper.npy   bool and score, by row of the scene
      masks/, scores/          final masks, and scores as 16-bit maps
      detector/                the detector's maps, 16 bits
      views.json               the cameras of the masks
      result.json              numbers, warnings, versions

    Attributes:
        config: Options from the result.json of an earlier run (or its folder), or from a TOML or
            JSON file with options. Command-line options override the file: --masks None unsets a
            value, --no-all-views a switch. Paths are relative to the current folder.
        dry_run: Validate all input and print the resolved configuration. Writes nothing to --out.
        masks: Folder with a mask per camera: CAMERA.png.
        detector: Detectors that contribute evidence besides --masks: `native`, the attributes of
            the Gaussians and exact traces of editing (only `robust` uses them); MODEL.onnx, a 2D
            network that runs on the rendered views, or a folder with the encoder.onnx and
            decoder.onnx of SAFIRE; both; or `none`.
        preset: Input and output format of a published model: iml-vit, trufor, mvss-net or pscc-net.
        spec: Input and output format of any other model, as a TOML file with the fields of the
            class OnnxSpec, by default MODEL.toml beside MODEL.onnx if it exists.
        provider: Execution provider of onnxruntime, such as cuda.
        threads: Number of CPU threads of the model.
        method: `robust` estimates the reliability of every mask. GS-Checker trusts all views
            alike: `official` follows the schedule of its released code, `paper` its equations,
            over several epochs.
        all_views: Run the --detector on the views of all cameras. Otherwise `robust` stops when
            further views no longer change the labels, unless --views gives a number.
        lambda2: For official and paper: weight lambda2 (eq. 10) of a Gaussian outside the masks.
            With 10, 91 % of its blending weight has to lie inside them, at 1 half of it.
        epochs: For official and paper: how often the optimisation visits each view.
        threshold: Score above which a Gaussian is labelled as tampered: a probability for `robust`,
            a score relative to the maximum for GS-Checker.
        mask_rule: How labels become a mask: share, pixels in which tampered Gaussians have more
            than half of the weight; attribute, pixels whose rendered score exceeds the threshold;
            per-view, the rule of the released code, which normalises each view on its own.
    """

    config: Annotated[Path | None, arg("FILE")] = None
    dry_run: Switch = False
    masks: Annotated[Path | None, arg("DIR", "none")] = None
    detector: Annotated[tuple[Path, ...], arg("none|native|MODEL.onnx ...", "native")] = ()
    preset: Annotated[str | None, arg("NAME", "RGB in [0, 1]")] = None
    spec: Annotated[Path | None, arg("FILE.toml", "beside the model")] = None
    provider: Annotated[str | None, arg("NAME", "cpu")] = None
    threads: Annotated[int | None, arg("N", "all cores")] = None
    method: Method = "robust"
    all_views: Switch = False
    lambda2: Annotated[float | None, arg("PRICE", "10")] = None
    epochs: Annotated[int | None, arg("N", "official 1, paper 5")] = None
    threshold: Annotated[float | None, arg("SCORE", "robust 0.5, GS-Checker 0.1")] = None
    mask_rule: Annotated[
        MaskRule | None,
        arg("share|attribute|per-view", "robust share, official per-view, paper attribute"),
    ] = None
