"""`gsc-jax evaluate`: scores equal the metrics, and an invalid truth is refused."""

import json
import shutil
from pathlib import Path

import numpy as np
import pytest
from cli_case import COUNT, FIXTURES, NAMES, refused, run
from data import DATA, TAMPERED, needs_data

from gsc_jax.benchmark.metrics import auc, confusion
from gsc_jax.io.masks import image_path, read_probability, write_mask
from gsc_jax.scene import InputError

case, found, own_cache = FIXTURES


@pytest.fixture
def folder(found, tmp_path) -> Path:
    """A copy of results that tests may change."""
    return shutil.copytree(found[0], tmp_path / "results")


def mask(folder: Path, name: str) -> np.ndarray:
    return read_probability(image_path(folder, name)) > 0.5


def numbers(folder: Path) -> dict:
    return json.loads((folder / "evaluation.json").read_text())


def test_by_gaussian(case, folder):
    answer = run("evaluate", folder, "--truth", case / "truth.npy")
    assert (answer.code, answer.err) == (0, "")
    truth, labels = np.load(case / "truth.npy"), np.load(folder / "labels.npy")
    expected = confusion(labels, truth)
    scores = numbers(folder)["gaussians"]
    assert scores["rows"] == COUNT
    assert (scores["tampered"], scores["found"]) == (truth.sum(), labels.sum())
    assert scores["both"] == (truth & labels).sum()
    for name in ("f1", "iou", "precision", "recall"):
        assert scores[name] == pytest.approx(getattr(expected, name))
        assert f"{getattr(expected, name):.3f}" in answer.out
    assert scores["auc"] == pytest.approx(auc(np.load(folder / "tamper.npy"), truth))
    assert "views" not in numbers(folder)
    assert str(folder / "evaluation.json") in answer.out


