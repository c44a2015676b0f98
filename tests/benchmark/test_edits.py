"""Edits with exact truth: what is labelled differs, what is not is the original, bit by bit."""

import dataclasses
import functools

import jax
import numpy as np
import pytest
from data import load_scene, needs_data
from hypothesis import given, settings
from strategies import blobs, camera, motions, random_scene, with_row

from gsc_jax.benchmark import changing, filling, pasting, regions, scenes
from gsc_jax.benchmark.metrics import truth_mask
from gsc_jax.benchmark.tamper import EDITS, Edit, Tampered, cut_object, tamper, transformed
from gsc_jax.scene import Gaussians, InputError, invalid_rows
from gsc_jax.splat import render

SIZE = 0.06
UP = np.array([0, -1.0, 0])


@functools.cache
def room():
    return scenes.make_room(count=6000), scenes.room_cameras(8, width=96, height=72)


@functools.cache
def vase() -> Gaussians:
    return scenes.make_object(count=600)


@functools.cache
def tampered(edit: Edit, seed: int = 0, *, size: float = SIZE) -> Tampered:
    donor = vase() if edit == "incorporation" else None
    return tamper(*room(), edit, donor=donor, size=size, seed=seed)


@functools.cache
def looked() -> regions.Sight:
    return regions.look(*room())


@functools.cache
def grown(seed: int = 0, size: float = 0.04) -> regions.Region:
    chosen = regions.pick(looked(), 1, np.random.default_rng(seed))[0]
    return regions.grow(room()[0], looked(), chosen, size)


def rows_of(gaussians: Gaussians) -> set[bytes]:
    """Every row, all its fields together."""
    leaves = [np.asarray(leaf).reshape(len(gaussians), -1) for leaf in jax.tree.leaves(gaussians)]
    return {row.tobytes() for row in np.hstack(leaves)}


def rotation_of(quat) -> np.ndarray:
    from scipy.spatial.transform import Rotation

    return Rotation.from_quat(quat, scalar_first=True).as_matrix()


each_edit = pytest.mark.parametrize("edit", EDITS)


@each_edit
def test_what_is_not_labelled_is_the_original_bit_by_bit(edit):
    original, found = room()[0], tampered(edit)
    assert found.labels.shape == (len(found.gaussians),)
    assert found.labels.dtype == bool
    before = rows_of(original)
    rest, edited = (rows_of(found.gaussians.take(rows)) for rows in (~found.labels, found.labels))
    assert rest <= before
    assert not edited & before, "a labelled row is still what it was"
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
    gaussians = tampered(edit).gaussians
    for leaf, of_original in zip(*map(jax.tree.leaves, (gaussians, room()[0])), strict=True):
        assert leaf.dtype == np.float32
        assert leaf.shape[1:] == of_original.shape[1:]
        assert np.isfinite(leaf).all()
    assert not any(rows.any() for rows in invalid_rows(gaussians).values())


@each_edit
def test_rows_are_shuffled(edit):
    labels = tampered(edit).labels
    places = np.flatnonzero(labels) / len(labels)
    # Of evenly spread places the mean is 1/2, and a gap hardly ever a large multiple of the usual.
    assert abs(places.mean() - 0.5) < 4 * 0.29 / np.sqrt(len(places))
    assert np.diff(places, prepend=0, append=1).max() < 12 / len(places)


@each_edit
def test_an_edit_is_compact_and_shows_at_about_the_wanted_size(edit):
    found = tampered(edit)
    _, cameras = room()
    assert found.edit == edit
    assert found.visible.shape == (len(cameras),)
    seen = found.visible >= regions.VISIBLE
    assert seen.mean() >= 0.5
    assert SIZE / 2.5 < np.median(found.visible[seen]) < SIZE * 2.5
    truth = truth_mask(found.gaussians, cameras[0], found.labels).mean()
    assert truth == pytest.approx(found.visible[0], abs=1e-9)
    # In a room of 4 x 5 metres.
    means = found.gaussians.means[found.labels]
    assert np.quantile(np.linalg.norm(means - np.median(means, axis=0), axis=1), 0.9) < 1.0


@each_edit
def test_the_description_says_what_was_done(edit):
    text = tampered(edit).description
    assert text.startswith(edit.capitalize())
    assert text.endswith(".")
    count = len(vase()) if edit == "incorporation" else np.sum(tampered(edit).labels)
    assert f"{count:,}" in text
    assert "% of the pixels" in text
    assert "\n" not in text


