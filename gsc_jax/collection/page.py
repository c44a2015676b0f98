"""collection.html: a table of all scenes of a scan that sorts, filters and opens 100,000 rows."""

from collections import Counter
from collections.abc import Sequence

from gsc_jax.cli.report.page import complete_page
from gsc_jax.collection.record import Row
from gsc_jax.estimators.protocol import outcome

MARK = "<!-- gsc_jax collection -->"
SHOWN = ("id", "scene_probability", "labelled_share", "gaussians", "bytes", "seconds", "traces")
SHOWN += ("error_class", "error", "report", "duplicate_of")
"""Columns of the page, in its order; the outcome follows them."""


def collection_page(rows: Sequence[Row]) -> str:
    """Render the page of a collection, complete in one file but for the reports that it links to.

    The data are compact JSON, and the script makes elements for the visible rows only. Names and
    errors are foreign text, which becomes text of elements and never markup.
    """
    probabilities = [p for row in rows if (p := row["scene_probability"]) is not None]
    outcomes = Counter(map(outcome, probabilities))
    data = [[*(_shown(row, n) for n in SHOWN), outcome(row["scene_probability"])] for row in rows]
    bins = Counter(min(int(10 * probability), 9) for probability in probabilities)
    return complete_page(
        "gsc_jax.collection",
        "collection",
        mark=MARK,
        count=len(rows),
        edited=outcomes["evidence"],
        outcomes=[(f"outcome:{x}", outcomes[x]) for x in ("evidence", "inconclusive", "none")],
        bins=[bins[index] for index in range(10)],
        errors=Counter(row["error_class"] for row in rows if row["error_class"]).most_common(),
        traces=Counter(name for row in rows for name in row["traces"] or ()).most_common(),
        data=data,
    )


def _shown(row: Row, name: str) -> object:
    value = row[name]
    if isinstance(value, list):
        return " ".join(value)
    if name == "error" and value:  # its beginning is in the column of the scene, too
        return value.removeprefix(f"{row['path']}: ")
    return float(f"{value:.4g}") if isinstance(value, float) else value
