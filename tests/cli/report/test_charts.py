"""The chart of the report."""

import base64
import dataclasses
import re
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
from reports import COUNT, TAMPERED, run

from gsc_jax.cli.report.charts import DARK, LIGHT, score_histogram

CSS = Path(__file__).parents[3] / "gsc_jax" / "cli" / "report" / "report.css"


def test_histogram_counts_labels_of_unseen_gaussians_separately(tmp_path: Path):
    located = run(tmp_path, ["a view"], seen=np.arange(COUNT) >= 5)
    text = score_histogram(located.result).text
    assert text.startswith(f"{TAMPERED - 5} of {COUNT - 5} visible Gaussians score above")
    assert f"{TAMPERED - 5} of them are labelled as tampered, and 5 that no view shows" in text
    hidden = dataclasses.replace(located.result, seen=np.arange(COUNT) >= TAMPERED)
    assert "0 of them are labelled as tampered" in score_histogram(hidden).text


def test_the_histogram_is_drawn_in_the_colours_of_both_schemes_of_the_page(tmp_path: Path):
    drawn = score_histogram(run(tmp_path, ["a view"]).result)
    css = CSS.read_text()
    for uri, own, other in ((drawn.light, LIGHT, DARK), (drawn.dark, DARK, LIGHT)):
        svg = base64.b64decode(uri.partition(",")[2]).decode()
        assert ElementTree.fromstring(svg).tag.endswith("svg")
        assert not any(colour in svg for colour in other)
        for colour in own:
            assert colour in svg
            assert re.search(rf"--\w+: {colour}", css), colour
