"""`gsc-jax render`: a PNG of the scene from each camera.

The cameras of an orbit are written, too. The next run replaces only the files in render.json.
"""

import dataclasses

import jax
import numpy as np

from gsc_jax.cli.options import Render
from gsc_jax.cli.outputs import planned_outputs, versions, write_json
from gsc_jax.cli.ownership import refuse_foreign, refuse_overlap
from gsc_jax.cli.scene_input import check_numbers, choose_cameras, read_scene
from gsc_jax.cli.staging import replacing
from gsc_jax.evidence.monitor import Monitor
from gsc_jax.io.cameras import camera_files, save_cameras
from gsc_jax.io.masks import image_path, write_image
from gsc_jax.scene import InputError
from gsc_jax.splat import render

REPORT = "render.json"
CAMERAS = "cameras.json"


def run_render(options: Render, *, monitor: Monitor) -> tuple[list[str], list[str]]:
    """Render a scene file from its cameras; return lines to print, and warnings."""
    warnings: list[str] = []
    check_numbers(options)
    if not all(0 <= channel <= 1 for channel in options.background):
        raise InputError(f"--background {options.background}: expected three numbers from 0 to 1")
    scene, cameras = read_scene(options, warnings, monitor)
    cameras = choose_cameras(options, scene, cameras, warnings)
    files = [options.scene, *(camera_files(options.cameras) if options.cameras else [])]
    reports = [REPORT] if options.cameras else [CAMERAS, REPORT]
    names = planned_outputs(cameras, reports, [""])
    for name in names[len(reports) :]:
        if name.partition("/")[0] in reports:
            raise InputError(f"camera of {name}: its name is that of a report; rename it")
    refuse_overlap(options.out, files, written=names)
    refuse_foreign(options.out, names, report=REPORT)
    gaussians = jax.device_put(scene.gaussians)
    with replacing(options.out, report=REPORT) as folder:
        if options.cameras is None:
            save_cameras(folder / CAMERAS, cameras)
        for camera in monitor.track("render", cameras, len(cameras)):
            image, _ = render(gaussians, camera, background=options.background, near=options.near)
            write_image(image_path(folder, camera.name), np.asarray(image))
        command = dataclasses.asdict(options)
        write_json(folder / REPORT, {"command": command, "versions": versions()})
    images = "1 image" if len(cameras) == 1 else f"{len(cameras)} images"
    return [f"{images} in {options.out}"], warnings
