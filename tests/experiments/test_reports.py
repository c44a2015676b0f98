"""Numbers of the tables, worked out by hand from a few rows."""

import calibration
import editing
import enough
import fusion
import mask_checks
import pandas as pd
import parsimony
import pytest
import speed_accuracy
import tables

KEY = {"scene": "room", "edit": "removal", "seed": 0, "regime": "blobs"}


def cells(text: str, name: str) -> list[str]:
    """Cells of the row of a table with this name, without the name."""
    (line,) = (line for line in text.splitlines() if line.startswith(f"| {name} |"))
    return [cell.strip() for cell in line.split("|")[2:-1]]


def by_method(**f1: list[float]) -> pd.DataFrame:
    """A row for each method and case, the cases being seeds."""
    return pd.DataFrame(
        [
            {**KEY, "seed": seed, "method": name, "f1": value}
            for name, values in f1.items()
            for seed, value in enumerate(values)
        ]
    )


def test_the_calibration_error_weights_the_distance_of_each_bin_by_its_share():
    bins = [(0, 0.6, 0.1, 0.0), (0, 0.2, 0.3, 0.2), (9, 0.2, 0.8, 1.0)]
    rows = pd.DataFrame(bins, columns=["bin", "share", "said", "true"])
    # The first two are one bin: 0.15 said, 0.05 true. The error of the last has the other sign.
    assert calibration.expected_error(rows) == pytest.approx(0.8 * 0.10 + 0.2 * 0.2)
    assert calibration.bins_of(rows).share.tolist() == pytest.approx([0.8, 0.2])


def test_the_scene_probability_separates_by_its_rank():
    edited, authentic = (pd.DataFrame({"verdict": v}) for v in ([0.9, 0.4], [0.5, 0.1]))
    assert tables.separation(edited, authentic) == 0.75


def test_changes_are_those_of_each_case():
    rows = by_method(whole=[0.5, 0.9], part=[0.4, 0.95])
    found = cells(tables.changes(rows, {"part": "whole"}), "part")
    assert found == ["-0.025", "-0.100", "+0.050"]


def test_a_front_has_the_points_that_no_cheaper_one_reaches():
    points = pd.DataFrame({"seconds": [3.0, 1.0, 2.0, 1.0], "f1": [0.7, 0.5, 0.5, 0.6]})
    assert tables.front_of(points).f1.tolist() == [0.6, 0.7]


def test_cases_that_a_prior_harms_and_helps_are_counted_apart():
    attributes, wrong = fusion.ATTRIBUTES, fusion.WRONG
    scores = {"robust": [0.5, 0.5, 0.5], attributes: [0.6, 0.55, 0.495], wrong: [0.4, 0.2, 0.5]}
    rows = by_method(**scores)
    rows = rows[~((rows.method == wrong) & (rows.seed == 2))]  # a case without such a prior
    text = fusion.report(rows)
    changes = text.partition("Change of the F1")[2]
    assert cells(changes, attributes) == ["+0.048", "-0.005", "0 of 3", "2 of 3"]
    assert cells(changes, wrong) == ["-0.200", "-0.300", "2 of 2", "0 of 2"]


def test_observation_stops_at_the_first_change_below_the_tolerance():
    steps = [(4, 0.5, 0.3), (6, 0.8, 0.001), (9, 0.9, 0.2)]
    rows = pd.DataFrame([{**KEY, "views": v, "f1": f, "change": c} for v, f, c in steps])
    found = tables.where(enough.stops(rows), tolerance=0.02)
    assert set(found["views"]) == {6}
    assert found.lost.tolist() == pytest.approx([-0.1])
    never = enough.stops(rows.assign(change=1.0))
    assert set(never["views"]) == {9}
    assert set(never.lost) == {0.0}


def test_the_least_share_is_that_from_which_on_no_larger_one_is_worse():
    shares = {0.2: 0.80, 0.4: 0.70, 0.6: 0.795, 0.8: 0.83, 1.0: 0.80}
    rows = pd.DataFrame({"share": shares.keys(), "f1": shares.values()})
    assert parsimony.enough(rows) == "0.6, best 0.8: +0.03"


def test_the_cheapest_setting_is_hardly_worse_than_the_best():
    points = pd.DataFrame({"method": "a", "seconds": [1.0, 2.0, 3.0], "f1": [0.7, 0.792, 0.8]})
    assert speed_accuracy.extremes(points).f1.tolist() == [0.8, 0.792]


def test_wins_and_margins_are_counted_case_by_case():
    rows = by_method(robust=[0.9, 0.6, 0.1], other=[0.5, 0.605, 0.7])
    assert cells(editing.by_case(rows), "robust")[-2:] == ["2 of 3", "1"]
    assert cells(editing.by_case(rows), "other")[-2:] == ["2 of 3", "0"]
    mean, median, least, behind = cells(editing.margins(rows), "other")
    assert (mean.split()[0], median, least, behind) == ("-0.068", "-0.005", "-0.60", "67%")


def test_masks_with_a_reason_are_called_no_evidence():
    measures = [("a", 0.5, 0.2, 0), ("a", 0.7, 0.3, 2), ("b", 1.0, 0.9, 0)]
    rows = pd.DataFrame(measures, columns=["masks", "accuracy", "agreement", "reasons"])
    text = mask_checks.report(rows)
    assert cells(text, "a") == ["0.50 to 0.70", "0.20 to 0.30", "1 of 2"]
    assert cells(text, "b")[-1] == "0 of 1"
