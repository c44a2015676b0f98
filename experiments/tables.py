"""CSV files, tables in Markdown and sections of `docs/results*.md`."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Literal

import numpy as np
import pandas as pd

from gsc_jax.benchmark.metrics import auc
from gsc_jax.io.files import atomic

Row = dict[str, Any]
Frame = Any
"""`pandas.DataFrame`: its own annotations are too loose for a static checker."""
Best = Literal["max", "min"]
ITSELF = "the detector itself"
"""Masks of the detector on the views that it was shown: lifting should improve on them."""
TRUTH = "true labels"
"""Upper bound: 1 by definition, unless the model is distorted before it is observed."""
REFERENCE = (ITSELF, TRUTH)
"""Rows that are not methods."""


def write_csv(path: Path, rows: Frame) -> None:
    """Write rows with missing values as `nan`, under a temporary name first."""
    with atomic(path) as temporary:
        rows.to_csv(temporary, index=False, na_rep="nan")


def read_csv(path: Path) -> Frame:
    """Read rows written by `write_csv`; empty text stays empty text."""
    return pd.read_csv(path, keep_default_na=False, na_values=["nan"])


def write_section(path: Path, name: str, text: str) -> None:
    """Replace the text between `<!-- name -->` and `<!-- /name -->`; append both if missing.

    The section may be in `path` or in a page beside it, such as results-paper.md of results.md.
    """
    begin, end = f"<!-- {name} -->", f"<!-- /{name} -->"
    pages = path.parent.glob(f"{path.stem}-*.md")
    path = next((page for page in pages if begin in page.read_text()), path)
    page = path.read_text() if path.exists() else ""
    if begin not in page or end not in page:
        page = f"{page}\n{begin}\n{end}\n"
    before, _, rest = page.partition(begin)
    after = rest.partition(end)[2]
    with atomic(path) as temporary:
        temporary.write_text(f"{before}{begin}\n{text.strip()}\n{end}{after}")


def where(rows: Frame, **values: object) -> Frame:
    """Select the rows with these values in these columns."""
    chosen = np.ones(len(rows), bool)
    for column, value in values.items():
        chosen &= (rows[column] == value).to_numpy()
    return rows[chosen]


def spread(rows: Frame, metric: str = "f1") -> float:
    """Standard deviation over seeds of the mean of a metric; 0 for a single seed."""
    means = rows.groupby("seed")[metric].mean()
    return float(means.std()) if len(means) > 1 else 0.0


def differences(rows: Frame, one: str, other: str) -> np.ndarray:
    """F1 of a method minus that of another, case by case, in the order of the rows."""
    pairs = zip(where(rows, method=one).f1, where(rows, method=other).f1, strict=True)
    return np.array([a - b for a, b in pairs])


def changes(rows: Frame, full: Mapping[str, str]) -> str:
    """Tabulate F1 of variants minus that of the methods they vary, given by name, case by case."""
    lines = []
    for name, whole in full.items():
        change = differences(rows, name, whole)
        lines.append([name, *(f"{f(change):+.3f}" for f in (np.mean, np.min, np.max))])
    return markdown(["variant", "mean", "least", "largest"], lines)


def front_of(points: Frame, x: str = "seconds", y: str = "f1") -> Frame:
    """Points, the smallest `x` first, whose `y` no other one of a smaller `x` reaches."""
    ordered = points.sort_values([x, y], ascending=[True, False])
    return ordered[ordered[y] > ordered[y].cummax().shift(fill_value=-1.0)]


def separation(edited: Frame, authentic: Frame) -> float:
    """AUC of the scene probabilities of edited against those of authentic cases."""
    values = np.append(edited.verdict, authentic.verdict)
    return auc(values, np.arange(len(values)) < len(edited))


def markdown(heads: Sequence[str], rows: Sequence[Sequence[object]]) -> str:
    """Format a table in Markdown."""
    lines = [heads, ["---"] * len(heads), *rows]
    return "\n".join(f"| {' | '.join(map(str, line))} |" for line in lines)


def pivot(
    rows: Frame,
    down: str,
    across: str,
    *,
    metric: str = "f1",
    over: str = "seed",
    total: bool = True,
    best: Best | None = "max",
    digits: int = 2,
) -> str:
    """Tabulate means of a metric and their standard deviation over seeds, the best in bold.

    Args:
        rows: Measurements, with a column `seed` or `over`.
        down: Column whose values are the rows of the table.
        across: Column whose values are the columns of the table.
        metric: Column to average.
        over: Column over whose values the standard deviation is computed.
        total: Add the mean over all columns, which count equally, however many rows they have.
        best: Whether the largest or the smallest mean is set in bold, except in the rows
            `REFERENCE`; None for none.
        digits: Decimal places.
    """
    table = {}
    for column in [*rows[across].unique(), *([None] if total else [])]:
        own = rows if column is None else where(rows, **{across: column})
        cells = _cells(own, [down, across], metric, over)
        contest = cells["mean"].drop(list(REFERENCE), errors="ignore").dropna()
        winner = getattr(contest, best)() if best and len(contest) else None
        table["mean" if column is None else str(column)] = {
            name: _cell(cell, None if name in REFERENCE else winner, digits)
            for name, cell in cells.iterrows()
        }
    lines = [
        [name, *(cells.get(name, "-") for cells in table.values())] for name in rows[down].unique()
    ]
    return markdown([down, *table], lines)


def _cells(rows: Frame, keys: list[str], metric: str, over: str) -> Frame:
    """Mean over the columns of a table, standard deviation and number of seeds, for each row."""
    down = keys[0]
    means = rows.groupby(keys, sort=False)[metric].mean().groupby(down, sort=False).mean()
    unit = rows[over].rename("unit")
    by_unit = rows.groupby([*keys, unit])[metric].mean().groupby([down, "unit"]).mean()
    groups = by_unit.groupby(down)
    return pd.DataFrame({"mean": means, "spread": groups.std(), "seeds": groups.size()})


def with_columns(table: str, columns: Mapping[str, Mapping[str, str]]) -> str:
    """Append columns of texts, by heading and row, to a table in Markdown."""
    heads, dashes, *lines = table.splitlines()
    for head, texts in columns.items():
        heads, dashes = f"{heads} {head} |", f"{dashes} --- |"
        lines = [f"{line} {texts.get(line.split('|')[1].strip(), '')} |" for line in lines]
    return "\n".join([heads, dashes, *lines])


def _cell(cell: Any, winner: float | None, digits: int) -> str:
    if np.isnan(cell["mean"]):
        return "-"
    text = f"{cell['mean']:z.{digits}f}"
    if winner is not None and text == f"{winner:z.{digits}f}":
        text = f"**{text}**"
    return f"{text} ± {cell['spread']:.{digits}f}" if cell["seeds"] > 1 else text
