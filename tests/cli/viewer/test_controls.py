"""The panel of the served viewer: when the splats are sent again."""

import dataclasses
import threading
import time
import types
from collections.abc import Iterator

import numpy as np
import pytest
from results_folder import write_results

from gsc_jax.cli.results import read_results
from gsc_jax.cli.viewer import contents, controls
from gsc_jax.cli.viewer.access import Access
from gsc_jax.cli.viewer.contents import layer_colours, viewer_contents
from gsc_jax.cli.viewer.server import serving

pytest.importorskip("viser")

TIMEOUT_SECONDS = 20.0


@pytest.fixture
def inputs(tmp_path_factory: pytest.TempPathFactory) -> Iterator[controls.LayerInputs]:
    folder = tmp_path_factory.mktemp("controls") / "found"
    write_results(folder)
    shown, _ = viewer_contents(read_results(folder), most=10**6)
    with serving(Access(host="localhost", token="token"), port=0) as server:
        yield controls.add_layer_controls(server, shown)


def test_each_gaussian_is_in_the_layer_of_its_label_and_score(tmp_path, monkeypatch):
    write_results(tmp_path / "found")
    shown, _ = viewer_contents(read_results(tmp_path / "found"), most=10**6)
    score = np.random.default_rng(0).random(len(shown.score), np.float32)
    score[:3] = 0, shown.threshold, 1
    layers = {}
    node = types.SimpleNamespace(visible=True)
    monkeypatch.setattr(controls, "add_splats", lambda _, *of: layers.update([of]) or node)
    controls.add_layers(None, dataclasses.replace(shown, score=score))  # type: ignore[arg-type]
    assert len(layers.pop("/heat map").centers) == len(score)
    assert not node.visible
    assert list(layers)[:2] == ["/tampered/score 0.5 to 0.75", "/tampered/score 0.75 to 0.9"]
    for name, splats in layers.items():
        low, high = map(float, name.partition("score ")[2].split(" to "))
        inside = (score >= low) & ((score < high) | (high == 1))
        inside &= (score > shown.threshold) == name.startswith("/tampered")
        np.testing.assert_array_equal(splats.centers, shown.splats.centers[inside])
    assert sum(len(splats.centers) for splats in layers.values()) == len(score)


def test_threshold_is_sent_once_and_only_if_it_matters(
    inputs: controls.LayerInputs, monkeypatch: pytest.MonkeyPatch
):
    computed: list[tuple[str, float]] = []

    def recorded(*arguments, **options):
        computed.append(arguments[2:])
        return layer_colours(*arguments, **options)

    monkeypatch.setattr(contents, "layer_colours", recorded)
    inputs.layer.value = "original"
    inputs.threshold.value = 0.25
    assert computed == [("original", 0.0)]
    inputs.layer.value = "tampered only"
    inputs.threshold.value = 0.75
    inputs.layer.value = "heat map"
    inputs.threshold.value = 0.5
    inputs.layer.value = "result"
    after = [("tampered only", 0.25), ("tampered only", 0.75), ("heat map", 0.0), ("result", 0.5)]
    assert computed == [("original", 0.0), *after]


def test_last_of_several_quick_changes_is_sent_once(
    inputs: controls.LayerInputs, monkeypatch: pytest.MonkeyPatch
):
    computed: list[float] = []
    entered, released = threading.Event(), threading.Event()

    def slow(*arguments, **options):
        computed.append(arguments[3])
        entered.set()
        assert released.wait(TIMEOUT_SECONDS)
        return layer_colours(*arguments, **options)

    def change(value: float) -> threading.Thread:
        thread = threading.Thread(target=setattr, args=(inputs.threshold, "value", value))
        thread.start()
        end = time.monotonic() + TIMEOUT_SECONDS
        while inputs.threshold.value != value:
            assert time.monotonic() < end
            time.sleep(0.01)
        return thread

    inputs.layer.value = "authentic only"
    monkeypatch.setattr(contents, "layer_colours", slow)
    threads = [change(0.125)]
    assert entered.wait(TIMEOUT_SECONDS)
    threads += [change(value) for value in (0.25, 0.375, 0.625, 0.875)]
    released.set()
    for thread in threads:
        thread.join(TIMEOUT_SECONDS)
    assert computed == [0.125, 0.875]
