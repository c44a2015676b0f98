"""Where methods break, and how the chart shows it."""

import pandas as pd
import pytest
from charts import BLACK, line_styles
from stability import COMPARED, breaking_point


def test_a_method_breaks_where_f1_falls_below_half_of_that_without_failures():
    rows = pd.DataFrame({"strength": [0, 0, 1, 1, 3, 3], "f1": [1, 0.6, 0.7, 0.5, 0.1, 0.3]})
    assert breaking_point(rows) == pytest.approx((2.0, 0.4))
    assert breaking_point(rows[rows.strength < 3]) is None


def test_methods_of_a_family_share_a_colour_and_differ_in_their_lines():
    styles = line_styles(list(COMPARED))
    assert styles.pop("robust")["color"] == BLACK
    lines = {(style["color"], style["ls"]) for style in styles.values()}
    assert len(lines) == len(styles)
    colours = {name.split(",")[0]: style["color"] for name, style in styles.items()}
    assert colours["GS-Checker official"] == colours["GS-Checker paper"] != colours["SA3D"]
    assert colours["mode vote"] == colours["inverse projection"] != colours["FlashSplat"]
