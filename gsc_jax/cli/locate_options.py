"""Arguments of `gsc-jax locate`; the docstring is its help text."""

import dataclasses
from pathlib import Path
from typing import Annotated

from gsc_jax.cli.options import SceneOptions, Switch, arg
from gsc_jax.estimators import Method
from gsc_jax.evidence.masks import MaskRule


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
      smoothing = 3.0

    written to the folder of --out:
      report.html              start here
      overview.png             a few views side by side
      render/, overlay/        renders, and renders with the mask
      tamper.ply               the scene, plus the property tamper
      highlight.ply            tampered red, the rest grey
      labels.npy, tamper.npy   bool and score, by row of the scene
      masks/, detector/        final masks, and the detector's
      views.json               the cameras of the masks
      result.json              numbers, warnings, versions

    Attributes:
        config: Options from the result.json of an earlier run (or its folder), or from a TOML or
            JSON file as above. Command-line options override the file: --masks None unsets a
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
        MaskRule | None, arg("share|attribute|per-view", "robust share, GS-Checker attribute")
    ] = None
