"""How every command reads a scene: the file, the cameras, and what can be wrong with either."""

import contextlib
import math
from collections.abc import Iterator, Sequence
from pathlib import Path

from gsc_jax.cli.options import Look
from gsc_jax.cli.outputs import evenly
from gsc_jax.evidence.monitor import Progress
from gsc_jax.io.cameras import load_cameras
from gsc_jax.io.masks import image_path
from gsc_jax.io.ply import PlyScene, read_ply
from gsc_jax.render.orbit import orbit_cameras
from gsc_jax.scene import Camera, Gaussians, InputError

ORBIT_VIEWS = 24
MIN_SIDE, MAX_PIXELS = 8, 50_000_000


def check_look(options: Look) -> None:
    """Refuses numbers that mean nothing, before anything is read."""
    if options.views is not None and options.views < 1:
        raise InputError(f"--views {options.views}: expected at least one view")
    for flag, value in (("scale", options.scale), ("near", options.near)):
        if not (math.isfinite(value) and value > 0):
            raise InputError(f"--{flag} {value:g}: expected a positive number")
    if options.seed < 0:
        raise InputError(f"--seed {options.seed}: expected 0 or more")


def load_scene(
    options: Look, warnings: list[str], progress: Progress
) -> tuple[PlyScene, list[Camera]]:
    """The scene, and the cameras at their scale, whose names can name files."""
    progress("load", 0, 2)
    scene = read_ply(options.scene)
    if scene.dropped:
        warnings.append(f"{options.scene}: {scene.dropped_summary}")
    if "tamper" in {p.name for element in scene.ply.elements for p in element.properties}:
        warnings.append(f"{options.scene}: has a property tamper already; results replace it")
    progress("load", 1, 2)
    cameras = _cameras(options, scene.gaussians, warnings)
    with about(options.cameras or options.scene):
        _check_names(cameras)
    progress("load", 2, 2)
    return scene, cameras


def _cameras(options: Look, gaussians: Gaussians, warnings: list[str]) -> list[Camera]:
    if options.cameras is not None:
        cameras = load_cameras(options.cameras)
    else:
        count = options.views or ORBIT_VIEWS
        cameras = orbit_cameras(gaussians, count, seed=options.seed)
        warnings.append(
            f"no --cameras given: {count} cameras were placed around the scene, -y up, and written "
            "beside the results; those that the scene was trained with see it best"
        )
    scaled = [camera.scaled(options.scale) for camera in cameras]
    for camera in scaled:
        size = f"{camera.width} x {camera.height}"
        if min(camera.width, camera.height) < MIN_SIDE or camera.width * camera.height > MAX_PIXELS:
            raise InputError(
                f"--scale {options.scale:g}: camera {camera.name!r} would have {size} pixels, "
                f"expected sides of at least {MIN_SIDE} and at most {MAX_PIXELS:,} pixels in all"
            )
    return scaled


def chosen_cameras(options: Look, cameras: Sequence[Camera], warnings: list[str]) -> list[Camera]:
    """As many of the cameras as were asked for."""
    count = options.views or len(cameras)
    if count > len(cameras):
        warnings.append(
            f"--views {count}: only {len(cameras)} cameras can be used, all of them are"
        )
    return evenly(cameras, count)


def _check_names(cameras: Sequence[Camera]) -> None:
    """Refuses cameras whose pictures could not be told apart or named inside the folder."""
    names: dict[Path, str] = {}
    for camera in cameras:
        if camera.name != camera.name.encode(errors="replace").decode():  # lone surrogates
            raise InputError(
                f"camera {camera.name!r}: is no text, which masks and outputs go by; rename it"
            )
        path = image_path("masks", camera.name)
        if path in names:
            raise InputError(
                f"cameras {names[path]!r} and {camera.name!r} have one name but for the slashes, "
                "and masks and outputs go by it; rename one"
            )
        names[path] = camera.name


@contextlib.contextmanager
def about(path: Path) -> Iterator[None]:
    """Puts the file in question before the message of an InputError."""
    try:
        yield
    except InputError as error:
        raise InputError(f"{path}: {error}") from error
