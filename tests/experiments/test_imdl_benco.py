"""Exchange with IMDL-BenCo: the layout that its datasets read, and the way back."""

import json

import imdl_benco
import numpy as np
import pytest
from PIL import Image

from gsc_jax import save_ply
from gsc_jax.benchmark.metrics import mean_over_tampered_views, truth_mask
from gsc_jax.benchmark.scenes import tampered_room
from gsc_jax.detectors.folder import FolderDetector
from gsc_jax.io.cameras import save_cameras
from gsc_jax.io.masks import image_path, write_mask
from gsc_jax.scene import InputError

MADE = tampered_room(count=3_000, views=4, heldout=1, width=64, height=48, seed=5)
TRUTH = [truth_mask(MADE.gaussians, camera, MADE.labels) for camera in MADE.cameras]


@pytest.fixture
def edited(tmp_path):
    """A folder as `gsc-jax tamper` writes it, and the same scene without truth."""
    for name in ("edited", "authentic"):
        (tmp_path / name / "truth").mkdir(parents=True)
        save_ply(tmp_path / name / "scene.ply", MADE.gaussians)
        save_cameras(tmp_path / name / "cameras.json", MADE.cameras)
    for camera, mask in zip(MADE.cameras, TRUTH, strict=True):
        write_mask(image_path(tmp_path / "edited" / "truth", camera.name), mask)
    return tmp_path


def test_the_dataset_has_both_layouts(edited):
    out = edited / "benco"
    imdl_benco.dataset((edited / "edited", edited / "authentic"), out=out)
    tampered = sorted(path.name for path in (out / "Tp").iterdir())
    assert tampered == sorted(path.name for path in (out / "Gt").iterdir())  # sorted, in pairs
    protocol = json.loads((out / "dataset.json").read_text())
    truths = {image.rsplit("/", 1)[1]: truth for image, truth in protocol}
    assert sorted(truths) == tampered
    for name, truth in truths.items():
        with Image.open(out / "Gt" / name) as expected, Image.open(out / "Tp" / name) as image:
            assert image.size == expected.size
            assert (truth == "Negative") == (not np.asarray(expected).any())
    assert all(truth == "Negative" for name, truth in truths.items() if "authentic" in name)


def test_masks_come_back_by_scene_and_are_measured_as_our_own(edited, capsys):
    out, pred = edited / "benco", edited / "pred"
    imdl_benco.dataset((edited / "edited", edited / "authentic"), out=out)
    pred.mkdir()
    rng = np.random.default_rng(0)
    for name, _, _ in imdl_benco.entries(out):
        noise = rng.random((48, 64))
        Image.fromarray((255 * noise).astype(np.uint8)).save(pred / name)
    imdl_benco.masks(pred, dataset=out, out=edited / "masks")
    folder = FolderDetector(edited / "masks" / "edited")
    back = [folder(np.zeros((48, 64, 3)), camera) > 0.5 for camera in MADE.cameras]
    means = imdl_benco.measure(pred, dataset=out)
    scores = mean_over_tampered_views(back, TRUTH)
    assert means["pixel-level F1"] == pytest.approx(scores.f1)
    assert means["pixel-level IOU"] == pytest.approx(scores.iou)
    assert json.loads(capsys.readouterr().out.splitlines()[-1])["images"] == len(scores.views)


def test_our_masks_are_collected_under_its_names(edited):
    out = edited / "benco"
    imdl_benco.dataset((edited / "edited",), out=out)
    found = edited / "found" / "edited"
    (found / "masks").mkdir(parents=True)
    for camera, mask in zip(MADE.cameras, TRUTH, strict=True):
        write_mask(image_path(found / "masks", camera.name), mask)
    imdl_benco.predictions((found,), dataset=out, out=edited / "ours")
    means = imdl_benco.measure(edited / "ours", dataset=out)
    assert min(means.values()) == pytest.approx(1)


def test_what_is_no_dataset_is_refused(edited):
    with pytest.raises(InputError, match=r"names\.json"):
        imdl_benco.masks(edited, dataset=edited, out=edited / "masks")
    with pytest.raises(InputError, match="folders of one name"):
        imdl_benco.dataset((edited / "edited", edited / "edited"), out=edited / "twice")
