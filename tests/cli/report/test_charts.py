"""Charts of the report and the distributions in them."""

import base64
import dataclasses
import re
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest
from reports import COUNT, TAMPERED, run

from gsc_jax.cli.report.charts import DARK, LIGHT, attribute_distributions, chart, score_histogram

CSS = Path(__file__).parents[3] / "gsc_jax" / "cli" / "report" / "report.css"


def distributions(located):
    result = located.result
    found = attribute_distributions(located.scene.gaussians, result.labels, result.seen)
    return {distribution.title: distribution for distribution in found}


def test_distributions_differ_and_exclude_unseen_gaussians(tmp_path: Path):
    found = distributions(run(tmp_path, ["a view"]))
    assert len(found) == 7
    for distribution in found.values():
        assert (len(distribution.tampered), len(distribution.authentic)) == (100, 293)
        for shares in distribution.shares(20)[:2]:
            assert shares.sum() == pytest.approx(1)
    size = found["Size"]
    assert np.median(size.tampered) < np.median(size.authentic) - 0.3
    tampered, authentic, _ = size.shares(20)
    assert np.minimum(tampered, authentic).sum() < 0.5, "the small overlap is not visible"


def test_histogram_counts_labels_of_unseen_gaussians_separately(tmp_path: Path):
    located = run(tmp_path, ["a view"], seen=np.arange(COUNT) >= 5)
    text = score_histogram(located.result).text
    assert text.startswith(f"{TAMPERED - 5} of {COUNT - 5} visible Gaussians score above")
    assert f"{TAMPERED - 5} of them are labelled as tampered, and 5 that no view shows" in text
    hidden = dataclasses.replace(located.result, seen=np.arange(COUNT) >= TAMPERED)
    assert distributions(dataclasses.replace(located, result=hidden)) == {}
    assert "0 of them are labelled as tampered" in score_histogram(hidden).text


def test_chart_is_drawn_in_the_colours_of_both_schemes_of_the_page():
    drawn = chart(lambda axes: axes.plot([0, 1]), title="t", text="", size=(2, 2))
    css = CSS.read_text()
    for uri, scheme in ((drawn.light, LIGHT), (drawn.dark, DARK)):
        svg = base64.b64decode(uri.partition(",")[2]).decode()
        assert ElementTree.fromstring(svg).tag.endswith("svg")
        assert scheme["ink"] in svg
        for colour in (scheme["ink"], scheme["muted"], *scheme["cycle"]):
            assert re.search(rf"--\w+: {colour}", css), colour
