"""Sentences about results."""

import dataclasses
from pathlib import Path
from types import SimpleNamespace

import hypothesis.strategies as st
import numpy as np
import pytest
from hypothesis import example, given
from reports import run, summarised
from strategies import random_scene
from tables import read_csv

from gsc_jax.cli.report import wording
from gsc_jax.estimators.protocol import EVIDENCE_FROM, outcome
from gsc_jax.forensics.contrast import contrasts
from gsc_jax.forensics.evidence import forensic_evidence

NAMES = [f"view {i:02}" for i in range(8)]


def test_summary_names_the_report_the_traces_and_the_reliability(tmp_path: Path):
    lines = summarised(run(tmp_path, NAMES))
    assert any(str(Path("out") / "report.html") in line for line in lines)
    assert any("100 of 400 Gaussians are off." in line for line in lines)
    assert any("2 reliable, 2 inverted, 2 uninformative" in line for line in lines)


def test_summary_starts_with_the_outcome(tmp_path: Path):
    for verdict, start in ((0.1, "No evidence"), (0.5, "Inconclusive"), (0.97, "Evidence of")):
        lines = summarised(run(tmp_path, NAMES[:1], verdict=verdict))
        first = next(line for line in lines if not line.startswith("The masks show"))
        assert first.startswith(start)
        assert ("candidates" in first) == (verdict < 0.65)


def test_a_conflict_of_masks_and_attributes_is_the_first_sentence(tmp_path: Path):
    def first(verdict: float, rank: float | None, alone: float = 0.5) -> str:
        prior = SimpleNamespace(verdict=alone, traces=())
        located = run(tmp_path, NAMES[:1], verdict=verdict, rank=rank, prior=prior)
        return summarised(located)[0]

    assert first(0.98, 1.0).startswith("The masks show an edit")
    assert "parts of the scene, 70% stand out more" in first(0.98, 0.7)
    for pair in ((0.98, 0.49), (0.98, None), (0.5, 1.0)):
        assert "masks show" not in first(*pair)
    assert "masks show" not in first(0.98, 1.0, alone=0.9), "the attributes show another edit"


def test_the_rates_of_the_outcomes_are_those_of_the_tables():
    docs = Path(wording.__file__).parents[3] / "docs"
    names = {
        "masks": "calibration",
        "attributes": "heldout",
        "masks and attributes": "beside_masks",
    }
    tables = {basis: read_csv(docs / f"{name}.csv") for basis, name in names.items()}
    tables["masks"] = tables["masks"][tables["masks"].bin == -1]
    tables["attributes"] = tables["attributes"].drop_duplicates(["host", "edit", "seed"])
    both = tables["masks and attributes"]
    both = both[both.prior == "attributes"]
    tables["masks and attributes"] = both.assign(
        edit=both.edit.where(both.kind == "edited", "none")
    )
    assert tables.keys() == wording.COUNTS.keys()
    for basis, rows in tables.items():
        found = rows.verdict.map(outcome)
        for name, counts in wording.COUNTS[basis].items():
            kinds = (rows.edit.eq("none"), rows.edit.ne("none"))
            assert counts == tuple((found[kind] == name).sum() for kind in kinds)


@pytest.mark.parametrize(
    ("verdict", "basis", "weak"),
    [
        (0.01, "attributes", True),
        (0.4, "attributes", True),
        (0.9, "attributes", False),
        (0.01, "masks", False),
        (0.4, "masks and attributes", False),
        (0.9, "masks and attributes", False),
    ],
)
def test_an_outcome_of_most_scenes_is_said_to_say_little(verdict, basis, weak):
    text = wording.meaning(verdict, basis=basis)
    assert ("it says little" in text) == weak
    total = {"attributes": 94, "masks": 30, "masks and attributes": 24}[basis]
    assert f" of {total} authentic and " in text
    assert f"In tests of {'simulated masks alone' if basis == 'masks' else basis} " in text


def test_the_rates_are_those_of_what_the_run_used(tmp_path: Path):
    def edited(**changes) -> str:
        lines = summarised(run(tmp_path, NAMES[:1], **changes))
        return next(line for line in lines if line.startswith("edited"))

    prior = SimpleNamespace(verdict=0.5, traces=())
    assert "In tests of masks and attributes" in edited(verdict=0.9, prior=prior)
    assert "In tests of simulated masks alone" in edited(verdict=0.9, prior=None)


def test_without_attributes_or_traces_the_rates_are_those_of_tests():
    for basis, traced in (("masks", True), ("masks and attributes", False), ("attributes", False)):
        assert "In tests" in wording.meaning(0.99, basis=basis, traced=traced)


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


def test_labels_are_candidates_without_evidence_of_editing():
    def lead(verdict: float | None, tampered: int = 3) -> str:
        counts = {"tampered": tampered, "gaussians": 10}
        shares = {"per_view": [{}], "tampered_share_of_views": 0.5}
        return wording.lead({"verdict": verdict, "counts": counts, **shares})

    for verdict in (0.0, 0.4, EVIDENCE_FROM - 1e-6):
        text = lead(verdict)
        assert text.startswith("3 of 10 Gaussians (30.0%) are candidates: they stand out most")
        assert "None of 10" in lead(verdict, tampered=0)
    for verdict in (None, EVIDENCE_FROM, 1.0):
        assert lead(verdict).startswith("3 of 10 Gaussians (30.0%) are labelled as tampered")


def test_every_trace_has_an_explanation():
    traces = forensic_evidence(random_scene(50)).traces
    assert {trace.name for trace in traces} == set(wording.TRACES)


def test_the_largest_differences_are_stated_and_no_small_ones():
    shares = dict.fromkeys(wording.CONTRASTS, 0.5)
    assert wording.differences({}) is None
    assert wording.differences(shares) is None
    shares |= {"size": 0.02, "opacity": 0.8, "brightness": 0.71, "flatness": 0.69, "other": 1}
    stated = str(wording.differences(shares))
    assert "smaller in 98%, more opaque in 80%, brighter in 71% of the pairs" in stated
    shares |= {"view dependence": 0.25}
    stated = str(wording.differences(shares))
    assert "more opaque in 80%, less view-dependent in 75% of the pairs" in stated


def test_every_contrast_has_words():
    labels = np.random.default_rng(0).random(400) < 0.5
    assert contrasts(random_scene(400), labels).keys() == wording.CONTRASTS.keys()


def test_the_summary_states_differences_and_what_the_attributes_say(tmp_path: Path):
    located = run(tmp_path, NAMES[:1], prior=SimpleNamespace(verdict=0.1, traces=()))
    located = dataclasses.replace(located, contrasts={"size": 0.01})
    text = "\n".join(summarised(located))
    assert "contrast Compared pair by pair" in text
    assert "smaller in 99% of the pairs" in text
    assert "(scene probability; 10% by the attributes alone)" in text
    without = summarised(run(tmp_path, NAMES[:1], prior=None))
    assert "alone)" not in "\n".join(without)
    assert "contrast" not in "\n".join(without)


def test_with_masks_a_trace_is_named_too():
    for basis, start in (
        ("masks and attributes", "It rests on the masks and on a trace"),
        ("attributes", "It rests on a trace"),
        ("masks", "In tests of simulated masks alone"),
    ):
        assert wording.meaning(0.9, basis=basis, traced=True).startswith(start)
