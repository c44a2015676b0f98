"""`gsc-jax locate --dry-run`: what would be done, and how long it would take, in lines."""

import shutil
import tempfile
import time
from pathlib import Path

from gsc_jax.cli.detector_choice import network_path
from gsc_jax.cli.locate import Plan, plan_locate
from gsc_jax.cli.options import Locate
from gsc_jax.cli.staging import FILES
from gsc_jax.cli.trial import Trial, try_out
from gsc_jax.estimators.gschecker import Config, MethodConfig
from gsc_jax.evidence.monitor import Progress, silent
from gsc_jax.io.masks import image_path
from gsc_jax.scene import InputError

MARGIN = 0.7, 1.7
"""How far off the seconds may be either way: views differ, and machines do other things as well."""


def dry_run(options: Locate, *, progress: Progress = silent) -> tuple[list[str], list[str]]:
    """Says what a run of `locate` would do; writes nothing into the folder of results.

    Args:
        options: The arguments of the command line.
        progress: Called with (stage, done, total).

    Returns:
        Lines for people, and the warnings that the run would begin with.

    Raises:
        InputError: where the run would.
    """
    check_writable(options.out)
    begin = time.perf_counter()
    plan = plan_locate(options, progress=progress)
    loading = time.perf_counter() - begin
    trial = try_out(plan, progress=progress)
    return [
        f"A dry run: nothing was written to {options.out}.",
        f"scene    {options.scene}: {len(plan.scene.gaussians):,} Gaussians",
        f"views    {_views(plan)}",
        *(f"{name:8} {said}" for name, said in _asked(plan, trial)),
        f"method   {_method(plan.asked.config)}",
        f"writes   {_writes(plan, trial)}",
        f"time     {_time(trial, loading)}",
        f"memory   about {size(trial.peak_mib * 2**20)}",
    ], [*plan.warnings, *_no_room(options.out, trial)]


def check_writable(out: Path) -> None:
    """Refuses a folder of results that could not be written to.

    Raises:
        InputError: naming the folder.
    """
    there = _existing(out)
    if not there.is_dir():
        raise InputError(f"{out}: cannot be written to ({there} is a file); choose another place")
    try:
        tempfile.TemporaryFile(dir=there).close()  # a name that nobody sees, and gone at once
    except OSError as error:
        raise InputError(
            f"{out}: cannot be written to ({error.strerror or error}); choose another place"
        ) from error


def _existing(path: Path) -> Path:
    """The path, or the innermost folder that it would be made in."""
    return next(place for place in (path, *path.absolute().parents) if place.exists())


def _no_room(out: Path, trial: Trial) -> list[str]:
    free = shutil.disk_usage(_existing(out)).free
    if free >= trial.bytes:
        return []
    return [f"{out}: {size(free)} are free there, and the results take {size(trial.bytes)}"]


def _views(plan: Plan) -> str:
    source = plan.asked.options.cameras
    sizes = [(camera.width, camera.height) for camera in plan.cameras]
    extremes = dict.fromkeys((min(sizes), max(sizes)))
    pixels = " to ".join(f"{width} x {height}" for width, height in extremes)
    return f"{len(sizes)} of {pixels} pixels, {f'from {source}' if source else 'an orbit'}"


def _asked(plan: Plan, trial: Trial) -> list[tuple[str, str]]:
    """Whom the run listens to, in labelled lines."""
    asked, lines = plan.asked, []
    if asked.native:
        lines.append(("asks", "the Gaussians themselves"))
    if asked.detector is None:
        return lines
    usable = len(asked.detector.select(plan.cameras))
    if trial.network is None:
        return [*lines, ("reads", f"the masks of {usable} views in {asked.options.masks}")]
    network, path = trial.network, network_path(asked.options)
    each = f"{duration(network.seconds)} a view"
    if network.kept:
        each = f"{network.kept} of {network.tried} views tried are kept from an earlier run"
        each += f", {duration(network.seconds)} for another" if network.seconds else ""
    return [*lines, ("shows", f"the views to {path}: {each}")]


def _method(config: Config) -> str:
    parts = [f"threshold {config.threshold:g}", f"mask rule {config.mask_rule}"]
    if isinstance(config, MethodConfig):
        parts += [f"lambda2 {config.loop.lambda2:g}", f"epochs {config.epochs}"]
    elif config.tolerance:
        parts.append(f"tolerance {config.tolerance:g}")
    return f"{config.name} ({', '.join(parts)}, seed {config.seed})"


def _writes(plan: Plan, trial: Trial) -> str:
    """Where the results go, how large they are, and what they replace."""
    out = plan.asked.options.out
    names = [*FILES, *(image_path("masks", camera.name) for camera in plan.cameras)]
    replaced = sum((out / name).exists() for name in names)
    said = "beside what is there" if out.exists() else "a new folder"
    if (out / "result.json").exists():
        said = "in place of the results there"
    elif replaced:
        said = f"in place of {replaced} {'file' if replaced == 1 else 'files'} there"
    return f"{out}: about {size(trial.bytes)}, {said}"


def _time(trial: Trial, loading: float) -> str:
    least, most = (loading + sum(part.values()) for part in (trial.least, trial.most))
    middle = {name: (trial.least[name] + trial.most[name]) / 2 for name in trial.most}
    parts = ", ".join(f"{name} {duration(part)}" for name, part in middle.items() if part >= 0.5)
    between = f"{duration(least * MARGIN[0])} to {duration(most * MARGIN[1])}"
    return f"about {duration((least + most) / 2)} ({between})" + (f": {parts}" if parts else "")


def duration(seconds: float) -> str:
    """A duration for people, to the two digits that are known at best."""
    if seconds < 10:
        return f"{seconds:.1f} s"
    if seconds < 120:
        return f"{seconds:.0f} s"
    return f"{seconds / 60:.0f} min" if seconds < 7200 else f"{seconds / 3600:.1f} h"


def size(count: float) -> str:
    """Bytes for people."""
    return f"{count / 2**20:.0f} MiB" if count < 2**30 else f"{count / 2**30:.1f} GiB"
