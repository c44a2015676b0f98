"""`gsc-jax locate`: from files to a folder of results; all input is checked first."""

import contextlib
import dataclasses
import hashlib
import tempfile
from importlib.metadata import distributions
from pathlib import Path
from typing import Any, NamedTuple

import jax

from gsc_jax.cli import detector_choice, scene_input
from gsc_jax.cli.config_file import read_config_file
from gsc_jax.cli.options import Locate
from gsc_jax.cli.outputs import Located, planned_outputs, versions, write_report, write_results
from gsc_jax.cli.ownership import refuse_foreign, refuse_overlap
from gsc_jax.cli.staging import BY_CAMERA, FILES, replacing, views_of
from gsc_jax.estimators.protocol import Estimator, Prior
from gsc_jax.evidence.detector import Detector, fit_to_view
from gsc_jax.evidence.monitor import Monitor
from gsc_jax.evidence.storage import ArrayStore
from gsc_jax.forensics.contrast import contrasts
from gsc_jax.io.cameras import camera_files
from gsc_jax.io.files import content_bytes, content_digest, memory_limit, writing_to
from gsc_jax.io.ply import PlyScene
from gsc_jax.io.tables import read_table
from gsc_jax.io.validation import shown
from gsc_jax.locate import locate
from gsc_jax.scene import Camera, InputError

EXPANDED = 16
"""Evidence up to this part of --memory is expanded, which makes estimates faster."""


class Inputs(NamedTuple):
    """Validated input of a run, sizes and digests of its files, and whether `attributes` count."""

    options: Locate
    estimator: Estimator
    attributes: bool
    detector: Detector | None
    scene: PlyScene
    cameras: list[Camera]
    warnings: list[str]
    files: dict[str, dict[str, Any]]


def read_inputs(
    options: Locate, *, monitor: Monitor, previews: int = scene_input.PREVIEW_VIEWS
) -> Inputs:
    """Read and check all input of `locate`; without masks, `previews` cameras are placed."""
    scene_input.check_numbers(options)
    if (options.out / "edit.json").exists():
        raise InputError(
            f"{options.out}: holds an edit of `tamper` and its truth; give another --out"
        )
    if options.scene.name == "highlight.ply" and (options.scene.parent / "result.json").exists():
        raise InputError(f"{options.scene}: was recoloured by `locate`; give the original scene")
    warnings = []
    if options.config and (method := read_config_file(options.config).method) != options.method:
        warnings.append(
            f"{options.config}: is for the method {method}; the settings that depend on the method "
            f"were dropped, as --method is {options.method}"
        )
    estimator = detector_choice.configured_estimator(options)
    options = detector_choice.with_spec(options)
    attributes = detector_choice.uses_attributes(options, estimator)
    detector = detector_choice.open_detector(options, attributes=attributes)
    files = [options.scene, options.masks, detector_choice.network_path(options), options.spec]
    files = [*filter(None, files), *(camera_files(options.cameras) if options.cameras else [])]
    refuse_overlap(options.out, files, written=(*FILES, *BY_CAMERA))
    placed = scene_input.ORBIT_VIEWS if detector else previews
    scene, cameras = scene_input.read_scene(options, warnings, monitor, placed=placed)
    # At once: a file that changes during the run does not match its digest.
    digests = {str(p): {"bytes": content_bytes(p), "sha256": content_digest(p)} for p in files}
    # Once, since NumPy reads the arrays of JAX without copying, but not the other way round.
    scene = dataclasses.replace(scene, gaussians=jax.device_put(scene.gaussians))
    usable = detector.select(cameras) if detector and options.views else cameras
    cameras = scene_input.choose_cameras(options, scene, usable, warnings)
    refuse_foreign(options.out, planned_outputs(cameras), report="result.json")
    return Inputs(options, estimator, attributes, detector, scene, cameras, warnings, digests)


def run_locate(options: Locate, *, monitor: Monitor) -> Located:
    """Find the tampered Gaussians of a scene file and write the results."""
    with monitor.stage("load"):
        inputs = read_inputs(options, monitor=monitor)
    return locate_and_write(inputs, prior=inputs.attributes, monitor=monitor)


