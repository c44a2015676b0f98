import heldout
import numpy as np
import pandas as pd

from gsc_jax.cli.report.wording import TRACES


def rows():
    """Two authentic cases, and edited ones of two families."""
    cases = [("none", "quick", 0.2), ("none", "quick", 0.4), ("incorporation", "quick", 0.9)]
    cases += [("modification", "quick", 0.3), ("modification", "laundered", 0.1)]
    cases += [("removal", "quick", 0.5)]
    columns = {"host": "room", "seed": 1, "export": "float", "regime": "no masks"}
    scores = {"auc": 0.9, "f1_gaussians": 0.5}
    return pd.DataFrame(
        [
            {**columns, **scores, "edit": edit, "family": family, "verdict": verdict}
            for edit, family, verdict in cases
        ]
    ).assign(**dict.fromkeys(TRACES, np.nan))


def test_traces_are_counted_and_compared_with_the_edit():
    text = heldout.report(
        rows().assign(
            **{
                "copy-move": [np.nan, np.nan, 0.9, 0.1, np.nan, 0.5],
                "quantisation": [np.nan, 0.0, np.nan, np.nan, np.nan, 1.0],
            }
        )
    )
    assert "| copy-move | 0 of 2 | 3 of 4 | 2 |" in text
    assert "| quantisation | 1 of 2 | 1 of 4 | 1 |" in text
    assert "| row-order | 0 of 2 | 0 of 4 | 0 |" in text


def test_edited_cases_are_counted_by_family():
    text = heldout.report(rows())
    assert "| quick | 1 | 1 | 1 | 3 |" in text
    assert "| laundered | 0 | 1 | 0 | 1 |" in text


def test_each_kind_of_edit_is_compared_with_all_authentic_cases():
    text = heldout.report(rows())
    assert "**AUC of the scene probability by edit**, against all 2 authentic cases" in text
    assert "| incorporation | 1.00 | 1 of 1 |" in text
    assert "| modification | 0.25 | 0 of 2 |" in text  # above one of two, and above none
