"""What the viewer shows of a folder of results."""

import dataclasses
import socket

import numpy as np
import pytest
from results_folder import write_results

from gsc_jax.cli.report.wording import headline
from gsc_jax.cli.results import Results, read_results
from gsc_jax.cli.viewer import contents as module
from gsc_jax.cli.viewer import page as page_module
from gsc_jax.cli.viewer.contents import viewer_contents
from gsc_jax.cli.viewer.page import viewer_page
from gsc_jax.forensics.evidence import forensic_evidence
from gsc_jax.scene.gaussians import concatenate

ALL = 10**6


@pytest.fixture(scope="module")
def results(tmp_path_factory: pytest.TempPathFactory) -> Results:
    folder = tmp_path_factory.mktemp("viewer") / "found"
    write_results(folder)
    return read_results(folder)


def scaled(results: Results, size: float) -> Results:
    """The same results in another unit of length."""
    gaussians = results.scene.gaussians
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
    scene = dataclasses.replace(results.scene, gaussians=gaussians)
    return dataclasses.replace(results, scene=scene, cameras=cameras)


def test_contents_are_those_of_the_results(results: Results):
    contents, notes = viewer_contents(results, most=ALL)
    assert notes == []
    assert len(contents.splats.centers) == len(results.scene.gaussians)
    order = np.argsort(contents.rows)
    np.testing.assert_array_equal(contents.rows[order], results.scene.rows)
    np.testing.assert_array_equal(contents.score[order], results.tamper)
    assert [pose.name for pose in contents.poses] == [camera.name for camera in results.cameras]
    tampered = int(results.labels.sum())
    assert contents.sentences[0] == headline(0.97, tampered)
    assert contents.total == results.scene.total


def test_traces_of_the_report_are_found_again(results: Results):
    scene = results.scene
    report = results.report | {"attributes": {"verdict": 0.9, "traces": {"row-order": "found"}}}
    half = scene.gaussians.take(np.arange(600))
    moved = dataclasses.replace(half, means=(np.asarray(half.means) + 3).astype(np.float32))
    both = concatenate([scene.gaussians, moved])
    rows = np.arange(len(both))
    doubled = dataclasses.replace(
        results,
        report=report,
        scene=dataclasses.replace(scene, gaussians=both, rows=rows),
        tamper=np.zeros(len(both), np.float32),
        labels=np.zeros(len(both), bool),
    )
    contents, _ = viewer_contents(doubled, most=ALL)
    expected = {t.name: t.score > 0.5 for t in forensic_evidence(both).traces if t.found}
    assert expected
    assert contents.traces.keys() == expected.keys()
    for name, has in expected.items():
        np.testing.assert_array_equal(contents.traces[name], has[contents.rows])
    assert viewer_contents(results, most=ALL)[0].traces == {}


def test_it_starts_at_the_view_that_shows_most_of_what_is_labelled(results: Results):
    views = [
        view | {"tampered_share": share}
        for view, share in zip(results.report["per_view"], (0.1, 0.3, 0.2), strict=True)
    ]
    shown = dataclasses.replace(results, report=results.report | {"per_view": views})
    names = [pose.name for pose in viewer_contents(shown, most=ALL)[0].poses]
    assert names == [views[k]["name"] for k in (1, 2, 0)]


def test_the_page_has_the_reason_and_the_reservation(results: Results):
    def sentences(**changes: object) -> str:
        changed = dataclasses.replace(results, report=results.report | changes)
        return " ".join(viewer_contents(changed, most=10)[0].sentences)

    trace = {"quantisation": "5 of 9 Gaussians have colours off the values."}
    traced = sentences(attributes={"verdict": 0.1, "traces": trace})
    assert "rests on a trace in the stored values" in traced
    assert trace["quantisation"] in traced
    assert "In tests of attributes in re-exported files" in sentences(
        attributes={"verdict": 0.1, "traces": {}}
    )
    assert "smaller in 98% of the pairs" in sentences(contrasts={"size": 0.02})
    both = sentences(attributes={"verdict": 0.1, "traces": {}}, judged_views=3)
    assert "In tests of masks and attributes" in both
    assert "In tests of simulated masks alone" in sentences(judged_views=3)


def test_omitted_gaussians_are_reported(results: Results):
    contents, notes = viewer_contents(results, most=100)
    assert len(contents.splats.centers) == len(contents.score) == 100
    assert "100 of 1,998 Gaussians" in notes[0]


def test_the_first_splats_show_the_labelled_ones_and_their_surroundings(results: Results):
    contents, _ = viewer_contents(results, most=100)
    assert (contents.score > contents.threshold).sum() == 50
    whole, _ = viewer_contents(results, most=ALL)
    np.testing.assert_array_equal(whole.rows[:100], contents.rows)


def test_far_plane_includes_outliers(results: Results, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(module, "MAX_DEPTH_SAMPLES", 10)
    means = np.array(results.scene.gaussians.means)
    means[1001] = [0, 0, 500]
    gaussians = dataclasses.replace(results.scene.gaussians, means=means)
    scene = dataclasses.replace(results.scene, gaussians=gaussians)
    contents, _ = viewer_contents(dataclasses.replace(results, scene=scene), most=ALL)
    for pose in contents.poses:
        distances = np.linalg.norm(contents.splats.centers - pose.position, axis=1)
        assert distances.max() < contents.far < 2000


@pytest.mark.parametrize("size", [1e-3, 1e3])
def test_lengths_scale_with_the_scene(results: Results, size: float):
    report = results.report | {"config": {"threshold": 0.5, "near": 1e-6}}
    results = dataclasses.replace(results, report=report)
    contents, _ = viewer_contents(results, most=ALL)
    other, _ = viewer_contents(scaled(results, size), most=ALL)
    assert other.far == pytest.approx(size * contents.far, rel=1e-3)


def test_sentences_without_labels_and_without_scene_probability(results: Results):
    counts = results.report["counts"] | {"tampered": 0}
    report = results.report | {"counts": counts, "verdict": None}
    contents, _ = viewer_contents(dataclasses.replace(results, report=report), most=ALL)
    assert len(contents.sentences) == 1
    assert "None of 1,998" in contents.sentences[0]


def test_hostile_names_are_escaped_in_the_page(results: Results, monkeypatch: pytest.MonkeyPatch):
    contents, _ = viewer_contents(results, most=10)
    bad = "</script><b>&'\""
    poses = [pose._replace(name=bad) for pose in contents.poses]
    contents = dataclasses.replace(contents, title=bad, sentences=[bad], poses=poses)
    client = "<html><body><script>scene</script></body></html>"
    monkeypatch.setattr(page_module, "_client", lambda *_: client)
    page = viewer_page(contents)
    assert "<b>" not in page
    assert page.count("</script>") == page.count("<script") == 3


def test_nobody_listens_while_the_page_is_made(results: Results, monkeypatch: pytest.MonkeyPatch):
    viser, ports, refused = pytest.importorskip("viser"), [], []

    class Watched(viser.ViserServer):
        def __init__(self, *arguments, **options):
            super().__init__(*arguments, **options)
            ports.append(self.get_port())

    def add_splats(*_: object) -> None:
        with pytest.raises(ConnectionError):
            socket.create_connection(("127.0.0.1", ports[0]))
        refused.append(True)

    monkeypatch.setattr(viser, "ViserServer", Watched)
    monkeypatch.setattr(page_module, "add_splats", add_splats)
    viewer_page(viewer_contents(results, most=10)[0])
    assert refused == [True]
