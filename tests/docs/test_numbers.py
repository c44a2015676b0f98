"""The numbers of the README are those of the tables that the experiments print."""

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
    """The row of a table that begins with a name, without it."""
    (row,) = re.findall(rf"^\| {re.escape(first)} \|(.*)\|$", text, flags=re.MULTILINE)
    return [cell.strip() for cell in row.split("|")]


def table(heading: str) -> str:
    """The first table of the results below a text."""
    below = RESULTS[RESULTS.index(heading) :]
    return re.search(r"(^\|.*\n)+", below, flags=re.MULTILINE)[0]  # type: ignore[index]


def means(row: list[str]) -> list[float]:
    return [float(re.split(r" ±", cell.replace("*", ""))[0]) for cell in row]


@pytest.mark.parametrize("name", NAMES)
def test_the_methods_do_as_the_readme_says(name):
    failures = "| method | clean | boundary | misses | blobs | consistent | inverted | mixture |"
    row = means(cells(table(failures), NAMES[name]))
    said = [float(cell) for cell in cells(README, name)]
    assert said == [row[0], row[-1], min(row[:-1])]


@pytest.mark.parametrize(
    ("said", "evidence"),
    [
        ("AUC per Gaussian, file as edited", "Gaussians, as edited"),
        ("AUC per Gaussian, exported again in 8 bits", "Gaussians, 8 bits"),
    ],
)
def test_the_gaussians_say_as_much_as_the_readme_says(said, evidence):
    row = means(cells(table("**AUC per Gaussian, no 2D detector**"), evidence))[:3]
    np.testing.assert_allclose([float(cell) for cell in cells(README, said)], row, atol=0.0051)


def test_the_masks_without_a_detector_are_as_good_as_the_readme_says():
    pairs = [cell.split(" / ") for cell in cells(README, "mean F1 per view, as edited / exported")]
    masks = table("**F1 per held-out view, no 2D detector**")
    for column, evidence in enumerate(("Gaussians, as edited", "Gaussians, 8 bits")):
        assert [float(pair[column]) for pair in pairs] == means(cells(masks, evidence))[:3]
