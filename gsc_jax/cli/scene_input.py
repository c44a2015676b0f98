"""Reading and checking the scene and the cameras, as all commands do."""

import math
from collections.abc import Sequence
from pathlib import PurePath

from gsc_jax.cli.options import SceneOptions
from gsc_jax.cli.ownership import UNFINISHED
from gsc_jax.evidence.monitor import Monitor
from gsc_jax.io.cameras import load_cameras
from gsc_jax.io.files import memory_limit
from gsc_jax.io.masks import image_path
from gsc_jax.io.ply import PlyScene, read_ply
from gsc_jax.io.validation import naming
from gsc_jax.render.interior import moved_indoors
from gsc_jax.render.orbit import FOV_DEGREES, opaque_means, orbit_cameras, scene_extent
from gsc_jax.render.up import estimated_up, parse_up, up_text
from gsc_jax.render.visibility import check_views, storage_warnings
from gsc_jax.scene import Camera, InputError
from gsc_jax.scene.gaussians import MAX_MAGNITUDE

ORBIT_VIEWS, PREVIEW_VIEWS = 24, 12
"""Number of cameras on an orbit: one every 15 degrees, or 30 where views only show a result."""
Y_UP_FORMAT, Z_UP_COMMENT = ".glb", "Vertical Axis: z"
"""The vertical of all glTF is +y; nerfstudio writes a comment. Brush calls any vertical "y"."""
MAX_WIDTH = 1600
"""Width to which INRIA's trainer scales wider images, so that models have no finer detail."""
MIN_SIDE_PIXELS, MAX_PIXELS = 8, 50_000_000
"""Limits of image sizes; beyond them, the camera or --scale is most likely a typing error."""


def check_numbers(options: SceneOptions) -> None:
    """Refuse numbers outside their range before anything is read."""
    if options.views is not None and options.views < 1:
        raise InputError(f"--views {options.views}: expected at least one view")
    memory_limit(options.memory)
    for flag, value in {"scale": options.scale, "near": options.near}.items():
        if value is not None and not (math.isfinite(value) and value > 0):
            raise InputError(f"--{flag} {value:g}: expected a positive number")
    if options.seed < 0:
        raise InputError(f"--seed {options.seed}: expected 0 or more")
    if options.up is not None and options.cameras is not None:
        raise InputError("--up: is for an orbit, which --cameras replaces; leave out one of them")
    if options.up is not None:
        parse_up(options.up)


def read_scene(
    options: SceneOptions, warnings: list[str], monitor: Monitor, *, placed: int = ORBIT_VIEWS
) -> tuple[PlyScene, list[Camera]]:
    """Read the scene file and the cameras, scaled and with names that can name files.

    Without --cameras and --views, that many cameras are `placed`; with 0, there are none.
    """
    monitor.progress("load", 0, 2)
    scene = read_ply(options.scene, max_bytes=memory_limit(options.memory))
    if scene.dropped:
        warnings.append(f"{options.scene}: {scene.dropped_summary}")
    if "tamper" in {p.name for element in scene.ply.elements for p in element.properties}:
        warnings.append(f"{options.scene}: already has a property tamper, which is replaced")
    monitor.progress("load", 1, 2)
    cameras = _read_cameras(options, scene, warnings, placed and (options.views or placed))
    with naming(options.cameras or options.scene):
        check_names(cameras)
    monitor.progress("load", 2, 2)
    return scene, cameras


