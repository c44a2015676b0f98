"""Traces of the file format, and laws of all traces: authentic scenes have none."""

import dataclasses

import numpy as np
import pytest
from data import DATA, SCENES, needs_data
from forensics_cases import (
    TRACES,
    assert_matches,
    central_rows,
    changed,
    detected,
    labels_of,
    quantised_room,
    room,
    with_copy,
    without_higher_bands,
)
from garden import make_garden
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation
from strategies import random_scene, with_row

from gsc_jax.benchmark.scenes import make_room
from gsc_jax.forensics.copy_move import copy_move
from gsc_jax.forensics.evidence import forensic_evidence
from gsc_jax.forensics.quantisation import quantisation
from gsc_jax.forensics.traces import any_trace, quaternion_convention, sh_degree
from gsc_jax.io.ply import load_ply

NAMES = ("copy-move", "quantisation", "sh-degree", "quaternion-convention", "row-order")
PART = central_rows(room())
LABELS = labels_of(room(), PART)


@pytest.mark.parametrize("make", [make_room, make_garden])
def test_made_scenes_have_no_traces(make):
    scene = make(count=5000)
    for order in (np.arange(5000), np.random.default_rng(0).permutation(5000)):
        for detect in TRACES:
            trace = detected(detect, scene.take(order))
            assert not trace.found, trace.explanation
            assert not trace.score.any()


REAL = [*(f"scenes/{name}" for name in (*SCENES, "seal", "hexbox")), "objects/plant"]


@needs_data
@pytest.mark.parametrize("name", REAL)
def test_real_scenes_have_no_traces(name):
    gaussians = load_ply(DATA / f"{name}.ply")
    gaussians = gaussians.take(np.sort(central_rows(gaussians, 60_000)))
    for detect in TRACES:
        trace = detected(detect, gaussians)
        assert not trace.found, trace.explanation


@pytest.mark.parametrize("padded", [LABELS, ~LABELS])
def test_harmonics_of_another_degree_are_marked(padded):
    edited = without_higher_bands(room(), np.flatnonzero(padded))
    assert_matches(detected(sh_degree, edited), LABELS, precision=0.99)


def test_quaternions_of_another_length_are_marked():
    unit = np.asarray(room().rotations)
    normalised = changed(room(), PART, quats=unit[PART])
    assert_matches(detected(quaternion_convention, normalised), LABELS, precision=0.99)
    all_unit = dataclasses.replace(room(), quats=unit)
    assert not detected(quaternion_convention, all_unit).found
    longer = changed(all_unit, PART, quats=2 * unit[PART])
    assert_matches(detected(quaternion_convention, longer), LABELS, precision=0.99)


@pytest.mark.parametrize("rotation", ["none", "kept"])
def test_rotations_that_training_did_not_change_are_no_trace(rotation):
    """Where no view showed a part in training, its quaternions stay as they were, of length 1."""
    unit, rng = np.asarray(room().rotations), np.random.default_rng(0)
    deviation = {"none": 0.1, "kept": 0.004}[rotation]
    lengths = 1 + deviation * rng.normal(size=(len(unit), 1))
    kept = unit[PART] if rotation == "kept" else np.array([1, 0, 0, 0], np.float32)
    trained = dataclasses.replace(room(), quats=(unit * lengths).astype(np.float32))
    assert not detected(quaternion_convention, changed(trained, PART, quats=kept)).found


def test_quaternions_of_another_sign_are_marked():
    unit = np.asarray(room().rotations)
    positive = dataclasses.replace(room(), quats=unit * np.where(unit[:, :1] < 0, -1, 1))
    assert not detected(quaternion_convention, positive).found
    # Half of the edit follows the convention by chance, which its border cannot reveal.
    edited = changed(positive, PART, quats=-unit[PART])
    assert_matches(detected(quaternion_convention, edited), LABELS, recall=0.8)


@needs_data
@pytest.mark.parametrize("seed", [41, 45, 51, 54])
def test_a_scene_that_was_turned_after_training_has_no_trace(seed):
    gaussians = load_ply(DATA / "scenes" / "seal.ply")
    turn = Rotation.random(rng=seed) * Rotation.from_rotvec([np.deg2rad(75), 0, 0])
    quats = np.asarray(gaussians.quats, np.float64)
    turned = turn * Rotation.from_quat(quats, scalar_first=True)
    # Editors store the product as it is; SciPy may flip its sign, so the sign is computed here.
    w, v = turn.as_quat(scalar_first=True)[0], turn.as_quat(scalar_first=True)[1:]
    negative = w * quats[:, 0] - quats[:, 1:] @ v < 0
    unit = turned.as_quat(canonical=True, scalar_first=True)
    edited = dataclasses.replace(gaussians, quats=np.where(negative[:, None], -unit, unit))
    assert not detected(quaternion_convention, edited).found


@pytest.mark.parametrize("count", [0, 1, 2, 13, 40])
def test_small_scenes_have_no_traces(count):
    traces = forensic_evidence(random_scene(count)).traces
    assert tuple(trace.name for trace in traces) == NAMES
    for trace in traces:
        assert trace.score.shape == (count,)
        assert trace.score.dtype == np.float32
        assert not trace.found
        assert trace.explanation