@each_edit
def test_same_seed_same_edit_other_seed_another(edit):
    donor = vase() if edit == "incorporation" else None
    again = tamper(*room(), edit, donor=donor, size=SIZE, seed=0)
    np.testing.assert_array_equal(again.labels, tampered(edit).labels)
    jax.tree.map(np.testing.assert_array_equal, again.gaussians, tampered(edit).gaussians)
    other = tampered(edit, 1)
    places = [np.median(x.gaussians.means[x.labels], axis=0) for x in (again, other)]
    assert np.linalg.norm(places[0] - places[1]) > 1e-3


def test_the_scene_is_left_alone():
    original, _ = room()
    copy = jax.tree.map(np.array, original)
    tamper(*room(), "modification", size=SIZE, seed=3)
    jax.tree.map(np.testing.assert_array_equal, copy, original)


def test_a_modification_changes_the_pixels_that_it_is_true_of():
    found, (original, cameras) = tampered("modification"), room()
    view = cameras[int(np.argmax(found.visible))]
    inside = truth_mask(found.gaussians, view, found.labels)
    images = (np.asarray(render(g, view)[0]) for g in (found.gaussians, original))
    difference = np.abs(np.subtract(*images)).mean(axis=-1)
    assert difference[inside].mean() > 0.03
    assert difference[inside].mean() > 3 * difference[~inside].mean()


def test_a_pasted_object_stands_on_something():
    found = tampered("incorporation")
    pasted, rest = (found.gaussians.take(rows) for rows in (found.labels, ~found.labels))
    _, high = pasting.extent(pasted)
    foot = np.append(np.median(pasted.means[:, [0, 2]], axis=0), high[1])[[0, 2, 1]]
    near = np.linalg.norm(rest.means[:, [0, 2]] - foot[[0, 2]], axis=1) < 0.2
    assert np.min(np.abs(rest.means[near, 1] - foot[1])) < 0.03
    inside = near & (rest.means[:, 1] < foot[1] - 0.1) & (rest.means[:, 1] > foot[1] - 0.4)
    solid = np.asarray(rest.opacities) > 0.5
    assert np.sum(inside & solid) < 0.2 * np.sum(near & solid), "it stands inside of something"


@pytest.mark.parametrize("degree", [0, 1, 3])
def test_a_donor_takes_the_degree_of_the_scene(degree):
    donor = random_scene(20, degree=2)
    fitted = pasting.of_degree(donor, degree)
    shared = min(9, (degree + 1) ** 2)
    assert fitted.sh_degree == degree
    np.testing.assert_array_equal(fitted.sh[:, :shared], donor.sh[:, :shared])
    assert not fitted.sh[:, shared:].any()


def test_a_removal_closes_the_hole():
    gaussians, cameras = room()
    found = tampered("removal")
    best = np.argsort(-found.visible)[:3]
    for view in (cameras[i] for i in best):
        inside = truth_mask(found.gaussians, view, found.labels)
        assert np.asarray(render(found.gaussians, view)[1])[inside].mean() > 0.9
        assert np.asarray(render(gaussians, view)[1])[inside].mean() > 0.9


def test_a_hole_in_a_sheet_is_filled_in_its_plane_with_its_colours():
    rng = np.random.default_rng(0)
    flat = rng.uniform(-2, 2, (6000, 2))
    sheet = blobs(np.column_stack([flat, rng.normal(0, 0.01, 6000)]), opacity=0.9, scale=0.05)
    sheet = dataclasses.replace(sheet, sh=(sheet.sh + np.sign(flat[:, :1, None])).astype("f4"))
    away = np.linalg.norm(flat, axis=1)
    region = regions.Region(
        rows=np.flatnonzero(away < 0.5),
        ring=np.flatnonzero((away >= 0.5) & (away < 1)),
        center=np.zeros(3),
        radius=0.5,
        towards=np.array([0, 0, 1.0]),
    )
    fill = filling.filling(sheet, filling.hole_of(sheet, region), rng)
    assert np.linalg.norm(fill.means[:, :2], axis=1).max() < 0.55
    assert np.abs(fill.means[:, 2]).max() < 0.06
    assert 0.7 < len(fill) / len(region.rows) < 1.4, "it is not as dense as its surroundings"
    agree = np.sign(fill.sh[:, 0, 0]) == np.sign(fill.means[:, 0])
    assert agree.mean() > 0.9, "the border between the colours does not go on"


def test_a_region_grows_along_the_surface_to_its_size():
    region, sight = grown(), looked()
    small = grown(size=0.02)
    assert set(small.rows) < set(region.rows)
    assert not set(region.rows) & set(region.ring)
    covers = regions.typical_share(sight.shares[:, region.rows].sum(axis=1))
    assert covers == pytest.approx(0.04, rel=0.3)
    assert np.linalg.norm(region.towards) == pytest.approx(1)
    np.testing.assert_allclose(sight.up, UP, atol=0.2)


