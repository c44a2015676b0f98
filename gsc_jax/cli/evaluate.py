"""`gsc-jax evaluate`: compare the results of a run with the truth, by Gaussian and by view.

The masks of the 2D detector are compared with the same truth, which shows what lifting them to the
Gaussians gains. A truth of another size is resized and thresholded like the output of a detector.
"""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from gsc_jax.benchmark.metrics import auc, confusion, mean_over_tampered_views
from gsc_jax.cli.options import Evaluate
from gsc_jax.cli.outputs import write_json
from gsc_jax.cli.ownership import refuse_foreign_file
from gsc_jax.cli.report.wording import share
from gsc_jax.cli.results import Results, read_by_row, read_results, result_file
from gsc_jax.cli.staging import EVALUATION, EVALUATION_MARK
from gsc_jax.detectors.folder import FolderDetector
from gsc_jax.evidence.detector import fit_to_view
from gsc_jax.io.files import memory_limit
from gsc_jax.io.masks import image_path, read_probability
from gsc_jax.scene import Camera, InputError

MEASURES = {"f1": "F1", "iou": "IoU", "precision": "precision", "recall": "recall"}
"""Titles of the columns, by property of `Confusion`."""
NAME_WIDTH = 32
ASPECT_TOLERANCE = 0.02
"""Relative difference of aspects that rounding the sizes of small images explains."""


def run_evaluate(options: Evaluate) -> tuple[list[str], list[str]]:
    """Compare results with the truth and write the scores; return lines to print, and warnings."""
    out = options.out or options.folder / EVALUATION
    refuse_foreign_file(out, EVALUATION_MARK)
    labels, masks = _file_and_folder(options.truth)
    limit = memory_limit(options.memory)
    results = read_results(options.folder, max_bytes=limit)
    report: dict[str, Any] = {"folder": options.folder, "truth": options.truth}
    lines, warnings = list[str](), list[str]()
    if labels is not None:
        scores = report["gaussians"] = _by_gaussian(results, labels)
        lines += [
            f"{scores['found']:,} of {scores['rows']:,} Gaussians were found, "
            f"{scores['tampered']:,} are tampered, {scores['both']:,} are both.",
            "",
            _row("by Gaussian", [*MEASURES.values(), "AUC"]),
            _row("", [scores[name] for name in (*MEASURES, "auc")]),
            "",
        ]
    if masks is not None:
        report["views"] = _by_view(results, masks, limit, warnings)
        lines += [*_view_table(report["views"]), ""]
    write_json(out, {**report, "warnings": warnings})
    return [*lines, f"numbers  {out}"], warnings


def _file_and_folder(truth: Sequence[Path]) -> tuple[Path | None, Path | None]:
    """The truth by row, a file, and the truth by view, a folder."""
    for path in truth:
        if not path.exists():
            reason = "no such file or folder; give labels.npy or a folder of masks"
            raise InputError(f"{path}: {reason}")
    folders = [path for path in truth if path.is_dir()]
    files = [path for path in truth if path not in folders]
    if not truth or max(len(folders), len(files)) > 1:
        given = " ".join(map(str, truth))
        raise InputError(f"--truth {given}: expected labels.npy, a folder of masks, or one of each")
    return next(iter(files), None), next(iter(folders), None)


def _by_gaussian(results: Results, truth: Path) -> dict[str, Any]:
    """Scores of the labels, and the AUC of `tamper`; rows that were not read are authentic."""
    values = read_by_row(truth, results.scene.total)
    if not np.isin(values, (0, 1)).all():
        raise InputError(f"{truth}: holds {values.dtype} other than 0 and 1, expected labels.npy")
    labels = values.astype(bool)
    found, scores = map(results.scene.expand, (results.labels, results.tamper))
    counts = confusion(found, labels)
    return {
        "rows": results.scene.total,
        "tampered": int(labels.sum()),
        "found": int(found.sum()),
        "both": int(counts.tp),
        **{name: getattr(counts, name) for name in MEASURES},
        "auc": auc(scores, labels),
    }


