"""The scenes of a collection: a folder, a glob, a text file, or a CSV or Parquet manifest."""

import glob
from collections import Counter
from collections.abc import Mapping, Sequence
from pathlib import Path

from gsc_jax.collection.record import RESERVED
from gsc_jax.io.compressed import SUFFIXES
from gsc_jax.io.files import existing_file
from gsc_jax.io.validation import reported
from gsc_jax.scene import InputError

Entry = dict[str, str | None]
"""`id`, `path`, `cameras`, `masks`, and further columns, which a scan keeps."""
PLACES = ("path", "cameras", "masks")
MANIFESTS = (".csv", ".parquet", ".pq")
LISTS = (".txt", ".lst", ".list")


def read_manifest(source: Path) -> list[Entry]:
    """List the scenes of a source, sorted by id for a folder and a glob.

    A source is a folder, searched to any depth; a glob; a text file with a path, an address or a
    comment (#) per line; or a .csv or .parquet with a column `path`, optionally `id`, `cameras` and
    `masks`, and any others. Relative paths are relative to the manifest. InputError if there is no
    scene, two have one id, or a manifest cannot be read.
    """
    suffix = source.suffix.lower()
    if source.is_dir():
        rows = _files(sorted(source.rglob("*")), source)
    elif not source.exists() and glob.has_magic(str(source)):
        pattern = str(source.relative_to(source.anchor))
        rows = _files(sorted(Path(source.anchor).glob(pattern)))
    elif suffix in MANIFESTS:
        rows = _rows(source)
    elif suffix in LISTS:
        text = existing_file(source, expected="a list").read_text("utf-8", "surrogateescape")
        rows = [{"path": x} for line in text.splitlines() if (x := line.strip()) and x[0] != "#"]
    else:
        existing_file(source, expected="a folder, a glob, a list (.txt), a .csv or a .parquet")
        rows = _files([source])
    if not rows:
        raise InputError(f"{source}: holds no scene, expected .ply or compressed scenes")
    entries = [_entry(row, source) for row in rows]
    for name, count in Counter(entry["id"] for entry in entries).items():
        if count > 1:
            raise InputError(f"{source}: two scenes have the id {name!r}; give each its own")
    return entries


def _files(paths: Sequence[Path], root: Path | None = None) -> list[Entry]:
    return [
        {"id": str(path.relative_to(root) if root else path), "path": str(path.absolute())}
        for path in paths
        if path.suffix.lower() in (".ply", *SUFFIXES) and path.is_file()
    ]


def _rows(source: Path) -> list[Entry]:
    from pyarrow import csv, parquet

    existing_file(source, expected="a manifest")
    with reported(f"{source}: damaged", ", expected a manifest"):
        if source.suffix.lower() != ".csv":
            table = parquet.read_table(source)
        else:  # an id 007 stays as it is
            names = csv.open_csv(source).schema.names
            options = csv.ConvertOptions(column_types=dict.fromkeys(names, "string"))
            table = csv.read_csv(source, convert_options=options)
    if "path" not in table.column_names:
        found = ", ".join(table.column_names)
        raise InputError(f"{source}: expected a column `path`, found {found}; rename the column")
    if taken := sorted(set(table.column_names) & set(RESERVED) - {"id", *PLACES}):
        raise InputError(f"{source}: the column {taken[0]!r} is one of the results; rename it")
    rows = table.to_pylist()
    return [{k: None if v in (None, "") else str(v) for k, v in row.items()} for row in rows]


def _entry(row: Mapping[str, str | None], source: Path) -> Entry:
    """An entry with absolute paths, and the path as written as its id where none is given."""
    if not row["path"]:
        raise InputError(f"{source}: a row has no path; complete or remove it")
    places = {name: row.get(name) for name in PLACES}
    for name, place in places.items():
        if place and "://" not in place:
            places[name] = str((source.parent / place).absolute())
    return {**row, **places, "id": row.get("id") or row["path"]}
