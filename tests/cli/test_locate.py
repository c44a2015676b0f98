"""`gsc-jax locate`: the folder of results, and the options."""

import json
import os
import shutil
import sys

import imageio.v3 as iio
import numpy as np
import pytest
from cli_case import BROKEN, COUNT, FIXTURES, NAMES, contents, given, refused, report, run
from plyfile import PlyData

from gsc_jax.benchmark.metrics import confusion
from gsc_jax.cli.pictures import layer_path
from gsc_jax.cli.staging import BY_CAMERA, EVALUATION_MARK, FILES
from gsc_jax.forensics.contrast import contrasts
from gsc_jax.io.masks import image_path, read_probability, write_mask
from gsc_jax.io.ply import read_ply

case, found, own_cache = FIXTURES
pytestmark = pytest.mark.usefixtures("own_cache")


def test_the_summary_counts_labels_and_names_files(found):
    out, answer = found
    assert answer.code == 0
    first = answer.out.splitlines()[0]
    labels = np.load(out / "labels.npy")
    count = f"{labels.sum():,} of {COUNT - len(BROKEN)} Gaussians"
    assert first.startswith(f"Evidence of editing. {count}")
    assert "3 views" in first
    for name in ("report.html", "overview.png", "tamper.ply", "result.json"):
        assert str(out / name) in answer.out
    assert answer.err.startswith("1 warning:\n  ")
    assert answer.err.count("\n") == 2
    assert "left out 2 of 300 Gaussians" in answer.err


def test_the_folder_holds_the_documented_files_and_no_others(found):
    out, _ = found
    expected = set(FILES)
    for name in NAMES:
        expected |= {f"{kind}/{name}.png" for kind in ("masks", "scores", "detector")}
        expected |= {layer_path("", kind, name).as_posix() for kind in ("render", "overlay")}
    files = contents(out).keys()
    assert files == expected
    assert [path for path in out.iterdir() if path.name.startswith(".")] == []
    assert report(out)["outputs"].keys() == set(files)
    assert {*FILES, *BY_CAMERA} == {name.split("/")[0] for name in files}


def test_the_object_is_found(case, found):
    out, _ = found
    truth = np.load(case / "truth.npy")
    truth[list(BROKEN)] = False
    assert confusion(np.load(out / "labels.npy"), truth).f1 > 0.8
    for name in NAMES:
        mask = read_probability(image_path(out / "masks", name))
        assert confusion(mask, read_probability(image_path(case / "masks", name))).f1 > 0.8


def test_tamper_ply_is_the_scene_plus_one_property(case, found):
    out, _ = found
    before = PlyData.read(case / "scene.ply")["vertex"]
    after = PlyData.read(out / "tamper.ply")["vertex"]
    names = [prop.name for prop in before.properties]
    assert [prop.name for prop in after.properties] == [*names, "tamper"]
    assert after.data.dtype["tamper"] == np.dtype("<f4")
    for name in names:
        assert after.data.dtype[name] == before.data.dtype[name]
        np.testing.assert_array_equal(after[name], before[name])
    np.testing.assert_array_equal(after["tamper"], np.load(out / "tamper.npy"))


def test_arrays_have_an_entry_per_row_of_the_file(found):
    out, _ = found
    labels, tamper = np.load(out / "labels.npy"), np.load(out / "tamper.npy")
    assert (labels.dtype, labels.shape) == (np.dtype(bool), (COUNT,))
    assert (tamper.dtype, tamper.shape) == (np.dtype(np.float32), (COUNT,))
    assert not labels[list(BROKEN)].any()
    assert not tamper[list(BROKEN)].any()
    assert ((tamper >= 0) & (tamper <= 1)).all()
    np.testing.assert_array_equal(labels, tamper > 0.5)


def test_highlight_holds_the_valid_rows_coloured_by_label(found):
    out, _ = found
    vertex = PlyData.read(out / "highlight.ply")["vertex"]
    labels = np.delete(np.load(out / "labels.npy"), BROKEN)
    assert len(vertex) == COUNT - len(BROKEN)
    np.testing.assert_array_equal(vertex["f_dc_0"] > vertex["f_dc_1"] + 0.1, labels)


def test_images_have_the_size_of_the_views(case, found):
    out, _ = found
    for name in NAMES:
        final = iio.imread(image_path(out / "masks", name))
        assert (final.shape, final.dtype) == ((40, 48), np.dtype(np.uint8))
        assert set(np.unique(final)) == {0, 255}
        for kind in ("render", "overlay"):
            assert iio.imread(layer_path(out, kind, name)).shape == (40, 48, 3)
        np.testing.assert_array_equal(
            read_probability(image_path(out / "detector", name)),
            read_probability(image_path(case / "masks", name)),
        )
    sheet = iio.imread(out / "overview.png")
    assert sheet.shape[0] > 300
    assert sheet[..., :3].std() > 10, "the overview is empty"


