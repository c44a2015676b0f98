"""A fingerprint changes with everything that determines the output of a model."""

import pytest
from onnx_models import WEIGHTS, external_data, external_model, network

from gsc_jax.detectors.session import external_files, fingerprint


@pytest.mark.parametrize("name", ["w", "sub/w.bin", "é.data", "n" * 127, "n" * 128, "n" * 240])
def test_external_files_are_found(tmp_path, name):
    external_data(tmp_path / name)
    external_data(tmp_path / "other.bin")
    assert external_files(external_model(tmp_path, name)) == [tmp_path / name]


def test_plain_model_has_no_external_files(tmp_path):
    assert external_files(network(tmp_path)) == []


def test_fingerprint_depends_on_facts_model_and_external_data(tmp_path):
    weights = external_data(tmp_path / "w.bin")
    path = external_model(tmp_path, "w.bin")
    first = fingerprint(path, "spec")
    assert fingerprint(path, "spec") == first, "fingerprints are not reproducible"
    found = {first, fingerprint(path, "other spec"), fingerprint(path, "spec", "cuda")}
    weights.write_bytes((2 * WEIGHTS).tobytes())
    found.add(fingerprint(path, "spec"))
    external_data(tmp_path / "sub" / "w.bin")
    found.add(fingerprint(external_model(tmp_path, "sub/w.bin"), "spec"))
    assert len(found) == 5
