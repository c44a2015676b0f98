"""`gsc-jax locate --dry-run`: validate all input, print the resolved configuration."""

import dataclasses
import tempfile
from pathlib import Path
from typing import Any

from gsc_jax.cli.detector_choice import network_path
from gsc_jax.cli.locate import Inputs, read_inputs
from gsc_jax.cli.locate_options import Locate
from gsc_jax.evidence.monitor import Monitor
from gsc_jax.scene import InputError


def dry_run(options: Locate, *, monitor: Monitor) -> tuple[list[str], list[str]]:
    """Describe a run of `locate`, which is not started: lines to print, and warnings."""
    _check_writable(options.out)
    inputs = read_inputs(options, monitor=monitor)
    config: dict[str, Any] = dataclasses.asdict(inputs.estimator)  # pyright: ignore[reportArgumentType]
    config |= {f"loop.{key}": value for key, value in config.pop("loop", {}).items()}
    results = "replaces results" if (options.out / "result.json").exists() else "new results"
    return [
        f"Dry run: nothing was written to {options.out}.",
        f"scene    {options.scene}: {len(inputs.scene.gaussians):,} Gaussians",
        f"views    {_views(inputs)}",
        *(f"evidence {source}" for source in _evidence(inputs)),
        *(f"config   {name} = {value}" for name, value in config.items()),
        f"writes   {options.out}: {results}",
    ], inputs.warnings


def _check_writable(out: Path) -> None:
    """Refuse a folder in which no file can be created; it need not exist."""
    existing = next(place for place in (out, *out.absolute().parents) if place.exists())
    try:
        tempfile.TemporaryFile(dir=existing).close()
    except OSError as error:
        raise InputError(
            f"{out}: cannot be written to ({error.strerror or error}); choose another place"
        ) from error


def _views(inputs: Inputs) -> str:
    sizes = [(camera.width, camera.height) for camera in inputs.cameras]
    pixels = " to ".join(f"{w} x {h}" for w, h in dict.fromkeys((min(sizes), max(sizes))))
    cameras = inputs.options.cameras
    return f"{len(sizes)} of {pixels} pixels, {f'from {cameras}' if cameras else 'on an orbit'}"


def _evidence(inputs: Inputs) -> list[str]:
    sources = ["the attributes of the Gaussians"] if inputs.attributes else []
    if inputs.detector is not None:
        count = len(inputs.detector.select(inputs.cameras))
        network = network_path(inputs.options)
        source = f"{network} on up to" if network else f"masks in {inputs.options.masks} of"
        sources.append(f"{source} {count} views")
    return sources
