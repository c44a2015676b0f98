"""report.html: what a person is shown who was handed a scene and a folder of results.

One file that needs nothing else: pictures are small and inside of it, the large ones are taken from
the folder where that is there, and a policy in the page forbids the network. Everything on the page
is HTML before any script runs; the script adds the stage, sorting and keys. Names of cameras and
files come from outside, so all of the text is escaped by the template, and none of it is in the
script or the style sheet, which are our own.
"""

import base64
import dataclasses
import hashlib
import json
from collections.abc import Iterator, Mapping
from importlib.resources import files
from pathlib import Path
from typing import Any

from gsc_jax.cli.located import Located
from gsc_jax.cli.report.charts import (
    Chart,
    attribute_chart,
    groups_chart,
    property_charts,
    views_chart,
)
from gsc_jax.cli.report.thumbnails import LAYERS, Picture, pictures, url
from gsc_jax.cli.report.wording import (
    TRACES,
    WORTH,
    effort_sentence,
    found_sentence,
    headline,
    percent,
    share,
    traces_found,
)
from gsc_jax.cli.staging import OUTPUTS
from gsc_jax.evidence.monitor import Progress, silent


@dataclasses.dataclass(frozen=True, kw_only=True)
class View:
    """A view of the page.

    Attributes:
        number: Place in the order of the cameras, from 1.
        name: Of the camera.
        width: Of its image, in pixels.
        height: Of its image, in pixels.
        found: Share of it that is tampered.
        said: Share of it that the detector flagged; None where it was not asked.
        worth: What its mask is worth, a key of `WORTH`, or None.
        pictures: The layers that there are.
    """

    number: int
    name: str
    width: int
    height: int
    found: float
    said: float | None
    worth: str | None
    pictures: list[Picture]


@dataclasses.dataclass(frozen=True, kw_only=True)
class File:
    """A file of the folder, or a folder in it.

    Attributes:
        name: As people read it.
        url: Relative to the page.
        what: What it is.
    """

    name: str
    url: str
    what: str


def report_page(
    folder: Path, report: Mapping[str, Any], located: Located, *, progress: Progress = silent
) -> str:
    """The page on a run.

    Args:
        folder: Where its pictures are.
        report: The content of result.json.
        located: The run.
        progress: Called with (stage, done, total).

    Returns:
        HTML that is complete by itself.
    """
    result = located.result
    views = list(_views(folder, report, progress))
    present = {picture.layer for view in views for picture in view.pictures}
    style, script = _text("report.css"), _text("report.js")
    return _template().render(
        report=report,
        result=result,
        headline=headline(report["verdict"], report["counts"]["tampered"]),
        found=found_sentence(
            report["counts"]["tampered"],
            report["counts"]["gaussians"],
            verdict=report["verdict"],
            views=report["views"],
            covered=report["tampered_share_of_views"],
        ),
        effort=effort_sentence(result),
        traces=sorted(result.native.traces, key=lambda t: not t.found) if result.native else [],
        traces_found=traces_found(result),
        trace_words=TRACES,
        views=views,
        layers=[layer for layer in LAYERS if layer.name in present],
        worth=WORTH,
        charts=_charts(report, located),
        properties=property_charts(located.scene.gaussians, result),
        files=_files(folder, report["outputs"]),
        counts=_counts(report, located),
        tables={
            "Configuration": _flat(report["config"]),
            "Command": _flat(_asked_for(report["command"])),
            "Versions": _flat(report["versions"]),
        },
        style=style,
        script=script,
        script_hash=base64.b64encode(hashlib.sha256(script.encode()).digest()).decode(),
    )


def _asked_for(command: Mapping[str, Any]) -> dict[str, Any]:
    """The options that say something, of which the rest is left to the method."""
    left = [name for name, said in command.items() if said is None or said is False or said == []]
    return {name: said for name, said in command.items() if name not in left}


def _views(folder: Path, report: Mapping[str, Any], progress: Progress) -> Iterator[View]:
    told = report["per_view"]
    progress("report", 0, len(told))
    for number, (view, layers) in enumerate(
        zip(told, pictures(folder, told), strict=True), start=1
    ):
        yield View(
            number=number,
            name=view["name"],
            width=view["width"],
            height=view["height"],
            found=view["tampered_share"],
            said=view["detector_share"],
            worth=view["reliability"],
            pictures=layers,
        )
        progress("report", number, len(told))


def _charts(report: Mapping[str, Any], located: Located) -> list[Chart]:
    result = located.result
    charts = (
        attribute_chart(result),
        views_chart(report["per_view"]),
        groups_chart(result.group_sizes),
    )
    return [chart for chart in charts if chart]


def _files(folder: Path, outputs: list[str]) -> list[File]:
    """The files of the folder, and of folders their name only, as `OUTPUTS` has them."""
    counts = {name: sum(path.startswith(name) for path in outputs) for name in OUTPUTS}
    return [
        File(
            name=name,
            url=url(folder / name, folder) + "/" * name.endswith("/"),
            what=OUTPUTS[name] + (f" ({count})" if name.endswith("/") else ""),
        )
        for name, count in counts.items()
        if count
    ]


def _counts(report: Mapping[str, Any], located: Located) -> list[tuple[str, str]]:
    counts = report["counts"]
    names = {
        "rows": "Rows of the file",
        "gaussians": "Gaussians that can be rendered",
        "seen": "Gaussians that were seen",
        "unseen": "Gaussians that were not seen",
        "tampered": "Gaussians that are tampered",
    }
    rows = [(title, f"{counts[name]:,}") for name, title in names.items()]
    rows += [(f"Left out: {reason}", f"{n:,}") for reason, n in counts["dropped"].items()]
    rows += [
        ("Views", f"{report['views']:,}"),
        ("Views that a detector judged", f"{report['judged_views']:,}"),
        ("Tampered share of the views, mean", share(located.visible_share)),
    ]
    return rows


def _flat(value: Any, name: str = "") -> list[tuple[str, str]]:
    """A nested configuration as rows of dotted names and values."""
    if isinstance(value, dict) and value:
        return [
            row
            for key, entry in value.items()
            for row in _flat(entry, f"{name}.{key}" if name else str(key))
        ]
    return [(name, value if isinstance(value, str) else json.dumps(value, ensure_ascii=False))]


def _text(name: str) -> str:
    return files("gsc_jax.cli.report").joinpath(name).read_text(encoding="utf-8")


def _template():
    import jinja2
    from markupsafe import Markup

    environment = jinja2.Environment(
        autoescape=True, trim_blocks=True, lstrip_blocks=True, undefined=jinja2.StrictUndefined
    )
    environment.filters |= {"share": share, "percent": percent, "ours": Markup}
    return environment.from_string(_text("report.html"))
