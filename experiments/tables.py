"""What the experiments share: tables in CSV and in the sections of `docs/results.md`."""

import csv
from collections.abc import Sequence
from pathlib import Path

from gsc_jax.io.files import atomic


def write_csv(path: Path, rows: Sequence[dict[str, object]]) -> None:
    """Write rows of the same keys."""
    with atomic(path) as temporary, temporary.open("w", newline="") as file:
        writer = csv.DictWriter(file, list(rows[0]))
        writer.writeheader()
        writer.writerows(rows)


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
