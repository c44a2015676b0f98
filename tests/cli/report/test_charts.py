"""The chart of the report."""

import dataclasses
from pathlib import Path

import numpy as np
from reports import COUNT, TAMPERED, run

from gsc_jax.cli.report.charts import COLOURS, VARIABLES, score_histogram

CSS = Path(__file__).parents[3] / "gsc_jax" / "cli" / "report" / "report.css"


def test_histogram_counts_labels_of_unseen_gaussians_separately(tmp_path: Path):
    located = run(tmp_path, ["a view"], seen=np.arange(COUNT) >= 5)
    text = score_histogram(located.result).text
    assert text.startswith(f"{TAMPERED - 5} of {COUNT - 5} visible Gaussians score above")
    assert f"{TAMPERED - 5} of them are labelled as tampered, and 5 that no view shows" in text
    hidden = dataclasses.replace(located.result, seen=np.arange(COUNT) >= TAMPERED)
    assert "0 of them are labelled as tampered" in score_histogram(hidden).text


def test_the_histogram_is_drawn_in_the_colours_of_the_page(tmp_path: Path):
    svg = score_histogram(run(tmp_path, ["a view"]).result).svg
    assert svg.startswith("<svg")
    assert svg.rstrip().endswith("</svg>")
    assert not any(colour in svg for colour in COLOURS)
    for name in VARIABLES:
        assert f"var(--{name})" in svg
        assert f"--{name}:" in CSS.read_text(), name