def locate_and_write(inputs: Inputs, *, prior: Prior | bool, monitor: Monitor) -> Located:
    """Find the tampered Gaussians of validated input, with a prior as of `locate`, and write."""
    options, scene, cameras = inputs.options, inputs.scene, inputs.cameras
    with replacing(options.out, identity=_identity(inputs)) as folder:
        store = ArrayStore(views_of(folder), max_bytes=memory_limit(options.memory) // EXPANDED)
        settings = {"config": inputs.estimator, "prior": prior, "monitor": monitor, "store": store}
        result = locate(scene.gaussians, cameras, inputs.detector, **settings)
        with monitor.stage("write"):
            found = contrasts(scene.gaussians, result.labels)
            located = Located(scene, cameras, result, inputs.files, found)
            write_results(folder, located, store, monitor=monitor)
        warnings = list(dict.fromkeys([*inputs.warnings, *result.warnings]))  # of `check_views`
        times = {"stages": monitor.summary(), "seconds": monitor.elapsed()}
        result = dataclasses.replace(result, **times, warnings=warnings)
        located = dataclasses.replace(located, result=result)
        report = write_report(folder, dataclasses.asdict(options), located, monitor=monitor)
    return dataclasses.replace(located, report={**report, "seconds": monitor.elapsed()})


def _identity(inputs: Inputs) -> str:
    """Digest of the command, its files and the installed packages; an equal run may continue."""
    installed = sorted({(package.name, package.version) for package in distributions()})
    network = getattr(inputs.detector, "fingerprint", None)
    facts = inputs.options, inputs.estimator, inputs.files, network, installed, versions()
    return hashlib.blake2b(repr(facts).encode(), digest_size=16).hexdigest()


def earlier_results(out: Path) -> str | None:
    """Words for the results in a folder, as "results of 'scene.ply'"; None if it has none."""
    path, scene = out / "result.json", ""
    if not path.exists():
        return None
    with contextlib.suppress(InputError, LookupError, TypeError):  # a file of another program
        scene = f" of {shown(read_table(path, remedy='')['command']['scene'])}"
    return f"results{scene}"


def dry_run(options: Locate, *, monitor: Monitor) -> tuple[list[str], list[str]]:
    """Describe a run of `locate`, of which nothing is computed: lines to print, and warnings."""
    existing = next(p for p in (options.out, *options.out.absolute().parents) if p.exists())
    with writing_to(options.out):
        tempfile.TemporaryFile(dir=existing).close()
    inputs = read_inputs(options, monitor=monitor)
    config: dict[str, Any] = dataclasses.asdict(inputs.estimator)  # pyright: ignore[reportArgumentType]
    config |= {f"loop.{key}": value for key, value in config.pop("loop", {}).items()}
    sizes = [(camera.width, camera.height) for camera in inputs.cameras]
    pixels = " to ".join(f"{w} x {h}" for w, h in dict.fromkeys((min(sizes), max(sizes))))
    sources = ["the attributes of the Gaussians"] if inputs.attributes else []
    if inputs.detector is not None:
        network = detector_choice.network_path(inputs.options)
        source = f"{network} on up to" if network else f"masks in {inputs.options.masks} of"
        chosen = inputs.detector.select(inputs.cameras)
        sources.append(f"{source} {len(chosen)} views")
        for camera in () if network else chosen:
            fit_to_view(inputs.detector(None, camera), camera)
    earlier = earlier_results(options.out)
    origin = options.cameras or "cameras that were placed around the scene"
    return [
        f"Dry run: nothing was written to {options.out}.",
        f"scene    {options.scene}: {len(inputs.scene.gaussians):,} Gaussians",
        f"views    {len(sizes)} of {pixels} pixels, from {origin}",
        *(f"evidence {source}" for source in sources),
        *(f"config   {name} = {value}" for name, value in config.items()),
        f"writes   {options.out}: {'replaces ' + earlier if earlier else 'new results'}",
    ], inputs.warnings
