"""Charts of the report and the distributions in them."""

import base64
import dataclasses
import re
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest
from reports import COUNT, TAMPERED, run

from gsc_jax.cli.report.charts import (
    DARK,
    LIGHT,
    attribute_charts,
    attributes,
    chart,
    score_histogram,
    shares,
)

CSS = Path(__file__).parents[3] / "gsc_jax" / "cli" / "report" / "report.css"


def test_distributions_differ_and_exclude_unseen_gaussians(tmp_path: Path):
    located = run(tmp_path, ["a view"])
    result = located.result
    groups = result.seen & result.labels, result.seen & ~result.labels
    assert [group.sum() for group in groups] == [100, 293]
    drawn = {chart.title: chart for chart in attribute_charts(located.scene.gaussians, result)}
    assert len(drawn) == 7
    for title, _, values in attributes(located.scene.gaussians):
        found, _ = shares([values[group] for group in groups], 20)
        assert [share.sum() for share in found] == pytest.approx([1, 1])
        if title == "Size":
            assert np.median(values[groups[0]]) < np.median(values[groups[1]]) - 0.3
            assert np.minimum(*found).sum() < 0.5, "the small overlap is not visible"
            assert f"{np.median(values[groups[0]]):.3g}" in drawn[title].text


def test_histogram_counts_labels_of_unseen_gaussians_separately(tmp_path: Path):
    located = run(tmp_path, ["a view"], seen=np.arange(COUNT) >= 5)
    text = score_histogram(located.result).text
    assert text.startswith(f"{TAMPERED - 5} of {COUNT - 5} visible Gaussians score above")
    assert f"{TAMPERED - 5} of them are labelled as tampered, and 5 that no view shows" in text
    hidden = dataclasses.replace(located.result, seen=np.arange(COUNT) >= TAMPERED)
    assert attribute_charts(located.scene.gaussians, hidden) == []
    assert "0 of them are labelled as tampered" in score_histogram(hidden).text


def test_chart_is_drawn_in_the_colours_of_both_schemes_of_the_page():
    drawn = chart(lambda axes: axes.plot([0, 1]), title="t", text="", size=(2, 2))
    css = CSS.read_text()
    for uri, scheme in ((drawn.light, LIGHT), (drawn.dark, DARK)):
        svg = base64.b64decode(uri.partition(",")[2]).decode()
        assert ElementTree.fromstring(svg).tag.endswith("svg")
        for colour in scheme:
            assert (colour in svg) == (colour != scheme[-1]), "one curve, so no last colour"
            assert re.search(rf"--\w+: {colour}", css), colour
