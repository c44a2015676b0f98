"""Sources of scans: folders, globs, lists and tables, and messages about bad ones."""

import pytest

from gsc_jax.scene import InputError

pytest.importorskip("pyarrow", reason="needs the extra `cluster`")

import pyarrow as pa
from pyarrow import parquet

from gsc_jax.collection.manifest import read_manifest


@pytest.fixture
def folder(tmp_path):
    for name in ("a.ply", "b/c.spz", "b/note.md"):
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).write_text("")
    return tmp_path


def ids(entries) -> list[str]:
    return [entry["id"] for entry in entries]


def test_a_folder_and_a_glob(folder):
    assert ids(read_manifest(folder)) == ["a.ply", "b/c.spz"]
    assert ids(read_manifest(folder / "**" / "*.spz")) == [str(folder / "b" / "c.spz")]
    assert ids(read_manifest(folder / "a.ply")) == [str(folder / "a.ply")]


def test_a_list_is_relative_to_itself_and_keeps_addresses(folder):
    (folder / "list.txt").write_text("# scenes\na.ply\n\n  # more\ns3://bucket/d.ply\n")
    entries = read_manifest(folder / "list.txt")
    assert ids(entries) == ["a.ply", "s3://bucket/d.ply"]
    assert [entry["path"] for entry in entries] == [str(folder / "a.ply"), "s3://bucket/d.ply"]


@pytest.mark.parametrize("suffix", ["csv", "parquet"])
def test_a_table_keeps_its_columns_as_text(folder, suffix):
    path = folder / f"m.{suffix}"
    if suffix == "csv":
        path.write_text("id,path,cameras,case\n007,a.ply,cams.json,12\n008,b/c.spz,,13\n")
    else:
        columns = {"id": ["007", "008"], "path": ["a.ply", "b/c.spz"]}
        columns |= {"cameras": ["cams.json", None], "case": [12, 13]}
        parquet.write_table(pa.table(columns), path)
    first, second = read_manifest(path)
    assert (first["id"], first["case"], second["case"]) == ("007", "12", "13")
    assert (first["cameras"], second["cameras"]) == (str(folder / "cams.json"), None)


@pytest.mark.parametrize(
    ("name", "content", "message"),
    [
        ("m.csv", "file\na.ply\n", "expected a column `path`, found file"),
        ("m.csv", "path,id\na.ply,1\nb/c.spz,1\n", "two scenes have the id '1'"),
        ("m.csv", "path,sha256\na.ply,1\n", "'sha256' is one of the results"),
        ("m.csv", "path,id\n,1\n", "a row has no path"),
        ("m.parquet", "no table", "damaged"),
        ("l.txt", "\n", "holds no scene"),
    ],
)
def test_bad_sources(folder, name, content, message):
    (folder / name).write_text(content)
    with pytest.raises(InputError, match=message):
        read_manifest(folder / name)


def test_a_missing_source(tmp_path):
    with pytest.raises(InputError, match="no such file"):
        read_manifest(tmp_path / "nothing")