def test_result_json_holds_options_configuration_and_counts(case, found):
    out, _ = found
    result = report(out)
    command, counts, views = result["command"], result["counts"], result["per_view"]
    assert (command["masks"], command["detector"]) == (str(case / "masks"), [])
    assert (command["scale"], command["threshold"]) == (None, None)
    assert (result["method"], result["config"]["threshold"], result["seed"]) == ("robust", 0.5, 0)
    assert 0 < result["verdict"] < 1
    assert {view["reliability"] for view in views} <= {"reliable", "uninformative", "inverted"}
    assert counts["rows"] == COUNT
    assert counts["dropped"] == {"position not finite": 1, "rotation zero": 1}
    assert counts["gaussians"] == COUNT - 2 == counts["seen"] + counts["unseen"]
    assert counts["tampered"] == np.load(out / "labels.npy").sum()
    assert result["views"] == result["judged_views"] == 3
    assert [view["name"] for view in views] == list(NAMES)
    areas = [view["tampered_share"] for view in views]
    scene = read_ply(case / "scene.ply")
    labels = np.load(out / "labels.npy")[scene.rows]
    assert result["contrasts"] == contrasts(scene.gaussians, labels)
    assert result["tampered_share_of_views"] == pytest.approx(np.mean(areas))
    assert areas[0] == pytest.approx(iio.imread(image_path(out / "masks", NAMES[0])).mean() / 255)
    assert {"load", "lift", "optimise", "masks", "write"} < set(result["stages"])
    assert all(stage["seconds"] >= 0 for stage in result["stages"].values())
    assert {"gsc_jax", "python", "jax", "device"} < set(result["versions"])
    assert len(result["warnings"]) == 1


def test_a_second_run_replaces_the_first_and_nothing_else(case, tmp_path):
    out = tmp_path / "out"
    assert "has replaced" not in run(*given(case), "--out", out).out
    (out / "masks" / "mine.png").write_bytes(b"mine")
    (out / "notes.txt").write_text("mine")
    again = run(*given(case, views=1, scale=0.5, method="paper", seed=3), "--out", out)
    assert again.code == 0
    assert f"{out}: has replaced results of '{case / 'scene.ply'}'" in again.out
    assert [p.name for p in sorted((out / "masks").rglob("*.png"))] == [
        "img.0001.JPG.png",
        "mine.png",
    ]
    assert (out / "notes.txt").read_text() == "mine"
    assert iio.imread(image_path(out / "masks", NAMES[0])).shape == (20, 24)
    result = report(out)
    assert (result["method"], result["seed"], result["config"]["seed"]) == ("paper", 3, 3)
    assert result["views"] == 1


def test_the_cameras_may_be_in_the_folder_of_results(case, tmp_path):
    """A run with fewer views removes masks and scores of the run before, and no input."""
    shutil.copy(case / "cameras.json", tmp_path)
    (tmp_path / "evaluation.json").write_text(f"{EVALUATION_MARK}not of these results")
    assert run(*given(case, cameras=tmp_path), "--out", tmp_path).code == 0
    assert (tmp_path / "evaluation.json").exists()
    assert run(*given(case, cameras=tmp_path, views=1), "--out", tmp_path).code == 0
    assert report(tmp_path)["views"] == 1
    assert len(list((tmp_path / "masks").rglob("*.png"))) == 1
    assert (tmp_path / "cameras.json").read_bytes() == (case / "cameras.json").read_bytes()
    assert not (tmp_path / "evaluation.json").exists(), "scores of another run were kept"
    (tmp_path / "cameras.json").unlink()
    again = given(case, cameras=tmp_path / "views.json")
    assert "another --out" in refused(*again, "--out", tmp_path)
    assert run(*again, "--out", tmp_path / "out").code == 0


@pytest.mark.skipif(sys.platform != "linux", reason="file names are valid text here")
def test_paths_need_not_be_valid_text(case, tmp_path):
    scene = tmp_path / os.fsdecode(b"sc\xff.ply")
    shutil.copy(case / "scene.ply", scene)
    out = tmp_path / os.fsdecode(b"\xfe")
    assert run(*given(case, scene=scene), "--out", out).code == 0
    result = report(out)
    assert result["command"]["scene"] == str(tmp_path / r"sc\xff.ply")
    assert r"sc\xff.ply: left out 2" in result["warnings"][0]
    assert r"sc\xff.ply" in (out / "report.html").read_text(encoding="utf-8")
    assert run("evaluate", out, "--truth", case / "truth.npy").code == 0
    assert json.loads((out / "evaluation.json").read_bytes())["folder"] == str(tmp_path / r"\xfe")


def test_the_scene_may_be_an_earlier_result(case, found, tmp_path):
    answer = run(*given(case, scene=found[0] / "tamper.ply"), "--out", tmp_path)
    assert answer.code == 0
    assert "already has a property tamper" in answer.err
    np.testing.assert_array_equal(
        np.load(tmp_path / "tamper.npy"), np.load(found[0] / "tamper.npy")
    )
    assert "another --out" in refused(
        *given(case, scene=found[0] / "tamper.ply"), "--out", found[0]
    )


def test_a_picture_of_results_is_no_scene(case, found, tmp_path):
    picture = found[0] / "highlight.ply"
    assert "give the original scene" in refused(*given(case, scene=picture), "--out", tmp_path)


def test_views_without_a_mask_get_a_final_mask(case, tmp_path):
    shutil.copytree(case / "masks", tmp_path / "masks")
    (tmp_path / "masks" / "c.png").unlink()
    answer = run(*given(case, masks=tmp_path / "masks"), "--out", tmp_path / "out")
    assert "1 of 3" in answer.err
    result = report(tmp_path / "out")
    assert (result["views"], result["judged_views"]) == (3, 2)
    assert (tmp_path / "out" / "masks" / "c.png").is_file()
    assert not (tmp_path / "out" / "detector" / "c.png").exists()


def test_empty_masks_label_nothing(case, tmp_path):
    for name in NAMES:
        write_mask(image_path(tmp_path / "masks", name), np.zeros((40, 48), bool))
    answer = run(*given(case, masks=tmp_path / "masks"), "--out", tmp_path / "out")
    assert "masks are empty" in answer.err
    assert not np.load(tmp_path / "out" / "labels.npy").any()
