"""Results as a viewer shows them: what is seen and said, and what a panel sends when it changes."""

import dataclasses
import threading
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from results_folder import write_results

from gsc_jax.cli.report.wording import headline
from gsc_jax.cli.results import Results, read_results
from gsc_jax.cli.viewer import exhibit as viewing
from gsc_jax.cli.viewer import panel
from gsc_jax.cli.viewer.exhibit import Exhibit, counted, exhibit
from gsc_jax.cli.viewer.page import page
from gsc_jax.cli.viewer.server import serving
from gsc_jax.cli.viewer.splats import shown

PATIENCE = 20.0


@pytest.fixture(scope="module")
def folder(tmp_path_factory) -> Path:
    found = tmp_path_factory.mktemp("viewer") / "found"
    write_results(found)
    return found


class TestExhibit:
    def test_it_shows_the_results(self, folder):
        results = read_results(folder)
        made, notes = exhibit(results, most=10**6)
        assert notes == []
        assert len(made.splats) == len(results.gaussians)
        np.testing.assert_array_equal(made.score, results.tamper)
        assert [place.name for place in made.poses] == [c.name for c in results.cameras]
        assert made.said[0] == headline(0.97, int(results.labels.sum()))
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

    def test_no_outlier_is_left_out_of_it(self, folder, monkeypatch):
        monkeypatch.setattr(viewing, "SAMPLE", 10)
        results = read_results(folder)
        means = np.array(results.gaussians.means)
        means[1001] = [0, 0, 500]
        gaussians = dataclasses.replace(results.gaussians, means=means)
        made, _ = exhibit(dataclasses.replace(results, gaussians=gaussians), most=10**6)
        assert 500 < made.far < 2000

    @pytest.mark.parametrize("size", [1e-3, 1e3])
    def test_it_is_as_far_as_the_scene_is_large(self, folder, size):
        results = read_results(folder)
        report = results.report | {"config": {"threshold": 0.5, "near": 1e-6}}
        results = dataclasses.replace(results, report=report)
        made, _ = exhibit(results, most=10**6)
        sized, _ = exhibit(_sized(results, size), most=10**6)
        assert sized.far == pytest.approx(size * made.far, rel=1e-3)
        assert sized.frustum == pytest.approx(size * made.frustum, rel=1e-3)

    def test_nothing_found_is_said(self, folder):
        results = read_results(folder)
        counts = results.report["counts"] | {"tampered": 0}
        report = results.report | {"counts": counts, "verdict": None}
        made, _ = exhibit(dataclasses.replace(results, report=report), most=10**6)
        assert made.said == ["No tampered Gaussian was found: none of 1,998, in 3 views."]

    def test_a_doubt_is_told_in_the_words_of_the_report(self, folder):
        results = read_results(folder)
        report = results.report | {"verdict": 0.4}
        made, _ = exhibit(dataclasses.replace(results, report=report), most=10**6)
        assert made.said[0] == headline(0.4, 1)
        assert made.said[1].startswith("If something was: ")
        assert "is 40%." in made.said[1]


def _sized(results: Results, size: float) -> Results:
    """Results in another unit of length."""
    gaussians = results.gaussians
    gaussians = dataclasses.replace(
        gaussians,
        means=(size * np.asarray(gaussians.means)).astype(np.float32),
        log_scales=(np.asarray(gaussians.log_scales) + np.log(size)).astype(np.float32),
    )
    cameras = []
    for camera in results.cameras:
        viewmat = np.array(camera.viewmat)
        viewmat[:3, 3] *= size
        cameras.append(dataclasses.replace(camera, viewmat=viewmat))
    return dataclasses.replace(results, gaussians=gaussians, cameras=cameras)


class TestPanel:
    @pytest.fixture(scope="class")
    @staticmethod
    def made(folder) -> Exhibit:
        return exhibit(read_results(folder), most=10**6)[0]

    @pytest.fixture
    def inputs(self, made) -> Iterator[dict[str, Any]]:
        """The inputs of a panel that is served, by label."""
        pytest.importorskip("viser")
        with serving(made, host="localhost", port=0) as server:
            handles = server.gui._gui_input_handle_from_uuid.values()
            yield {getattr(handle, "label", ""): handle for handle in handles}

    @pytest.fixture
    def painted(self, monkeypatch) -> list[tuple[str, float]]:
        """What was computed, as modes and thresholds."""
        asked: list[tuple[str, float]] = []

        def recorded(splats, score, mode, threshold):
            asked.append((mode, threshold))
            return shown(splats, score, mode, threshold)

        monkeypatch.setattr(panel, "shown", recorded)
        return asked

    def test_a_threshold_is_sent_where_it_matters_and_once(self, inputs, painted):
        inputs["threshold"].value = 0.25
        assert painted == []
        inputs["show"].value = "tampered only"
        inputs["threshold"].value = 0.75
        inputs["show"].value = "heat map"
        inputs["threshold"].value = 0.5
        inputs["show"].value = "original"
        assert painted == [
            ("tampered only", 0.25),
            ("tampered only", 0.75),
            ("heat map", 0.75),
            ("original", 0.5),
        ]

    def test_of_changes_in_quick_succession_the_last_is_sent_once(self, inputs, monkeypatch):
        painted: list[float] = []
        begun, go_on = threading.Event(), threading.Event()

        def slowly(splats, score, mode, threshold):
            painted.append(threshold)
            begun.set()
            assert go_on.wait(PATIENCE)
            return shown(splats, score, mode, threshold)

        def moved(value: float) -> threading.Thread:
            thread = threading.Thread(target=setattr, args=(slider, "value", value))
            thread.start()
            end = time.monotonic() + PATIENCE
            while slider.value != value:
                assert time.monotonic() < end
                time.sleep(0.01)
            return thread

        monkeypatch.setattr(panel, "shown", slowly)
        slider = inputs["threshold"]
        go_on.set()
        inputs["show"].value = "authentic only"
        begun.clear()
        go_on.clear()
        threads = [moved(0.125)]
        assert begun.wait(PATIENCE)
        threads += [moved(value) for value in (0.25, 0.375, 0.625, 0.875)]
        go_on.set()
        for thread in threads:
            thread.join(PATIENCE)
        assert painted[1:] == [0.125, 0.875]


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
