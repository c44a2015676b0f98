"""The runner against the library, on a small made scene."""

import dataclasses

import cases
import numpy as np
import pandas as pd
import pytest
import runner
from methods import ALL_METHODS, labelled
from observations import Prediction, observe_regimes
from scipy.special import logit
from strategies import blobs, camera
from tables import ITSELF, TRUTH, read_csv, write_csv

from gsc_jax.benchmark.simulate import REGIMES
from gsc_jax.evidence.observation import observe
from gsc_jax.scene import Gaussians, InputError

CAMERA = camera(17, 15)


@pytest.fixture(scope="module")
def case():
    return cases.make_case(cases.QUICK, "incorporation", 0)


def test_all_regimes_are_lifted_as_by_observe(case):
    masks = cases.detector_masks(case, {name: REGIMES[name] for name in ("clean", "mixture")})
    for regime, observed in observe_regimes(case, masks).items():
        named = dict(zip([c.name for c in case.scene.cameras], masks[regime], strict=True))
        alone = observe(case.gaussians, case.scene.cameras, named)
        lifted = observed.observation
        np.testing.assert_allclose(lifted.evidence.total, alone.evidence.total, rtol=1e-4)
        difference = np.abs(lifted.evidence.tampered - alone.evidence.tampered)
        assert difference.max() < 1e-2
        assert np.array_equal(lifted.votes.tampered, alone.votes.tampered)


def test_the_true_labels_score_one_and_no_labels_score_zero(case):
    observed = observe_regimes(case, cases.detector_masks(case, {"clean": REGIMES["clean"]}))
    nothing = {"nothing": lambda one: labelled(np.zeros_like(one.case.labels))}
    itself, truth, none = runner.judge(observed, nothing)
    assert itself["method"] == ITSELF
    assert itself["f1"] == pytest.approx(1)
    assert np.isnan(itself["f1_gaussians"])
    assert truth["method"] == TRUTH
    assert truth["f1"] == truth["f1_gaussians"] == truth["auc"] == pytest.approx(1)
    assert truth["false_area"] == 0
    assert none["f1"] == none["f1_gaussians"] == none["false_area"] == 0
    assert none["auc"] == 0.5


def case_of(gaussians: Gaussians, *, labels: list[bool], truth: list) -> cases.Case:
    """A case with one camera, which is also the held-out one, and this truth (V, H, W)."""
    scene = cases.Scene(name="by hand", gaussians=gaussians, cameras=[CAMERA], heldout=[CAMERA])
    mask = np.array(truth, bool)
    return cases.Case(
        scene=scene,
        edit="incorporation",
        seed=0,
        gaussians=gaussians,
        labels=np.array(labels),
        truth=mask,
        heldout_truth=mask,
        decoy=np.zeros_like(mask),
        description="",
    )


def test_scores_by_hand():
    """Three Gaussians, found, falsely found and missed; two views of two pixels, one authentic."""
    opacities = np.array([0.8, 0.4, 0.2], np.float32)
    gaussians = dataclasses.replace(blobs(np.eye(3)), logit_opacities=logit(opacities))
    made = case_of(gaussians, labels=[True, False, True], truth=[[[1, 0]], [[0, 0]]])
    found = Prediction(score=np.array([3.0, 1, 1]), labels=np.array([True, True, False]))
    assert runner.scores(made, found, np.array([[[1, 1]], [[0, 0]]], bool)) == {
        "f1": 0.6667,  # of the tampered view: precision 1 / 2, recall 1
        "iou": 0.5,
        "precision": 0.5,
        "recall": 1.0,
        "false_area": 0.25,  # of all four pixels
        "f1_gaussians": 0.7273,  # 2 * 0.8 / (2 * 0.8 + 0.4 + 0.2)
        "auc": 0.75,  # one pair in order and one tie
    }


