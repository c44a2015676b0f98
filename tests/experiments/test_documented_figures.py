"""Rows of docs/editing.csv are recomputed: the code still gives the documented figures."""

import pytest
import runner
from cases import detector_masks, make_case
from detector_strengths import scaled
from methods import ALL_METHODS
from observations import observe_regimes
from tables import read_csv, where

from gsc_jax.benchmark.simulate import REGIMES

METHODS = ("inverse projection", "FlashSplat", "GS-Checker official", "robust")


@pytest.mark.parametrize(
    ("edit", "regime"),
    [("incorporation", "inverted"), ("modification", "mixture"), ("removal", "clean")],
)
def test_documented_figures_come_out_of_the_code(edit, regime):
    documented = where(read_csv(runner.DOCS / "editing.csv"), scene="room", edit=edit, seed=0)
    documented = where(documented, regime=regime).set_index("method")
    case = make_case("room", edit, 0)
    strength = documented.mixture_strength.iloc[0] if regime == "mixture" else 1.0
    failures = scaled(REGIMES[regime], strength)
    observed = observe_regimes(case, detector_masks(case, {regime: failures}))
    rows = list(runner.judge(observed, {name: ALL_METHODS[name] for name in METHODS}))
    assert [row["method"] for row in rows] == [*runner.REFERENCE, *METHODS]
    for row in rows:
        figures = documented.loc[row["method"]]
        for metric in ("f1", "iou", "precision", "recall", "false_area", "f1_gaussians", "auc"):
            expected = pytest.approx(figures[metric], abs=runner.SAME, nan_ok=True)
            assert row[metric] == expected, f"{row['method']}, {metric}"
