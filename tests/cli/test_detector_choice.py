"""The estimator and the detectors of a run, and the cache of the outputs of a 2D network."""

import numpy as np
import pytest
from cli_case import (
    BROKEN,
    FIXTURES,
    NAMES,
    given,
    network,
    record_network_views,
    refused,
    report,
    run,
    unparsable,
)

from gsc_jax.benchmark.metrics import confusion

case, found, own_cache = FIXTURES
pytestmark = pytest.mark.usefixtures("own_cache")


def test_a_network_runs_on_the_renders(case, tmp_path):
    argv = given(case, masks=None, detector=network(tmp_path / "red.onnx"))
    assert run(*argv, "--out", tmp_path / "out").code == 0
    truth = np.load(case / "truth.npy")
    truth[list(BROKEN)] = False
    assert confusion(np.load(tmp_path / "out" / "labels.npy"), truth).f1 > 0.8
    assert "render" in report(tmp_path / "out")["stages"]


def test_invalid_specs(case, tmp_path):
    spec = tmp_path / "net.toml"
    model = network(tmp_path / "red.onnx")
    argv = [*given(case, masks=None, detector=model, spec=spec), "--out", tmp_path / "no"]
    for text in ("size = 0\n", "size = \n"):
        spec.write_text(text)
        assert f"{spec}: " in refused(*argv)
    assert "one of them" in refused(*argv, "--preset", "trufor")


def test_the_spec_beside_a_model_is_used_and_reported(case, tmp_path):
    model = network(tmp_path / "red.onnx")
    beside, other = tmp_path / "red.toml", tmp_path / "other.toml"
    beside.write_text('chanels = "bgr"\n')
    argv = given(case, masks=None, detector=model, method="official")
    message = refused(*argv, "--out", tmp_path / "no")
    assert f"{beside}: unknown key 'chanels' (did you mean 'channels'?)" in message
    beside.write_text('channels = "bgr"\n')
    assert run(*argv, "--out", tmp_path / "out").code == 0
    assert report(tmp_path / "out")["command"]["spec"] == str(beside)
    truth = np.load(case / "truth.npy")
    assert confusion(np.load(tmp_path / "out" / "labels.npy"), truth).f1 < 0.5, (
        "colours not swapped"
    )
    other.write_text("")
    assert run(*argv, "--spec", other, "--out", tmp_path / "out").code == 0
    assert report(tmp_path / "out")["command"]["spec"] == str(other)
    assert confusion(np.load(tmp_path / "out" / "labels.npy"), truth).f1 > 0.8
    # A preset overrides the file beside the model.
    beside.write_text("size = 0\n")
    assert run(*argv, "--preset", "pscc-net", "--out", tmp_path / "out").code == 0
    assert report(tmp_path / "out")["command"]["spec"] is None


def test_a_second_run_reads_the_outputs_of_the_network_from_the_cache(
    case, tmp_path, monkeypatch, own_cache
):
    judged = record_network_views(monkeypatch)
    argv = given(case, masks=None, detector=network(tmp_path / "red.onnx"))
    assert run(*argv, "--no-cache", "--out", tmp_path / "never").code == 0
    assert not own_cache.exists()
    assert run(*argv, "--out", tmp_path / "first").code == 0
    assert len(judged) == 2 * len(NAMES)
    assert run(*argv, "--out", tmp_path / "again", "--threads", 1).code == 0
    assert run(*argv, "--out", tmp_path / "lifted", "--method", "official").code == 0
    assert len(judged) == 2 * len(NAMES), "a network was run again"
    for name in ("first", "again"):
        tamper = np.load(tmp_path / name / "tamper.npy")
        np.testing.assert_array_equal(tamper, np.load(tmp_path / "never" / "tamper.npy"))
    assert run(*argv, "--out", tmp_path / "smaller", "--scale", 0.5).code == 0
    assert len(judged) == 3 * len(NAMES), "another image, the same output"


def test_invalid_providers_and_threads(case, tmp_path):
    out = "--out", tmp_path / "out"
    argv = given(case, masks=None, detector=network(tmp_path / "red.onnx"))
    assert "no provider 'abacus'" in refused(*argv, "--provider", "abacus", *out)
    assert "-1 threads" in refused(*argv, "--threads", -1, *out)
    assert "--threads" in unparsable(*argv, "--threads", "all", *out)


def test_a_network_of_the_wrong_shape(case, tmp_path):
    model = network(tmp_path / "wide.onnx", channels=6)
    message = refused(*given(case, masks=None, detector=model), "--out", tmp_path / "out")
    assert str(model) in message
    assert "[1, 6, ?, ?]" in message or "[1, 6, h, w]" in message
    assert not (tmp_path / "out").exists()
