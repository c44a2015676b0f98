"""The runner against the library, on a small made scene."""

import cases
import numpy as np
import pandas as pd
import pytest
import runner
from methods import ALL_METHODS, labelled
from observations import observe_regimes
from tables import ITSELF, TRUTH, read_csv, write_csv

from gsc_jax.benchmark.simulate import REGIMES
from gsc_jax.evidence.observation import observe
from gsc_jax.scene import InputError


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


def test_the_calibrated_mixture_hurts_the_inverse_projection(case):
    masks = cases.detector_masks(case, {"mixture": cases.calibrated_mixture(case)})
    inverse = {"inverse projection": ALL_METHODS["inverse projection"]}
    row = list(runner.judge(observe_regimes(case, masks), inverse))[-1]
    assert 0.1 <= row["f1"] <= 0.4


def test_rows_of_some_methods_are_merged_with_those_of_the_others(tmp_path):
    key = {"scene": "room", "edit": "removal", "seed": 0, "regime": "clean"}

    def row(name: str, f1: float) -> dict:
        return {**key, "method": name, "f1": f1}

    before = [row(TRUTH, 1.0), row("a", 0.1), row("b", 0.2)]
    write_csv(tmp_path / "x.csv", pd.DataFrame(before))
    args = runner.ChosenArgs(out=tmp_path, methods=("b", "c"))
    rows = runner.measured(args, "x", [[row(TRUTH, 1.0), row("b", 0.3), row("c", 0.4)]])
    expected = [*before[:2], row("b", 0.3), row("c", 0.4)]
    assert rows.to_dict("records") == read_csv(tmp_path / "x.csv").to_dict("records") == expected
    with pytest.raises(InputError, match="other cases"):
        runner.measured(args, "x", [[{**row("b", 0.3), "seed": 1}]])
    with pytest.raises(InputError, match="other masks"):
        runner.measured(args, "x", [[row(TRUTH, 0.9), row("b", 0.3)]])
    with pytest.raises(InputError, match="expected some of a, b"):
        args.among({"a": labelled, "b": labelled})  # pyright: ignore[reportArgumentType]
