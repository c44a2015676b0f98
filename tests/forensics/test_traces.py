"""Traces are silent on what nobody touched, and find what was changed in a way that shows."""

import dataclasses

import jax
import numpy as np
import pytest
from data import DATA, SCENES, load_tampered, needs_data
from garden import make_garden
from hypothesis import given, settings
from hypothesis import strategies as st
from strategies import random_scene, with_row

from gsc_jax.benchmark.scenes import concatenate, make_object, make_room
from gsc_jax.forensics.quantisation import off_lattice
from gsc_jax.forensics.traces import (
    Trace,
    combined,
    copied,
    degree,
    lattice,
    quaternions,
    rows,
    traces,
)
from gsc_jax.io.ply import load_ply
from gsc_jax.scene import Gaussians

NAMES = ("copied", "lattice", "degree", "rows", "quaternions")


@pytest.fixture(scope="module")
def room() -> Gaussians:
    return make_room(count=5000)


@pytest.fixture(scope="module")
def coarse(room) -> Gaussians:
    """The room as a file of 8 bits or so would hold it."""
    return _rounded(room, 1 / 16)


def _rounded(gaussians: Gaussians, step: float) -> Gaussians:
    return dataclasses.replace(
        gaussians,
        log_scales=np.round(gaussians.log_scales / step) * np.float32(step),
        sh=np.round(np.asarray(gaussians.sh) / step) * np.float32(step),
    )


def _ball(gaussians: Gaussians, count: int = 400) -> np.ndarray:
    """Rows about the middle one, nearest first."""
    means = np.asarray(gaussians.means)
    return np.argsort(np.linalg.norm(means - np.median(means, axis=0), axis=1))[:count]


def _changed(gaussians: Gaussians, inside: np.ndarray, **values) -> Gaussians:
    fields = {name: np.array(getattr(gaussians, name)) for name in values}
    for name, value in values.items():
        fields[name][inside] = value
    return dataclasses.replace(gaussians, **fields)


def _with_copy(gaussians: Gaussians, inside: np.ndarray, offset=(0.0, -5.0, 0.0)) -> Gaussians:
    """The scene and a part of it once more, elsewhere."""
    part = gaussians.take(inside)
    moved = np.asarray(part.means) + np.array(offset, np.float32)
    return concatenate([gaussians, dataclasses.replace(part, means=moved)])


def _check(trace: Trace, labels: np.ndarray, *, precision: float = 0.9, recall: float = 0.9):
    flagged = trace.score > 0.5
    assert trace.found, f"{trace.name} found nothing"
    assert labels[flagged].mean() >= precision, f"{trace.name} accuses others"
    assert flagged[labels].mean() >= recall, f"{trace.name} misses too many"
    assert f"{flagged.sum():,} of {len(labels):,}" in trace.explanation


@pytest.mark.parametrize("scene", [make_room, make_garden])
def test_made_scenes_are_silent(scene):
    untouched = scene(count=5000)
    for order in (np.arange(5000), np.random.default_rng(0).permutation(5000)):
        for trace in traces(untouched.take(order)):
            assert not trace.found, trace.explanation
            assert not trace.score.any()


@needs_data
@pytest.mark.parametrize("name", [*(f"scenes/{name}" for name in SCENES), "objects/plant"])
def test_real_scenes_are_silent(name):
    gaussians = load_ply(DATA / f"{name}.ply")
    gaussians = gaussians.take(np.sort(_ball(gaussians, 60_000)))
    for trace in traces(gaussians):
        assert not trace.found, trace.explanation


def test_copy_move_accuses_both_copies(room):
    part = _ball(room)
    edited = _with_copy(room, part)
    labels = np.arange(len(edited)) >= len(room)
    labels[part] = True
    trace = copied(edited)
    _check(trace, labels)
    assert "either may be the copy" in trace.explanation


def test_a_copy_that_was_turned_and_scaled_is_found(room):
    from gsc_jax.benchmark.pasting import transformed

    part = _ball(room)
    quarter = np.array([[0, -1, 0], [1, 0, 0], [0, 0, 1]])
    copy = transformed(room.take(part), quarter, 1.7, np.array([0, -9.0, 0]))
    labels = np.arange(len(room) + len(copy)) >= len(room)
    labels[part] = True
    _check(copied(concatenate([room, copy])), labels)


