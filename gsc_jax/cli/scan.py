"""`gsc-jax scan`: a collection of scenes to a Parquet dataset and a page, on a Ray cluster."""

import contextlib
import dataclasses
import logging
import signal
import socket
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import Annotated, Any

import tyro

from gsc_jax.cli import detector_choice
from gsc_jax.cli.cache import cache_folder
from gsc_jax.cli.options import Locate, arg
from gsc_jax.cli.ownership import UNFINISHED, refuse_blocked, refuse_foreign_file, refuse_overlap
from gsc_jax.cli.report.wording import share
from gsc_jax.cli.scene_input import check_numbers
from gsc_jax.cli.staging import locked
from gsc_jax.collection.manifest import read_manifest
from gsc_jax.collection.page import MARK, collection_page
from gsc_jax.collection.record import Row, merge_rows, read_rows
from gsc_jax.collection.scan import import_ray, scan
from gsc_jax.collection.settings import ScanSettings
from gsc_jax.evidence.monitor import Monitor
from gsc_jax.io.files import atomic
from gsc_jax.io.validation import reported
from gsc_jax.scene import InputError
from gsc_jax.scene.parallel import usable_cores

PAGE, RANKED = "collection.html", 20
"""Name of the page, and scenes in the table on the terminal."""
PER_SCENE = "cpus", "memory", "timeout", "retries", "report_above"
MAX_BLOCKS = 100_000
"""Units of work of Ray: a scene, or several of them in a larger collection."""


@dataclasses.dataclass(frozen=True, kw_only=True)
class Scan(Locate):
    """Judge every scene of a collection, on all cores or on a Ray cluster.

    for example:
      gsc-jax scan models/ --out scanned
      gsc-jax scan manifest.csv --out scanned --report-above 0.65

    Needs the extra `cluster`. The same command continues a killed scan.

    written to the folder of --out:
      collection.html          start here
      scenes/                  Parquet dataset, a row per scene
      reports/                 folders of locate, by --report-above

    Attributes:
        scene: A folder, a quoted glob, a text file with a path or address per line, or a table
            (.csv or .parquet) with a column path, and optionally id, cameras, masks and others.
        out: Folder for the results, created if missing; all machines of a cluster share it.
        address: Address of a running Ray cluster. By default one is started on this machine.
        workers: Scenes that are judged at the same time.
        cpus: Cores of a worker.
        timeout: Seconds that a scene may take.
        retries: How often a scene is tried again after a timeout or the loss of its process,
            before it is a row with an error. The exit code is 0 also with such rows.
        report_above: Scene probability from which the folder of `locate` is written; 0 for all.
        memory: Memory in GiB of a worker; a file that expands to more is refused.
    """

    scene: Annotated[tyro.conf.Positional[Path], arg("SOURCE")]
    out: Annotated[Path, arg("DIR")]
    address: Annotated[str | None, arg("HOST:PORT", "local")] = None
    workers: Annotated[int | None, arg("N", "one per --cpus cores")] = None
    cpus: Annotated[int, arg("N")] = 1
    timeout: Annotated[float, arg("SECONDS")] = 3600.0
    retries: Annotated[int, arg("N")] = 1
    report_above: Annotated[float | None, arg("PROBABILITY", "no folders")] = None
    memory: Annotated[float | None, arg("GIB", "its share of half of the machine's")] = None


