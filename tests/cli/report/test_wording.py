"""Sentences about results."""

from pathlib import Path

import hypothesis.strategies as st
from hypothesis import example, given
from reports import run
from strategies import random_scene

from gsc_jax.cli.report import wording
from gsc_jax.forensics.evidence import forensic_evidence

NAMES = [f"view {i:02}" for i in range(8)]


def test_summary_names_the_report_the_traces_and_the_reliability(tmp_path: Path):
    lines = wording.summary(run(tmp_path, NAMES), Path("out"))
    assert any(str(Path("out") / "report.html") in line for line in lines)
    assert any("100 of 400 Gaussians are off." in line for line in lines)
    assert any("2 reliable, 2 inverted, 2 uninformative" in line for line in lines)


def test_summary_starts_with_the_headline_only_if_the_labels_are_doubtful(tmp_path: Path):
    for verdict, start in ((0.5, wording.headline(0.5, 100)), (0.97, "100 of 400")):
        located = run(tmp_path, NAMES[:1], verdict=verdict)
        assert wording.summary(located, Path("out"))[0].startswith(start)


def test_numbers_are_rounded_to_bounds():
    percents = [wording.percent(p) for p in (0, 0.009, 0.5, 0.991, 1)]
    assert percents == ["<1%", "<1%", "50%", ">99%", ">99%"]
    assert [wording.share(part) for part in (1e-6, 0.123, 0.9999)] == ["<0.1%", "12.3%", ">99.9%"]


@given(st.floats(0, 1))
@example(0.0005)
@example(0.9995)
def test_share_is_zero_or_all_only_if_exact(part: float):
    text = wording.share(part)
    assert text not in ("0.0%", "100.0%")
    assert (text == "0%") == (part == 0)
    assert (text == "100%") == (part == 1)


def test_labels_are_conditional_if_the_scene_probability_is_low():
    for verdict in (0.0, 0.4, wording.MIN_EDITED - 1e-6):
        text = wording.labels_sentence(3, 10, verdict=verdict, views=1, covered=0.5)
        assert text.startswith("If the scene was edited: 3 of 10 Gaussians")
        assert "None of 10" in wording.labels_sentence(0, 10, verdict=verdict, views=1, covered=0.0)
    for verdict in (None, wording.MIN_EDITED, 1.0):
        text = wording.labels_sentence(3, 10, verdict=verdict, views=1, covered=0.5)
        assert text.startswith("3 of 10 Gaussians")


def test_every_trace_has_an_explanation():
    traces = forensic_evidence(random_scene(50)).traces
    assert {trace.name for trace in traces} == set(wording.TRACES)
