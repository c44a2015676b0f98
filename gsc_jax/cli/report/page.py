"""report.html: one page that explains a result to a person.

The page is complete in one file: thumbnails are embedded, full images are loaded from the folder
beside it if present, and a content security policy forbids the network and foreign scripts. The
HTML is complete without JavaScript. Names of cameras and files are foreign text: the template
escapes them, and none is in the script or the style sheet.
"""

import base64
import hashlib
import json
from collections.abc import Mapping
from importlib.resources import files
from pathlib import Path
from typing import Any

from gsc_jax.cli.report import wording
from gsc_jax.cli.report.charts import score_histogram
from gsc_jax.cli.report.thumbnails import LAYERS, thumbnails
from gsc_jax.cli.staging import OUTPUTS
from gsc_jax.evidence.monitor import Monitor
from gsc_jax.locate import Result

COUNTS = {
    "rows": "Rows of the file",
    "gaussians": "Gaussians that can be rendered",
    "seen": "Gaussians with evidence",
    "unseen": "Gaussians that no view shows",
    "tampered": "Labelled Gaussians",
}
"""Title of each entry of `counts` in result.json."""


def report_page(folder: Path, report: dict[str, Any], result: Result, *, monitor: Monitor) -> str:
    """Render the page of a run, whose images are in `folder`, with the content of result.json."""
    counts, views = report["counts"], report["per_view"]
    found = thumbnails(folder, [view["name"] for view in views])
    images = list(monitor.track("report", found, len(views)))
    present = {image.layer for view in images for image in view}
    totals = {name: sum(path.startswith(name) for path in report["outputs"]) for name in OUTPUTS}
    return complete_page(
        "gsc_jax.cli.report",
        "report",
        report=report,
        result=result,
        wording=wording,
        candidates=counts["tampered"] > 0 and wording.are_candidates(report["verdict"]),
        traces=sorted(getattr(result.prior, "traces", ()), key=lambda trace: not trace.found),
        views=sorted(
            zip(range(len(views)), views, images, strict=True),
            key=lambda view: -view[1]["tampered_share"],
        ),
        layers={name: title for name, title in LAYERS.items() if name in present},
        histogram=score_histogram(result),
        files=[
            (name, f"{text} ({totals[name]})" if name.endswith("/") else text)
            for name, text in OUTPUTS.items()
            if totals[name]
        ],
        tables=_tables(report),
    )


def _tables(report: Mapping[str, Any]) -> dict[str, list[tuple[str, str]]]:
    """Rows of names and values of each table, by caption."""
    counts, content = report["counts"], "{bytes:,} bytes, SHA-256 {sha256}"
    rows = [(title, f"{counts[name]:,}") for name, title in COUNTS.items()]
    rows += [(f"Left out: {reason}", f"{n:,}") for reason, n in counts["dropped"].items()]
    options = {k: v for k, v in report["command"].items() if v is not False and v not in (None, [])}
    return {
        "Time and memory": [(name, _usage(**stage)) for name, stage in report["stages"].items()],
        "Counts": rows,
        "Configuration": _flat(report["config"]),
        "Command": _flat(options),
        "Inputs": [(path, content.format(**facts)) for path, facts in report["inputs"].items()],
        "Versions": _flat(report["versions"]),
    }


def _usage(seconds: float, peak_mib: float | None) -> str:
    return f"{seconds:.2f} s" + ("" if peak_mib is None else f", peak {peak_mib:,.0f} MiB")


def _flat(value: Any, name: str = "") -> list[tuple[str, str]]:
    """A nested configuration as rows of dotted names and values."""
    if isinstance(value, dict) and value:
        nested = ((f"{name}.{key}" if name else str(key), entry) for key, entry in value.items())
        return [row for key, entry in nested for row in _flat(entry, key)]
    return [(name, value if isinstance(value, str) else json.dumps(value, ensure_ascii=False))]


def complete_page(package: str, name: str, **values: Any) -> str:
    """Render NAME.html of a package, complete with NAME.css and NAME.js, whose hash it allows.

    All values are escaped, except where the filter `trusted` marks our own markup.
    """
    import jinja2
    from markupsafe import Markup

    def read(suffix: str) -> str:
        return files(package).joinpath(f"{name}.{suffix}").read_text("utf-8")

    environment = jinja2.Environment(
        autoescape=True, trim_blocks=True, lstrip_blocks=True, undefined=jinja2.StrictUndefined
    )
    environment.filters |= {"share": wording.share, "percent": wording.percent, "trusted": Markup}
    return environment.from_string(read("html")).render(
        style=read("css"),
        script=read("js"),
        script_hash=base64.b64encode(hashlib.sha256(read("js").encode()).digest()).decode(),
        **values,
    )
