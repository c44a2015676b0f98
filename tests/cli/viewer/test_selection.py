"""Clicks, boxes and exports of the served viewer."""

import dataclasses
from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from results_folder import write_results
from scipy.spatial.transform import Rotation

from gsc_jax.cli.results import read_results
from gsc_jax.cli.viewer.contents import viewer_contents
from gsc_jax.cli.viewer.selection import PARTS, describe, exported, hit, on_screen
from gsc_jax.cli.viewer.splats import Splats
from gsc_jax.io.ply import read_ply
from gsc_jax.render.orbit import look_at
from gsc_jax.render.projection import project_centers
from gsc_jax.scene import InputError


@pytest.fixture(scope="module")
def contents(tmp_path_factory):
    folder = tmp_path_factory.mktemp("selection") / "found"
    write_results(folder)
    return viewer_contents(read_results(folder), most=10**6)[0]


def discs(depths: list[float], opacities: list[float]) -> Splats:
    """Unit spheres on the z axis."""
    count = len(depths)
    return Splats(
        centers=np.array([[0, 0, z] for z in depths], np.float32),
        covariances=np.tile(np.eye(3, dtype=np.float32), (count, 1, 1)),
        rgbs=np.zeros((count, 3), np.float32),
        opacities=np.array(opacities, np.float32)[:, None],
        scales=np.ones((count, 3), np.float32),
    )


@pytest.mark.parametrize(
    ("opacities", "expected"),
    [([0.9, 0.9, 0.9], 1), ([0.9, 0.2, 0.9], 0), ([0.9, 0, 0.9], 0), ([0, 0, 0.9], None)],
)
def test_a_click_hits_the_splat_that_is_seen(opacities, expected):
    splats = discs([8, 5, -5], opacities)
    drawn = splats.opacities[:, 0]
    assert hit(splats, drawn, np.zeros(3), np.array([0, 0, 3.0])) == expected
    assert hit(splats, drawn, np.zeros(3), np.array([1.0, 0, 0.001])) is None, "nothing is there"


def test_a_click_shows_the_values_in_the_file(contents):
    for index in (0, 7, 100):
        row = contents.rows[index]
        scene = read_ply(contents.folder / "tamper.ply")
        text = describe(contents, index)
        assert f"| row | {row:,} |" in text
        assert f"| score | {scene.ply['vertex']['tamper'][row]:.3f} |" in text
        place = ", ".join(f"{scene.ply['vertex'][axis][row]:.3g}" for axis in "xyz")
        assert f"| position | {place} |" in text
        logs = [scene.ply["vertex"][f"scale_{axis}"][row] for axis in range(3)]
        assert f"| scales | {', '.join(f'{np.exp(log):.3g}' for log in logs)} |" in text


@settings(max_examples=30, deadline=None)
@given(st.integers(0, 2), st.integers(0, 2**32 - 1))
def test_places_on_the_screen_are_those_of_the_renderer(contents, view, seed):
    pose = contents.poses[view]
    viewmat = look_at(pose.position, pose.look_at, pose.up)
    wxyz = Rotation.from_matrix(viewmat[:3, :3].T).as_quat(scalar_first=True)
    camera = SimpleNamespace(wxyz=wxyz, position=pose.position, fov=pose.fov, aspect=1.5)
    points = pose.look_at + np.random.default_rng(seed).normal(size=(20, 3)) * 0.2
    height, width = 400, 600
    focal = height / 2 / np.tan(pose.fov / 2)
    K = np.array([[focal, 0, width / 2], [0, focal, height / 2], [0, 0, 1]], np.float32)
    pixels, depths = project_centers(points.astype(np.float32), viewmat, K)
    ahead = np.asarray(depths) > 0.1
    places = on_screen(points, camera)  # pyright: ignore[reportArgumentType]
    expected = np.asarray(pixels) / [width, height]
    np.testing.assert_allclose(places[ahead], expected[ahead], atol=1e-3)
    assert np.isnan(on_screen(pose.position - 2 * (points - pose.position), camera)).any()  # pyright: ignore[reportArgumentType]


def test_exports_are_rows_of_the_file_with_all_properties(contents, tmp_path):
    whole = read_ply(contents.folder / "tamper.ply").ply["vertex"].data
    labelled = np.load(contents.folder / "labels.npy")
    selected = np.isin(np.arange(len(contents.rows)), [3, 9])
    rows = np.isin(np.arange(len(whole)), contents.rows[selected])
    for part, expected in zip(PARTS, (~labelled, labelled, ~rows, rows), strict=True):
        path = tmp_path / "part.ply"
        path.write_bytes(exported(contents, part, selected, contents.threshold))
        written = read_ply(path).ply["vertex"].data
        assert written.dtype == whole.dtype
        assert written.tobytes() == whole[expected].tobytes()
    none, small = np.zeros_like(selected), dataclasses.replace(contents, max_bytes=100)
    with pytest.raises(InputError, match="no Gaussian was chosen"):
        exported(contents, "only selected", none, 0.5)
    with pytest.raises(InputError, match="--memory"):
        exported(small, "only labelled", none, 0.5)
    with pytest.raises(InputError, match="start gsc-jax view again"):
        exported(dataclasses.replace(contents, version=0), "only labelled", none, 0.5)


def test_a_needle_is_hit_along_its_length_only():
    turn = np.array([[1, -1, 0], [1, 1, 0], [0, 0, np.sqrt(2)]]) / np.sqrt(2)
    needle = dataclasses.replace(
        discs([5], [0.9]),
        covariances=(turn @ np.diag([1, 1e-4, 1e-4]) @ turn.T)[None].astype(np.float32),
    )
    drawn = needle.opacities[:, 0]
    assert hit(needle, drawn, np.array([0.7, 0.7, 0]), np.array([0, 0, 1.0])) == 0
    assert hit(needle, drawn, np.array([0.7, 0, 0]), np.array([0, 0, 1.0])) is None