def test_by_view_with_the_detector_beside_it(case, folder, tmp_path):
    # One final mask covers half of the truth; the masks of the detector equal the truth.
    truth = mask(case / "masks", NAMES[0])
    half = truth & (np.cumsum(truth).reshape(truth.shape) <= truth.sum() // 2)
    write_mask(image_path(folder / "masks", NAMES[0]), half)
    shutil.copytree(case / "masks", tmp_path / "truth")
    write_mask(image_path(tmp_path / "truth", NAMES[2]), np.zeros_like(truth))
    out = tmp_path / "new" / "scores.json"
    answer = run("evaluate", folder, "--truth", tmp_path / "truth", "--out", out)
    assert answer.code == 0
    assert not (folder / "evaluation.json").exists()
    views = json.loads(out.read_text())["views"]
    final, detector = views["found"]["per_view"], views["detector"]["per_view"]
    assert set(final) == set(detector) == set(NAMES[:2])
    assert final[NAMES[0]]["recall"] == pytest.approx(half.sum() / truth.sum())
    assert final[NAMES[0]]["precision"] == pytest.approx(1)
    assert detector[NAMES[0]]["f1"] == pytest.approx(1)
    assert views["found"]["f1"] == pytest.approx(np.mean([v["f1"] for v in final.values()]))
    flagged = views["found"]["per_authentic_view"]
    assert flagged == {NAMES[2]: pytest.approx(mask(folder / "masks", NAMES[2]).mean())}
    assert views["detector"]["false_positive_area"] == pytest.approx(
        mask(folder / "detector", NAMES[2]).mean()
    )
    for part in (NAMES[0], "mean of 2", "2D masks on 2 + 1 judged"):
        assert part in answer.out
    assert views["truth"][NAMES[0]] == pytest.approx(truth.mean())


def test_both_at_once_in_any_order(case, folder):
    answer = run("evaluate", folder, "--truth", case / "truth.npy", case / "masks")
    assert answer.code == 0
    assert {"gaussians", "views"} < set(numbers(folder))
    again = run("evaluate", folder, "--truth", case / "masks", case / "truth.npy")
    assert again.out == answer.out


def test_results_without_a_detector(case, folder):
    shutil.rmtree(folder / "detector")
    answer = run("evaluate", folder, "--truth", case / "masks")
    assert "2D" not in answer.out
    assert "detector" not in numbers(folder)["views"]


def test_truth_of_some_views_and_of_another_size(case, folder, tmp_path):
    truth = mask(case / "masks", NAMES[0])
    write_mask(image_path(tmp_path / "truth", NAMES[0]), np.kron(truth, np.ones((3, 3), bool)))
    answer = run("evaluate", folder, "--truth", tmp_path / "truth")
    assert answer.err.startswith("2 warnings:\n")
    assert "2 of 3 views have no mask" in answer.err
    assert "another size" in answer.err
    scores = numbers(folder)["views"]["detector"]["per_view"]
    assert list(scores) == [NAMES[0]]
    assert scores[NAMES[0]]["f1"] > 0.98
    assert numbers(folder)["warnings"]


def test_nothing_tampered_anywhere(folder, tmp_path):
    for name in NAMES:
        write_mask(image_path(tmp_path / "truth", name), np.zeros((40, 48), bool))
    np.save(tmp_path / "truth.npy", np.zeros(COUNT, bool))
    answer = run("evaluate", folder, "--truth", tmp_path / "truth", tmp_path / "truth.npy")
    assert answer.code == 0
    assert "mean of 0" in answer.out
    assert numbers(folder)["gaussians"]["auc"] is None
    assert "nan" not in answer.out
    assert numbers(folder)["views"]["found"]["f1"] is None


def test_a_detector_is_compared_on_the_views_that_it_judged(case, folder):
    """Its only mask is right; the final mask covers half there, and everything elsewhere."""
    truth = {name: mask(case / "masks", name) for name in NAMES}
    whole = truth[NAMES[0]]
    half = whole & (np.cumsum(whole).reshape(whole.shape) <= whole.sum() / 2)
    for name in NAMES:
        write_mask(image_path(folder / "masks", name), half if name == NAMES[0] else truth[name])
        image_path(folder / "detector", name).unlink()
    write_mask(image_path(folder / "detector", NAMES[0]), whole)
    answer = run("evaluate", folder, "--truth", case / "masks")
    views = numbers(folder)["views"]
    judged = views["found"]["per_view"][NAMES[0]]["f1"]
    assert 0.6 < judged < 0.7
    assert views["found_where_judged"]["f1"] == pytest.approx(judged)
    assert views["found"]["f1"] == pytest.approx((judged + 2) / 3, abs=1e-3)
    rows = {line[:32].strip(): line[32:].split() for line in answer.out.splitlines()}
    assert rows["mean of 3"][0] == f"{views['found']['f1']:.3f}"
    assert rows["found on 1 + 0 judged"][0] == f"{judged:.3f}"
    assert rows["2D masks on 1 + 0 judged"][:2] == ["1.000", "1.000"]


@pytest.mark.parametrize(
    ("array", "expected"),
    [
        (np.zeros(COUNT - 2, bool), f"expected a .npy of {COUNT} numbers"),
        (np.zeros((COUNT, 1), bool), "shape (300, 1)"),
        (np.linspace(0, 1, COUNT), "float64"),
        (np.full(COUNT, 2), "int64"),
    ],
)
def test_labels_of_another_scene(folder, tmp_path, array, expected):
    np.save(tmp_path / "truth.npy", array)
    message = refused("evaluate", folder, "--truth", tmp_path / "truth.npy")
    assert f"{tmp_path / 'truth.npy'}: " in message
    assert expected in message


def test_invalid_truths(case, folder, tmp_path):
    file, several = tmp_path / "truth.npy", tmp_path / "truth.npz"
    file.write_bytes(b"no array")
    np.savez(several, a=np.zeros(2))
    masks, other = tmp_path / "masks", tmp_path / "other"
    write_mask(masks / "other.png", np.zeros((40, 48), bool))
    write_mask(image_path(other, NAMES[0]), np.zeros((40, 40), bool))
    for truth, expected in (
        ([file], "damaged"),
        ([several], "damaged"),
        ([tmp_path / "missing"], "no such file or folder"),
        ([masks], "none of its 1 images"),
        ([other], "has 40 x 40 pixels, the view 48 x 40"),
        ([masks, other], "or one of each"),
        ([case / "truth.npy", file], "or one of each"),
        ([], "--truth"),
    ):
        assert expected in refused("evaluate", folder, "--truth", *truth)
    assert not (folder / "evaluation.json").exists()


@pytest.mark.parametrize(
    ("memory", "problem"),
    [("-1", "--memory -1"), ("1e300", "--memory 1e+300"), ("1e-6", "of memory")],
)
def test_memory_is_bounded_by_an_option(case, folder, memory, problem):
    bound = ("--memory", memory)
    assert problem in refused("evaluate", folder, "--truth", case / "truth.npy", *bound)
    assert problem in refused("view", folder, "--html", folder / "page.html", *bound)


@pytest.mark.parametrize("file", ["masks", "views.json"])
def test_the_bound_on_memory_reaches_every_file(case, folder, monkeypatch, file):
    checked = {"masks": "gsc_jax.io.masks", "views.json": "gsc_jax.io.tables"}[file]

    def check(path, needed, limit):
        if Path(path).is_relative_to(folder / file):
            raise InputError(f"{path}: {needed} of {limit}")

    monkeypatch.setattr(f"{checked}.check_allocation", check)
    message = refused("evaluate", folder, "--truth", case / "masks", "--memory", 3)
    assert message.strip().endswith(f" of {3 * 2**30}")


def test_folders_without_results_and_with_masks_of_another_run(case, folder):
    assert "holds no results" in refused("evaluate", case, "--truth", case / "truth.npy")
    write_mask(image_path(folder / "masks", NAMES[0]), np.zeros((4, 4), bool))
    message = refused("evaluate", folder, "--truth", case / "masks")
    assert "4 x 4 pixels, expected 48 x 40" in message


@needs_data
def test_a_real_scene(tmp_path):
    """The truth of the shared scenes has the format of `tamper`."""
    given = DATA / "tampered" / TAMPERED[1]
    argv = [given / "scene.ply", "--cameras", given / "cameras.json", "--masks", given / "detector"]
    options = ["--detector", "none", "--views", 6, "--scale", 0.25]
    assert run("locate", *argv, *options, "--out", tmp_path).code == 0
    answer = run("evaluate", tmp_path, "--truth", given / "labels.npy", given / "truth")
    assert answer.code == 0
    assert "another size" in answer.err
    assert numbers(tmp_path)["gaussians"]["rows"] == 123_214
    assert numbers(tmp_path)["views"]["found"]["f1"] >= 0


def test_only_earlier_scores_are_replaced(case, folder, tmp_path):
    truth = tmp_path / "labels.npy"
    shutil.copy(folder / "labels.npy", truth)
    before = truth.read_bytes()
    for out in (truth, folder / "result.json"):
        message = refused("evaluate", folder, "--truth", truth, "--out", out)
        assert f"{out}: exists and is not from an earlier run" in message
    assert truth.read_bytes() == before
    for _ in range(2):
        assert run("evaluate", folder, "--truth", truth, "--out", tmp_path / "own.json").code == 0
