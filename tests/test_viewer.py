"""What the viewer is given, and how it is started; what it looks like is in test_viewer_page."""

import contextlib
import dataclasses
import io
import socket
import sys
import urllib.request
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from results_folder import write_results
from scipy.spatial.transform import Rotation
from strategies import blobs, camera, floats, motions, random_scene, scenes

from gsc_jax.app import viewer
from gsc_jax.app.options import View
from gsc_jax.app.results import read_results
from gsc_jax.app.viewer import run_view
from gsc_jax.app.viewing.exhibit import counted, exhibit, legend
from gsc_jax.app.viewing.page import page
from gsc_jax.app.viewing.poses import pose, upward
from gsc_jax.app.viewing.splats import MODES, fitting_half, half_unit, heat, largest, shown, splats
from gsc_jax.errors import InputError

UP = np.array([0.0, -1.0, 0.0])


@pytest.fixture(scope="module")
def folder(tmp_path_factory) -> Path:
    found = tmp_path_factory.mktemp("viewer") / "found"
    write_results(found)
    return found


class TestSplats:
    @given(scenes())
    def test_covariances_have_the_scales_along_the_axes(self, gaussians):
        made = splats(gaussians)
        turned = Rotation.from_quat(np.asarray(gaussians.quats), scalar_first=True).as_matrix()
        inside = np.einsum("nji,njk,nkl->nil", turned, made.covariances, turned)
        expected = np.exp(2 * gaussians.log_scales)[:, :, None] * np.eye(3)
        np.testing.assert_allclose(inside, expected, atol=1e-5)
        np.testing.assert_array_equal(made.covariances, made.covariances.swapaxes(1, 2))

    def test_colours_and_opacities_are_those_of_the_file(self):
        made = splats(blobs([[0, 0, 1]], opacity=0.25))
        np.testing.assert_allclose(made.rgbs, 0.5)
        np.testing.assert_allclose(made.opacities, [[0.25]], rtol=1e-6)

    @given(st.floats(1e-4, 1e4))
    def test_covariances_survive_half_precision_in_any_unit(self, size):
        scene = random_scene(200)
        scene = dataclasses.replace(
            scene, log_scales=(scene.log_scales + np.log(size)).astype(np.float32)
        )
        covariances = splats(scene).covariances / half_unit(splats(scene)) ** 2
        stored = fitting_half(covariances).astype(np.float16).astype(np.float32)
        largest_entry = np.abs(covariances).max(axis=(1, 2), keepdims=True)
        assert (np.abs(stored - covariances) <= 2e-3 * largest_entry).all()

    def test_what_is_too_large_keeps_its_form(self):
        huge = np.diag([1e9, 1e8, 1.0])[None].astype(np.float32)
        fitted = fitting_half(huge)
        assert np.isfinite(fitted.astype(np.float16)).all()
        np.testing.assert_allclose(fitted / fitted.max(), huge / huge.max(), rtol=1e-6)

    def test_points_without_extent_have_a_unit(self):
        assert half_unit(splats(blobs([[0, 0, 1]], scale=1e-30))) == 1

    @given(st.integers(1, 30))
    def test_the_largest_are_those_of_most_opacity_times_area(self, count):
        scene = random_scene(20)
        axes = np.sort(np.asarray(scene.scales), axis=1)
        shows = np.asarray(scene.opacities) * axes[:, 1] * axes[:, 2]
        expected = np.sort(np.argsort(-shows)[:count])
        np.testing.assert_array_equal(largest(scene, count), expected)


class TestShown:
    SCORE = np.array([0, 0.3, 0.5, 0.7, 1], np.float32)
    SPLATS = splats(blobs(np.eye(5, 3)))

    @given(st.sampled_from([0.0, 0.3, 0.5, 0.9, 1.0]))
    def test_tampered_and_authentic_share_the_scene(self, threshold):
        _, tampered = shown(self.SPLATS, self.SCORE, "tampered only", threshold)
        _, authentic = shown(self.SPLATS, self.SCORE, "authentic only", threshold)
        np.testing.assert_array_equal(tampered + authentic, self.SPLATS.opacities)
        np.testing.assert_array_equal(tampered[:, 0] > 0, np.float32(threshold) < self.SCORE)

    def test_the_original_is_what_it_was(self):
        rgbs, opacities = shown(self.SPLATS, self.SCORE, "original", 0.5)
        np.testing.assert_array_equal(rgbs, self.SPLATS.rgbs)
        np.testing.assert_array_equal(opacities, self.SPLATS.opacities)

    def test_a_heat_map_gets_lighter_with_the_score(self):
        rgbs, opacities = shown(self.SPLATS, self.SCORE, "heat map", 0.5)
        assert (np.diff(rgbs @ [0.299, 0.587, 0.114]) > 0.03).all()
        np.testing.assert_array_equal(opacities, self.SPLATS.opacities)

    def test_colours_are_colours(self):
        colors = heat(np.linspace(0, 1, 50))
        assert colors.shape == (50, 3)
        assert colors.dtype == np.float32
        assert (colors >= 0).all()
        assert (colors <= 1).all()
        assert legend().count("rgb(") > 2

    def test_the_count_says_what_is_above(self):
        assert counted(self.SCORE, 0.5) == "2 of 5 Gaussians (40.0%) score above it"