def _by_view(results: Results, masks: Path, limit: int, warnings: list[str]) -> dict[str, Any]:
    """Score the final masks and the masks of the detector; and the edited share of each view."""
    views, truth = results.cameras, FolderDetector(masks, max_bytes=limit)
    chosen = truth.select(views)
    if missing := len(views) - len(chosen):
        warnings.append(f"{missing} of {len(views)} views have no mask in {truth.path}")
    true = {camera.name: _true_mask(truth, camera, warnings) for camera in chosen}
    warnings += truth.warnings
    found = {camera.name: _read_mask(results, "masks", camera, limit) for camera in chosen}
    paths = {c.name: result_file(results.folder, image_path("detector", c.name)) for c in chosen}
    judged = [camera for camera in chosen if paths[camera.name].exists()]
    detector = {camera.name: _read_mask(results, "detector", camera, limit) for camera in judged}
    shares = {name: float(mask.mean()) for name, mask in true.items()}
    scores = {"truth": shares, "found": _scores(found, true)}
    if not detector:
        return scores
    where_judged = _scores({name: found[name] for name in detector}, true)
    return scores | {"found_where_judged": where_judged, "detector": _scores(detector, true)}


def _true_mask(folder: FolderDetector, camera: Camera, warnings: list[str]) -> np.ndarray:
    truth = folder(None, camera)
    height, width = truth.shape
    aspect = camera.width / camera.height
    if abs(width / height - aspect) > ASPECT_TOLERANCE * aspect:
        raise InputError(
            f"{folder.path}: the mask of {camera.name!r} has {width} x {height} pixels, the view "
            f"{camera.width} x {camera.height}; expected masks of the same views"
        )
    resized = f"{folder.path}: masks of another size than their views were resized"
    if (height, width) != (camera.height, camera.width) and resized not in warnings:
        warnings.append(resized)
    return fit_to_view(truth, camera) > 0.5


def _read_mask(results: Results, kind: str, camera: Camera, limit: int) -> np.ndarray:
    path = result_file(results.folder, image_path(kind, camera.name))
    mask = read_probability(path, zero_one=False, max_bytes=limit) > 0.5
    if mask.shape != (camera.height, camera.width):
        raise InputError(
            f"{path}: has {mask.shape[1]} x {mask.shape[0]} pixels, expected {camera.width} x "
            f"{camera.height}, as in result.json; run gsc-jax locate again"
        )
    return mask


def _scores(masks: Mapping[str, np.ndarray], truth: Mapping[str, np.ndarray]) -> dict[str, Any]:
    """Measures of the tampered views and their means, and the flagged area of the others."""
    names = list(masks)
    scores = mean_over_tampered_views(list(masks.values()), [truth[name] for name in names])
    tampered = [names[view] for view in scores.views]
    areas = {name: float(masks[name].mean()) for name in names if name not in tampered}
    return {
        **{name: getattr(scores, name) for name in MEASURES},
        "false_positive_area": float(np.mean(list(areas.values()))) if areas else None,
        "per_view": {
            name: {measure: float(scores.per_view[measure][i]) for measure in MEASURES}
            for i, name in enumerate(tampered)
        },
        "per_authentic_view": areas,
    }


def _view_table(views: Mapping[str, Any]) -> list[str]:
    """A line per tampered view, the means, and the flagged share of the authentic views."""
    found, detector = views["found"], views.get("detector")
    means = {f"mean of {len(found['per_view'])}": found}
    if detector:
        judged = f"on {len(detector['per_view'])} + {len(detector['per_authentic_view'])} judged"
        if views["found_where_judged"] != found:
            means[f"found {judged}"] = views["found_where_judged"]
        means[f"2D masks {judged}"] = detector
    lines = [_row("by view", [*MEASURES.values(), "authentic"])]
    for name, scores in {**found["per_view"], **means}.items():
        area = scores.get("false_positive_area")
        cells = [scores[measure] for measure in MEASURES]
        lines.append(_row(name, [*cells, None if area is None else share(area)]))
    return [*lines, "", "authentic: found share of the views that show nothing tampered"]


def _row(name: str, cells: Sequence[str | float | None]) -> str:
    """A line of a table; a long name is cut at its beginning."""
    name = name if len(name) <= NAME_WIDTH else f"...{name[3 - NAME_WIDTH :]}"
    cells = [f"{cell:.3f}" if isinstance(cell, float) else cell or "-" for cell in cells]
    return f"{name:{NAME_WIDTH}}" + "".join(f"{cell:>10}" for cell in cells).replace("nan", "  -")
