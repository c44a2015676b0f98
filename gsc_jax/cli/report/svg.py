"""Charts for a page: what matplotlib draws, as SVG that belongs to the page it stands in.

Colours are the page's own, so that they follow its light and dark scheme: a figure is drawn in
stand-in colours, which become CSS variables. Text stays text, in the font of the page. Ids that
nothing refers to go, the others are made unique; matplotlib's style sheet, which would apply to
all of the page, goes too (the page has one for its charts).
"""

import contextlib
import io
import re
from collections.abc import Iterator
from typing import TYPE_CHECKING, Any
from xml.etree import ElementTree

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

INK, MUTED, GRID = "#000102", "#000103", "#000104"
TAMPERED, AUTHENTIC, THIRD = "#000105", "#000106", "#000107"
VARIABLES = {
    INK: "--ink",
    MUTED: "--muted",
    GRID: "--line",
    TAMPERED: "--tampered",
    AUTHENTIC: "--authentic",
    THIRD: "--third",
}
"""What each stand-in colour is called in the style sheet of the page."""
STYLE: dict[Any, Any] = {
    "svg.fonttype": "none",
    "font.size": 9,
    "text.color": INK,
    "axes.labelcolor": INK,
    "axes.edgecolor": MUTED,
    "axes.linewidth": 0.8,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "xtick.color": MUTED,
    "ytick.color": MUTED,
    "xtick.labelcolor": INK,
    "ytick.labelcolor": INK,
    "legend.frameon": False,
    "axes.unicode_minus": True,
}
NAMESPACE = re.compile(r"^\{.*\}")


@contextlib.contextmanager
def drawing(width: float = 4.4, height: float = 2.7) -> "Iterator[tuple[Figure, Axes]]":
    """A figure of one chart, in inches at 9 points: what is drawn in the block has our style."""
    import matplotlib
    from matplotlib.figure import Figure

    with matplotlib.rc_context(STYLE):
        figure = Figure(figsize=(width, height), layout="constrained")
        yield figure, figure.subplots()


def inline_svg(figure: "Figure", *, name: str, title: str) -> str:
    """A figure as an element for an HTML page.

    Args:
        figure: What `drawing` gave.
        name: Unique on the page; ids begin with it.
        title: What the chart shows, for those who do not see it.

    Returns:
        The element, without a size of its own.
    """
    import matplotlib

    text = io.StringIO()
    nothing = dict.fromkeys(("Date", "Creator", "Format", "Type"))
    with matplotlib.rc_context({**STYLE, "svg.hashsalt": name}):
        figure.savefig(text, format="svg", transparent=True, metadata=nothing)
    root = ElementTree.fromstring(text.getvalue())
    _plain(root)
    _own_ids(root, name)
    box = root.get("viewBox", "")
    root.attrib.clear()
    root.attrib |= {"viewBox": box, "role": "img", "aria-labelledby": f"{name}-title"}
    label = ElementTree.Element("title", id=f"{name}-title")
    label.text = title
    root.insert(0, label)
    return _own_colours(ElementTree.tostring(root, encoding="unicode"))


def _plain(root: ElementTree.Element) -> None:
    """Drops the namespaces, which HTML does not write, and what is not drawn."""
    for parent in root.iter():
        for child in list(parent):
            if NAMESPACE.sub("", child.tag) in ("metadata", "style"):
                parent.remove(child)
        parent.tag = NAMESPACE.sub("", parent.tag)
        parent.attrib = {NAMESPACE.sub("", key): value for key, value in parent.attrib.items()}


def _own_ids(root: ElementTree.Element, name: str) -> None:
    """Only ids that are referred to, and those after the name of the chart."""
    reference = re.compile(r"(url\(#|^#)([^)]+)")
    used = {
        found[1]
        for element in root.iter()
        for value in element.attrib.values()
        for found in reference.findall(value)
    }
    for element in root.iter():
        identity = element.attrib.pop("id", None)
        for key, value in element.attrib.items():
            element.set(key, reference.sub(rf"\g<1>{name}-\g<2>", value))
        if identity in used:
            element.set("id", f"{name}-{identity}")


def _own_colours(svg: str) -> str:
    for colour, variable in VARIABLES.items():
        svg = svg.replace(colour, f"var({variable})")
    return svg
