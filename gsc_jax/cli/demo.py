"""`gsc-jax demo`: locate a pasted object in a generated scene, and compare with the truth.

All input and output goes through files and through the code of `gsc-jax locate`. The simulated
detector has all failures at once (`mixture`): single masks are then of little use.
"""

import functools
import sys
import textwrap
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import NamedTuple, get_args

import numpy as np

from gsc_jax.benchmark.metrics import Scores, confusion, mean_over_tampered_views, truth_mask
from gsc_jax.benchmark.scenes import MadeScene, tampered_room
from gsc_jax.benchmark.simulate import REGIMES, decoy_labels, simulate
from gsc_jax.cli.locate import run_locate
from gsc_jax.cli.options import Demo, Locate
from gsc_jax.cli.pictures import SHEET_ROWS, contact_sheet, overlay
from gsc_jax.cli.scene_input import evenly_spaced
from gsc_jax.cli.tamper import write_scene, write_views
from gsc_jax.estimators import Method
from gsc_jax.evidence.masks import view_mask
from gsc_jax.evidence.monitor import Monitor
from gsc_jax.io.cameras import save_cameras
from gsc_jax.io.masks import write_mask, write_probability
from gsc_jax.locate import Result
from gsc_jax.scene import Camera, InputError
from gsc_jax.splat import render

REGIME = "mixture"
HELDOUT = "heldout_cameras.json"  # the first file of the input that is written
ATTRIBUTES_ONLY = "native"
RUNS: dict[str, Method] = {ATTRIBUTES_ONLY: "robust", **{name: name for name in get_args(Method)}}
"""Runs by folder, each with its method; the first without masks."""
EXPLANATION = """\
robust estimates the reliability of every mask, and uses the attributes of the Gaussians. native
uses these alone, by a classifier that was trained on this room and such a vase (docs/results.md
has other scenes): it says where an edit would be, its report how likely there is one. GS-Checker
trusts all masks: official follows its released code, with one pass of optimisation after the
vote; paper makes five, in which every view without the vase in its mask counts ten times."""

Views = dict[str, np.ndarray]
"""An image or mask by camera name."""


class Case(NamedTuple):
    """A scene, and by camera, held-out cameras included, the truth and the detector's masks."""

    made: MadeScene
    truth: Views
    detector: Views

    def scores(self, masks: Views, cameras: Sequence[Camera]) -> Scores:
        """Mean scores of masks over the tampered views among some cameras."""
        names = [camera.name for camera in cameras]
        return mean_over_tampered_views([masks[n] for n in names], [self.truth[n] for n in names])


def run_demo(
    options: Demo, *, monitor: Monitor, made: MadeScene | None = None
) -> tuple[list[str], list[str]]:
    """Run all methods on a generated scene; return lines to print, and warnings (none)."""
    given = options.out / "input"
    for path in (given, options.out / "heldout.png"):
        if path.exists() and not (given / HELDOUT).exists():  # else from an interrupted demo
            raise InputError(f"{path}: exists and is not from `demo`; give another --out")
    made = made or tampered_room(seed=options.seed)
    case = _made_input(given, made, options.seed, monitor)
    results = {name: _locate(given, name, options, monitor) for name in RUNS}
    found: dict[str, Views] = {}
    for name, result in results.items():
        mask = functools.partial(view_mask, scored=result, rule=result.estimator.mask_rule)
        found[name] = {camera.name: mask(made.gaussians, camera) for camera in made.heldout_cameras}
    rows = {}
    for camera in evenly_spaced(made.heldout_cameras, SHEET_ROWS):
        image, views = np.asarray(render(made.gaussians, camera)[0]), [case.truth, *found.values()]
        rows[camera.name] = [image, *(overlay(image, masks[camera.name]) for masks in views)]
    contact_sheet(options.out / "heldout.png", rows, titles=("render", "truth", *found))
    return [
        *_introduction(case),
        "",
        *_table(case, results, found),
        "",
        *EXPLANATION.splitlines(),
        "",
        f"images   {options.out / 'heldout.png'}: the truth beside the masks of each method",
        *(f"report   {options.out / name / 'report.html'}" for name in RUNS),
        f"again    {sys.argv[0]} locate {given / 'scene.ply'} --cameras {given / 'cameras.json'} "
        f"--masks {given / 'masks'} --out found",
    ], []


def _made_input(folder: Path, made: MadeScene, seed: int, monitor: Monitor) -> Case:
    """Write a scene, its truth, and masks of a detector; held-out views get no mask."""
    decoy = decoy_labels(made.gaussians, made.labels, seed=seed)
    save_cameras(folder / HELDOUT, made.heldout_cameras)
    write_scene(folder, made.gaussians, made.cameras, made.labels)
    cameras, truth, decoys = [*made.cameras, *made.heldout_cameras], [], []
    for camera in monitor.track("make", cameras, len(cameras)):
        truth.append(truth_mask(made.gaussians, camera, made.labels))
        decoys.append(truth_mask(made.gaussians, camera, decoy))
    maps = simulate(np.stack(truth), np.stack(decoys), seed=seed, failures=REGIMES[REGIME])
    names = [camera.name for camera in cameras]
    case = Case(made, *(dict(zip(names, views, strict=True)) for views in (truth, maps)))
    masks = {camera.name: case.detector[camera.name] for camera in made.cameras}
    write_views(folder / "masks", masks, write_probability)
    write_views(folder / "truth", case.truth, write_mask)
    return case


def _locate(given: Path, name: str, options: Demo, monitor: Monitor) -> Result:
    scene, cameras, out = given / "scene.ply", given / "cameras.json", options.out / name
    masks = None if name == ATTRIBUTES_ONLY else given / "masks"
    command = Locate(
        scene=scene, cameras=cameras, masks=masks, out=out, method=RUNS[name], seed=options.seed
    )
    return run_locate(command, monitor=Monitor(progress=monitor.progress)).result


def _introduction(case: Case) -> list[str]:
    made, failures = case.made, REGIMES[REGIME]
    scores = case.scores(case.detector, made.cameras)
    return textwrap.wrap(
        f"A generated room of {len(made.labels):,} Gaussians, {made.labels.sum():,} of which are a "
        f"vase pasted onto the table; {len(made.cameras)} views, and {len(made.heldout_cameras)} "
        f"held out for the scores. The simulated detector ({REGIME}) misses the vase in "
        f"{failures.misses:.0%} of the views, flags an authentic object in {failures.decoy:.0%}, "
        f"inverts {failures.inverted:.0%}, and adds blobs and ragged edges: its masks have a mean "
        f"F1 of {scores.f1:.2f}, IoU {scores.iou:.2f}.",
        width=88,
    )


def _table(case: Case, results: Mapping[str, Result], found: Mapping[str, Views]) -> list[str]:
    """Scores of the labels, and of the masks of the held-out views; the detector has no labels."""
    titles = ("found", "precision", "recall", "F1", "views: F1", "IoU")
    lines = [f"{'Gaussians':20}" + "".join(f"{title:>11}" for title in titles)]
    for method, masks in {"detector alone": case.detector, **found}.items():
        means, cells = case.scores(masks, case.made.heldout_cameras), [""] * 4
        if method in results:
            score = confusion(labels := results[method].labels, case.made.labels)
            measures = (score.precision, score.recall, score.f1)
            cells = [f"{labels.sum():,}", *(f"{measure:.3f}" for measure in measures)]
        cells += [f"{means.f1:.3f}", f"{means.iou:.3f}"]
        lines.append(f"{method:20}" + "".join(f"{cell:>11}" for cell in cells))
    return lines
