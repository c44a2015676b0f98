"""`gsc-jax evaluate`: the results of a run against the truth, by Gaussian and by view.

The metrics are those of `gsc_jax.benchmark.metrics`. The 2D detector is measured on the same views
by the same rule, so that it shows what lifting its masks gained. A truth of another size than a
view is brought to the view's, once, and thresholded, as a detector's output is.
"""

import json
import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from gsc_jax.benchmark.metrics import auc, confusion, false_positive_area, mean_over_tampered_views
from gsc_jax.cli.options import Evaluate
from gsc_jax.cli.outputs import plain
from gsc_jax.cli.report.wording import share
from gsc_jax.cli.results import Results, read_results
from gsc_jax.cli.staging import EVALUATION
from gsc_jax.detectors.folder import FolderDetector
from gsc_jax.evidence.detector import fit_to_view
from gsc_jax.io.files import atomic
from gsc_jax.io.masks import image_path, read_probability
from gsc_jax.scene import Camera, InputError

MEASURES = ("f1", "iou", "precision", "recall")
"""Properties of `Confusion`, in the order of the tables."""
BESIDE = ("f1", "iou")
"""Of the 2D detector, beside them."""
TITLES = {"f1": "F1", "iou": "IoU", "auc": "AUC", "2D f1": "2D F1", "2D iou": "2D IoU"}
NAME = 24
ASPECT = 0.02
"""How far the aspects of a truth and of its view may differ: sizes are rounded."""

Masks = dict[str, np.ndarray]
"""Tampered pixels (H, W) bool, by camera name."""


def run_evaluate(options: Evaluate) -> tuple[list[str], list[str]]:
    """Compares results with the truth and writes the scores.

    Args:
        options: The arguments of the command line.

    Returns:
        Tables for people, and warnings.

    Raises:
        InputError: if there are no results, or the truth is none of them.
    """
    labels, masks = _kinds(options.truth)
    results = read_results(options.folder)
    report: dict[str, Any] = {"folder": options.folder, "truth": options.truth}
    warnings: list[str] = []
    lines: list[str] = []
    if labels is not None:
        report["gaussians"] = by_gaussian(results, labels)
        lines += [*_gaussian_table(report["gaussians"]), ""]
    if masks is not None:
        report["views"] = by_view(results, masks, warnings)
        lines += [*_view_table(report["views"]), ""]
    out = options.out or options.folder / EVALUATION
    with atomic(out) as temporary:
        text = json.dumps(plain({**report, "warnings": warnings}), indent=2, ensure_ascii=False)
        temporary.write_text(text + "\n", encoding="utf-8")
    return [*lines, f"numbers  {out}"], warnings


def _kinds(truth: Sequence[Path]) -> tuple[Path | None, Path | None]:
    """The truth by row and the one by view, told apart by what they are."""
    for path in truth:
        if not path.exists():
            raise InputError(
                f"{path}: no such file or folder, expected labels.npy or a folder of masks"
            )
    folders = [path for path in truth if path.is_dir()]
    files = [path for path in truth if not path.is_dir()]
    if len(folders) > 1 or len(files) > 1 or not truth:
        given = " ".join(map(str, truth)) or "of nothing"
        raise InputError(f"--truth {given}: expected labels.npy, a folder of masks, or one of each")
    return (files or [None])[0], (folders or [None])[0]


def by_gaussian(results: Results, truth: Path) -> dict[str, Any]:
    """Scores of the labels, and of the scores behind them.

    Args:
        results: Of `locate`. Rows that it could not read count as found authentic.
        truth: A .npy of bool by row of the scene.

    Returns:
        Counts, the measures and the area under the ROC curve, by name.

    Raises:
        InputError: if the truth is no such array or that of another scene.
    """
    true = _labels(truth, results.total)
    found, scores = np.zeros(results.total, bool), np.zeros(results.total, np.float32)
    found[results.rows], scores[results.rows] = results.labels, results.tamper
    counts = confusion(found, true)
    return {
        "rows": results.total,
        "tampered": int(true.sum()),
        "found": int(found.sum()),
        "both": int(counts.tp),
        **{name: getattr(counts, name) for name in MEASURES},
        "auc": auc(scores, true),
    }


def _labels(path: Path, total: int) -> np.ndarray:
    expected = f"expected a .npy of {total:,} true or false, one per row of the scene"
    try:
        labels = np.load(path, allow_pickle=False)
    except (OSError, ValueError, EOFError) as error:
        raise InputError(f"{path}: cannot be read ({error}), {expected}") from error
    if not isinstance(labels, np.ndarray):  # an .npz
        raise InputError(f"{path}: holds several arrays, {expected}")
    zero_one = labels.dtype.kind in "iu" and np.isin(labels, (0, 1)).all()
    if labels.shape != (total,) or not (labels.dtype == bool or zero_one):
        raise InputError(f"{path}: holds {labels.dtype} of shape {labels.shape}, {expected}")
    return labels.astype(bool)


def by_view(results: Results, truth: Path, warnings: list[str]) -> dict[str, Any]:
    """Scores of the final masks and of the detector's, by view.

    Args:
        results: Of `locate`.
        truth: A folder with a mask per camera.
        warnings: What a user should know is added.

    Returns:
        The tampered share of each view, the scores of `found` and, if there was one, of `detector`,
        which may not have judged all views: `found_where_judged` compares with it.

    Raises:
        InputError: if no view has a truth, or a truth is not of the view.
    """
    folder, views = FolderDetector(truth), results.cameras
    chosen = folder.select(views)
    if len(chosen) < len(views):
        warnings.append(f"{len(views) - len(chosen)} of {len(views)} views have no mask in {truth}")
    true = {camera.name: _true_mask(folder, camera, warnings) for camera in chosen}
    warnings += folder.warnings
    found = {camera.name: _own_mask(results, "masks", camera) for camera in chosen}
    judged = [c for c in chosen if image_path(results.folder / "detector", c.name).is_file()]
    said = {camera.name: _own_mask(results, "detector", camera) for camera in judged}
    scores = {
        "truth": {name: float(mask.mean()) for name, mask in true.items()},
        "found": _scores(found, true),
    }
    if not said:
        return scores
    beside = _scores({name: found[name] for name in said}, true)
    return scores | {"found_where_judged": beside, "detector": _scores(said, true)}