def test_a_copy_with_noise_is_found(room):
    part = _ball(room)
    edited = _with_copy(room, part)
    noise = 0.03 * np.random.default_rng(0).normal(size=(len(edited), 3))
    edited = dataclasses.replace(
        edited, log_scales=(np.asarray(edited.log_scales) + noise).astype(np.float32)
    )
    labels = np.arange(len(edited)) >= len(room)
    labels[part] = True
    _check(copied(edited), labels, recall=0.8)


def test_scattered_twins_are_chance(room):
    chosen = np.random.default_rng(0).choice(len(room), 400, replace=False)
    twins = room.take(chosen)
    places = np.random.default_rng(1).permutation(np.asarray(twins.means)) + np.float32(0.01)
    assert not copied(concatenate([room, dataclasses.replace(twins, means=places)])).found


def test_free_values_among_quantised_ones_are_off_the_lattice(room, coarse):
    part = _ball(room)
    labels = np.zeros(len(room), bool)
    labels[part] = True
    assert not lattice(coarse).found
    edited = _changed(coarse, part, log_scales=np.asarray(room.log_scales)[part])
    trace = lattice(edited)
    _check(trace, labels, precision=0.99)
    assert "scales" in trace.explanation


def test_quantised_values_among_free_ones_are_on_a_lattice(room, coarse):
    part = _ball(room, 800)
    labels = np.zeros(len(room), bool)
    labels[part] = True
    edited = _changed(room, part, log_scales=np.round(np.asarray(room.log_scales)[part] * 16) / 16)
    _check(lattice(edited), labels, recall=0.8)


def test_a_second_lattice_between_the_values_of_the_first():
    host = _rounded(make_room(count=20_000), 1 / 16)
    part = _ball(host, 2000)
    labels = np.zeros(len(host), bool)
    labels[part] = True
    sh = np.array(host.sh)[part]
    sh[:, 0] += np.float32(0.37 / 16)
    _check(lattice(_changed(host, part, sh=sh)), labels, precision=0.99)


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_extremes_that_neighbour_only_each_other_are_no_lattice_of_their_own(seed):
    """Even values of a scene, odd ones of an edit, and two lamps that are brighter than all."""
    rng = np.random.default_rng(seed)
    ranges = {"scene": (6000, 0, 96, 2), "edit": (800, 1, 97, 2)}
    ranges |= {"lamp": (300, 96, 100, 1), "other lamp": (300, 100, 104, 1)}
    values = [rng.choice(np.arange(*span), count) for count, *span in ranges.values()]
    part = np.repeat(np.arange(4), [count for count, *_ in ranges.values()])
    own = [np.flatnonzero(part == k) for k in range(4)]
    neighbours = np.concatenate([rng.choice(rows, (len(rows), 12)) for rows in own])
    column = np.concatenate(values).astype(np.float32)
    _, block = off_lattice(column, np.ones(len(column), bool), neighbours)
    assert block[part == 1].mean() > 0.98
    assert not block[part != 1].any()


@needs_data
def test_a_window_that_is_brighter_than_all_else_is_not_taken_for_an_edit():
    scene = load_tampered("kitchen-incorporate")
    _check(lattice(scene.gaussians), scene.labels, precision=0.99, recall=0.15)


def test_half_of_a_scene_with_a_lattice_of_its_own_is_a_tile_of_the_export():
    host = _rounded(make_room(count=20_000), 1 / 16)
    half = np.flatnonzero(np.asarray(host.means)[:, 0] > np.median(np.asarray(host.means)[:, 0]))
    sh = np.array(host.sh)[half] + np.float32(0.37 / 16)
    assert not lattice(_changed(host, half, sh=sh)).found


def test_harmonics_that_end_elsewhere(room):
    part = _ball(room)
    labels = np.zeros(len(room), bool)
    labels[part] = True
    sh = np.array(room.sh)[part]
    sh[:, 1:] = 0
    _check(degree(_changed(room, part, sh=sh)), labels, precision=0.99)
    sh = np.array(room.sh)
    sh[~labels, 1:] = 0
    _check(degree(dataclasses.replace(room, sh=sh)), labels, precision=0.99)


