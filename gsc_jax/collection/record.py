"""The row of a scene, its Arrow schema, and the Parquet dataset of all rows.

A finished scene is at once a file `OUT/scenes/config=C/part=P/KEY-ID.parquet`, of one row, where
KEY is the digest of its content and C that of the configuration. At the end of a scan the files of
a part become one file, so that a million scenes are 256 files per configuration.
"""

import hashlib
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from gsc_jax.io.files import atomic
from gsc_jax.scene import InputError

if TYPE_CHECKING:
    import pyarrow as pa

Row = dict[str, Any]
TEXTS = ("id", "path", "cameras", "masks", "key", "sha256", "format", "result_sha256", "report")
TEXTS += ("error_class", "error", "duplicate_of", "status", "version", "configuration")
WHOLE = ("bytes", "gaussians", "labelled", "attempts")
REAL = ("scene_probability", "labelled_share", "seconds")
LISTS = ("traces", "warnings")
RESERVED = (*TEXTS, *WHOLE, *REAL, *LISTS, "stages")
OWN = ("id", "path", "cameras", "masks", "duplicate_of", "status")
"""Columns that a duplicate does not take from the scene that it repeats."""
TRANSIENT = ("TimeoutError", "WorkerLost")
"""Errors of the machine and not of the file: the next scan tries such a scene again."""


def schema(row: Mapping[str, Any]) -> "pa.Schema":
    """Schema of a row: the columns of every scan, and those of the manifest as text."""
    import pyarrow as pa

    stage = pa.struct({"name": pa.string(), "seconds": pa.float64(), "peak_mib": pa.float64()})
    kinds = {name: pa.string() for name in TEXTS}
    kinds |= {name: pa.int64() for name in WHOLE} | {name: pa.float64() for name in REAL}
    kinds |= {name: pa.list_(pa.string()) for name in LISTS} | {"stages": pa.list_(stage)}
    return pa.schema({**kinds, **{name: pa.string() for name in row if name not in kinds}})


def complete(row: Mapping[str, Any]) -> Row:
    """A row with all columns, so that all rows of a dataset have one schema."""
    return {**dict.fromkeys(RESERVED), **{name: [] for name in (*LISTS, "stages")}, **row}


def write_row(out: Path, row: Row) -> None:
    """Write the row of a finished scene to the dataset of a folder of results."""
    name = hashlib.sha256(str(row["id"]).encode("utf-8", "surrogateescape")).hexdigest()[:16]
    part = dataset_folder(out, row["configuration"]) / f"part={row['key'][:2] or 'unread'}"
    _write(part / f"{row['key'][:32] or 'unread'}-{name}.parquet", [row])


def read_rows(out: Path, configuration: str) -> Iterator[Row]:
    """The rows of a configuration; of two with one id in a part, the newer one."""
    for part in sorted(dataset_folder(out, configuration).glob("part=*")):
        yield from _rows(part)


def wants_report(row: Row, above: float | None) -> bool:
    """Whether a judged scene gets the folder of `locate`; without a probability, if labelled."""
    found = row["scene_probability"]
    return above is not None and (bool(row["labelled"]) if found is None else found) >= above


def finished_scenes(
    out: Path, configuration: str, *, report_above: float | None = None
) -> dict[str, list[str]]:
    """Ids of the finished scenes by key, the one that was judged first.

    Transient errors are not final, and a scene that now gets a folder is judged again.
    """
    finished: dict[str, list[str]] = {}
    for row in sorted(read_rows(out, configuration), key=lambda row: bool(row["duplicate_of"])):
        # A copy counts only after its original, which a killed scan may not have judged.
        original = not row["duplicate_of"] or row["key"] in finished
        has_all = row["report"] or row["duplicate_of"] or row["error_class"]
        final = has_all or not wants_report(row, report_above)
        if original and row["key"] and final and row["error_class"] not in TRANSIENT:
            finished.setdefault(row["key"], []).append(row["id"])
    return finished


def merge_rows(out: Path, configuration: str, keys: Mapping[str, str]) -> None:
    """Make one file of each part, and fill in duplicates.

    `keys` are those of the scenes of this scan by id: rows of their former contents are removed.
    """
    for part in sorted(dataset_folder(out, configuration).glob("part=*")):
        old = set(part.glob("*.parquet"))
        rows = [row for row in _rows(part) if keys.get(row["id"], row["key"]) == row["key"]]
        first = {row["key"]: row for row in rows if not row["duplicate_of"]}
        for row in rows:
            if row["duplicate_of"] and row["key"] in first:
                row |= {k: first[row["key"]][k] for k in RESERVED if k not in OWN}
        lines = "\n".join(sorted(f"{row['key']} {row['id']} {row['attempts']}" for row in rows))
        digest = hashlib.sha256(lines.encode("utf-8", "surrogateescape")).hexdigest()[:32]
        merged = part / f"{digest}.parquet"
        if rows and old != {merged}:
            _write(merged, rows)
        for path in old - {merged} if rows else old:
            path.unlink(missing_ok=True)


def dataset_folder(out: Path, configuration: str) -> Path:
    """Folder of the dataset of one configuration."""
    return out / "scenes" / f"config={configuration[:16]}"


def _rows(part: Path) -> list[Row]:
    """The rows of a part; merged files, without a dash in their name, come first."""
    from pyarrow import parquet

    rows: dict[tuple[str, str], Row] = {}
    whole = part.glob("[!.]*.parquet")  # hidden is what a killed worker has not finished
    for path in sorted(whole, key=lambda path: ("-" in path.name, path.name)):
        try:
            found = parquet.ParquetFile(path).read().to_pylist()
        except Exception as error:
            raise InputError(f"{path}: damaged; remove it, its scenes are judged again") from error
        rows |= {(row["id"], row["key"]): row for row in found}
    return list(rows.values())


def _write(path: Path, rows: list[Row]) -> None:
    from pyarrow import Table, parquet

    names = {name: None for row in rows for name in row}
    with atomic(path) as temporary:
        parquet.write_table(Table.from_pylist(rows, schema=schema(names)), temporary)