class TestPoses:
    @given(motions())
    def test_a_pose_inverts_the_view_matrix(self, motion):
        quat, translation = motion
        viewmat = np.eye(4)
        viewmat[:3, :3] = Rotation.from_quat(quat, scalar_first=True).as_matrix()
        viewmat[:3, 3] = translation
        placed = pose(camera(viewmat=viewmat), np.zeros((1, 3)), up=UP)
        turned = Rotation.from_quat(placed.wxyz, scalar_first=True).as_matrix()
        np.testing.assert_allclose(viewmat[:3, :3] @ turned, np.eye(3), atol=1e-5)
        back = viewmat[:3, :3] @ placed.position + viewmat[:3, 3]
        np.testing.assert_allclose(back, 0, atol=1e-4)
        ahead = viewmat[:3, :3] @ placed.look_at + viewmat[:3, 3]
        np.testing.assert_allclose(ahead[:2], 0, atol=1e-4)
        assert ahead[2] > 0
        # Up in its image: to no side, and not down.
        inside = viewmat[:3, :3] @ placed.up
        assert abs(inside[0]) < 1e-5
        assert inside[1] < 0
        assert np.linalg.norm(placed.up) == pytest.approx(1)

    def test_it_looks_at_what_is_there(self):
        means = np.array([[0, 0, 2], [0, 0, 3], [0, 0, 4], [0, 0, -9], [50, 0, 1]])
        placed = pose(camera(), means, up=UP)
        np.testing.assert_allclose(placed.look_at, [0, 0, 3])

    def test_its_angles_are_those_of_the_image(self):
        placed = pose(camera(40, 30, focal=20), np.ones((1, 3)), up=UP)
        assert np.tan(placed.fov / 2) == pytest.approx(15 / 20)
        assert placed.aspect == pytest.approx(40 / 30)

    @given(floats(3, -1, 1))
    def test_upright_cameras_tell_what_is_up(self, axis):
        turned = Rotation.from_rotvec([0, axis[1], 0]).as_matrix()
        viewmat = np.eye(4)
        viewmat[:3, :3] = turned
        np.testing.assert_allclose(upward([camera(viewmat=viewmat)]), UP, atol=1e-6)

    def test_nobody_to_tell_what_is_up(self):
        np.testing.assert_array_equal(upward([]), UP)
        flipped = np.diag([-1.0, -1.0, 1.0, 1.0])
        np.testing.assert_array_equal(upward([camera(), camera(viewmat=flipped)]), UP)


class TestExhibit:
    def test_it_shows_the_results(self, folder):
        results = read_results(folder)
        made, notes = exhibit(results, most=10**6)
        assert notes == []
        assert len(made.splats) == len(results.gaussians)
        np.testing.assert_array_equal(made.score, results.tamper)
        assert [place.name for place in made.poses] == [c.name for c in results.cameras]
        assert made.start is made.poses[0]
        assert "Very probably" in made.said[0]
        found = int(results.labels.sum())
        assert counted(made.score, made.threshold).startswith(f"{found:,} of ")

    def test_what_is_left_out_is_told(self, folder):
        made, notes = exhibit(read_results(folder), most=100)
        assert len(made.splats) == len(made.score) == 100
        assert "100 of 1,998 Gaussians" in notes[0]

    def test_everything_lies_before_the_far_plane(self, folder):
        results = read_results(folder)
        made, _ = exhibit(results, most=10**6)
        for place in made.poses:
            distances = np.linalg.norm(made.splats.centers - place.position, axis=1)
            assert distances.max() < made.far

    def test_without_cameras_it_is_seen_from_around(self, folder):
        results = dataclasses.replace(read_results(folder), cameras=[], notes=["gone"])
        made, notes = exhibit(results, most=10**6)
        assert made.poses == []
        assert notes == ["gone"]
        assert np.linalg.norm(made.start.position - made.start.look_at) > 0.5

    def test_nothing_found_is_said(self, folder):
        results = read_results(folder)
        counts = results.report["counts"] | {"tampered": 0}
        report = results.report | {"counts": counts, "verdict": None}
        made, _ = exhibit(dataclasses.replace(results, report=report), most=10**6)
        assert made.said == ["No tampered Gaussian was found: none of 1,998."]


