"""How long a run of `locate` takes and how much memory, measured: it is tried in the small.

A few views go through the code of a run, from the look to the pictures, which end in a temporary
folder. What is per view is counted so many times, what is not, once; where it is not known which
of both, the truth lies between. Of the Gaussians themselves a sample is asked; a 2D network is
asked about one view, unless it was asked before.
"""

import dataclasses
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from gsc_jax.cli.locate import Plan
from gsc_jax.cli.located import Located
from gsc_jax.cli.outputs import evenly, write_report, write_results
from gsc_jax.cli.staging import BY_CAMERA, files_below
from gsc_jax.cli.trial_network import Network, try_network
from gsc_jax.estimators.robust.early_stopping import batches
from gsc_jax.estimators.robust.estimator import RobustConfig
from gsc_jax.evidence.monitor import Progress, peak_memory_mib, silent
from gsc_jax.evidence.storage import IN_MEMORY
from gsc_jax.forensics.evidence import native_evidence
from gsc_jax.locate import Result, locate
from gsc_jax.scene import Camera, Gaussians
from gsc_jax.scene.parallel import WORKERS

TRIED = 4
"""Views."""
SAMPLES = 64, 2**15
"""Gaussians that are asked about themselves: to compile, and to measure."""
SAME = 0.6
"""What of the sample's time is the same for any number; measured, as is what follows."""
NATIVE_BYTES = 1600
"""Memory for what the Gaussians themselves say, of each; measured on up to 3 million of them."""
EVIDENCE_BYTES, PIXEL_BYTES = 8, 3
"""Memory for a Gaussian in a view, and for a pixel of a mask and of what the detector said."""
MORE_TO_OPTIMISE = 30
"""Views that `robust` takes as long for as for its first ones; measured, it classifies a sample."""


@dataclasses.dataclass(frozen=True, kw_only=True)
class Trial:
    """What a run will take.

    Attributes:
        least: Seconds by stage.
        most: Seconds by stage.
        peak_mib: Memory.
        bytes: Of the results.
        network: What the network takes; None where there is none.
    """

    least: dict[str, float]
    most: dict[str, float]
    peak_mib: float
    bytes: int
    network: Network | None


class _StandIn:
    """A detector in place of all others: flags the middle of a view, and is shown the renders."""

    def __init__(self, needs_image: bool):
        self.needs_image = needs_image
        self.shown: list[tuple[np.ndarray, Camera]] = []

    def select(self, cameras: Sequence[Camera]) -> list[Camera]:
        return list(cameras)

    def __call__(self, image: np.ndarray | None, camera: Camera) -> np.ndarray:
        if image is not None:
            self.shown.append((image, camera))
        rows, columns = camera.height // 3, camera.width // 3
        flagged = np.zeros((camera.height, camera.width), np.float32)
        flagged[rows:-rows, columns:-columns] = 1
        return flagged


class Clock:
    """Notes when the steps of each stage of a run are done."""

    def __init__(self) -> None:
        self.times: dict[str, list[float]] = {}

    def __call__(self, stage: str, done: int, total: int) -> None:
        """Notes one, as the `Progress` of a run."""
        del done, total
        self.times.setdefault(stage, []).append(time.perf_counter())

    def since(self, stage: str, step: int) -> float:
        """Seconds from a step of a stage to its last one."""
        times = self.times.get(stage, [])
        return times[-1] - times[step] if len(times) > step else 0.0


def try_out(plan: Plan, *, progress: Progress = silent) -> Trial:
    """Measures what a run will take.

    Args:
        plan: The run; nothing is written where its results go.
        progress: Called with (stage, done, total).

    Raises:
        InputError: if the run would fail: the network on a view, say.
    """
    asked = plan.asked
    usable = asked.detector.select(plan.cameras) if asked.detector else plan.cameras
    tried = evenly(usable, TRIED)
    stand_in = _StandIn(needs_image=asked.network is not None)
    progress("try", 0, 4)
    native = _native(plan.scene.gaussians) if asked.native else Asking()
    progress("try", 1, 4)
    compiling = _round(plan, tried, stand_in)
    progress("try", 2, 4)
    writing = _write(plan, tried, compiling.result)
    progress("try", 3, 4)
    stand_in.shown.clear()
    compiled = _round(plan, tried, stand_in)
    network = try_network(asked, stand_in.shown) if asked.network else None
    progress("try", 4, 4)
    few, many = looks_of(plan, len(usable), network)
    views = len(plan.cameras)
    least, most = (
        seconds_by_stage(views, compiled, writing, looks, network) for looks in (few, many)
    )
    if isinstance(asked.config, RobustConfig):
        least["optimise"] = compiled.optimise * len(few)
        more = sum(look - len(tried) for look in many) / MORE_TO_OPTIMISE
        most["optimise"] = compiled.optimise * (len(many) + max(more, 0.0))
    cold = max(compiling.seconds - compiled.seconds, 0.0) + native.compiling
    return Trial(
        least={"native": native.seconds, **least, "compile": 0.0},
        most={"native": native.seconds, **most, "compile": cold},
        peak_mib=max(native.peak_mib, _peak_mib(plan, len(usable))),
        bytes=writing.bytes(len(plan.cameras)),
        network=network,
    )


