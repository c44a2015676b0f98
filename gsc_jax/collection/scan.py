"""The scan: a Ray dataset of scenes to one of rows, with an actor per worker."""

import sys
from typing import TYPE_CHECKING, Any, cast

from gsc_jax.collection.record import finished_scenes
from gsc_jax.collection.settings import ScanSettings
from gsc_jax.collection.worker import Ledger, SceneWorker
from gsc_jax.scene import InputError

if TYPE_CHECKING:
    from ray.data import Dataset

AHEAD = 2
"""Scenes in an actor: one is judged while the next one is read."""


def scan(dataset: "Dataset", *, settings: ScanSettings | None = None) -> "Dataset":
    """Judge the scenes of a dataset, each as `gsc-jax locate` does.

    Args:
        dataset: A row per scene: `path`, a path or an address that fsspec opens; optionally `id`,
            `cameras` and `masks`; other columns are kept as text. A block is the unit of work of
            Ray: `dataset.repartition` to blocks of few rows.
        settings: Settings of the scan.

    Returns:
        A lazy dataset with a row per scene, in any order: see docs/scale.md for its columns. A
        scene that cannot be judged has an `error_class` and an `error`, a copy of another scene
        names that in `duplicate_of`, and one judged by an earlier scan is "finished" in `status`.

    Raises:
        InputError: if Ray is missing.
    """
    ray, settings = import_ray(), settings or ScanSettings()
    configuration = settings.digest()
    out, above = settings.out, settings.report_above
    finished = finished_scenes(out, configuration, report_above=above) if out else {}
    # On the driver's node: a ledger that is lost with another node would end the scan.
    strategy = ray.util.scheduling_strategies.NodeAffinitySchedulingStrategy
    here = strategy(ray.get_runtime_context().get_node_id(), soft=False)
    ledger = ray.remote(Ledger).options(num_cpus=0, scheduling_strategy=here).remote(finished)
    return dataset.map(
        cast(Any, SceneWorker),  # Ray makes an instance in every actor
        fn_constructor_args=(settings, configuration, ledger),
        compute=ray.data.ActorPoolStrategy(
            min_size=1,  # the cores also serve what reads the dataset and what follows
            max_size=settings.workers,
            max_tasks_in_flight_per_actor=2 * AHEAD,  # enough for Ray to add workers
            max_concurrent_calls_per_actor=AHEAD,
            enable_true_multi_threading=True,
        ),
        num_cpus=settings.cpus,
        memory=settings.worker_bytes if settings.memory else None,
    )


def import_ray() -> Any:
    """Ray with its datasets, or an InputError with the remedy."""
    try:
        import ray
        import ray.data
    except ImportError as error:
        raise InputError(f"scan: needs Ray: {sys.executable} -m pip install 'ray[data]'") from error
    return ray