def test_quaternions_of_another_length_or_sign(room):
    part = _ball(room)
    labels = np.zeros(len(room), bool)
    labels[part] = True
    unit = np.asarray(room.rotations)
    normalised = _changed(room, part, quats=unit[part])
    _check(quaternions(normalised), labels, precision=0.99)
    all_unit = dataclasses.replace(room, quats=unit)
    assert not quaternions(all_unit).found
    _check(quaternions(_changed(all_unit, part, quats=2 * unit[part])), labels, precision=0.99)
    positive = dataclasses.replace(room, quats=unit * np.where(unit[:, :1] < 0, -1, 1))
    assert not quaternions(positive).found
    # Half of them keep to the convention by chance, and at the rim nobody can tell.
    signs = quaternions(_changed(positive, part, quats=-unit[part]))
    _check(signs, labels, recall=0.8)


def test_an_object_at_the_end_of_an_unsorted_file(room):
    vase = make_object(count=600)
    shuffled = room.take(np.random.default_rng(0).permutation(len(room)))
    edited = concatenate([shuffled, vase])
    labels = np.arange(len(edited)) >= len(room)
    _check(rows(edited), labels, precision=0.8)
    order = np.random.default_rng(1).permutation(len(edited))
    assert not rows(edited.take(order)).found, "a shuffled file tells nothing by its order"
    ordered = np.argsort(np.asarray(edited.means)[:, 0])
    assert not rows(edited.take(ordered)).found, "a sorted file tells nothing by its order"


@pytest.mark.parametrize("count", [0, 1, 2, 13, 40])
def test_small_scenes_say_nothing(count):
    found = traces(random_scene(count))
    assert tuple(trace.name for trace in found) == NAMES
    for trace in found:
        assert trace.score.shape == (count,)
        assert trace.score.dtype == np.float32
        assert not trace.found
        assert trace.explanation
    assert combined(found).shape == (count,)


@pytest.mark.parametrize("field", ["means", "log_scales", "quats", "logit_opacities", "sh"])
@pytest.mark.parametrize("value", [np.nan, np.inf])
def test_damaged_rows_get_no_score_and_harm_nothing(coarse, room, field, value):
    part = _ball(room)
    sh = np.array(room.sh)[part]
    sh[:, 1:] = 0
    edited = _changed(coarse, part, sh=sh)
    damaged = with_row(edited, field, value, row=int(part[0]))
    whole, found = (combined(traces(scene)) for scene in (edited, damaged))
    others = np.arange(len(edited)) != part[0]
    assert np.isfinite(found).all()
    if field != "logit_opacities" or np.isnan(value):
        assert found[part[0]] == 0
    assert np.mean((found > 0.5)[others] == (whole > 0.5)[others]) > 0.999


@settings(max_examples=3, deadline=None)
@given(st.integers(0, 99))
def test_the_order_of_the_rows_does_not_matter_to_the_others(seed):
    room = make_room(count=2000)
    part = _ball(room, 200)
    sh = np.array(room.sh)[part]
    sh[:, 1:] = 0
    edited = _changed(room, part, sh=sh)
    order = np.random.default_rng(seed).permutation(len(edited))
    for trace in (copied, lattice, degree, quaternions):
        score = trace(edited).score
        assert np.mean(np.abs(trace(edited.take(order)).score - score[order]) < 1e-4) > 0.99


def test_combined_is_the_noisy_or():
    scores = np.array([[0, 0.5, 1], [0, 0.5, 0.3]], np.float32)
    one, other = (Trace(name="rows", score=score, explanation="") for score in scores)
    np.testing.assert_allclose(combined([one, other]), [0, 0.75, 1])
    assert one.found
    assert not Trace(name="rows", score=scores[0, :1], explanation="").found


def test_arrays_of_jax_will_do(room):
    edited = _with_copy(room, _ball(room))
    on_device = jax.tree.map(jax.numpy.asarray, edited)
    for one, other in zip(traces(edited), traces(on_device), strict=True):
        np.testing.assert_array_equal(one.score, other.score)
