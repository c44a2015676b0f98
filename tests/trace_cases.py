"""Made scenes with traces of edits, and the check of a trace against the true labels."""

import dataclasses
import functools
from collections.abc import Callable

import jax
import numpy as np

from gsc_jax.benchmark.scenes import concatenate, make_room
from gsc_jax.forensics.traces import NEIGHBOURS, Trace
from gsc_jax.scene import Gaussians
from gsc_jax.scene.neighbours import nearest_neighbours

Detect = Callable[[Gaussians, np.ndarray], Trace]


@functools.cache
def room(count: int = 5000) -> Gaussians:
    return jax.tree.map(np.asarray, make_room(count=count))


@functools.cache
def quantised_room(count: int = 5000) -> Gaussians:
    """The room with scales and harmonics in steps of 1/16, as a file of 8 bits holds them."""
    scene = room(count)
    return dataclasses.replace(
        scene,
        log_scales=np.round(scene.log_scales * 16) / np.float32(16),
        sh=np.round(scene.sh * 16) / np.float32(16),
    )


def central_rows(gaussians: Gaussians, count: int = 400) -> np.ndarray:
    """Rows closest to the median position, nearest first."""
    means = np.asarray(gaussians.means)
    return np.argsort(np.linalg.norm(means - np.median(means, axis=0), axis=1))[:count]


def changed(gaussians: Gaussians, rows: np.ndarray, **values) -> Gaussians:
    """The Gaussians with other values in some rows."""
    fields = {name: np.array(getattr(gaussians, name)) for name in values}
    for name, value in values.items():
        fields[name][rows] = value
    return dataclasses.replace(gaussians, **fields)


def with_copy(gaussians: Gaussians, rows: np.ndarray) -> Gaussians:
    """The scene with some rows appended again, elsewhere."""
    copy = gaussians.take(rows)
    moved = np.asarray(copy.means) + np.array([0, -5, 0], np.float32)
    return concatenate([gaussians, dataclasses.replace(copy, means=moved)])


def labels_of(gaussians: Gaussians, rows: np.ndarray) -> np.ndarray:
    labels = np.zeros(len(gaussians), bool)
    labels[rows] = True
    return labels


def without_higher_bands(gaussians: Gaussians, rows: np.ndarray) -> Gaussians:
    sh = np.array(gaussians.sh)[rows]
    sh[:, 1:] = 0
    return changed(gaussians, rows, sh=sh)


def detected(detect: Detect, gaussians: Gaussians) -> Trace:
    """A trace of a scene whose rows are all valid."""
    rows = np.arange(len(gaussians))
    return detect(gaussians, nearest_neighbours(np.asarray(gaussians.means), rows, NEIGHBOURS))


def assert_matches(trace: Trace, labels: np.ndarray, *, precision=0.9, recall=0.9) -> None:
    flagged = trace.score > 0.5
    assert trace.found, f"{trace.name} found nothing"
    assert labels[flagged].mean() >= precision, f"{trace.name} marks authentic Gaussians"
    assert flagged[labels].mean() >= recall, f"{trace.name} misses tampered Gaussians"
    assert f"{flagged.sum():,} of {len(labels):,}" in trace.explanation
