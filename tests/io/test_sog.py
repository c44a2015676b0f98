"""Folders of SOG, streamed or not, as PlayCanvas splat-transform 2.7.1 (npm) writes them."""

import io
import json
import os
import shutil
import types
import zipfile
from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from scipy.spatial import KDTree

from gsc_jax.io.ply import load_ply, read_ply
from gsc_jax.scene import InputError

pytest.importorskip("gsply")
ROWS, CHUNKS, ENVIRONMENT = 2400, ("0_0", "0_1", "0_2"), 20
"""Of level 0, made from the `waves` of this file; level 1 has 100 rows, which are not read."""


def waves(*shape: int, start: float, size: float = 1.0) -> np.ndarray:
    return (size * np.sin(start + np.arange(np.prod(shape)).reshape(shape))).astype(np.float32)


@pytest.fixture
def streamed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A streamed scene, and Pillow in place of imagecodecs, which is larger than all the rest."""

    def decode(data: bytes) -> np.ndarray:
        return np.asarray(Image.open(io.BytesIO(data)).convert("RGBA"))

    monkeypatch.setattr("gsply.sog_reader.imagecodecs", types.SimpleNamespace(webp_decode=decode))
    with zipfile.ZipFile(Path(__file__).with_name("streamed_sog.zip")) as archive:
        archive.extractall(tmp_path / "scene")
    return tmp_path / "scene"


def test_the_finest_level_and_the_environment_are_read(streamed):
    found = load_ply(streamed)
    assert len(found) == ROWS + ENVIRONMENT
    for rows, start, count in ((slice(ROWS), 0, ROWS), (slice(ROWS, None), 90, ENVIRONMENT)):
        part = found.take(rows)
        distances, nearest = KDTree(waves(count, 3, start=start, size=20)).query(part.means)
        assert np.array_equal(np.sort(nearest), np.arange(count))
        assert distances.max() < 0.01
        scales = waves(count, 3, start=start + 1)[nearest] - 3
        np.testing.assert_allclose(part.log_scales, scales, atol=0.03)
        colours = waves(count, 12 if start == 0 else 3, start=start + 4)[nearest]
        np.testing.assert_allclose(part.sh[:, 0], colours[:, :3], atol=0.03)
    assert found.sh_degree == 1
    assert not np.asarray(found.sh[ROWS:, 1:]).any()  # the environment has no such bands


def test_a_folder_is_no_file_of_the_format_in_its_name(streamed):
    moved = streamed.rename(streamed.with_name("scene.splat"))
    assert len(load_ply(moved)) == ROWS + ENVIRONMENT


def test_the_chunks_follow_in_the_order_of_the_tree(streamed):
    parts = [load_ply(streamed / name) for name in CHUNKS]
    assert min(map(len, parts)) > 0
    means = np.concatenate([part.means for part in parts])
    np.testing.assert_array_equal(load_ply(streamed).means[:ROWS], means)


def test_files_of_any_date_are_read_and_links_to_elsewhere_are_not(streamed):
    for path in streamed.rglob("*"):
        os.utime(path, (0, 0))
    assert len(load_ply(streamed)) == ROWS + ENVIRONMENT
    image = streamed / "0_0" / "quats.webp"
    image.rename(streamed.parent / "quats.webp")
    image.symlink_to(streamed.parent / "quats.webp")
    with pytest.raises(InputError, match=r"quats\.webp"):
        read_ply(streamed)


def test_the_files_inside_are_no_scenes(streamed):
    for path in (streamed / "lod-meta.json", streamed / "0_0/meta.json"):
        with pytest.raises(InputError, match=f"name the folder {path.parent}"):
            read_ply(path)
    with pytest.raises(InputError, match=r"is a folder, expected a scene"):
        read_ply(streamed.parent)


def damaged(index: dict, name: str) -> dict:
    nodes, leaves = [index["tree"]], []
    while nodes:
        node = nodes.pop()
        nodes += node.get("children", [])
        leaves += [node["lods"]["0"]] if "lods" in node else []
    if name == "elsewhere":
        index["filenames"] = ["../other/meta.json"] * len(index["filenames"])
    elif name == "the index again":
        index["filenames"] = ["lod-meta.json"] * len(index["filenames"])
    elif name == "too many rows":
        leaves[0]["count"] += 1
    elif name == "rows before the first":
        leaves[0]["offset"] = -1
    elif name == "rows of two nodes":
        leaves[0].update(leaves[1])
    elif name == "no such chunk":
        leaves[0]["file"] = 99
    elif name == "a chunk before the first":
        leaves[0]["file"] = -1
    elif name == "no count":
        leaves[0]["count"] = None
    elif name == "no finest level":
        index["tree"] = {}
        del index["environment"]
    elif name == "no tree":
        del index["tree"]
    return index


@pytest.mark.parametrize(
    ("name", "match"),
    [
        ("elsewhere", r"\.\./other/meta\.json is not a meta\.json inside the folder"),
        ("the index again", r"lod-meta\.json is not a meta\.json inside"),
        ("too many rows", "or two nodes have"),
        ("rows before the first", "or two nodes have"),
        ("rows of two nodes", "or two nodes have"),
        ("no such chunk", "damaged or unknown"),
        ("a chunk before the first", "damaged or unknown"),
        ("no count", "damaged or unknown"),
        ("no finest level", "no Gaussians of level 0"),
        ("no tree", r"'tree'"),
    ],
)
def test_a_damaged_index_is_refused(streamed, name, match):
    shutil.copytree(streamed / "0_0", streamed.parent / "other")
    path = streamed / "lod-meta.json"
    path.write_text(json.dumps(damaged(json.loads(path.read_text()), name)))
    with pytest.raises(InputError, match=match) as refused:
        read_ply(streamed)
    assert str(refused.value).startswith(f"{streamed}: damaged or unknown")
    assert "splat-transform scene/lod-meta.json" in str(refused.value)


def test_memory_is_checked(streamed):
    with pytest.raises(InputError, match="of memory to read"):
        read_ply(streamed, max_bytes=2**16)
    images = sorted((streamed / "0_0").glob("means_*.webp"))
    Image.new("RGBA", (8000, 8000)).save(images[0], lossless=True)
    with pytest.raises(InputError, match="of memory to read"):
        read_ply(streamed, max_bytes=2**30)
