"""`gsc-jax render`: a PNG of the scene from each camera."""

import jax
import numpy as np

from gsc_jax.cli.options import Render
from gsc_jax.cli.scene_input import check_numbers, choose_cameras, naming, read_scene
from gsc_jax.evidence.monitor import Monitor
from gsc_jax.io.cameras import save_cameras
from gsc_jax.io.masks import image_path, write_image
from gsc_jax.render.visibility import check_views
from gsc_jax.scene import InputError
from gsc_jax.splat import render


def run_render(options: Render, *, monitor: Monitor) -> tuple[list[str], list[str]]:
    """Render a scene file from its cameras; return lines to print, and warnings.

    Raises:
        InputError: if an input is invalid or an image cannot be written.
    """
    warnings: list[str] = []
    check_numbers(options)
    if not all(0 <= channel <= 1 for channel in options.background):
        raise InputError(f"--background {options.background}: expected three numbers from 0 to 1")
    scene, cameras = read_scene(options, warnings, monitor)
    cameras = choose_cameras(options, cameras, warnings)
    with naming(options.cameras or options.scene):
        warnings += check_views(scene.gaussians, cameras, near=options.near)
    if options.cameras is None:
        save_cameras(options.out / "cameras.json", cameras)
    gaussians = jax.device_put(scene.gaussians)
    for done, camera in enumerate(cameras, start=1):
        image, _ = render(gaussians, camera, background=options.background, near=options.near)
        write_image(image_path(options.out, camera.name), np.asarray(image))
        monitor.progress("render", done, len(cameras))
    images = "1 image" if len(cameras) == 1 else f"{len(cameras)} images"
    return [f"{images} in {options.out}"], warnings
