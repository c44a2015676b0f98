"""The command `tamper`: a scene file in, an edited one with its exact truth out, to test with.

What it writes is what `locate` reads, and what its results can be compared with.
"""

import dataclasses
import json
import shlex
from collections.abc import Mapping, Sequence
from pathlib import Path

import jax
import numpy as np

from gsc_jax.benchmark.metrics import truth_mask
from gsc_jax.benchmark.pasting import extent
from gsc_jax.benchmark.scenes import make_object
from gsc_jax.benchmark.simulate import REGIMES, decoy_labels, simulate
from gsc_jax.benchmark.tamper import Tampered, tamper
from gsc_jax.cli.options import Tamper
from gsc_jax.cli.outputs import evenly, plain, versions
from gsc_jax.cli.pictures import contact_sheet, overlay
from gsc_jax.cli.scene_input import about, check_look, chosen_cameras, load_scene
from gsc_jax.cli.staging import files_below, refuse_overlap, replacing
from gsc_jax.evidence.monitor import Progress, silent
from gsc_jax.io.cameras import save_cameras
from gsc_jax.io.files import atomic
from gsc_jax.io.masks import image_path, write_mask, write_probability
from gsc_jax.io.ply import load_ply, save_ply
from gsc_jax.render.projection import NEAR
from gsc_jax.render.visibility import check_views
from gsc_jax.scene import Camera, Gaussians, InputError
from gsc_jax.splat import render

OUTPUTS = ("scene.ply", "cameras.json", "labels.npy", "masks", "truth")
ROWS = 4


def run_tamper(options: Tamper, *, progress: Progress = silent) -> tuple[list[str], list[str]]:
    """Edits a scene file and writes the result with its truth.

    Args:
        options: The arguments of the command line.
        progress: Called with (stage, done, total).

    Returns:
        What to print, line by line, and warnings.

    Raises:
        InputError: if an input is wrong, no place for the edit is found, or nothing can be written.
    """
    warnings: list[str] = []
    check_look(options)
    read = _check(options)
    scene, cameras = load_scene(options, warnings, progress)
    cameras = chosen_cameras(options, cameras, warnings) if options.views else cameras
    donor = _donor(options)
    leaves = {"report": "edit.json", "by_camera": ("masks", "truth")}
    with replacing(options.out, keep=read, **leaves) as folder:
        progress("edit", 0, 1)
        with about(options.cameras or options.scene):
            warnings += check_views(scene.gaussians, cameras, near=options.near)
        with about(options.scene):
            edited = tamper(
                scene.gaussians,
                cameras,
                options.edit,
                donor=donor,
                size=options.size,
                near=options.near,
                seed=options.seed,
            )
        progress("edit", 1, 1)
        if edited.labels.mean() > 0.5:
            share = f"{edited.labels.mean():.0%}"
            warnings.append(f"{share} of the Gaussians are tampered; the scene is small for this")
        _write(folder, options, scene.gaussians, edited, cameras, progress)
    return _story(options, edited), warnings


def _check(options: Tamper) -> list[Path]:
    """Refuses what can be seen before anything is read; the paths that will be read."""
    if options.object is not None and options.edit != "incorporation":
        raise InputError(f"--object: a {options.edit} pastes nothing, leave it out")
    if not 0 < options.size <= 0.5:
        raise InputError(
            f"--size {options.size:g}: expected a share of the pixels above 0, up to 0.5"
        )
    if (options.out / "result.json").exists():
        raise InputError(f"{options.out}: holds results of `locate`; give another --out")
    there = [name for name in OUTPUTS if (options.out / name).exists()]
    if there and not (options.out / "edit.json").exists():
        raise InputError(
            f"{options.out / there[0]}: is there, and no edit of ours; give another --out"
        )
    given = (options.scene, options.cameras, options.object)
    read = [path for path in given if path is not None]
    refuse_overlap(options.out, read, written=OUTPUTS)
    return read


def _donor(options: Tamper) -> Gaussians | None:
    if options.edit != "incorporation":
        return None
    if options.object is None:
        return make_object(seed=options.seed)
    donor = load_ply(options.object)
    try:
        extent(donor)
    except ValueError as error:
        raise InputError(f"{options.object}: {error}; expected a .ply of one thing") from error
    return donor


