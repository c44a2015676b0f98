"""What the experiments share on paper: CSV, tables in Markdown, sections of `docs/results.md`."""

import csv
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from gsc_jax.io.files import atomic

Row = dict[str, Any]


def write_csv(path: Path, rows: Sequence[Row]) -> None:
    """Write rows; what one of them lacks is not a number."""
    keys = dict.fromkeys(key for row in rows for key in row)
    with atomic(path) as temporary, temporary.open("w", newline="") as file:
        writer = csv.DictWriter(file, list(keys), restval="nan")
        writer.writeheader()
        writer.writerows(rows)


def read_csv(path: Path) -> list[Row]:
    """Read rows back, numbers as numbers."""
    with path.open(newline="") as file:
        return [{key: _number(text) for key, text in row.items()} for row in csv.DictReader(file)]


def _number(text: str) -> Any:
    for kind in (int, float):
        try:
            return kind(text)
        except ValueError:
            continue
    return text


def write_section(path: Path, name: str, text: str) -> None:
    """Replace what stands between the marks `<!-- name -->` and `<!-- /name -->` of a page.

    A page or section that is not there is begun.
    """
    begin, end = f"<!-- {name} -->", f"<!-- /{name} -->"
    page = path.read_text() if path.exists() else ""
    if begin not in page or end not in page:
        page = f"{page}\n{begin}\n{end}\n"
    before, _, rest = page.partition(begin)
    after = rest.partition(end)[2]
    with atomic(path) as temporary:
        temporary.write_text(f"{before}{begin}\n{text.strip()}\n{end}{after}")


def where(rows: Sequence[Row], **chosen: object) -> list[Row]:
    """The rows that have these values."""
    return [row for row in rows if all(row[key] == value for key, value in chosen.items())]


def mean(rows: Sequence[Row], metric: str = "f1") -> float:
    """Mean of a metric over the rows in which it exists; not a number where there is none."""
    values = [row[metric] for row in rows if not np.isnan(row[metric])]
    return float(np.mean(values)) if values else float("nan")


def spread(rows: Sequence[Row], metric: str = "f1") -> float:
    """Standard deviation over seeds of the mean over everything else; 0 for a single seed."""
    means = [mean(where(rows, seed=seed), metric) for seed in values_of(rows, "seed")]
    return float(np.std(means, ddof=1)) if len(means) > 1 else 0.0


def values_of(rows: Sequence[Row], key: str) -> list[Any]:
    """The values of a column, in the order in which they first appear."""
    return list(dict.fromkeys(row[key] for row in rows))


def markdown(heads: Sequence[str], rows: Sequence[Sequence[object]]) -> str:
    """A table in Markdown."""
    lines = [heads, ["---"] * len(heads), *rows]
    return "\n".join(f"| {' | '.join(map(str, line))} |" for line in lines)


def pivot(
    rows: Sequence[Row],
    down: str,
    across: str,
    *,
    metric: str = "f1",
    total: bool = True,
    best: Callable[[Sequence[float]], float] | None = max,
    extra: dict[str, dict[str, str]] | None = None,
    reference: Sequence[str] = (),
    digits: int = 2,
) -> str:
    """A table in Markdown: mean and spread over seeds of a metric, the best of a column in bold.

    Args:
        rows: What was measured, with a column `seed`.
        down: The column whose values are the rows of the table.
        across: The column whose values are its columns.
        metric: What is averaged.
        total: Add the mean over all columns.
        best: Picks what is set in bold; None for nothing.
        extra: Further columns, by heading and row.
        reference: Rows that take no part in the contest for the best.
        digits: After the point.
    """
    extra = extra or {}
    names, columns = values_of(rows, down), values_of(rows, across)
    cells = {
        name: [where(rows, **{down: name, across: column}) for column in columns]
        + ([where(rows, **{down: name})] if total else [])
        for name in names
    }
    contest = [name for name in names if name not in reference]
    width = len(columns) + total
    winners = [
        _winner([mean(cells[name][k], metric) for name in contest], best) for k in range(width)
    ]
    heads = [down, *map(str, columns), *(["mean"] if total else []), *extra]
    lines = []
    for name in names:
        texts = [
            _cell(cells[name][k], metric, winners[k] if name in contest else None, digits)
            for k in range(width)
        ]
        texts += [column.get(name, "") for column in extra.values()]
        lines.append([name, *texts])
    return markdown(heads, lines)


def _winner(
    values: Sequence[float], best: Callable[[Sequence[float]], float] | None
) -> float | None:
    known = [value for value in values if not np.isnan(value)]
    return best(known) if best and known else None


def _cell(rows: Sequence[Row], metric: str, winner: float | None, digits: int) -> str:
    value = mean(rows, metric)
    if np.isnan(value):
        return "-"
    text = f"{value:z.{digits}f}"
    if winner is not None and text == f"{winner:z.{digits}f}":
        text = f"**{text}**"
    return (
        f"{text} ± {spread(rows, metric):.{digits}f}" if len(values_of(rows, "seed")) > 1 else text
    )