def test_a_region_does_not_jump_over_a_gap():
    x = np.linspace(-1, 1, 21)
    sheet = np.stack(np.meshgrid(x, x), axis=-1).reshape(-1, 2)
    front, back = (np.column_stack([sheet, np.full(len(sheet), z)]) for z in (3.0, 4.0))
    two = blobs(np.vstack([front, back]), opacity=0.9, scale=0.05)
    cameras = [camera(60, 60, focal=40.0)]
    sight = regions.look(two, cameras)
    region = regions.grow(two, sight, 220, 0.3)
    assert 0 < len(region.rows) <= 441
    assert region.rows.max() < 441


def test_rows_that_cannot_be_rendered_are_in_no_region():
    gaussians, _ = room()
    broken = with_row(gaussians, "means", np.nan, row=int(grown().rows[1]))
    region = regions.grow(broken, looked(), int(grown().rows[0]), 0.04)
    assert np.isfinite(broken.means[region.rows]).all()
    assert int(grown().rows[1]) not in region.rows


@given(motions())
@settings(max_examples=8)
def test_a_moved_scene_looks_the_same_to_a_camera_moved_with_it(motion):
    quat, translation = motion
    R, scale = rotation_of(quat), 1.7
    scene, view = random_scene(12, seed=3, degree=3), camera()
    moved = transformed(scene, R, scale, translation)
    viewmat = np.eye(4)
    viewmat[:3, :3] = R.T
    viewmat[:3, 3] = -R.T @ translation
    there = dataclasses.replace(view, viewmat=viewmat.astype(np.float32))
    expected, _ = render(scene, view, near=0.2)
    image, _ = render(moved, there, near=0.2 * scale)
    assert np.asarray(expected).mean() > 0.02, "nothing is seen"
    difference = np.abs(np.asarray(image) - np.asarray(expected))
    assert difference.mean() < 2e-4
    assert difference.max() < 0.02


def test_a_pasted_object_does_not_tell_by_its_numbers():
    scene = room()[0]
    length = np.linalg.norm(scene.quats, axis=1, keepdims=True)
    unit = dataclasses.replace(scene, quats=scene.quats / length)
    pasted = pasting._in_the_manner_of(unit, vase())
    np.testing.assert_allclose(np.linalg.norm(pasted.quats, axis=1), 1, atol=1e-5)
    odd = dataclasses.replace(scene, quats=2 * scene.quats / length)
    assert np.array_equal(pasting._in_the_manner_of(odd, vase()).quats, vase().quats)


def test_a_linear_warp_is_a_similarity():
    scene = random_scene(30, degree=0)
    axis = np.array([0.6, 0.0, 0.8])
    region = dataclasses.replace(grown(), center=np.zeros(3), radius=0.0, towards=axis)
    grown_twice = changing.warped(scene, changing.resized(region, 2.0))
    np.testing.assert_allclose(grown_twice.means, 2 * scene.means, rtol=1e-5)
    # In the order and sense of the original, or the format would tell what was edited.
    np.testing.assert_allclose(grown_twice.log_scales, scene.log_scales + np.log(2), atol=1e-4)
    np.testing.assert_allclose(grown_twice.quats, scene.quats, atol=1e-3)
    images = [render(g, camera())[0] for g in (transformed(scene, np.eye(3), 2, np.zeros(3)),)]
    np.testing.assert_allclose(render(grown_twice, camera())[0], images[0], atol=2e-3)


@pytest.mark.parametrize("warp", [changing.twisted, changing.swollen])
def test_a_warp_moves_the_middle_and_leaves_the_edge(warp):
    region = dataclasses.replace(grown(), center=np.array([0.0, 0, 3]), radius=0.5, towards=UP)
    scene = random_scene(400)
    after = changing.warped(scene, warp(region, 0.7))
    offsets = scene.means - region.center
    across = np.linalg.norm(offsets[:, [0, 2]], axis=1)
    moved = np.linalg.norm(after.means - scene.means, axis=1)
    assert moved[across > 0.61].max() < 1e-5
    assert moved[(across < 0.4) & (across > 0.1)].min() > 1e-3
    assert all(np.isfinite(leaf).all() for leaf in jax.tree.leaves(after))
    touched = changing._changed(scene, after, region.radius)
    assert not touched[across > 0.61].any()
    assert touched[(across < 0.4) & (across > 0.1)].all()