@dataclasses.dataclass(frozen=True, kw_only=True)
class Round:
    """The views tried, from the look to the masks: seconds, by view but to optimise."""

    look: float
    optimise: float
    masks: float
    result: Result

    @property
    def seconds(self) -> float:
        """All of it, by the clock on the wall."""
        return self.result.seconds


def _round(plan: Plan, tried: list[Camera], stand_in: _StandIn) -> Round:
    clock = Clock()
    result = locate(
        plan.scene.gaussians,
        tried,
        stand_in,
        config=plan.asked.config,
        native=False,
        progress=clock,
    )
    seconds = result.stages["optimise"]["seconds"]
    return Round(
        look=clock.since("look", 0) / len(tried),
        optimise=seconds,
        masks=result.stages["masks"]["seconds"] / len(tried) / WORKERS,
        result=result,
    )


@dataclasses.dataclass(frozen=True, kw_only=True)
class Writing:
    """What writing the views tried took: once, and for each view, in seconds and bytes."""

    once: float
    each: float
    bytes_once: int
    bytes_each: float

    def bytes(self, views: int) -> int:
        """Of the results of so many views."""
        return round(self.bytes_once + self.bytes_each * views)


def _write(plan: Plan, tried: list[Camera], result: Result) -> Writing:
    """Writes the results of the views tried, where nobody looks for them."""
    located = Located(
        scene=plan.scene,
        cameras=tried,
        result=result,
        stages=result.stages,
        seconds=result.seconds,
        warnings=result.warnings,
    )
    command, clock = dataclasses.asdict(plan.asked.options), Clock()
    with tempfile.TemporaryDirectory(prefix="gsc-jax-") as name:
        folder, begin = Path(name), time.perf_counter()
        write_results(folder, plan.scene, tried, result, progress=clock)
        write_report(folder, command, located, progress=clock)
        all_of_it = time.perf_counter() - begin
        sizes = {name: (folder / name).stat().st_size for name in files_below(folder)}
    by_view = clock.since("write", 1) + clock.since("report", 0)
    pictures = sum(size for name, size in sizes.items() if name.split("/")[0] in BY_CAMERA)
    return Writing(
        once=all_of_it - by_view,
        each=by_view / len(tried),
        bytes_once=sum(sizes.values()) - pictures,
        bytes_each=pictures / len(tried),
    )


@dataclasses.dataclass(frozen=True, kw_only=True)
class Asking:
    """What asking all of the Gaussians takes: seconds, those to compile, and the memory peak."""

    seconds: float = 0.0
    compiling: float = 0.0
    peak_mib: float = 0.0


def _native(gaussians: Gaussians) -> Asking:
    """Asks a few of the Gaussians, which compiles, and then a sample of all."""
    rng, count = np.random.default_rng(0), len(gaussians)

    def seconds(size: int) -> float:
        rows = np.sort(rng.choice(count, size, replace=False))
        begin = time.perf_counter()
        native_evidence(gaussians.take(rows))
        return time.perf_counter() - begin

    few, some = (min(size, count) for size in SAMPLES)
    compiling, sample = seconds(few), seconds(some)
    return Asking(
        seconds=sample * (SAME + (1 - SAME) * count / some),
        compiling=compiling,
        peak_mib=peak_memory_mib() + NATIVE_BYTES * (count - some) / 2**20,
    )


def looks_of(plan: Plan, usable: int, network: Network | None) -> tuple[list[int], list[int]]:
    """Numbers of views after which the estimator is asked: at least and at most."""
    config = plan.asked.config
    if plan.asked.detector is None:
        return [], []
    if network is None or not isinstance(config, RobustConfig) or config.tolerance == 0:
        return [usable], [usable]
    all_of_them = list(batches(usable))
    return all_of_them[:2], all_of_them


def seconds_by_stage(
    views: int,
    measured: Round,
    writing: Writing,
    looks: Sequence[int],
    network: Network | None,
) -> dict[str, float]:
    """Seconds of each stage of the whole run but the first, where all grow with the views."""
    judged, tried = max(looks, default=0), len(measured.result.masks)
    asked = network.seconds * (1 - network.kept / network.tried) if network else 0.0
    return {
        "look": judged * (measured.look + asked),
        "optimise": measured.optimise * sum(looks) / tried,
        "masks": measured.masks * views,
        "write": writing.once + writing.each * views,
    }


def _peak_mib(plan: Plan, usable: int) -> float:
    """Memory of the rest: what the trial used, and what more views take."""
    looked = EVIDENCE_BYTES * usable * len(plan.scene.gaussians) if plan.asked.detector else 0
    pixels = sum(camera.width * camera.height for camera in plan.cameras)
    return peak_memory_mib() + (min(looked, IN_MEMORY) + PIXEL_BYTES * pixels) / 2**20
