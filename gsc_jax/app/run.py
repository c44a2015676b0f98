"""The commands `locate` and `render`: from files to files; and how every command reads a scene.

What can be wrong with the input is looked at first, what takes long comes after it. Both return
what a person should be told; only `gsc_jax.app.cli` prints.
"""

import contextlib
import dataclasses
import math
from collections.abc import Iterator, Sequence
from pathlib import Path

import jax
import numpy as np

from gsc_jax.app.cache import default_cache
from gsc_jax.app.options import Locate, Look, Render
from gsc_jax.app.outputs import Located, evenly, write_report, write_results
from gsc_jax.app.publish import refuse_overlap, replacing
from gsc_jax.detection import Detector
from gsc_jax.detectors.cached import CachedDetector
from gsc_jax.detectors.folder import FolderDetector
from gsc_jax.detectors.onnx import OnnxDetector
from gsc_jax.detectors.onnx_spec import PLAIN, PRESETS, OnnxSpec, preset, read_spec, spec_beside
from gsc_jax.detectors.safire import SafireDetector
from gsc_jax.errors import InputError
from gsc_jax.io.cameras import load_cameras, save_cameras
from gsc_jax.io.masks import image_path, write_image
from gsc_jax.io.ply import PlyScene, read_ply
from gsc_jax.locate import locate
from gsc_jax.method import CONFIGS, Config, MethodConfig
from gsc_jax.scene import Camera, Gaussians
from gsc_jax.splat import render
from gsc_jax.stages import Progress, Stages, silent
from gsc_jax.views import check_views, orbit_cameras

ORBIT_VIEWS = 24
MIN_SIDE, MAX_PIXELS = 8, 50_000_000


NATIVE, NOBODY = Path("native"), Path("none")
"""What may be said to --detector instead of a file."""


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
    stages, warnings = Stages(), []
    check_look(options)
    if (options.out / "edit.json").exists():
        raise InputError(
            f"{options.out}: holds an edit of `tamper` and its truth; give another --out"
        )
    config, options = _config(options), _with_spec(options)
    paths = (options.scene, options.cameras, options.masks, _network(options), options.spec)
    inputs = [path for path in paths if path]
    refuse_overlap(options.out, inputs)
    detector = _detector(options)
    with stages("load"):
        scene, cameras = load_scene(options, warnings, progress)
    if options.views:
        usable = detector.select(cameras) if detector else cameras
        cameras = chosen_cameras(options, usable, warnings)
    with about(options.cameras or options.scene):
        check_views(scene.gaussians, cameras, near=options.near)  # locate repeats its warnings
    with replacing(options.out, keep=inputs) as folder:
        result = locate(
            scene.gaussians,
            cameras,
            detector,
            config=config,
            native=_asks_native(options),
            progress=progress,
        )
        warnings += result.warnings
        with stages("write"):
            if options.cameras is None:
                save_cameras(folder / "cameras.json", cameras)
            write_results(folder, scene, cameras, result, progress=progress)
        own = stages.summary()
        located = Located(
            scene=scene,
            cameras=cameras,
            result=result,
            stages={"load": own["load"], **result.stages, "write": own["write"]},
            seconds=stages.elapsed(),
            warnings=warnings,
        )
        write_report(folder, dataclasses.asdict(options), located)
    return located


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


def _config(options: Locate) -> Config:
    """The method with what was asked for changed; None leaves a value to the method."""
    method = CONFIGS[options.method]
    if options.threshold is not None and not 0 <= options.threshold < 1:
        raise InputError(f"--threshold {options.threshold:g}: expected 0 or more, and less than 1")
    common = {
        "threshold": method.threshold if options.threshold is None else options.threshold,
        "near": options.near,
        "mask_rule": options.mask_rule or method.mask_rule,
        "seed": options.seed,
    }
    if isinstance(method, MethodConfig):
        return dataclasses.replace(_schedule(options, method), **common)
    for flag, value in (("lambda2", options.lambda2), ("epochs", options.epochs)):
        if value is not None:
            raise InputError(
                f"--{flag} {value:g}: only applies to --method official or paper, expected one of "
                f"them, found {options.method}"
            )
    tolerance = 0.0 if options.all_views or options.views else method.tolerance
    return dataclasses.replace(method, tolerance=tolerance, **common)


