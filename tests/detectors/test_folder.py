"""Masks in a folder are matched to cameras by name."""

from pathlib import Path

import imageio.v3 as iio
import numpy as np
import pytest
from onnx_models import view

from gsc_jax.detectors.folder import FolderDetector
from gsc_jax.io import masks
from gsc_jax.scene import Camera, InputError


def cameras(*names: str) -> list[Camera]:
    return [view(name) for name in names]


def folder(path: Path, *files: str) -> FolderDetector:
    """A folder in which mask k has sides of 4 + k pixels, to identify the mask that was read."""
    for k, file in enumerate(files):
        (path / file).parent.mkdir(parents=True, exist_ok=True)
        extension = Path(file).suffix.lower()
        iio.imwrite(path / file, np.full((4 + k, 4 + k), 255, np.uint8), extension=extension)
    return FolderDetector(path)


def selected(detector: FolderDetector, *names: str) -> list[str]:
    return [chosen.name for chosen in detector.select(cameras(*names))]


@pytest.mark.parametrize(
    ("name", "files", "read"),
    [
        ("a", ["a.png"], "a.png"),
        ("a", ["a.PNG"], "a.PNG"),
        ("a", ["b.png", "a.JPG"], "a.JPG"),
        ("a.jpg", ["a.png"], "a.png"),
        ("a.jpg", ["a.png", "a.jpg.png"], "a.jpg.png"),
        ("a.png", ["a.png"], "a.png"),
        ("a", ["a.jpg.png"], "a.jpg.png"),
        ("a", ["a.jpg.png", "a.png"], "a.png"),
        ("img.0001.JPG", ["img.0001.png", "img.0002.png", "img.png"], "img.0001.png"),
        ("img.0001", ["img.0001.png", "img.0002.png", "img.png"], "img.0001.png"),
        ("left/a.JPG", ["left/a.png", "right/a.png"], "left/a.png"),
        ("left/a.JPG", ["left/a.png", "a.png"], "left/a.png"),
        ("left\\a.JPG", ["left/a.png", "right/a.png"], "left/a.png"),
        ("left/a.JPG", ["a.png"], "a.png"),
        ("left/a.JPG", ["a.JPG.png", "a.png"], "a.JPG.png"),
        ("left/a", ["a.JPG.png"], "a.JPG.png"),
        ("a.JPG", ["masks/a.png"], "masks/a.png"),
    ],
)
def test_most_exact_file_is_the_mask_of_a_camera(tmp_path, name, files, read):
    detector = folder(tmp_path, *files)
    (chosen,) = detector.select(cameras(name))
    assert detector(None, chosen).shape == (4 + files.index(read),) * 2


@pytest.mark.parametrize(
    ("name", "file"),
    [("a", "A.png"), ("a", "aa.png"), ("img.0001", "img.png"), ("left/a", "right/a.png")],
)
def test_unrelated_file_is_not_a_mask(tmp_path, name, file):
    detector = folder(tmp_path, file)
    with pytest.raises(InputError, match="named after") as caught:
        detector.select(cameras(name))
    for part in (name, file, f"{name}.png"):
        assert repr(part) in str(caught.value)
    with pytest.raises(InputError, match="no mask for camera"):
        detector(None, view(name))


def test_selected_cameras_keep_their_order(tmp_path):
    detector = folder(tmp_path, "a.png", "c.png", "unused.png")
    assert selected(detector, "c", "b", "a", "d") == ["c", "a"]
    assert detector.needs_image is False


@pytest.mark.parametrize(
    ("names", "files"),
    [
        (["a"], ["a.png", "a.jpg"]),
        (["a.jpg"], ["a.png", "a.jpg"]),
        (["a"], ["masks/a.png", "detector/a.png"]),
        (["left/a", "right/a"], ["a.png"]),
        (["a.jpg", "a.png"], ["a.png"]),
        (["a", "a"], ["a.png"]),
    ],
)
def test_ambiguous_match_is_an_error(tmp_path, names, files):
    detector = folder(tmp_path, *files)
    with pytest.raises(InputError, match="equally well") as caught:
        detector.select(cameras(*names))
    assert str(tmp_path) in str(caught.value)