def test_level_ground_costs_nothing_and_an_empty_side_the_same_on_all_sides():
    x, z = np.meshgrid(np.linspace(-1, 1, 41), np.linspace(-1, 1, 41))
    plane = np.stack([x.ravel(), 0 * x.ravel(), z.ravel()], axis=1)
    place, up = np.zeros(3), np.array([0, -1.0, 0])

    def cost(points):
        return pasting.standing_cost(points, place, up, 0.9, 1.0)[0]

    assert cost(plane) == pytest.approx(0, abs=1e-6)
    side = np.linalg.svd(up[None])[2][1:]
    sector = np.floor(np.arctan2(*(plane @ side.T).T[::-1]) * pasting.SECTORS / (2 * np.pi))
    inner = np.linalg.norm(plane, axis=1) < 0.4
    costs = [cost(plane[inner | (sector % 8 != k)]) for k in range(pasting.SECTORS)]
    np.testing.assert_allclose(costs, 1 / pasting.SECTORS, atol=1e-3)


def test_a_cut_object_is_upright_and_stands_at_the_origin():
    gaussians, cameras = room()
    thing = cut_object(gaussians, cameras, seed=0)
    low, high = pasting.extent(thing)
    assert 10 < len(thing) < len(gaussians) / 2
    assert high[1] == pytest.approx(0, abs=1e-4)
    np.testing.assert_allclose((low + high)[[0, 2]], 0, atol=1e-4)
    jax.tree.map(np.testing.assert_array_equal, thing, cut_object(gaussians, cameras, seed=0))


def test_turning_between_opposite_directions_is_a_rotation():
    for end in (UP, -UP, np.array([0.6, 0.8, 0])):
        turn = pasting.turn_between(UP, end)
        np.testing.assert_allclose(turn @ UP, end, atol=1e-9)
        assert np.linalg.det(turn) == pytest.approx(1)


def test_bad_arguments_say_what_was_expected():
    gaussians, cameras = room()
    with pytest.raises(ValueError, match=r"edit must be one of incorporation, .*, got 'paint'"):
        tamper(gaussians, cameras, "paint")  # pyright: ignore[reportArgumentType]
    with pytest.raises(ValueError, match="incorporation needs a donor"):
        tamper(gaussians, cameras, "incorporation")
    with pytest.raises(ValueError, match="removal has no use for a donor"):
        tamper(gaussians, cameras, "removal", donor=vase())
    for size in (0, -0.1, 0.6, float("nan")):
        with pytest.raises(ValueError, match="size is a share of the pixels"):
            tamper(gaussians, cameras, "removal", size=size)
    with pytest.raises(ValueError, match="not enough"):
        tamper(gaussians, cameras, "incorporation", donor=vase().take(np.arange(3)))
    with pytest.raises(ValueError, match="scale must be positive"):
        transformed(gaussians, np.eye(3), 0, np.zeros(3))


def test_bad_scenes_are_refused():
    gaussians, cameras = room()
    with pytest.raises(InputError, match="no cameras"):
        tamper(gaussians, [], "removal")
    clear = dataclasses.replace(gaussians, logit_opacities=np.full(len(gaussians), -3, np.float32))
    with pytest.raises(InputError, match="nothing opaque"):
        tamper(clear, cameras, "removal")


def test_an_edit_that_does_not_come_out_says_what_was_tried():
    # On nothing but a wall there is no ground to stand on.
    flat = np.random.default_rng(0).uniform(-2, 2, (500, 2))
    wall = blobs(np.column_stack([flat, np.full(500, 4.0)]), opacity=0.9, scale=0.15)
    with pytest.raises(InputError, match=r"no incorporation of 5 %.*no level and free ground"):
        tamper(wall, [camera(60, 60, focal=40.0)], "incorporation", donor=vase())
    with pytest.raises(InputError, match=r"no modification of .* in \d attempts \(.*; try another"):
        tamper(wall, [camera(60, 60, focal=40.0)], "modification", size=1e-4)


@needs_data
@pytest.mark.slow
@pytest.mark.parametrize(
    ("scene", "edit"),
    [("kitchen", "modification"), ("playbot", "removal"), ("flowers", "incorporation")],
)
def test_real_scenes_can_be_tampered_with(scene, edit):
    gaussians, cameras = load_scene(scene)
    donor = vase() if edit == "incorporation" else None
    found = tamper(gaussians, cameras[::3], edit, donor=donor, seed=2)
    assert rows_of(found.gaussians.take(~found.labels)) <= rows_of(gaussians)
    assert found.labels.any()
    seen = found.visible[found.visible >= regions.VISIBLE]
    assert 0.02 < np.median(seen) < 0.125
