"""The tables by family: which scenes are compared with which, and cells without a case."""

import pandas as pd
import pytest
from unseen import AS_EDITED, UNTOUCHED, report
from without_masks import WITH_TRACES, WITHOUT_TRACES


def rows_of(families: tuple[str, ...]) -> pd.DataFrame:
    """Edited scenes of probability 0.4 and 0.6, authentic ones of 0.2 and, laundered, of 0.5."""
    rows = []

    def add(family: str, edit: str, probability: float) -> None:
        for export in (AS_EDITED, "8 bits"):
            for method in (WITH_TRACES, WITHOUT_TRACES):
                rows.append(
                    {"scene": "hexbox", "edit": edit, "seed": 0, "export": export}
                    | {"family": family, "method": method, "verdict": probability}
                    | {"regime": "no masks", "auc": 0.75, "f1": 0.5}
                )

    for family in families:
        add(family, "incorporation", 0.4)
        if family != "editor":
            add(family, "removal", 0.6)
    add(UNTOUCHED, "none", 0.2)
    if "laundered" in families:
        add("laundered", "none", 0.5)
    return pd.DataFrame(rows)


def line(text: str, family: str) -> list[str]:
    """Cells of the last table row that begins with this family."""
    (*_, last) = [row for row in text.splitlines() if row.startswith(f"| {family} |")]
    return [cell.strip() for cell in last.strip("|").split("|")][1:]


def test_laundered_edits_are_compared_with_laundered_scenes():
    text = report(rows_of(("quick", "laundered")))
    assert line(text, "quick") == ["1.00 (1.00)"] * 3 + ["1 of 2", "0 of 1"]
    expected = ["0.00 (0.00)", "1.00 (1.00)", "0.50 (0.50)", "1 of 2", "1 of 1"]
    assert line(text, "laundered") == expected
    assert "untouched | 0.20" in text


def test_an_edit_that_a_family_lacks_has_a_dash():
    text = report(rows_of(("quick", "editor")))
    assert line(text, "editor") == ["1.00 (1.00)", "-", "1.00 (1.00)", "0 of 1", "0 of 1"]


@pytest.mark.parametrize("family", ["editor", "laundered"])
def test_one_family_alone_has_its_tables(family):
    assert f"{family} edits, the hardest export first" in report(rows_of((family,)))
