"""The figures of the README equal those of the pages of results."""

import re
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
README = (ROOT / "README.md").read_text(encoding="utf-8")
DOCS = ROOT / "docs"
NAMES = {
    "`robust`": "robust",
    "FlashSplat": "FlashSplat",
    "GS-Checker, `official`": "GS-Checker official",
    "GS-Checker, `paper`": "GS-Checker paper",
}


def cells(text: str, first: str) -> list[str]:
    """Cells of the table row that begins with a name, without the name."""
    (row,) = re.findall(rf"^\| {re.escape(first)} \|(.*)\|$", text, flags=re.MULTILINE)
    return [cell.strip() for cell in row.split("|")]


def table(page: str, heading: str) -> str:
    """First table of a page after a text."""
    text = (DOCS / page).read_text(encoding="utf-8")
    below = text[text.index(heading) :]
    return re.search(r"(^\|.*\n)+", below, flags=re.MULTILINE)[0]  # type: ignore[index]


def means(row: list[str]) -> list[float]:
    return [float(re.split(r" ±", cell.replace("*", ""))[0]) for cell in row]


@pytest.mark.parametrize("name", NAMES)
def test_f1_by_method(name):
    failures = "| method | clean | boundary | misses | blobs | consistent | inverted | mixture |"
    row = means(cells(table("results-paper.md", failures), NAMES[name]))
    quoted = [float(cell) for cell in cells(README, name)]
    assert quoted == [row[0], row[-1], min(row[:-1])]


@pytest.mark.parametrize("metric", ["AUC", "F1"])
def test_scores_without_a_detector(metric):
    regimes = table("results-attributes.md", f"**{metric} per Gaussian by regime**")
    row = means(cells(regimes, "no masks"))[:3]
    assert [float(cell) for cell in cells(README, f"{metric} per Gaussian")] == row
