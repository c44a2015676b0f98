"""`gsc-jax tamper`: edit a scene file and write it with its truth, to test `locate`."""

import dataclasses
import shlex
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

import jax
import numpy as np

from gsc_jax.benchmark.incorporation import extent
from gsc_jax.benchmark.metrics import truth_mask
from gsc_jax.benchmark.scenes import make_object
from gsc_jax.benchmark.simulate import REGIMES, decoy_labels, simulate
from gsc_jax.benchmark.tamper import Edit, Tampered, tamper
from gsc_jax.cli.options import Tamper
from gsc_jax.cli.outputs import planned_outputs, save_array, versions, write_json
from gsc_jax.cli.ownership import refuse_foreign, refuse_overlap
from gsc_jax.cli.pictures import SHEET_ROWS, contact_sheet, overlay
from gsc_jax.cli.scene_input import check_numbers, choose_cameras, evenly_spaced, read_scene
from gsc_jax.cli.staging import replacing
from gsc_jax.evidence.monitor import Monitor
from gsc_jax.io.cameras import camera_files, save_cameras
from gsc_jax.io.files import memory_limit
from gsc_jax.io.masks import image_path, write_mask, write_probability
from gsc_jax.io.ply import load_ply, save_ply
from gsc_jax.io.validation import naming
from gsc_jax.render.projection import NEAR
from gsc_jax.scene import Camera, Gaussians, InputError
from gsc_jax.splat import render

REPORT = "edit.json"
FILES = ("scene.ply", "cameras.json", "labels.npy", "overview.png", REPORT)
BY_CAMERA = ("masks", "truth")
"""Folders with a picture per camera."""


def run_tamper(options: Tamper, *, monitor: Monitor) -> tuple[list[str], list[str]]:
    """Edit a scene file and write it with its truth; return lines to print, and warnings."""
    warnings: list[str] = []
    check_numbers(options)
    _check(options)
    scene, cameras = read_scene(options, warnings, monitor)
    cameras = choose_cameras(options, scene, cameras, warnings)
    folders = ("truth",) if options.masks == "none" else BY_CAMERA
    refuse_foreign(options.out, planned_outputs(cameras, FILES, folders), report=REPORT)
    edit = _edit(options)
    numbers = {name: getattr(options, name) for name in ("size", "near", "seed")}
    with replacing(options.out, report=REPORT) as folder:
        monitor.progress("edit", 0, 1)
        with naming(options.scene):
            edited = tamper(scene.gaussians, cameras, edit, **numbers)
        monitor.progress("edit", 1, 1)
        _write(folder, options, edited, cameras, monitor)
        _write_overview(folder / "overview.png", scene.gaussians, edited, cameras, options.near)
        failures = None if options.masks == "none" else dataclasses.asdict(REGIMES[options.masks])
        shares = zip([camera.name for camera in cameras], edited.visible, strict=True)
        description = {
            "description": edited.description,
            "command": dataclasses.asdict(options),
            "failures": failures,
            "gaussians": len(edited.labels),
            "tampered": int(edited.labels.sum()),
            "visible": {name: round(float(share), 5) for name, share in shares},
            "versions": versions(),
        }
        write_json(folder / REPORT, description)
    return _lines(options, edited), warnings


def _check(options: Tamper) -> None:
    """Refuse invalid options before anything is read."""
    if options.object is not None and options.edit != "incorporation":
        raise InputError(f"--object: a {options.edit} pastes nothing; leave it out")
    if not 0 < options.size <= 0.5:
        raise InputError(f"--size {options.size:g}: expected a share above 0, up to 0.5")
    if (options.out / "result.json").exists():
        raise InputError(f"{options.out}: holds results of `locate`; give another --out")
    files = [options.scene, *([options.object] if options.object else [])]
    files += camera_files(options.cameras) if options.cameras else []
    refuse_overlap(options.out, files, written=(*FILES, *BY_CAMERA))


