"""Made scenes with traces of edits, and evidence from log odds without running the classifier."""

import dataclasses
import functools
from collections.abc import Callable

import jax
import numpy as np

from gsc_jax.benchmark.scenes import concatenate, make_room
from gsc_jax.forensics.calibration import Classification
from gsc_jax.forensics.copy_move import copy_move
from gsc_jax.forensics.evidence import LOCAL_TRACES, ForensicEvidence, combine
from gsc_jax.forensics.row_order import row_order
from gsc_jax.forensics.traces import NEIGHBOURS, Trace
from gsc_jax.scene import Gaussians
from gsc_jax.scene.neighbours import nearest_neighbours

Detect = Callable[[Gaussians, np.ndarray], Trace]
TRACES: tuple[Detect, ...] = (copy_move, *LOCAL_TRACES, lambda gaussians, _: row_order(gaussians))
BASE, PEAK = -3.0, 7.0
"""Log odds of the base rate and of the peak of a scene."""


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


def changed(gaussians: Gaussians, rows: np.ndarray | slice, **values) -> Gaussians:
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


def classified(log_odds, probability: float = 0.9, peak: float = PEAK) -> Classification:
    """Output of the classifier for Gaussians that are all known."""
    log_odds = np.asarray(log_odds, np.float32)
    return Classification(
        known=np.ones(len(log_odds), bool),
        log_odds=log_odds,
        middle=min(float(np.median(log_odds)), BASE),
        peak=peak,
        top=peak,
        scene_probability=probability,
    )


def evidence_of(
    log_odds,
    probability: float = 0.9,
    *,
    rows: tuple[int, ...] = (),
    name: str = "copy-move",
    peak: float = PEAK,
) -> ForensicEvidence:
    """Evidence of the classifier, and of a trace that marks some rows."""
    score = np.zeros(len(log_odds), np.float32)
    score[list(rows)] = 0.999
    traces = [Trace(name=name, score=score, explanation="")] if rows else []
    return combine(classified(log_odds, probability, peak), traces)


def two_groups(seed: int, edited: int) -> np.ndarray:
    """Log odds of 20,000 Gaussians, of which the last ones are higher."""
    rng = np.random.default_rng(seed)
    return np.append(rng.normal(-4, 0.6, 20_000 - edited), rng.normal(1.5, 1, edited))


def peak_of(log_odds: np.ndarray) -> float:
    """Highest mean of 256 log odds that are adjacent, as around a place."""
    return float(np.convolve(log_odds, np.full(256, 1 / 256), mode="valid").max())
