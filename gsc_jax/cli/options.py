"""The arguments of the commands, as frozen dataclasses: tyro makes flags and help texts of them.

The docstrings are what `--help` prints, so they speak to whoever types the command. The fields go
into result.json as they are.
"""

import dataclasses
from collections.abc import Callable
from pathlib import Path
from typing import Annotated, Literal

import tyro

from gsc_jax.benchmark.tamper import Edit
from gsc_jax.estimators.gschecker import Method
from gsc_jax.evidence.masks import MaskRule
from gsc_jax.render.projection import NEAR

_arg = tyro.conf.arg


def _otherwise(what: str) -> Callable[[str], str]:
    """What `--help` says of a default: in words where it is nothing, else as --config has it."""

    def hint(value: str) -> str:
        said = what if value in ("None", "False", "") else value
        return f"(default: {said})" if said else ""

    return hint


_Switch = Annotated[bool, _arg(help_behavior_hint=_otherwise(""))]
Regime = Literal[
    "none", "clean", "boundary", "misses", "blobs", "consistent", "inverted", "mixture"
]
"""The regimes of `gsc_jax.benchmark.simulate`, and none."""


@dataclasses.dataclass(frozen=True, kw_only=True)
class Look:
    """Which scene, and from where: what all commands that look at one share."""

    scene: Annotated[tyro.conf.Positional[Path], _arg(metavar="SCENE.ply")]
    out: Annotated[Path, _arg(metavar="DIR")]
    cameras: Annotated[
        Path | None, _arg(metavar="FILE_OR_DIR", help_behavior_hint=_otherwise("an orbit"))
    ] = None
    views: Annotated[int | None, _arg(metavar="N", help_behavior_hint=_otherwise("all"))] = None
    scale: Annotated[float, _arg(metavar="S")] = 1.0
    near: Annotated[float, _arg(metavar="DEPTH")] = NEAR
    seed: Annotated[int, _arg(metavar="K")] = 0
    no_cache: _Switch = False