def _read_cameras(
    options: SceneOptions, scene: PlyScene, warnings: list[str], count: int
) -> list[Camera]:
    gaussians = scene.gaussians
    if options.cameras is not None:
        cameras = load_cameras(options.cameras, max_bytes=memory_limit(options.memory))
    elif count == 0:
        return []
    else:
        y_up = options.scene.is_file() and options.scene.suffix.lower() == Y_UP_FORMAT
        stated = "y" if y_up else "z" if Z_UP_COMMENT in scene.ply.comments else None
        known = options.up or stated
        up = parse_up(known) if known else estimated_up(gaussians)
        # The near plane would cut a small scene away: it is seen from afar, in a narrower view.
        fov = max(60 * min(1, scene_extent(gaussians)[1] / (0.75 * options.near)), FOV_DEGREES[0])
        orbit = orbit_cameras(gaussians, count, fov_degrees=fov, up=up, seed=options.seed)
        if abs(orbit[0].viewmat).max() > MAX_MAGNITUDE:  # before any work: they are written last
            raise InputError(f"{options.scene}: too large to place cameras around; scale it down")
        indoors = moved_indoors(gaussians, orbit, up)
        cameras, place = indoors or orbit, "in and around the room" if indoors else "on an orbit"
        warnings.append(
            f"no --cameras given: {count} cameras were placed {place}, with {up_text(up)} as the "
            "up direction (--up), and written beside the results; the training cameras show more"
        )
    stored = [camera.scaled(options.scale or 1.0) for camera in cameras]
    scaled = stored if options.scale else [c.scaled(min(1, MAX_WIDTH / c.width)) for c in stored]
    for camera in (*stored, *scaled):
        pixels, side = camera.width * camera.height, min(camera.width, camera.height)
        if side < MIN_SIDE_PIXELS or pixels > MAX_PIXELS:
            raise InputError(
                f"{options.cameras or options.scene}: camera {camera.name!r} has {camera.width} x "
                f"{camera.height} pixels at --scale {options.scale or 1:g}, expected sides of at "
                f"least {MIN_SIDE_PIXELS} and at most {MAX_PIXELS:,} pixels; correct the size, or "
                "choose another scale"
            )
    if options.scale is None and (wide := sum(c.width > MAX_WIDTH for c in stored)):
        text = f"{wide} of {len(cameras)} cameras are scaled down to a width of {MAX_WIDTH} pixels"
        warnings.append(f"{text}, as by INRIA's trainer; --scale 1 keeps their size")
    return scaled


def choose_cameras(
    options: SceneOptions, scene: PlyScene, cameras: Sequence[Camera], warnings: list[str]
) -> list[Camera]:
    """The --views of the cameras, evenly spaced, or all of them; refused if they see no scene."""
    if not cameras:  # none were placed, so that only the scene is checked
        warnings += storage_warnings(scene.gaussians, opaque_means(scene.gaussians)).values()
        return []
    count = options.views or len(cameras)
    if count > len(cameras):
        warnings.append(f"--views {count}: there are only {len(cameras)} usable cameras")
    chosen = evenly_spaced(cameras, count)
    with naming(options.cameras or options.scene):
        warnings += check_views(scene.gaussians, chosen, near=options.near)
    return chosen


def evenly_spaced(cameras: Sequence[Camera], count: int) -> list[Camera]:
    """At most `count` cameras, evenly spaced in their order.

    The last camera is left out: on a closed path it is next to the first.
    """
    count = min(count, len(cameras))
    return [cameras[i * len(cameras) // count] for i in range(count)]


def check_names(cameras: Sequence[Camera]) -> None:
    """Refuse names of cameras that cannot name files, or name one file, or a file as a folder."""
    names: dict[PurePath, str] = {}
    for name in (camera.name for camera in cameras):
        path = image_path("masks", name)
        if UNFINISHED in path.parts:
            raise InputError(f"camera {name!r}: the name {UNFINISHED} is reserved; rename it")
        if path in names:
            raise InputError(f"{names[path]!r} and {name!r} differ only in slashes; rename one")
        names[path] = name
    names |= {path.with_suffix(".jpg"): name for path, name in names.items()}
    for path, name in names.items():
        if folder := next((place for place in path.parents if place in names), None):
            raise InputError(
                f"cameras {names[folder]!r} and {name!r}: {folder.name!r} would be a file and a "
                "folder; rename one"
            )