@pytest.mark.parametrize("field", ["means", "log_scales", "quats", "logit_opacities", "sh"])
@pytest.mark.parametrize("value", [np.nan, np.inf])
def test_invalid_rows_score_0_and_change_no_others(field, value):
    edited = without_higher_bands(quantised_room(), PART)
    damaged = with_row(edited, field, value, row=int(PART[0]))
    whole, found = (any_trace(forensic_evidence(scene).traces) for scene in (edited, damaged))
    others = np.arange(len(edited)) != PART[0]
    assert np.isfinite(found).all()
    if field != "logit_opacities" or np.isnan(value):
        assert found[PART[0]] == 0
    assert np.mean((found > 0.5)[others] == (whole > 0.5)[others]) > 0.999


@settings(max_examples=3, deadline=None)
@given(st.integers(0, 99))
def test_permuting_rows_permutes_scores(seed):
    scene = room(2000)
    edited = without_higher_bands(scene, central_rows(scene, 200))
    order = np.random.default_rng(seed).permutation(len(edited))
    for detect in TRACES[:-1]:  # not that of the order of the rows
        score = detected(detect, edited).score[order]
        permuted = detected(detect, edited.take(order)).score
        assert np.mean(np.abs(permuted - score) < 1e-4) > 0.99


def test_what_training_left_black_is_no_part_of_another_degree():
    """Colours are clipped at 0, so that black Gaussians keep the harmonics they had."""
    black = np.array(room().sh)
    black[PART, 0] = -1.8
    black[PART, 1:] = 0
    assert detected(sh_degree, changed(room(), PART, sh=0)).found
    assert not detected(sh_degree, dataclasses.replace(room(), sh=black)).found


@pytest.mark.parametrize("opacity", [0.1, 0.01])
def test_what_no_view_showed_in_training_is_no_edit(opacity):
    """Spheres of opacity 0.1, in colours of 8 bits, and without harmonics."""
    start = np.full((len(PART), 3), -3.0, np.float32)
    sh = np.zeros((len(PART), *room().sh.shape[1:]), np.float32)
    sh[:, 0] = np.random.default_rng(0).integers(0, 16, (len(PART), 3)) / 16
    logit = np.float32(np.log(opacity / (1 - opacity)))
    turned = np.array([0.8, 0.6, 0, 0], np.float32)  # the whole scene, after training
    same = {"log_scales": start, "sh": sh, "quats": turned}
    untrained = changed(room(), PART, **same, logit_opacities=logit)
    visible = changed(room(), PART, **same, logit_opacities=2.0)
    for trace in (quantisation, sh_degree, quaternion_convention):
        assert not detected(trace, untrained).found
        assert detected(trace, visible).found


def test_black_values_that_clones_share_are_no_levels():
    sh = np.array(room().sh)
    values = np.random.default_rng(0).choice(
        np.linspace(-1.9, -1.8, 20, dtype=np.float32), 3 * len(PART)
    )
    sh[PART, 0] = values.reshape(-1, 3)
    assert detected(quantisation, changed(room(), PART, sh=(sh + 2)[PART])).found
    assert not detected(quantisation, dataclasses.replace(room(), sh=sh)).found


def test_black_gaussians_of_a_tile_belong_to_the_tile():
    """An exporter gave a tile a codebook of its own for scales and colours."""
    scene = quantised_room(20_000)
    tile = central_rows(scene, 2_500)
    sh, log_scales = np.array(scene.sh), np.array(scene.log_scales)
    sh[tile[::3], 0] = -30 / 16
    sh[tile, 0] += 1 / 32
    log_scales[tile] += 1 / 32
    assert not detected(
        quantisation, dataclasses.replace(scene, sh=sh, log_scales=log_scales)
    ).found


def test_a_turned_part_of_a_file_without_largest_components_is_no_trace():
    """SOG, SPZ and compressed.ply make the largest component positive, and w of any sign."""
    quats = np.array(room().rotations)
    quats *= np.where(quats[:, :1] < 0, -1, 1) / np.linalg.norm(quats, axis=1, keepdims=True)
    turned = np.random.default_rng(0).normal(size=(len(PART), 4)).astype(np.float32)
    quats[PART] = turned / np.linalg.norm(turned, axis=1, keepdims=True)
    assert detected(quaternion_convention, dataclasses.replace(room(), quats=quats)).found
    largest = np.take_along_axis(quats, np.abs(quats).argmax(axis=1)[:, None], axis=1)
    stored = dataclasses.replace(room(), quats=(quats * np.sign(largest)).astype(np.float32))
    assert not detected(quaternion_convention, stored).found


@pytest.mark.parametrize(("opacity", "found"), [(0.1, False), (0.9, True)])
def test_what_no_view_showed_in_training_is_no_copy(opacity, found):
    """Untrained Gaussians are alike, wherever they are."""
    start = {"log_scales": -3.0, "quats": np.array([1, 0, 0, 0], np.float32)}
    alike = changed(room(), PART, **start, logit_opacities=np.log(opacity / (1 - opacity)))
    assert detected(copy_move, with_copy(alike, PART)).found == found
