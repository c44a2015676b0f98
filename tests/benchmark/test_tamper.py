"""Edits with exact truth: labelled rows differ, the others equal the original to the bit."""

import dataclasses

import jax
import numpy as np
import pytest
from data import load_scene, needs_data
from edited_room import SIZE, edited, room, rows_of, vase
from strategies import blobs, camera

from gsc_jax.benchmark import regions
from gsc_jax.benchmark.metrics import truth_mask
from gsc_jax.benchmark.tamper import EDITS, tamper
from gsc_jax.scene import InputError, invalid_rows

each_edit = pytest.mark.parametrize("edit", EDITS)


@each_edit
def test_unlabelled_rows_equal_the_original(edit):
    original, found = room()[0], edited(edit)
    assert found.labels.shape == (len(found.gaussians),)
    assert found.labels.dtype == bool
    before = rows_of(original)
    rest, changed = (rows_of(found.gaussians.take(rows)) for rows in (~found.labels, found.labels))
    assert rest <= before
    assert not changed & before, "a labelled row equals the original"
    count = {
        "incorporation": (len(original), len(vase())),
        "modification": (len(original) - found.labels.sum(), found.labels.sum()),
    }
    if edit in count:
        assert (np.sum(~found.labels), np.sum(found.labels)) == count[edit]
    else:
        assert np.sum(~found.labels) < len(original)
        assert found.labels.any()


@each_edit
def test_edits_are_renderable_float32_of_the_degree_of_the_scene(edit):
    gaussians = edited(edit).gaussians
    for leaf, of_original in zip(*map(jax.tree.leaves, (gaussians, room()[0])), strict=True):
        assert leaf.dtype == np.float32
        assert leaf.shape[1:] == of_original.shape[1:]
    assert not any(rows.any() for rows in invalid_rows(gaussians).values())


@each_edit
def test_rows_are_shuffled(edit):
    labels = edited(edit).labels
    places = np.flatnonzero(labels) / len(labels)
    # Uniform places have mean 1/2, and hardly ever a gap of a large multiple of the usual one.
    assert abs(places.mean() - 0.5) < 4 * 0.29 / np.sqrt(len(places))
    assert np.diff(places, prepend=0, append=1).max() < 12 / len(places)


@each_edit
def test_an_edit_is_compact_and_covers_about_the_requested_share(edit):
    found = edited(edit)
    _, cameras = room()
    assert found.edit == edit
    assert found.visible.shape == (len(cameras),)
    seen = found.visible >= regions.VISIBLE_SHARE
    assert seen.mean() >= 0.5
    assert SIZE / 2.5 < np.median(found.visible[seen]) < SIZE * 2.5
    truth = truth_mask(found.gaussians, cameras[0], found.labels).mean()
    assert truth == pytest.approx(found.visible[0], abs=1e-9)
    # In a room of 4 x 4.4 metres.
    means = found.gaussians.means[found.labels]
    assert np.quantile(np.linalg.norm(means - np.median(means, axis=0), axis=1), 0.9) < 1.0


@each_edit
def test_the_seed_determines_the_edit(edit):
    again = tamper(*room(), vase() if edit == "incorporation" else edit, size=SIZE, seed=0)
    np.testing.assert_array_equal(again.labels, edited(edit).labels)
    jax.tree.map(np.testing.assert_array_equal, again.gaussians, edited(edit).gaussians)
    other = edited(edit, 1)
    places = [np.median(x.gaussians.means[x.labels], axis=0) for x in (again, other)]
    assert np.linalg.norm(places[0] - places[1]) > 1e-3


def test_the_original_is_not_changed():
    original, _ = room()
    copy = jax.tree.map(np.array, original)
    tamper(*room(), "modification", size=SIZE, seed=3)
    jax.tree.map(np.testing.assert_array_equal, copy, original)


@pytest.mark.parametrize(
    ("edit", "options", "match"),
    [
        ("paint", {}, "got 'paint'"),
        ("incorporation", {}, "got 'incorporation'"),
        ("removal", {"size": 0}, "size is a share"),
        ("removal", {"size": 0.6}, "size is a share"),
        ("removal", {"size": float("nan")}, "size is a share"),
        (vase().take(np.arange(3)), {}, "not enough"),
    ],
)
def test_invalid_arguments_are_refused(edit, options, match):
    with pytest.raises(ValueError, match=match):
        tamper(*room(), edit, **options)


def test_scenes_without_anything_to_edit_are_refused():
    gaussians, cameras = room()
    with pytest.raises(InputError, match="no cameras"):
        tamper(gaussians, [], "removal")
    clear = dataclasses.replace(gaussians, logit_opacities=np.full(len(gaussians), -3, np.float32))
    with pytest.raises(InputError, match="nothing opaque"):
        tamper(clear, cameras, "removal")


def test_a_failed_edit_gives_the_reasons():
    # A scene that is only a wall has no ground.
    flat = np.random.default_rng(0).uniform(-2, 2, (500, 2))
    wall = blobs(np.column_stack([flat, np.full(500, 4.0)]), opacity=0.9, scale=0.15)
    with pytest.raises(InputError, match=r"no incorporation of 5 %.*no level and free ground"):
        tamper(wall, [camera(60, 60, focal=40.0)], vase())
    with pytest.raises(InputError, match=r"no modification of .* in \d attempts \(.*; try another"):
        tamper(wall, [camera(60, 60, focal=40.0)], "modification", size=1e-4)


@needs_data
@pytest.mark.slow
@pytest.mark.parametrize(
    ("scene", "edit"),
    [("kitchen", "modification"), ("playbot", "removal"), ("flowers", "incorporation")],
)
def test_real_scenes_can_be_edited(scene, edit):
    gaussians, cameras = load_scene(scene)
    found = tamper(gaussians, cameras[::3], vase() if edit == "incorporation" else edit, seed=2)
    assert rows_of(found.gaussians.take(~found.labels)) <= rows_of(gaussians)
    assert found.labels.any()
    seen = found.visible[found.visible >= regions.VISIBLE_SHARE]
    assert 0.02 < np.median(seen) < 0.125
