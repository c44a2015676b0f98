"""Charts as SVG images for a page with a light and a dark colour scheme.

A chart is drawn twice by matplotlib, once in the colours of each scheme, and the page selects one
of the two images. Colours C0 (tampered) and C1 (authentic) repeat those of report.css.
"""

import base64
import dataclasses
import io
from collections.abc import Callable
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from matplotlib.axes import Axes

LIGHT = {"ink": "#1c1b1a", "muted": "#5c5954", "cycle": ["#b3004b", "#22588f"]}
DARK = {"ink": "#ebe8e3", "muted": "#aba69e", "cycle": ["#ff7fae", "#85b8ee"]}
STYLE = {
    "svg.fonttype": "none",
    "svg.hashsalt": "gsc_jax",  # reproducible ids
    "font.size": 9,
    "axes.spines.top": False,
    "axes.spines.right": False,
}


@dataclasses.dataclass(frozen=True, kw_only=True)
class Chart:
    """A chart: heading, sentences, and its image for each scheme as a data URI."""

    title: str
    text: str
    light: str
    dark: str


def chart(
    plot: "Callable[[Axes], object]", *, title: str, text: str, size: tuple[float, float]
) -> Chart:
    """Draw a chart in both colour schemes; `size` is in inches, with text of 9 points."""
    light, dark = (_data_uri(plot, scheme, size) for scheme in (LIGHT, DARK))
    return Chart(title=title, text=text, light=light, dark=dark)


def _data_uri(plot: "Callable[[Axes], object]", scheme: dict, size: tuple[float, float]) -> str:
    import matplotlib
    from matplotlib.figure import Figure

    file = io.BytesIO()
    with matplotlib.rc_context(_style(**scheme)):
        figure = Figure(figsize=size, layout="constrained")
        plot(figure.subplots())
        figure.savefig(file, format="svg", transparent=True, metadata={"Date": None})
    return f"data:image/svg+xml;base64,{base64.b64encode(file.getvalue()).decode()}"


def _style(ink: str, muted: str, cycle: list[str]) -> dict:
    from cycler import cycler

    text = ("text.color", "axes.labelcolor", "xtick.labelcolor", "ytick.labelcolor")
    lines = ("axes.edgecolor", "xtick.color", "ytick.color")
    style = STYLE | dict.fromkeys(text, ink) | dict.fromkeys(lines, muted)
    return style | {"axes.prop_cycle": cycler(color=cycle)}