def run_scan(options: Scan, *, monitor: Monitor) -> tuple[list[str], list[str]]:
    """Scan a collection and write the results; lines to print, and warnings."""
    ray, out = import_ray(), options.out
    entries = read_manifest(options.scene)
    refuse_overlap(out, [options.scene], written=(PAGE, "scenes", "reports"))
    refuse_blocked(out, [PAGE, "scenes/any", "reports/any", f"{UNFINISHED}/any"])
    refuse_foreign_file(out / PAGE, MARK)
    check_numbers(options)
    masked = options.masks is not None or any(entry.get("masks") for entry in entries)
    estimator = detector_choice.configured_estimator(options)
    evidence = detector_choice.uses_attributes(options, estimator) or masked
    detector_choice.open_detector(dataclasses.replace(options, masks=None), attributes=evidence)
    settings = _settings(options)
    if options.dry_run:
        return [f"Dry run: {len(entries):,} scenes, configuration {settings.digest()[:16]}."], []
    with locked(out / UNFINISHED), _connected(ray, options):
        cores = int(ray.cluster_resources().get("CPU", 1))
        if options.cpus > cores and not options.address:  # Ray would wait; a cluster may grow
            raise InputError(f"--cpus {options.cpus}: there are only {cores} cores; use fewer")
        workers = options.workers or max(cores // options.cpus, 1)
        settings = dataclasses.replace(settings, workers=min(workers, len(entries)))
        logging.getLogger("ray.data").setLevel(logging.ERROR)
        ray.data.DataContext.get_current().enable_progress_bars = False
        dataset = ray.data.from_items(entries, override_num_blocks=min(len(entries), MAX_BLOCKS))
        found = scan(dataset, settings=settings).iter_rows()
        kept = ("id", "key", "status", "error_class")
        tracked = monitor.track("scenes", found, len(entries))
        done = [{name: row[name] for name in kept} for row in tracked]
        merge_rows(out, settings.digest(), {row["id"]: row["key"] for row in done})
        rows = list(read_rows(out, settings.digest()))
        with atomic(out / PAGE) as temporary:
            temporary.write_text(collection_page(rows), encoding="utf-8", errors="backslashreplace")
    ids = {row["id"] for row in done}
    lines = _summary([row for row in rows if row["id"] in ids], done, options, monitor)
    return [*lines, f"page     {out / PAGE}, all {len(rows):,} scenes of the folder"], []


def _settings(options: Scan) -> ScanSettings:
    complete, words = detector_choice.with_spec(options), detector_choice.WORDS
    command = {field.name: getattr(complete, field.name) for field in dataclasses.fields(Locate)}
    command |= {k: v.absolute() for k, v in command.items() if isinstance(v, Path)}
    command["detector"] = tuple(p if p in words else p.absolute() for p in options.detector)
    return ScanSettings(
        command={k: v for k, v in command.items() if k not in ("scene", "out", "memory")},
        out=options.out.absolute(),
        workers=1 if options.workers is None else options.workers,
        cache=None if options.no_cache else cache_folder(),
        **{name: getattr(options, name) for name in PER_SCENE},
    )


@contextlib.contextmanager
def _connected(ray: Any, options: Scan) -> Iterator[None]:
    """Connect to a running cluster, which goes on afterwards, or start one and end it."""
    if ray.is_initialized():
        yield
        return
    host, colon, port = (options.address or "").rpartition("/")[2].rpartition(":")
    if colon:  # otherwise Ray would try for minutes
        with reported(f"--address {options.address}: no answer", "; is the cluster running?"):
            socket.create_connection((host, int(port)), timeout=10.0).close()
    cores = (options.workers or 0) * options.cpus or len(usable_cores())
    local = {"address": "local", "num_cpus": cores, "include_dashboard": False}
    cluster = {"address": options.address} if options.address else local
    handler = signal.getsignal(signal.SIGTERM)
    ray.init(**cluster, log_to_driver=False, logging_level=logging.ERROR)
    signal.signal(signal.SIGTERM, handler)  # Ray's own would end the process without a word
    try:
        yield
    finally:
        ray.shutdown()


def _summary(rows: list[Row], done: list[Row], options: Scan, monitor: Monitor) -> list[str]:
    """The most suspicious scenes, counts, errors by class, and where the results are."""
    ranked = [row for row in rows if row["scene_probability"] is not None]
    ranked.sort(key=lambda row: (-row["scene_probability"], row["id"]))
    lines = [f"{'probability':>11} {'labelled':>9} {'Gaussians':>11}  scene"]
    for row in ranked[:RANKED]:
        cells = f"{row['scene_probability']:>11.3f} {share(row['labelled_share']):>9}"
        copy = f" (copy of {row['duplicate_of']})" if row["duplicate_of"] else ""
        traces = f" [{', '.join(row['traces'])}]" if row["traces"] else ""
        lines.append(f"{cells} {row['gaussians']:>11,}  {row['id']}{traces}{copy}")
    counts = Counter("failed" if row["error_class"] else row["status"] for row in done)
    shown = ", ".join(f"{number:,} {status}" for status, number in sorted(counts.items()))
    lines.append(f"scenes   {len(rows):,} ({shown}) in {monitor.elapsed():.1f} s")
    failed = [row for row in rows if row["error_class"]]
    for kind, number in Counter(row["error_class"] for row in failed).most_common():
        first = next(row["error"] for row in failed if row["error_class"] == kind)
        lines.append(f"errors   {kind}: {number:,}, such as {first}")
    return [*lines, f"rows     {options.out / 'scenes'}"]
