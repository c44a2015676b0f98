"""The words in which results are told."""

from pathlib import Path

import hypothesis.strategies as st
from hypothesis import example, given
from reports import run

from gsc_jax.cli.report import wording as words

NAMES = [f"view {i:02}" for i in range(8)]


def test_the_summary_names_the_report_first(tmp_path: Path):
    lines = words.summary(run(tmp_path, NAMES), Path("out"))
    look = [line for line in lines if line.startswith("look at")]
    assert look == [f"look at  {Path('out') / 'report.html'}"]
    assert any(line.startswith("trace    100 of 400") for line in lines)
    assert any("finding it 2, missing it 2, inverted 2, of views without it 2" in x for x in lines)


def test_words_for_numbers():
    assert [words.percent(p) for p in (0, 0.009, 0.5, 0.991, 1)] == [
        "<1%",
        "<1%",
        "50%",
        ">99%",
        ">99%",
    ]
    shares = [words.share(part) for part in (0, 1e-6, 0.123, 0.9999, 1)]
    assert shares == ["0%", "<0.1%", "12.3%", ">99.9%", "100%"]
    least = [bound for bound, _ in words.LIKELY]
    assert least == sorted(least, reverse=True)
    assert least[-1] == 0


@given(st.floats(0, 1))
@example(0.0005)
@example(0.9995)
def test_a_share_is_nothing_or_all_only_where_it_is(part: float):
    said = words.share(part)
    assert said not in ("0.0%", "100.0%")
    assert (said == "0%") == (part == 0)
    assert (said == "100%") == (part == 1)


def test_what_is_rare_is_not_told_as_nothing():
    said = words.found_sentence(3, 10**6, verdict=0.9, views=20, covered=1e-5)
    assert said == (
        "3 of 1,000,000 Gaussians are labelled as tampered (<0.1%); "
        "they cover <0.1% of what 20 views show."
    )


def test_a_doubt_is_told_wherever_something_was_found_without_a_verdict_for_it():
    for verdict in (0.0, 0.4, words.PROBABLY - 1e-6):
        said = words.found_sentence(3, 10, verdict=verdict, views=1, covered=0.5)
        assert said.startswith("If something was: 3 of 10 Gaussians")
        nothing = words.found_sentence(0, 10, verdict=verdict, views=1, covered=0.0)
        assert nothing == "No tampered Gaussian was found: none of 10, in 1 view."
    for verdict in (None, words.PROBABLY, 1.0):
        said = words.found_sentence(3, 10, verdict=verdict, views=1, covered=0.5)
        assert said.startswith("3 of 10 Gaussians")


def test_the_summary_begins_with_what_a_verdict_makes_of_it(tmp_path: Path):
    doubted = words.summary(run(tmp_path, NAMES[:1], verdict=0.5), Path("out"))[0]
    assert doubted.startswith("It is unclear whether anything")
    assert "If something was: 100 of 400" in doubted
    assert words.summary(run(tmp_path, NAMES[:1]), Path("out"))[0].startswith("100 of 400")
