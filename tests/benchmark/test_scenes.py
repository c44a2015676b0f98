import jax
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial import KDTree

from gsc_jax.benchmark import furniture, scenes, surfaces
from gsc_jax.benchmark.metrics import truth_mask
from gsc_jax.scene import InputError, invalid_rows
from gsc_jax.splat import render


@pytest.fixture(scope="module")
def made():
    return scenes.tampered_room(count=12_000, views=8, heldout=3, width=96, height=72)


def test_made_scene_is_float32_degree_1_and_renderable(made):
    leaves = jax.tree.leaves(made.gaussians)
    assert all(isinstance(leaf, np.ndarray) and leaf.dtype == np.float32 for leaf in leaves)
    assert len(made.gaussians) == len(made.labels) == 12_000
    assert made.gaussians.sh.shape == (12_000, 4, 3)
    assert not any(rows.any() for rows in invalid_rows(made.gaussians).values())


def test_made_scene_has_the_statistics_of_a_trained_one(made):
    g = made.gaussians
    axes = np.sort(g.log_scales, axis=1)
    opacities = np.asarray(g.opacities)
    norms = np.linalg.norm(g.quats, axis=1)
    assert np.median(axes[:, 1] - axes[:, 0]) > np.log(5), "the Gaussians are not flat"
    assert np.ptp(axes[:, 2]) > np.log(20), "all Gaussians have one size"
    assert np.median(opacities) > 0.8
    assert 0.02 < np.mean(opacities < 0.2) < 0.2, "no tail of faint Gaussians"
    assert norms.std() > 0.1, "quaternions are normalised"
    assert 0.3 < np.mean(g.quats[:, 0] < 0) < 0.7, "quaternions have one sign"
    assert 0 < np.abs(g.sh[:, 1:]).mean() < 0.2 * np.abs(g.sh[:, 0]).mean()


def test_labels_mark_the_object_and_rows_are_shuffled(made):
    inside = made.gaussians.means[made.labels]
    assert made.labels.sum() == 1200
    assert np.abs(inside - scenes.OBJECT_FOOT).max() < 0.7
    assert inside[:, 1].max() < scenes.OBJECT_FOOT[1] + 0.03, "the object sinks into the table"
    assert 400 < made.labels[:6000].sum() < 800


def test_same_seed_same_scene_other_seed_other_scene():
    one, same, other = (scenes.tampered_room(seed=s, count=800, views=2) for s in (3, 3, 4))
    jax.tree.map(np.testing.assert_array_equal, one.gaussians, same.gaussians)
    np.testing.assert_array_equal(one.labels, same.labels)
    np.testing.assert_array_equal(one.cameras[0].viewmat, same.cameras[0].viewmat)
    assert not np.allclose(one.gaussians.means, other.gaussians.means)
    assert not np.allclose(one.cameras[0].viewmat, other.cameras[0].viewmat)


@pytest.mark.parametrize("count", [1, 777, 5001])
def test_count_is_met_exactly(count):
    assert len(scenes.make_room(count=count)) == len(scenes.make_object(count=count)) == count


def test_cameras_are_level_rigid_and_inside_the_room():
    cameras = scenes.room_cameras(16, width=64, height=48, seed=5)
    assert [camera.name for camera in cameras[:2]] == ["room_000", "room_001"]
    for camera in cameras:
        rotation = np.asarray(camera.viewmat)[:3, :3]
        np.testing.assert_allclose(rotation @ rotation.T, np.eye(3), atol=1e-5)
        assert np.linalg.det(rotation) > 0
        assert abs(rotation[0, 1]) < 1e-6, "the horizon is tilted"
        assert rotation[1, 1] > 0, "the camera is upside down"
        assert abs(camera.center[0]) < furniture.WIDTH / 2 - 0.3
        assert abs(camera.center[2]) < furniture.DEPTH / 2 - 0.3
        assert -furniture.HEIGHT < camera.center[1] < -furniture.TABLE


def test_renders_are_covered_and_textured_and_show_the_object(made):
    shown = []
    for camera in made.cameras + made.heldout_cameras:
        rgb, alpha = map(np.asarray, render(made.gaussians, camera))
        assert alpha.mean() > 0.93
        assert np.mean(alpha < 0.5) < 0.02, f"{camera.name} has holes"
        assert rgb.std(axis=(0, 1)).min() > 0.05, f"{camera.name} is blank"
        shown.append(truth_mask(made.gaussians, camera, made.labels).mean())
    assert np.mean(np.array(shown) > 0.01) > 0.7, "the object is seldom visible"
    assert min(shown) < 0.01, "no view looks elsewhere"


@given(stretch=st.sampled_from([1, 2, 5, 17]), count=st.sampled_from([100, 400]))
@settings(max_examples=8, deadline=None)
def test_points_leave_no_holes_however_long_the_surface(stretch, count):
    surface = surfaces.flat((0, 0, 0), stretch, 1)
    part = surfaces.Part(surface, surfaces.Texture("brick.png"))
    gaussians = surfaces.sample_parts(
        [part], count, statistics=surfaces.TrainingStatistics(), rng=np.random.default_rng(0)
    )
    spacing = np.sqrt(stretch / count)
    probes = np.random.default_rng(1).uniform(
        [-stretch / 2, 0, -0.5], [stretch / 2, 0, 0.5], (500, 3)
    )
    gaps, _ = KDTree(gaussians.means).query(probes)
    assert gaps.max() < 1.6 * spacing
    np.testing.assert_allclose(gaussians.means[:, 1], 0, atol=1e-6)


def test_surfaces_have_their_area_and_point_outwards():
    sphere = surfaces.ellipsoid((1, 2, 3), 0.5, 1.0)
    uv = np.random.default_rng(0).random((300, 2))
    points, normals = sphere.at(uv)
    assert sphere.area == pytest.approx(4 * np.pi * 0.25, rel=1e-2)
    np.testing.assert_allclose(points - [1, 2, 3], 0.5 * normals, atol=0.02)
    faces = surfaces.box((0, 0, 0), 1, 2, 3)
    assert sum(face.area for face in faces) == pytest.approx(2 * 1 * 2 + 2 * 2 * 3 + 1 * 3)
    for face in faces:
        points, normals = face.at(uv)
        assert ((points - [0, -1, 0]) * normals).sum(axis=1).min() > 0


def test_pictures_hang_upright_and_are_not_mirrored():
    points, normals = surfaces.panel((0, 0, 2), surfaces.FRONT, 2, 1).at(
        np.array([[0.0, 0.0], [1.0, 0.0], [0.0, 1.0]])
    )
    # Seen from the origin, which looks along +z: x to the right, y down.
    np.testing.assert_allclose(points, [[-1, -0.5, 2], [1, -0.5, 2], [-1, 0.5, 2]], atol=1e-12)
    np.testing.assert_allclose(normals, np.tile(surfaces.FRONT, (3, 1)), atol=1e-12)
    image = surfaces._image("astronaut.png")
    rows, columns = np.indices(image.shape[:2]) + 0.5
    uv = np.stack([columns.ravel() / image.shape[1], rows.ravel() / image.shape[0]], axis=-1)
    colors = surfaces.textured(surfaces.Texture("astronaut.png"), uv)
    np.testing.assert_allclose(colors.reshape(image.shape), image, atol=1e-4)


def test_missing_texture_is_bad_input():
    texture = surfaces.Texture("no such image.png")
    with pytest.raises(InputError, match=r"no such image\.png: texture not found; reinstall"):
        surfaces.textured(texture, np.zeros((4, 2)))