def test_file_belongs_to_the_more_exact_camera(tmp_path):
    assert selected(folder(tmp_path, "a.png"), "left/a", "a") == ["a"]


def test_invalid_folders_are_refused(tmp_path):
    (tmp_path / "empty").mkdir()
    (tmp_path / "other").mkdir()
    (tmp_path / "other" / "notes.txt").write_text("text")
    (tmp_path / "other" / "._a.png").write_bytes(b"hidden")
    iio.imwrite(tmp_path / "a.png", np.zeros((4, 4), np.uint8))
    expected = {
        "missing": "does not exist",
        "a.png": "is a file",
        "empty": "no images",
        "other": "no images",
    }
    for name, reason in expected.items():
        with pytest.raises(InputError, match=reason) as caught:
            FolderDetector(tmp_path / name)
        assert str(tmp_path / name) in str(caught.value)
    with pytest.raises(InputError, match="no cameras"):
        folder(tmp_path / "full", "a.png").select([])


def test_zero_one_is_decided_for_the_whole_folder(tmp_path):
    binary, soft = tmp_path / "binary", tmp_path / "soft"
    ones = np.ones((4, 4), np.uint8)
    for path, levels in ((binary, (0, 1)), (soft, (1, 200))):
        path.mkdir()
        for name, level in zip("ab", levels, strict=True):
            iio.imwrite(path / f"{name}.png", level * ones)
    iio.imwrite(binary / "overlay.png", np.eye(3, dtype=np.uint8)[None] * 200)
    np.testing.assert_array_equal(FolderDetector(binary)(None, view("b")), ones)
    np.testing.assert_allclose(FolderDetector(soft)(None, view("a")), ones / 255, rtol=1e-6)
    assert "0/1" in FolderDetector(binary).warnings[0]
    assert FolderDetector(soft).warnings == ()


@pytest.mark.parametrize(
    ("dtype", "levels", "dim"),
    [
        (np.uint8, [0, 2], True),
        (np.uint8, [0, 127], True),
        (np.uint16, [0, 255], True),
        (np.uint16, [0, 1], True),
        (np.uint8, [0, 1], False),  # with a white mask beside it: sure that nothing is tampered
        (np.uint8, [0, 0], False),
        (np.uint8, [0, 2, 5], False),
        (np.uint8, [100, 100], False),
        (np.uint8, [0, 128], False),
    ],
)
def test_masks_whose_white_is_a_dark_grey_are_named(tmp_path, dtype, levels, dim):
    iio.imwrite(tmp_path / "a.png", np.resize(np.array(levels, dtype), (4, 6)))
    iio.imwrite(tmp_path / "b.png", np.resize(np.array([0, 255], np.uint8), (4, 6)))
    detector = FolderDetector(tmp_path)
    for name in "abaa":
        detector(None, view(name))
    text = f"{tmp_path}: masks without white flag nothing ('a.png'); write them with 0 and 255"
    assert detector.warnings == (text,) * dim


@pytest.mark.parametrize("name", ["a", "a.png", "img.0001.JPG", "left/a.b.JPG", "left\\a"])
def test_written_mask_is_read_for_its_camera(tmp_path, name):
    masks.write_mask(masks.image_path(tmp_path, name), np.ones((5, 5), bool))
    masks.write_mask(masks.image_path(tmp_path, "other/" + name), np.zeros((4, 4), bool))
    assert FolderDetector(tmp_path)(None, view(name)).shape == (5, 5)


@pytest.mark.parametrize("size", [(1, 1), (1, 5000), (3, 3), (480, 640), (640, 100)])
def test_masks_that_cannot_show_the_view_are_refused(tmp_path, size):
    masks.write_mask(tmp_path / "a.png", np.ones(size, bool))
    camera = view("a").resized(480, 640)
    with pytest.raises(InputError, match=r"a\.png: .*'a' has .*expected") as error:
        FolderDetector(tmp_path)(None, camera)
    assert "\n" not in str(error.value)


@pytest.mark.parametrize("size", [(640, 480), (20, 16), (512, 512), (672, 480), (1280, 961)])
def test_masks_of_other_sizes_are_accepted(tmp_path, size):
    masks.write_mask(tmp_path / "a.png", np.ones(size, bool))
    assert FolderDetector(tmp_path)(None, view("a").resized(480, 640)).shape == size
