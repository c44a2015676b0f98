"""The command `tamper`: a scene file in, an edited one with its exact truth out, to test with.

What it writes is what `locate` reads, and what its results can be compared with.
"""

import json
from collections.abc import Mapping, Sequence
from pathlib import Path

import jax
import numpy as np

from gsc_jax.app.options import Tamper
from gsc_jax.app.outputs import evenly, refuse_overlap, replacing
from gsc_jax.app.pictures import contact_sheet, overlay
from gsc_jax.app.run import check_look, chosen_cameras, load_scene
from gsc_jax.benchmark.metrics import truth_mask
from gsc_jax.benchmark.scenes import make_object
from gsc_jax.benchmark.simulate import REGIMES, decoy_labels, simulate
from gsc_jax.benchmark.tamper import Tampered, tamper
from gsc_jax.errors import InputError
from gsc_jax.io.cameras import save_cameras
from gsc_jax.io.files import atomic
from gsc_jax.io.masks import image_path, write_mask, write_probability
from gsc_jax.io.ply import load_ply, save_ply
from gsc_jax.scene import Camera, Gaussians
from gsc_jax.splat import render
from gsc_jax.stages import Progress, silent

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
    _check(options)
    scene, cameras = load_scene(options, warnings, progress)
    cameras = chosen_cameras(options, cameras, warnings) if options.views else cameras
    progress("edit", 0, 1)
    edited = tamper(
        scene.gaussians,
        cameras,
        options.edit,
        donor=_donor(options),
        size=options.size,
        seed=options.seed,
    )
    progress("edit", 1, 1)
    with replacing(options.out) as folder:
        _write(folder, options, scene.gaussians, edited, cameras, progress)
    return _story(options, edited), warnings


def _check(options: Tamper) -> None:
    """Refuses what could be seen before anything is read."""
    if options.object is not None and options.edit != "incorporation":
        raise InputError(f"--object: a {options.edit} pastes nothing, leave it out")
    if not 0 < options.size <= 0.5:
        raise InputError(f"--size {options.size:g}: expected a share of the pixels, 0 to 0.5")
    given = [options.scene, options.cameras, options.object]
    refuse_overlap(options.out, [path for path in given if path is not None], written=OUTPUTS)


def _donor(options: Tamper) -> Gaussians | None:
    if options.edit != "incorporation":
        return None
    return load_ply(options.object) if options.object else make_object(seed=options.seed)


def _write(
    folder: Path,
    options: Tamper,
    original: Gaussians,
    edited: Tampered,
    cameras: Sequence[Camera],
    progress: Progress,
) -> None:
    """The scene, the truth, the masks of a detector that errs, and a picture."""
    gaussians = jax.device_put(edited.gaussians)
    decoy = decoy_labels(edited.gaussians, edited.labels, seed=options.seed)
    truth, suspicious = [], []
    for done, camera in enumerate(cameras, start=1):
        truth.append(truth_mask(gaussians, camera, edited.labels))
        suspicious.append(truth_mask(gaussians, camera, decoy))
        progress("truth", done, len(cameras))
    write_scene(folder, edited.gaussians, cameras, edited.labels)
    names = [camera.name for camera in cameras]
    write_truth(folder / "truth", dict(zip(names, truth, strict=True)))
    if options.masks != "none":
        said = simulate(
            np.stack(truth),
            np.stack(suspicious),
            seed=options.seed,
            failures=REGIMES[options.masks],
        )
        write_said(folder / "masks", dict(zip(names, said, strict=True)))
    _write_account(folder / "edit.json", options, edited, names)
    _write_picture(folder / "overview.png", original, edited, cameras)


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


def _write_account(path: Path, options: Tamper, edited: Tampered, names: Sequence[str]) -> None:
    account = {
        "description": edited.description,
        "edit": edited.edit,
        "scene": str(options.scene),
        "object": str(options.object) if options.object else None,
        "size": options.size,
        "seed": options.seed,
        "masks": options.masks,
        "gaussians": len(edited.labels),
        "tampered": int(edited.labels.sum()),
        "visible": dict(zip(names, edited.visible.round(5).tolist(), strict=True)),
    }
    with atomic(path) as temporary:
        temporary.write_text(json.dumps(account, indent=2) + "\n")


def _write_picture(
    path: Path, original: Gaussians, edited: Tampered, cameras: Sequence[Camera]
) -> None:
    """Before, after and the truth, in the views that show most of the edit."""
    best = np.argsort(-edited.visible, kind="stable")
    shown = evenly([cameras[i] for i in best[: max(ROWS, len(best) // 2)]], ROWS)
    rows = []
    for camera in shown:
        before, after = (np.asarray(render(g, camera)[0]) for g in (original, edited.gaussians))
        marked = overlay(after, truth_mask(edited.gaussians, camera, edited.labels))
        rows.append([before, after, marked])
    names = [camera.name for camera in shown]
    contact_sheet(path, rows, titles=("before", "after", "tampered"), labels=names)


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
    return [
        *lines,
        f"find it  gsc-jax locate {out / 'scene.ply'} --cameras {out / 'cameras.json'} "
        f"--masks {out / 'masks'} --out found",
    ]