def free_port() -> int:
    with socket.socket() as probe:
        probe.bind(("localhost", 0))
        return probe.getsockname()[1]


def view(found: Path, **changes: Any) -> View:
    given: dict[str, Any] = {"folder": found, "no_browser": True, "port": free_port()}
    return View(**(given | changes))


class TestRunView:
    def test_it_serves_until_interrupted(self, folder):
        said, out = [], io.StringIO()

        def interrupted():
            address = said[0].split()[1]
            with urllib.request.urlopen(address) as answer:
                assert b"Viser client" in answer.read()
            raise KeyboardInterrupt

        with contextlib.redirect_stdout(out):
            ending = run_view(view(folder), say=said.append, wait=interrupted)
        assert ending == (["served no longer"], [])
        assert said[0].startswith("view     http://localhost:")
        assert out.getvalue() == ""

    def test_it_opens_a_browser_unless_told_not_to(self, folder, monkeypatch):
        opened = []
        monkeypatch.setattr(viewer.webbrowser, "open", opened.append)
        options = view(folder, no_browser=False)
        run_view(options, say=opened.append, wait=lambda: None)
        assert opened[-1] == f"http://localhost:{options.port}"
        opened.clear()
        run_view(view(folder), say=lambda _: None, wait=lambda: None)
        assert opened == []

    def test_a_port_that_is_taken_is_told(self, folder):
        said = []
        with socket.create_server(("127.0.0.1", 0)) as taken:
            port = taken.getsockname()[1]
            run_view(view(folder, port=port), say=said.append, wait=lambda: None)
        assert f"port {port} is taken" in said[0]
        assert f"localhost:{port} " not in said[0]

    def test_what_is_missing_is_told_before_serving(self, folder):
        said = []
        run_view(view(folder, most=10), say=said.append, wait=lambda: None)
        assert any("10 of 1,998" in line for line in said)

    def test_a_page_is_written(self, folder, tmp_path):
        path = tmp_path / "page.html"
        lines, warnings = run_view(view(folder, html=path, most=50))
        assert str(path) in lines[0]
        assert "50 of 1,998" in warnings[0]
        text = path.read_text(encoding="utf-8")
        assert "<title>found" in text
        assert "<title>Viser</title>" not in text

    @pytest.mark.parametrize(
        ("changes", "said"),
        [
            ({"most": 0}, "--most 0"),
            ({"port": 70000}, "--port 70000"),
            ({"port": -1}, "--port -1"),
            ({"host": "no.such.host.invalid"}, "--host no.such.host.invalid"),
            ({"host": "192.0.2.1"}, "--host 192.0.2.1"),
            ({"folder": Path("nothing")}, "nothing"),
        ],
    )
    def test_what_cannot_be_is_refused(self, folder, changes, said):
        with pytest.raises(InputError, match=said) as refused:
            run_view(view(folder, **changes), wait=lambda: None)
        assert "\n" not in str(refused.value)

    def test_a_page_that_cannot_be_written(self, folder, tmp_path):
        with pytest.raises(InputError, match="cannot be written"):
            run_view(view(folder, html=tmp_path))

    def test_viser_is_an_extra(self, folder, monkeypatch):
        monkeypatch.setitem(sys.modules, "viser", None)
        with pytest.raises(InputError, match=r"pip install 'gsc_jax\[viewer\]'"):
            run_view(view(folder))


def test_names_cannot_break_the_page(folder):
    made, _ = exhibit(read_results(folder), most=10)
    bad = "</script><b>&'\""
    poses = [dataclasses.replace(place, name=bad) for place in made.poses]
    made = dataclasses.replace(made, title=bad, said=[bad], poses=poses)
    client = "<html><head><title>Viser</title></head><body>scene</body></html>"
    text = page(client, made)
    assert "<b>" not in text
    assert text.count("</script>") == text.count("<script")
    assert text.index("scene") < text.index('id="gsc"') < text.index("</body>")


def test_modes_are_four():
    assert MODES == ("original", "heat map", "tampered only", "authentic only")
