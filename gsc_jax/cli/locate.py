"""The commands `locate` and `render`: from files to files.

What can be wrong with the input is looked at first, what takes long comes after it. Both return
what a person should be told; only `gsc_jax.cli.main` prints.
"""

import contextlib
import dataclasses
from collections.abc import Iterator
from pathlib import Path

import jax
import numpy as np

from gsc_jax.cli.config_file import read_settings
from gsc_jax.cli.detector_choice import Asked, network_path, who_is_asked
from gsc_jax.cli.located import Located
from gsc_jax.cli.options import Locate, Render
from gsc_jax.cli.outputs import write_report, write_results
from gsc_jax.cli.scene_input import about, check_look, chosen_cameras, load_scene
from gsc_jax.cli.staging import refuse_overlap, replacing
from gsc_jax.evidence.monitor import Progress, Stages, silent
from gsc_jax.io.cameras import camera_files, save_cameras
from gsc_jax.io.masks import image_path, write_image
from gsc_jax.io.ply import PlyScene
from gsc_jax.locate import locate
from gsc_jax.render.visibility import check_views
from gsc_jax.scene import Camera, InputError
from gsc_jax.splat import render


@dataclasses.dataclass(frozen=True, kw_only=True)
class Plan:
    """A run of `locate` before its long part: what it is given is read and found to be right.

    Attributes:
        asked: Who is asked, and how.
        scene: The scene file.
        cameras: The views to look from.
        inputs: Files and folders that are read.
        warnings: What a user should know already.
    """

    asked: Asked
    scene: PlyScene
    cameras: list[Camera]
    inputs: list[Path]
    warnings: list[str]


def plan_locate(options: Locate, *, progress: Progress = silent) -> Plan:
    """Reads and checks all that a run of `locate` is given.

    Args:
        options: The arguments of the command line.
        progress: Called with (stage, done, total).

    Raises:
        InputError: if an input is wrong, or the folder of results is none for it.
    """
    check_look(options)
    if (options.out / "edit.json").exists():
        raise InputError(
            f"{options.out}: holds an edit of `tamper` and its truth; give another --out"
        )
    warnings = _left_out(options)
    asked = who_is_asked(options)
    network, spec = network_path(options), asked.options.spec
    inputs = [path for path in (options.scene, options.masks, network, spec) if path]
    inputs += camera_files(options.cameras) if options.cameras else []
    refuse_overlap(options.out, inputs)
    scene, cameras = load_scene(options, warnings, progress)
    if options.views:
        usable = asked.detector.select(cameras) if asked.detector else cameras
        cameras = chosen_cameras(options, usable, warnings)
    with about(options.cameras or options.scene):
        check_views(scene.gaussians, cameras, near=options.near)  # locate repeats its warnings
    return Plan(asked=asked, scene=scene, cameras=cameras, inputs=inputs, warnings=warnings)


def run_locate(options: Locate, *, progress: Progress = silent) -> Located:
    """Finds the tampered Gaussians of a scene file and writes the results.

    Args:
        options: The arguments of the command line.
        progress: Called with (stage, done, total).

    Returns:
        What was found, and the warnings and times of the whole run.

    Raises:
        InputError: if an input is wrong or the results cannot be written.
    """
    stages = Stages()
    with stages("load"):
        plan = plan_locate(options, progress=progress)
    asked, scene, cameras = plan.asked, plan.scene, plan.cameras
    with _telling_what_is_kept(asked), replacing(options.out, keep=plan.inputs) as folder:
        result = locate(
            scene.gaussians,
            cameras,
            asked.detector,
            config=asked.config,
            native=asked.native,
            progress=progress,
        )
        with stages("write"):
            write_results(folder, scene, cameras, result, progress=progress)
        own = stages.summary()
        located = Located(
            scene=scene,
            cameras=cameras,
            result=result,
            stages={"load": own["load"], **result.stages, "write": own["write"]},
            seconds=stages.elapsed(),
            warnings=[*plan.warnings, *result.warnings],
        )
        write_report(folder, dataclasses.asdict(asked.options), located, progress=progress)
    return dataclasses.replace(located, seconds=stages.elapsed())


def run_render(options: Render, *, progress: Progress = silent) -> tuple[int, list[str]]:
    """Renders a scene file from its cameras, into an image per camera.

    Args:
        options: The arguments of the command line.
        progress: Called with (stage, done, total).

    Returns:
        The number of images, and warnings.

    Raises:
        InputError: if an input is wrong or an image cannot be written.
    """
    warnings: list[str] = []
    check_look(options)
    if not all(0 <= channel <= 1 for channel in options.background):
        raise InputError(f"--background {options.background}: expected three numbers from 0 to 1")
    scene, cameras = load_scene(options, warnings, progress)
    cameras = chosen_cameras(options, cameras, warnings) if options.views else cameras
    with about(options.cameras or options.scene):
        warnings += check_views(scene.gaussians, cameras, near=options.near)
    if options.cameras is None:
        save_cameras(options.out / "cameras.json", cameras)
    gaussians = jax.device_put(scene.gaussians)
    for done, camera in enumerate(cameras, start=1):
        image, _ = render(gaussians, camera, background=options.background, near=options.near)
        write_image(image_path(options.out, camera.name), np.asarray(image))
        progress("render", done, len(cameras))
    return len(cameras), warnings


def _left_out(options: Locate) -> list[str]:
    """What of the --config is about another method than the one asked for."""
    if options.config is None or read_settings(options.config).method == options.method:
        return []
    other = read_settings(options.config).method
    return [
        f"{options.config}: is about the method {other}; what only that one understands was left "
        f"out, as --method says {options.method}"
    ]


@contextlib.contextmanager
def _telling_what_is_kept(asked: Asked) -> Iterator[None]:
    """Has an interruption say how many views the network need not be asked about again."""
    try:
        yield
    except KeyboardInterrupt as stop:
        judged = asked.network.judged if asked.network else 0
        if judged and not asked.options.no_cache:
            views = "view is" if judged == 1 else "views are"
            stop.add_note(
                f"what the network said of {judged} {views} kept, and the same command goes on "
                "from there"
            )
        raise