@dataclasses.dataclass(frozen=True, kw_only=True)
class Locate(Look):
    r"""Find the tampered Gaussians of a scene.

    Asks the Gaussians themselves, and no one else unless told to: their attributes, against those
    around them, often give an edit away. A 2D detector adds what it sees in the views: it is shown
    them, or the masks are read that it wrote. A mask is grey: black is authentic, white is
    tampered, and it is named after its camera.

    for example:
      gsc-jax locate scene.ply --out found
      gsc-jax locate scene.ply --masks masks --out found \
              --cameras cameras.json
      gsc-jax locate scene.ply --cameras sparse/0 --out found \
              --detector native net.onnx --preset iml-vit

    how long it would take, and the same run again with another threshold:
      gsc-jax locate scene.ply --out found --dry-run
      gsc-jax locate --config found/result.json --threshold 0.7 \
              --out stricter

    a file for --config, to write by hand; any line may be left out:
      [command]                # these options, - written as _
      scene = "scene.ply"
      all_views = true
      [config]                 # what has no option: fields of
      classes = [4, 8, 12]     # RobustConfig, or MethodConfig
      smoothing = 3.0

    written into the folder of --out:
      report.html              start here
      overview.png             a few views side by side
      render/, overlay/        each as it is, and marked
      tamper.ply               the scene, plus a property tamper
      highlight.ply            tampered red, the rest grey
      labels.npy, tamper.npy   bool and score, by row of the scene
      masks/, detector/        final masks, and the detector's
      views.json               the cameras looked from
      result.json              numbers, warnings, versions

    Attributes:
        scene: The scene: a 3DGS .ply of any exporter; with the extra `formats` also compressed.ply,
            spz and sog.
        out: Folder for the results, made where missing. What an earlier run wrote there is
            replaced when this one has succeeded; one that is interrupted changes nothing.
        cameras: cameras.json, transforms.json, a COLMAP model (extra `colmap`), or a folder that
            holds one of them. Without, cameras are placed around the scene.
        config: The options, from the result.json of an earlier run (or its folder), or from a .toml
            or .json as above. What is typed goes before it; a value of it is taken back by None, as
            in --masks None, a switch by --no-, as in --no-all-views. Its paths are those that could
            be typed: relative to where you are, not to the file.
        dry_run: Check all that is given, measure a few views, and say what would be done, how long
            it would take and how much memory. Writes nothing into --out.
        masks: Folder with a mask per camera: CAMERA.png.
        detector: Whom to ask besides --masks, and no one else: `native`, the Gaussians themselves,
            their attributes and exact traces of editing, to whom only `robust` listens; MODEL.onnx,
            a 2D network, or a folder with the encoder.onnx and decoder.onnx of SAFIRE, which is
            shown the rendered views; both; or `none`.
        preset: How to feed and read the model: iml-vit, trufor, mvss-net or pscc-net.
        spec: The same as a TOML file with the fields of `OnnxSpec`, for other models. A MODEL.toml
            beside MODEL.onnx need not be named, unless there is a --preset.
        provider: What the model runs on, an execution provider of onnxruntime, such as cuda; the
            CPU does what it cannot.
        threads: Threads of the model on the CPU.
        method: `robust`: asks what the mask of each view is worth. GS-Checker believes all views
            alike: `official` is the schedule of its released code, `paper` its equations as
            printed, over several epochs.
        all_views: Show a --detector the views of all cameras; otherwise `robust` stops when further
            ones no longer change the labels, unless --views says how many it shall be.
        lambda2: Of official and paper: price of a Gaussian's weight outside the masks; at 10 it has
            to lie inside them by 91 %, at 1 by half. Smaller finds more where masks miss or
            disagree.
        epochs: Of official and paper: how often the optimisation looks at each view.
        threshold: Above which a Gaussian is tampered: of `robust` a probability, of GS-Checker a
            score relative to the highest.
        mask_rule: What makes a pixel tampered: share, that tampered Gaussians have the larger part
            in it; attribute, that the rendered score exceeds the threshold; per-view, the released
            code's rule, which takes every view by itself.
        views: Look from this many cameras only, evenly spread over those that can be used. Of an
            orbit, this many are made, by default 24.
        scale: Size of the views relative to the cameras' images; 0.5 has a quarter of the pixels.
        near: Near plane in world units: what is closer to a camera is not seen.
        seed: What chance follows: where the estimator starts, the order of the views, and where an
            orbit begins.
        no_cache: Do not keep what XLA compiles and what the model says of each view in the cache
            folder of this user, where the next run finds them, and do not look for them there.
    """

    config: Annotated[Path | None, _arg(metavar="FILE", help_behavior_hint=_otherwise(""))] = None
    dry_run: _Switch = False
    masks: Annotated[Path | None, _arg(metavar="DIR", help_behavior_hint=_otherwise("none"))] = None
    detector: Annotated[
        tuple[Path, ...],
        _arg(metavar="none|native|MODEL.onnx ...", help_behavior_hint=_otherwise("native")),
    ] = ()
    preset: Annotated[
        str | None, _arg(metavar="NAME", help_behavior_hint=_otherwise("RGB in [0, 1]"))
    ] = None
    spec: Annotated[
        Path | None, _arg(metavar="FILE.toml", help_behavior_hint=_otherwise("beside the model"))
    ] = None
    provider: Annotated[str | None, _arg(metavar="NAME", help_behavior_hint=_otherwise("cpu"))] = (
        None
    )
    threads: Annotated[
        int | None, _arg(metavar="N", help_behavior_hint=_otherwise("all cores"))
    ] = None
    method: Method = "robust"
    all_views: _Switch = False
    lambda2: Annotated[float | None, _arg(metavar="PRICE", help_behavior_hint=_otherwise("10"))] = (
        None
    )
    epochs: Annotated[
        int | None, _arg(metavar="N", help_behavior_hint=_otherwise("official 1, paper 5"))
    ] = None
    threshold: Annotated[
        float | None,
        _arg(metavar="SCORE", help_behavior_hint=_otherwise("robust 0.5, GS-Checker 0.1")),
    ] = None
    mask_rule: Annotated[
        MaskRule | None,
        _arg(
            metavar="share|attribute|per-view",
            help_behavior_hint=_otherwise("robust share, GS-Checker attribute"),
        ),
    ] = None


@dataclasses.dataclass(frozen=True, kw_only=True)
class Render(Look):
    """Render a scene from its cameras: one PNG per camera, named after it.

    To look at a scene, or to show it to a detector of your own, whose masks `locate` then reads.

    for example:
      gsc-jax render scene.ply --cameras cameras.json --out views
      gsc-jax render scene.ply --out views --background 1 1 1

    Attributes:
        scene: The scene: a 3DGS .ply of any exporter; with the extra `formats` also compressed.ply,
            spz and sog.
        out: Folder for the images, made where missing.
        cameras: cameras.json, transforms.json, a COLMAP model (extra `colmap`), or a folder that
            holds one of them. Without, cameras are placed around the scene and written to
            DIR/cameras.json.
        background: Colour behind the scene, red, green and blue from 0 to 1.
        views: Render this many cameras only, evenly spread. Of an orbit, this many are made, by
            default 24.
        scale: Size of the images relative to the cameras' own.
        near: Near plane in world units: what is closer to a camera is not seen.
        seed: Where an orbit begins.
        no_cache: Do not keep what XLA compiles in the cache folder of this user, where the next run
            finds it.
    """

    background: tuple[float, float, float] = (0.0, 0.0, 0.0)