def test_a_level_holds_for_the_feature_relative_to_alpha_or_for_the_feature_itself():
    """Two Gaussians stand apart, with alpha 0.5 in pixel 4 and 0.8 in pixel 12."""
    alpha = np.array([0.5, 0.8], np.float32)
    gaussians = blobs([[-0.8, 0, 4], [0.8, 0, 4]], scale=0.05)
    gaussians = dataclasses.replace(gaussians, logit_opacities=logit(alpha))
    own = Prediction(
        score=np.zeros(2),
        labels=np.zeros(2, bool),
        feature=np.array([0.15, 0.15]),  # rendered, 0.075 and 0.12
        level=0.1,
    )
    expected = {"relative": [True, True], "itself": [False, True]}
    predictions = [own, dataclasses.replace(own, absolute=True)]
    masks = runner.heldout_masks(gaussians, [CAMERA], predictions)
    found = {name: mask[0, 7, [4, 12]].tolist() for name, mask in zip(expected, masks, strict=True)}
    assert found == expected
    assert not masks[0][0, :, 8].any(), "no Gaussian covers the middle"


def test_the_own_rule_of_sa3d_is_a_rendered_score_above_a_tenth():
    gaussians = blobs([[-0.8, 0, 4], [0.8, 0, 4]], scale=0.05)
    left = np.indices((CAMERA.height, CAMERA.width))[1] < 8
    made = case_of(gaussians, labels=[True, False], truth=[left])
    observed = observe_regimes(made, {"clean": left[None]})["clean"]
    own = ALL_METHODS["SA3D, own rule"](observed)
    assert own.labels.tolist() == [True, False]
    assert (own.absolute, own.level) == (True, 0.1)
    np.testing.assert_array_equal(own.rendered, own.score)
    assert not ALL_METHODS["SA3D"](observed).absolute


def test_the_calibrated_mixture_hurts_the_inverse_projection(case):
    masks = cases.detector_masks(case, {"mixture": cases.calibrated_mixture(case)})
    inverse = {"inverse projection": ALL_METHODS["inverse projection"]}
    row = list(runner.judge(observe_regimes(case, masks), inverse))[-1]
    assert 0.1 <= row["f1"] <= 0.4


def test_rows_of_some_methods_are_merged_with_those_of_the_others(tmp_path):
    key = {"scene": "room", "edit": "removal", "seed": 0, "regime": "clean"}

    def row(name: str, f1: float, false_area: float = 0.0) -> dict:
        return {**key, "method": name, "f1": f1, "false_area": false_area}

    before = [row(TRUTH, 1.0), row("a", 0.1), row("b", 0.2)]
    write_csv(tmp_path / "x.csv", pd.DataFrame(before))
    args = runner.ChosenArgs(out=tmp_path, methods=("b", "c"))
    rows = runner.measured(args, "x", [[row(TRUTH, 1.0), row("b", 0.3), row("c", 0.4)]])
    expected = [*before[:2], row("b", 0.3), row("c", 0.4)]
    assert rows.to_dict("records") == read_csv(tmp_path / "x.csv").to_dict("records") == expected
    rest = iter([[{**row("b", 0.3), "seed": 1}], [row("b", 0.3)]])
    with pytest.raises(InputError, match="other cases"):
        runner.measured(args, "x", rest)
    assert len(list(rest)) == 1, "refused before the second case is measured"
    more = pd.DataFrame([*before, {**before[0], "seed": 1}])
    with pytest.raises(InputError, match="other cases"):
        runner.merge(more, pd.DataFrame(before))
    with pytest.raises(InputError, match="other masks"):
        runner.measured(args, "x", [[row(TRUTH, 0.9), row("b", 0.3)]])
    with pytest.raises(InputError, match="other masks"):
        runner.measured(args, "x", [[row(TRUTH, 1.0, 0.2), row("b", 0.3)]])
    with pytest.raises(InputError, match="expected some of a, b"):
        args.among({"a": labelled, "b": labelled})  # pyright: ignore[reportArgumentType]
