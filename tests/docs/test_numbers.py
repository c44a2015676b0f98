"""The figures of the README equal those of docs/results.md."""

import re
from pathlib import Path

import numpy as np
import pytest

ROOT = Path(__file__).resolve().parents[2]
README = (ROOT / "README.md").read_text(encoding="utf-8")
RESULTS = (ROOT / "docs" / "results.md").read_text(encoding="utf-8")
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


def table(heading: str) -> str:
    """First table of the results after a text."""
    below = RESULTS[RESULTS.index(heading) :]
    return re.search(r"(^\|.*\n)+", below, flags=re.MULTILINE)[0]  # type: ignore[index]


def means(row: list[str]) -> list[float]:
    return [float(re.split(r" ±", cell.replace("*", ""))[0]) for cell in row]


@pytest.mark.parametrize("name", NAMES)
def test_f1_by_method(name):
    failures = "| method | clean | boundary | misses | blobs | consistent | inverted | mixture |"
    row = means(cells(table(failures), NAMES[name]))
    quoted = [float(cell) for cell in cells(README, name)]
    assert quoted == [row[0], row[-1], min(row[:-1])]


@pytest.mark.parametrize(
    ("quoted", "evidence"),
    [
        ("AUC per Gaussian, file as edited", "Gaussians, as edited"),
        ("AUC per Gaussian, exported again in 8 bits", "Gaussians, 8 bits"),
    ],
)
def test_auc_without_a_detector(quoted, evidence):
    row = means(cells(table("**AUC per Gaussian, no 2D detector**"), evidence))[:3]
    np.testing.assert_allclose([float(cell) for cell in cells(README, quoted)], row, atol=0.0051)


def test_f1_of_masks_without_a_detector():
    pairs = [cell.split(" / ") for cell in cells(README, "mean F1 per view, as edited / exported")]
    masks = table("**F1 per held-out view, no 2D detector**")
    for column, evidence in enumerate(("Gaussians, as edited", "Gaussians, 8 bits")):
        assert [float(pair[column]) for pair in pairs] == means(cells(masks, evidence))[:3]