@dataclasses.dataclass(frozen=True, kw_only=True)
class Tamper(Look):
    r"""Edit a scene, to test with: the truth is known for every Gaussian and every pixel.

    An incorporation stands an object into the scene, a modification changes a region in colour,
    texture, size or shape, a removal takes a region away and closes the hole. The edit happens
    where the cameras look, and the rows of the file are shuffled. It is an edit of what is seen: a
    file can still tell, for instance by the precision of its numbers.

    for example:
      gsc-jax tamper scene.ply --cameras cameras.json --edit removal \
              --out edited
      gsc-jax tamper scene.ply --object statue.ply --out edited

    written into the folder of --out:
      overview.png             before, after, and what is tampered
      scene.ply, cameras.json  what `locate` is given, and
      masks/                   what a simulated detector says
      labels.npy, truth/       the truth, by row and by view
      edit.json                what was done, in words and numbers

    Attributes:
        scene: The scene: a 3DGS .ply of any exporter; with the extra `formats` also compressed.ply,
            spz and sog.
        out: Folder for the results, made where missing.
        edit: What is done: incorporation, modification or removal.
        object: The object to stand into the scene: a .ply of nothing else, upright with -y up, of
            any place and size. By default a made vase.
        size: Share of the pixels that the edit is to cover, in the median of the views that see
            it.
        masks: What the simulated detector does wrong: nothing (clean), one thing (boundary,
            misses, blobs, consistent, inverted) or everything (mixture), at the strengths of
            docs/results.md, not calibrated per edit; none writes no masks.
        cameras: cameras.json, transforms.json, a COLMAP model (extra `colmap`), or a folder that
            holds one of them. Without, cameras are placed around the scene.
        views: Use this many cameras only, evenly spread. Of an orbit, this many are made, by
            default 24.
        scale: Size of the views relative to the cameras' images.
        near: Near plane in world units: what is closer to a camera is not seen.
        seed: What chance follows: the place and kind of the edit, the detector's mistakes.
        no_cache: Do not keep what XLA compiles in the cache folder of this user, where the next run
            finds it.
    """

    edit: Edit = "incorporation"
    object: Annotated[
        Path | None, _arg(metavar="OBJECT.ply", help_behavior_hint=_otherwise("a vase"))
    ] = None
    size: Annotated[float, _arg(metavar="SHARE")] = 0.05
    masks: Regime = "mixture"


@dataclasses.dataclass(frozen=True, kw_only=True)
class Demo:
    """Make a scene, tamper with it, find what was tampered, and compare with the truth.

    Nothing is downloaded: a furnished room with a vase pasted onto its table, and the masks of a
    simulated detector that errs as the real ones do.

    for example:
      gsc-jax demo --out demo

    Attributes:
        out: Folder for the scene, the masks and the results, made where missing.
        seed: What chance follows: the room, the cameras, the mistakes of the detector.
        no_cache: Do not keep what XLA compiles in the cache folder of this user, where the next run
            finds it.
    """

    out: Annotated[Path, _arg(metavar="DIR")]
    seed: Annotated[int, _arg(metavar="K")] = 0
    no_cache: _Switch = False


@dataclasses.dataclass(frozen=True, kw_only=True)
class View:
    """Look at the results of `locate` in 3D, in a browser. Needs the extra `viewer`.

    The scene in its own colours, as a heat map of the scores, or the tampered Gaussians alone, with
    a slider for the threshold and a jump to each camera.

    for example:
      gsc-jax view found
      gsc-jax view found --html found.html --most 200000

    Attributes:
        folder: Folder with the results of `locate`.
        html: Write a page that needs no server into this file, instead of serving one.
        port: Port to serve the page at.
        host: Address to serve the page at: `localhost` for this machine only, 0.0.0.0 for whoever
            can reach it.
        most: Most Gaussians to show: the tampered ones, and of the others those of largest opacity
            times area; a browser has its limits.
        no_browser: Do not open the page in a browser, only say where it is.
    """

    folder: Annotated[tyro.conf.Positional[Path], _arg(metavar="DIR")]
    html: Annotated[
        Path | None, _arg(metavar="FILE.html", help_behavior_hint=_otherwise("serve it"))
    ] = None
    port: Annotated[int, _arg(metavar="PORT")] = 8080
    host: Annotated[str, _arg(metavar="HOST")] = "localhost"
    most: Annotated[int, _arg(metavar="N")] = 500_000
    no_browser: _Switch = False


@dataclasses.dataclass(frozen=True, kw_only=True)
class Evaluate:
    """Compare the results of `locate` with the truth: by Gaussian, by view, or both.

    The masks of the 2D detector are compared with the same truth, where there were any, to see what
    lifting them to the Gaussians gained.

    for example:
      gsc-jax evaluate found --truth edited/labels.npy edited/truth

    Attributes:
        folder: Folder with the results of `locate`.
        truth: What is tampered: labels.npy, bool by row of the scene that `locate` was given; a
            folder with a mask per camera, CAMERA.png; or both, as `gsc-jax tamper` writes them.
        out: The file for the scores.
    """

    folder: Annotated[tyro.conf.Positional[Path], _arg(metavar="DIR")]
    truth: Annotated[tuple[Path, ...], _arg(metavar="labels.npy|MASKS ...")]
    out: Annotated[
        Path | None,
        _arg(metavar="FILE.json", help_behavior_hint=_otherwise("DIR/evaluation.json")),
    ] = None
