import numpy as np
import pandas as pd
import tables


def test_a_table_has_means_spreads_and_the_best_in_bold():
    means = [("a", "x", 0.2), ("a", "y", 0.6), ("b", "x", 0.4), ("b", "y", 0.4)]
    means += [(tables.TRUTH, "x", 0.9), (tables.TRUTH, "y", float("nan"))]
    rows = pd.DataFrame(
        [
            {"method": method, "regime": regime, "seed": seed, "f1": value + 0.1 * seed}
            for method, regime, value in means
            for seed in (0, 1)
        ]
    )
    text = tables.with_columns(tables.pivot(rows, "method", "regime"), {"paper": {"a": "0.5"}})
    assert text.splitlines() == [
        "| method | x | y | mean | paper |",
        "| --- | --- | --- | --- | --- |",
        "| a | 0.25 ± 0.07 | **0.65** ± 0.07 | **0.45** ± 0.07 | 0.5 |",
        "| b | **0.45** ± 0.07 | 0.45 ± 0.07 | **0.45** ± 0.07 |  |",
        "| true labels | 0.95 ± 0.07 | - | 0.95 ± 0.07 |  |",
    ]


def test_a_section_is_replaced_in_the_page_that_has_it(tmp_path):
    page = tmp_path / "results-paper.md"
    page.write_text("<!-- one -->\nold\n<!-- /one -->\n")
    tables.write_section(tmp_path / "results.md", "one", "new")
    assert page.read_text() == "<!-- one -->\nnew\n<!-- /one -->\n"
    assert not (tmp_path / "results.md").exists()


def test_a_section_is_replaced_and_the_rest_of_the_page_stays(tmp_path):
    page = tmp_path / "results.md"
    page.write_text("before\n<!-- one -->\nold\n<!-- /one -->\nafter\n")
    tables.write_section(page, "one", "new")
    tables.write_section(page, "two", "more")
    assert page.read_text() == (
        "before\n<!-- one -->\nnew\n<!-- /one -->\nafter\n\n<!-- two -->\nmore\n<!-- /two -->\n"
    )


def test_csv_round_trip(tmp_path):
    rows = pd.DataFrame([{"a": 1, "b": "x, y", "c": 0.25}, {"a": 2, "b": "", "d": 1e-9}])
    tables.write_csv(tmp_path / "rows.csv", rows)
    first, second = tables.read_csv(tmp_path / "rows.csv").to_dict("records")
    assert (first["a"], first["b"], first["c"]) == (1, "x, y", 0.25)
    assert np.isnan(first["d"])
    assert (second["b"], second["d"]) == ("", 1e-9)


def test_columns_count_equally_in_the_mean_and_the_spread_may_be_over_other_units():
    values = [("x", "h1", 0.9), ("x", "h2", 0.8), ("x", "h3", 1.0), ("y", "h1", 0.1)]
    rows = pd.DataFrame([{"m": "a", "edit": e, "host": h, "f1": f} for e, h, f in values])
    text = tables.pivot(rows, "m", "edit", over="host", best=None)
    assert text.splitlines()[-1] == "| a | 0.90 ± 0.10 | 0.10 | 0.50 ± 0.25 |"