def _schedule(options: Locate, method: MethodConfig) -> MethodConfig:
    """GS-Checker with the price and the epochs that were asked for."""
    if options.epochs is not None and options.epochs < 1:
        raise InputError(f"--epochs {options.epochs}: expected at least one")
    lambda2 = method.loop.lambda2 if options.lambda2 is None else options.lambda2
    if not (math.isfinite(lambda2) and lambda2 >= 0):
        raise InputError(f"--lambda2 {lambda2:g}: expected 0 or more")
    loop = dataclasses.replace(method.loop, lambda2=lambda2)
    return dataclasses.replace(method, epochs=options.epochs or method.epochs, loop=loop)


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
            "to cameras.json; those that the scene was trained with see it best"
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


def _network(options: Locate) -> Path | None:
    """The 2D network among those to be asked."""
    asked = [path for path in options.detector if path not in (NATIVE, NOBODY)]
    alone = NOBODY in options.detector and len(options.detector) > 1
    if len(asked) > 1 or options.detector.count(NATIVE) > 1 or alone:
        raise InputError(
            f"--detector {' '.join(map(str, options.detector))}: expected none, or native, one 2D "
            "network, or both"
        )
    return asked[0] if asked else None


def _asks_native(options: Locate) -> bool:
    """Whether the Gaussians themselves are asked; by default where the method can listen."""
    if NATIVE in options.detector and options.method != "robust":
        raise InputError(
            f"--method {options.method}: listens to masks only, and not to --detector native; "
            "use --method robust"
        )
    return options.method == "robust" and (NATIVE in options.detector or not options.detector)


def _detector(options: Locate) -> Detector | None:
    """The folder of masks, or the network, or neither."""
    network = _network(options)
    if options.masks is not None and network is not None:
        raise InputError(
            f"--masks {options.masks} and --detector {network}: give one of the two; the masks of "
            "several detectors cannot be told apart by the names of the cameras"
        )
    if network is None:
        for flag in ("preset", "spec", "provider", "threads"):
            if getattr(options, flag) is not None:
                raise InputError(f"--{flag} says how to run a 2D network; --detector names none")
    if options.masks is not None:
        if options.cameras is None:
            raise InputError(
                f"--masks {options.masks}: masks belong to cameras, give those with --cameras "
                "(`gsc-jax render` writes a cameras.json when it makes an orbit)"
            )
        return FolderDetector(options.masks)
    if network is not None:
        return _opened(network, options)
    if not _asks_native(options):
        nobody = " --detector none" if NOBODY in options.detector else ""
        raise InputError(
            f"--method {options.method}{nobody}: nothing to go by; give the masks of a 2D detector "
            "(--masks DIR), the detector itself (--detector MODEL.onnx), or ask the Gaussians "
            "(--method robust --detector native)"
        )
    return None


def _opened(path: Path, options: Locate) -> Detector:
    """A 2D network, which remembers what it said unless told not to."""
    if str(path) in PRESETS and not path.exists():
        raise InputError(
            f"--detector {path}: is the name of a preset, expected an ONNX model; export the "
            f"network and give --detector MODEL.onnx --preset {path}"
        )
    run = {"providers": [options.provider or "cpu"], "threads": options.threads or 0}
    if path.is_dir():
        if options.preset or options.spec:
            raise InputError(
                f"--detector {path}: a folder is taken for SAFIRE's two networks, which need no "
                "--preset and no --spec"
            )
        detector = SafireDetector(path, **run)
    else:
        detector = OnnxDetector(path, _spec(options), **run)
    if options.no_cache:
        return detector
    return CachedDetector(detector, default_cache() / "detections", detector.fingerprint)


def _spec(options: Locate) -> OnnxSpec:
    if options.preset and options.spec:
        raise InputError(f"--preset {options.preset} and --spec {options.spec}: give one of them")
    if options.preset:
        return preset(options.preset)
    return read_spec(options.spec) if options.spec else PLAIN


def _with_spec(options: Locate) -> Locate:
    """The options with the spec that lies beside the model, so that the report names it."""
    network = _network(options)
    if network is None or network.is_dir() or options.preset or options.spec:
        return options
    return dataclasses.replace(options, spec=spec_beside(network))


def check_look(options: Look) -> None:
    """Refuses numbers that mean nothing, before anything is read."""
    if options.views is not None and options.views < 1:
        raise InputError(f"--views {options.views}: expected at least one view")
    for flag, value in (("scale", options.scale), ("near", options.near)):
        if not (math.isfinite(value) and value > 0):
            raise InputError(f"--{flag} {value:g}: expected a positive number")
    if options.seed < 0:
        raise InputError(f"--seed {options.seed}: expected 0 or more")


def _check_names(cameras: Sequence[Camera]) -> None:
    """Refuses cameras whose pictures could not be told apart or would leave the folder."""
    names: dict[Path, str] = {}
    for camera in cameras:
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