def _write(
    folder: Path,
    options: Tamper,
    original: Gaussians,
    edited: Tampered,
    cameras: Sequence[Camera],
    progress: Progress,
) -> None:
    """The scene, the truth, the masks of a detector that errs, and a picture."""
    gaussians, names = jax.device_put(edited.gaussians), [camera.name for camera in cameras]

    def masks(labels: np.ndarray, stage: str) -> np.ndarray:
        found = []
        for camera in cameras:
            found.append(truth_mask(gaussians, camera, labels, near=options.near))
            progress(stage, len(found), len(cameras))
        return np.stack(found)

    truth = masks(edited.labels, "truth")
    write_scene(folder, edited.gaussians, cameras, edited.labels)
    write_truth(folder / "truth", dict(zip(names, truth, strict=True)))
    if options.masks != "none":
        failures = REGIMES[options.masks]
        decoy = masks(_decoy(options, edited), "decoy") if failures.decoy else None
        said = simulate(truth, decoy, seed=options.seed, failures=failures)
        write_said(folder / "masks", dict(zip(names, said, strict=True)))
    _write_picture(folder / "overview.png", original, edited, cameras, options.near)
    _write_account(folder, options, edited, names)


def _decoy(options: Tamper, edited: Tampered) -> np.ndarray:
    """An authentic region that the detector takes for tampered."""
    try:
        return decoy_labels(edited.gaussians, edited.labels, seed=options.seed)
    except ValueError as error:
        raise InputError(
            f"{options.scene}: {error}, so no detector can be wrong about it; choose --masks clean"
        ) from error


def write_scene(
    folder: Path, gaussians: Gaussians, cameras: Sequence[Camera], labels: np.ndarray
) -> None:
    """Writes a scene and its cameras, which `locate` is given, and which Gaussians are tampered.

    Args:
        folder: Where to: scene.ply, cameras.json, labels.npy.
        gaussians: N Gaussians.
        cameras: The cameras.
        labels: True where tampered, shape (N,).
    """
    save_ply(folder / "scene.ply", gaussians)
    save_cameras(folder / "cameras.json", cameras)
    with atomic(folder / "labels.npy") as temporary:
        np.save(temporary, labels)


def write_truth(folder: Path, truth: Mapping[str, np.ndarray]) -> None:
    """Writes the tampered pixels of every view, black and white, named after its camera."""
    for name, mask in truth.items():
        write_mask(image_path(folder, name), mask)


def write_said(folder: Path, said: Mapping[str, np.ndarray]) -> None:
    """Writes what a detector says of every view, grey, named after its camera."""
    for name, probability in said.items():
        write_probability(image_path(folder, name), probability)


def _write_account(folder: Path, options: Tamper, edited: Tampered, names: Sequence[str]) -> None:
    account = {
        "description": edited.description,
        "command": dataclasses.asdict(options),
        "failures": None if options.masks == "none" else dataclasses.asdict(REGIMES[options.masks]),
        "gaussians": len(edited.labels),
        "tampered": int(edited.labels.sum()),
        "visible": dict(zip(names, edited.visible.round(5).tolist(), strict=True)),
        "versions": versions(),
        "outputs": [*files_below(folder), "edit.json"],
    }
    with atomic(folder / "edit.json") as temporary:
        temporary.write_text(json.dumps(plain(account), indent=2) + "\n", encoding="utf-8")


def _write_picture(
    path: Path, original: Gaussians, edited: Tampered, cameras: Sequence[Camera], near: float
) -> None:
    """Before, after and the truth, in the views that show most of the edit."""
    best = np.argsort(-edited.visible, kind="stable")
    shown = evenly([cameras[i] for i in best[: max(ROWS, len(best) // 2)]], ROWS)
    rows = []
    for camera in shown:
        scenes = original, edited.gaussians
        before, after = (np.asarray(render(s, camera, near=near)[0]) for s in scenes)
        truth = truth_mask(edited.gaussians, camera, edited.labels, near=near)
        marked = overlay(after, truth)
        rows.append([before, after, np.abs(after - before).mean(axis=-1), marked])
    names = [camera.name for camera in shown]
    contact_sheet(path, rows, titles=("before", "after", "difference", "tampered"), labels=names)


def _story(options: Tamper, edited: Tampered) -> list[str]:
    out = options.out
    lines = [
        edited.description,
        f"{int(edited.labels.sum()):,} of {len(edited.labels):,} Gaussians are tampered: "
        f"{out / 'labels.npy'}, and {out / 'truth'} by view",
        f"look at  {out / 'overview.png'}",
    ]
    if options.masks == "none":
        return lines
    found = out.with_name(f"{out.name}-found")
    command = ["gsc-jax", "locate", out / "scene.ply", "--cameras", out / "cameras.json"]
    command += ["--masks", out / "masks", "--out", found]
    command += ["--near", options.near] if options.near != NEAR else []
    return [*lines, f"find it  {shlex.join(map(str, command))}"]