def _true_mask(folder: FolderDetector, camera: Camera, warnings: list[str]) -> np.ndarray:
    truth = folder(None, camera)
    height, width = truth.shape
    if abs(width / height - camera.width / camera.height) > ASPECT * camera.width / camera.height:
        raise InputError(
            f"{folder.path}: the mask of {camera.name!r} has {width} x {height} pixels, the view "
            f"{camera.width} x {camera.height}; expected masks of the same views"
        )
    resized = f"{folder.path}: masks of another size than the views were brought to it"
    if (height, width) != (camera.height, camera.width) and resized not in warnings:
        warnings.append(resized)
    return fit_to_view(truth, camera) > 0.5


def _own_mask(results: Results, kind: str, camera: Camera) -> np.ndarray:
    """What the run wrote of a view, which was larger than 0.5 where it still is."""
    path = image_path(results.folder / kind, camera.name)
    mask = read_probability(path, zero_one=False) > 0.5
    if mask.shape != (camera.height, camera.width):
        raise InputError(
            f"{path}: has {mask.shape[1]} x {mask.shape[0]} pixels, expected {camera.width} x "
            f"{camera.height}, as result.json says; run gsc-jax locate again"
        )
    return mask


def _scores(masks: Masks, truth: Masks) -> dict[str, Any]:
    """Means over the tampered views, the measures of each, and the area flagged in the others."""
    names = list(masks)
    scores = mean_over_tampered_views(list(masks.values()), [truth[name] for name in names])
    tampered = [names[view] for view in scores.views]
    authentic = [name for name in names if name not in tampered]
    areas = false_positive_area([masks[name] for name in authentic])
    return {
        **{name: getattr(scores, name) for name in MEASURES},
        "false_positive_area": float(areas.mean()) if authentic else None,
        "per_view": {
            name: {measure: float(scores.per_view[measure][i]) for measure in MEASURES}
            for i, name in enumerate(tampered)
        },
        "per_authentic_view": dict(zip(authentic, areas.tolist(), strict=True)),
    }


def _gaussian_table(scores: Mapping[str, Any]) -> list[str]:
    return [
        f"{scores['found']:,} of {scores['rows']:,} Gaussians were found, {scores['tampered']:,} "
        f"are tampered, {scores['both']:,} are both.",
        "",
        _row("by Gaussian", [*MEASURES, "auc"]),
        _row("", [scores[name] for name in (*MEASURES, "auc")]),
    ]


def _view_table(views: Mapping[str, Any]) -> list[str]:
    """A row per tampered view, the means, and what was flagged where nothing is."""
    found, said = views["found"], views.get("detector")
    lines = [_row("by view", [*MEASURES, *(f"2D {name}" for name in BESIDE if said)])]
    for name, scores in found["per_view"].items():
        lines.append(_scores_row(name, scores, said and said["per_view"].get(name, {})))
    if found["per_view"]:
        lines += _means(views)
    else:
        lines = ["No view shows anything tampered."]
    if found["per_authentic_view"]:
        lines += ["", _false_positives(views)]
    return lines


def _means(views: Mapping[str, Any]) -> list[str]:
    """The mean over all views and, where the 2D detector judged some, the one over these."""
    found, said = views["found"], views.get("detector")
    count, judged = len(found["per_view"]), len(said["per_view"]) if said else 0
    title = f"mean of {count}"
    if not said or judged == count:
        return [_scores_row(title, found, said)]
    where_judged = _scores_row(f"mean of the {judged} judged", views["found_where_judged"], said)
    return [_scores_row(title, found, {}), *([where_judged] if judged else [])]


def _scores_row(title: str, found: Mapping[str, Any], said: Mapping[str, Any] | None) -> str:
    """A row of the table by view."""
    cells = [found[name] for name in MEASURES]
    return _row(title, cells + [said.get(name) for name in BESIDE if said is not None])


def _false_positives(views: Mapping[str, Any]) -> str:
    """What was flagged of the authentic views, and of those that the 2D detector judged."""
    found, said = views["found"], views.get("detector")
    count = len(found["per_authentic_view"])
    judged = len(said["per_authentic_view"]) if said else 0
    which = "the authentic view" if count == 1 else f"the {count} authentic views"
    line = f"Of {which}, {share(found['false_positive_area'])} was found"
    if not said or not judged:
        return f"{line}."
    if judged < count:
        area = share(views["found_where_judged"]["false_positive_area"])
        line += f"; of the {judged} that the 2D detector judged, {area}"
    return f"{line}, and {share(said['false_positive_area'])} flagged by the 2D detector."


def _row(name: str, cells: Sequence[str | float | None]) -> str:
    """A name, cut to its end where it is long, and numbers or titles."""
    name = name if len(name) <= NAME else f"...{name[3 - NAME :]}"
    return f"{name:{NAME}}" + "".join(f"{_cell(cell):>10}" for cell in cells)


def _cell(value: str | float | None) -> str:
    if isinstance(value, str):
        return TITLES.get(value, value)
    return "-" if value is None or math.isnan(value) else f"{value:.3f}"
