"""`gsc-jax locate --dry-run`: validates and describes a run, and writes nothing."""

import json
import shutil

import pytest
from cli_case import COUNT, FIXTURES, contents, given, network, refused, report, run

case, found, own_cache = FIXTURES
pytestmark = pytest.mark.usefixtures("own_cache")


def test_it_describes_the_run_and_writes_nothing(case, tmp_path):
    out = tmp_path / "new" / "out"
    answer = run(*given(case), "--out", out, "--dry-run")
    assert answer.code == 0
    assert not out.parent.exists()
    for expected in (
        f"{COUNT - 2} Gaussians",
        f"3 of 48 x 40 pixels, from {case / 'cameras.json'}",
        "the attributes of the Gaussians",
        f"masks in {case / 'masks'} of 3 views",
        "name = robust",
        "threshold = 0.5",
        f"{out}: new results",
    ):
        assert expected in answer.out
    assert "left out 2 of 300" in answer.err


def test_it_warns_of_what_a_run_warns_of_once(case, tmp_path):
    cameras = json.loads((case / "cameras.json").read_text())
    cameras[2]["position"] = [1000.0, 1000.0, 1000.0]
    (tmp_path / "cameras.json").write_text(json.dumps(cameras))
    argv = *given(case, cameras=tmp_path / "cameras.json"), "--out", tmp_path / "out"
    assert run(*argv, "--dry-run").err.count("1 of 3 cameras see too little") == 1
    assert run(*argv).code == 0
    warnings = report(tmp_path / "out")["warnings"]
    assert sum("1 of 3 cameras see too little" in warning for warning in warnings) == 1


def test_existing_results_stay(case, found):
    out, _ = found
    before = contents(out)
    answer = run(*given(case, method="paper", lambda2=3), "--out", out, "--dry-run")
    assert f"{out}: replaces results of '{case / 'scene.ply'}'" in answer.out
    assert "epochs = 5" in answer.out
    assert "loop.lambda2 = 3.0" in answer.out
    assert contents(out) == before


def test_every_mask_is_read(case, tmp_path):
    shutil.copytree(case / "masks", tmp_path / "masks")
    last = max(path for path in (tmp_path / "masks").rglob("*") if path.is_file())
    last.write_text("no image")
    argv = given(case, masks=tmp_path / "masks")
    assert str(last) in refused(*argv, "--out", tmp_path / "out", "--dry-run")


def test_a_network_is_loaded_but_not_run(case, tmp_path, own_cache):
    model = network(tmp_path / "red.onnx")
    answer = run(*given(case, masks=None, detector=model), "--out", tmp_path / "o", "--dry-run")
    assert f"{model} on up to 3 views" in answer.out
    assert not (own_cache / "probability-maps").exists()


@pytest.mark.parametrize(
    ("changes", "expected"),
    [
        ({"masks": "missing"}, "missing: does not exist"),
        ({"near": 50}, "the near plane at 50"),
        ({"masks": None, "detector": "missing.onnx"}, "missing.onnx: no such file"),
        ({"masks": None, "detector": "nativ"}, "expected native, none or a model"),
    ],
)
def test_it_refuses_what_a_run_refuses(case, tmp_path, changes, expected):
    message = refused(*given(case, **changes), "--out", tmp_path / "out", "--dry-run")
    assert expected in message


def test_it_refuses_a_folder_that_cannot_be_written(case, tmp_path):
    (tmp_path / "file").write_text("in the way")
    message = refused(*given(case), "--out", tmp_path / "file" / "out", "--dry-run")
    assert "cannot be written" in message