def _edit(options: Tamper) -> Edit | Gaussians:
    """The kind of edit; for an incorporation, the object that is pasted."""
    if options.edit != "incorporation":
        return options.edit
    if options.object is None:
        return make_object(seed=options.seed)
    donor = load_ply(options.object, max_bytes=memory_limit(options.memory))
    with naming(options.object, errors=ValueError, remedy="; expected a .ply of one object"):
        extent(donor)
    return donor


def _write(
    folder: Path, options: Tamper, edited: Tampered, cameras: Sequence[Camera], monitor: Monitor
) -> None:
    """Write the scene, the truth and the masks of the simulated detector."""
    gaussians = jax.device_put(edited.gaussians)
    largest = max(c.height for c in cameras), max(c.width for c in cameras)

    def masks(labels: np.ndarray, stage: str) -> np.ndarray:
        stacked = np.zeros((len(cameras), *largest), bool)  # views of any size, at the top left
        for mask, c in zip(stacked, monitor.track(stage, cameras, len(cameras)), strict=True):
            mask[: c.height, : c.width] = truth_mask(gaussians, c, labels, near=options.near)
        return stacked

    def by_name(stacked: np.ndarray) -> dict[str, np.ndarray]:
        return {c.name: m[: c.height, : c.width] for c, m in zip(cameras, stacked, strict=True)}

    truth = masks(edited.labels, "truth")
    write_scene(folder, edited.gaussians, cameras, edited.labels)
    write_views(folder / "truth", by_name(truth), write_mask)
    if options.masks != "none":
        failures, decoy = REGIMES[options.masks], None
        if failures.decoy:
            with naming(options.scene, errors=ValueError, remedy="; choose --masks clean"):
                labels = decoy_labels(edited.gaussians, edited.labels, seed=options.seed)
            decoy = masks(labels, "decoy")
        maps = simulate(truth, decoy, seed=options.seed, failures=failures)
        write_views(folder / "masks", by_name(maps), write_probability)


def write_scene(
    folder: Path, gaussians: Gaussians, cameras: Sequence[Camera], labels: np.ndarray
) -> None:
    """Write scene.ply, cameras.json and labels.npy (N bool, true where tampered)."""
    save_ply(folder / "scene.ply", gaussians)
    save_cameras(folder / "cameras.json", cameras)
    save_array(folder / "labels.npy", labels)


def write_views(
    folder: Path, images: Mapping[str, np.ndarray], write: Callable[[Path, np.ndarray], None]
) -> None:
    """Write an image for every camera, named after it."""
    for name, image in images.items():
        write(image_path(folder, name), image)


def _write_overview(
    path: Path, original: Gaussians, edited: Tampered, cameras: Sequence[Camera], near: float
) -> None:
    """Scene before and after, difference and truth, in the views that show most of the edit."""
    best = np.argsort(-edited.visible, kind="stable")
    count, rows = max(SHEET_ROWS, len(best) // 2), {}
    for camera in evenly_spaced([cameras[i] for i in best[:count]], SHEET_ROWS):
        scenes = original, edited.gaussians
        before, after = (np.asarray(render(s, camera, near=near)[0]) for s in scenes)
        truth = truth_mask(edited.gaussians, camera, edited.labels, near=near)
        difference = np.abs(after - before).mean(axis=-1)
        rows[camera.name] = [before, after, difference, overlay(after, truth)]
    contact_sheet(path, rows, titles=("before", "after", "difference", "tampered"))


def _lines(options: Tamper, edited: Tampered) -> list[str]:
    out = options.out
    lines = [
        edited.description,
        f"{int(edited.labels.sum()):,} of {len(edited.labels):,} Gaussians are tampered: "
        f"{out / 'labels.npy'}, by view {out / 'truth'}",
        f"images   {out / 'overview.png'}",
    ]
    if options.masks == "none":
        return lines
    command = ["gsc-jax", "locate", out / "scene.ply", "--cameras", out / "cameras.json"]
    command += ["--masks", out / "masks", "--out", out.with_name(f"{out.name}-found")]
    command += ["--near", options.near] if options.near != NEAR else []
    return [*lines, f"find it  {shlex.join(map(str, command))}"]
