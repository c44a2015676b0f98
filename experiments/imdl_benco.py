"""Exchange views and masks with IMDL-BenCo, so that its detectors are used without ONNX.

    python experiments/imdl_benco.py dataset edited/ --out benco
    (IMDL-BenCo: test_save_images.py --test_data_path benco/dataset.json --output_dir saved)
    python experiments/imdl_benco.py masks saved/pred --dataset benco --out masks
    gsc-jax locate edited/scene.ply --cameras edited/cameras.json --masks masks/edited --out found

`dataset` renders folders of `gsc-jax tamper`, or of any scene.ply and cameras.json; `Tp` and `Gt`
are the layout of its ManiDataset, `dataset.json` that of its JsonDataset. `masks` takes the
predictions apart by scene, `predictions` collects the masks of `gsc-jax locate` under its names,
and `measure` has its pixel-level metrics: the mean over all images with tampered pixels.
"""

import json
import shutil
from collections.abc import Iterator
from pathlib import Path

import jax
import numpy as np
import tyro
from tqdm import tqdm

import gsc_jax
from gsc_jax.benchmark.metrics import auc, confusion
from gsc_jax.io.masks import image_path, read_probability, write_image, write_mask
from gsc_jax.scene import InputError

Folders = tyro.conf.Positional[tuple[Path, ...]]
Folder = tyro.conf.Positional[Path]
NAMES, PROTOCOL = "names.json", "dataset.json"
NEGATIVE = "Negative"
"""What the protocol has in place of the truth of an authentic image."""


def dataset(folders: Folders, /, *, out: Path) -> None:
    """Render scenes with their truth; without a folder `truth`, all views count as authentic.

    Args:
        folders: Folders with scene.ply, cameras.json and, of edited scenes, truth/.
        out: Folder of the dataset; an existing one is refused.
    """
    if len({folder.resolve().name for folder in folders}) < len(folders):
        raise InputError("two scenes have folders of one name; rename one, names tell them apart")
    for part in ("Tp", "Gt"):
        (out / part).mkdir(parents=True)
    names: dict[str, tuple[str, str]] = {}
    pairs: list[tuple[str, str]] = []
    for folder in folders:
        scene = folder.resolve().name
        for camera, image, tampered in views(folder):
            name = f"{scene}__{camera.replace('/', '__')}.png"
            if name in names:
                raise InputError(f"{folder}: two cameras would be {name}; rename one")
            write_image(out / "Tp" / name, image)
            write_mask(out / "Gt" / name, tampered)
            names[name] = scene, camera
            image_file, truth_file = (str((out / part / name).resolve()) for part in ("Tp", "Gt"))
            pairs.append((image_file, truth_file if tampered.any() else NEGATIVE))
    (out / NAMES).write_text(json.dumps(names, indent=1), "utf-8")
    (out / PROTOCOL).write_text(json.dumps(pairs, indent=1), "utf-8")
    print(f"{len(pairs)} views in {out}")


def views(folder: Path) -> Iterator[tuple[str, np.ndarray, np.ndarray]]:
    """Camera, image and tampered pixels of each view of a scene; progress is shown."""
    gaussians = jax.device_put(gsc_jax.load_ply(folder / "scene.ply"))
    for camera in tqdm(gsc_jax.load_cameras(folder / "cameras.json"), f"render {folder.name}"):
        image = np.asarray(gsc_jax.render(gaussians, camera)[0])
        tampered = np.zeros(image.shape[:2], bool)
        truth = image_path(folder / "truth", camera.name)
        if truth.exists():
            tampered = read_probability(truth) > 0.5
        yield camera.name, image, tampered


def masks(predictions: Folder, /, *, dataset: Path, out: Path) -> None:
    """Sort predictions by scene, as `gsc-jax locate --masks` and `FolderDetector` read them.

    Args:
        predictions: The folder `pred` that IMDL-BenCo wrote.
        dataset: The dataset of which they are.
        out: Folder to write, with a folder for each scene.
    """
    count = 0
    for name, scene, camera in entries(dataset):
        if (predictions / name).exists():
            path = image_path(out / scene, camera)
            path.parent.mkdir(parents=True, exist_ok=True)
            shutil.copyfile(predictions / name, path)
            count += 1
    if not count:
        raise InputError(f"{predictions}: no image of {dataset}; give the folder `pred`")
    print(f"{count} masks in {out}")


def predictions(found: Folders, /, *, dataset: Path, out: Path) -> None:
    """Collect the masks of `gsc-jax locate` as IMDL-BenCo saves those of a detector.

    Args:
        found: Folders of results, each with the name of its scene.
        dataset: The dataset of which the scenes are.
        out: Folder to write.
    """
    by_scene = {folder.resolve().name: folder / "masks" for folder in found}
    out.mkdir(parents=True)
    for name, scene, camera in entries(dataset):
        if scene not in by_scene:
            raise InputError(f"no results of the scene {scene}; give a folder of this name")
        shutil.copyfile(image_path(by_scene[scene], camera), out / name)
    print(f"masks in {out}")


def measure(predictions: Folder, /, *, dataset: Path, out: Path | None = None) -> dict[str, float]:
    """Print the pixel-level metrics of predictions, under the names that IMDL-BenCo gives them.

    Args:
        predictions: Folder of predictions, its own or those of `predictions`.
        dataset: The dataset of which they are.
        out: JSON file to write, too.
    """
    values: list[tuple[float, float, float]] = []
    for name, _, _ in entries(dataset):
        tampered = read_probability(dataset / "Gt" / name) > 0.5
        if tampered.any():
            probability = read_probability(predictions / name)
            counts = confusion(probability, tampered)
            values.append((counts.f1, counts.iou, auc(probability, tampered)))
    titles = ("pixel-level F1", "pixel-level IOU", "pixel-level AUC")
    means: dict[str, float] = {}
    if values:
        means = dict(zip(titles, np.mean(values, axis=0).tolist(), strict=True))
    text = json.dumps({"images": len(values), **means})
    print(text)
    if out is not None:
        out.write_text(text, "utf-8")
    return means


def entries(dataset: Path) -> Iterator[tuple[str, str, str]]:
    """File, scene and camera of each view of a dataset."""
    path = dataset / NAMES
    if not path.exists():
        raise InputError(f"{path}: no such file; give a folder that `dataset` wrote")
    for name, (scene, camera) in json.loads(path.read_text("utf-8")).items():
        yield name, scene, camera


COMMANDS = {c.__name__: c for c in (dataset, masks, predictions, measure)}

if __name__ == "__main__":
    try:
        tyro.extras.subcommand_cli_from_dict(COMMANDS, description=__doc__)
    except (InputError, FileExistsError) as error:
        raise SystemExit(f"error: {error}") from error
