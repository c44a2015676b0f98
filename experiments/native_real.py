"""Forensic evidence from the attributes on two scenes that were tampered with by others.

    python experiments/train_classifier.py --keep .cues
    python experiments/native_real.py --keep .cues [--data ../shared/data/tampered] [--out docs]

Each scene is measured with a classifier that never saw it; nothing was tuned on these two. As they
are, and after an export of host and object in 8 bits; alone, and with the masks of the detector.
"""

import dataclasses
from collections.abc import Iterator
from pathlib import Path

import numpy as np
from export import export
from native import EXPORTS, classifier_without
from real_scenes import HELDOUT, Args, Scene, load
from runner import start
from tables import markdown, write_section

from gsc_jax import view_mask
from gsc_jax.benchmark.metrics import auc, confusion, mean_over_tampered_views
from gsc_jax.estimators import METHODS, Finding
from gsc_jax.forensics.evidence import combine, estimate_from_attributes, forensic_evidence


@dataclasses.dataclass(frozen=True, kw_only=True)
class RealArgs(Args):
    """Folders of the scenes, of the tables, and of the classifiers."""

    keep: Path = Path(".cues")


def findings(scene: Scene, keep: Path) -> Iterator[tuple[str, Finding]]:
    """Findings by the evidence that they are based on."""
    classifier = classifier_without(scene.name.split("-")[0], keep)
    eight = export(scene.gaussians, "8 bits").gaussians
    saved = dict(zip(EXPORTS, (scene.gaussians, eight), strict=True))
    evidence = {name: forensic_evidence(own, classifier=classifier) for name, own in saved.items()}
    for name, own in evidence.items():
        names = ", ".join(trace.name for trace in own.traces if trace.found) or "no trace"
        alone = combine(own.classification, ())
        yield f"Gaussians, no traces, {name}", estimate_from_attributes(alone)
        yield f"Gaussians, {name} ({names})", estimate_from_attributes(own)
    yield "masks", METHODS["robust"].estimate(scene.observation)
    for name, own in evidence.items():
        yield f"masks + Gaussians, {name}", METHODS["robust"].estimate(scene.observation, own)


def scores(scene: Scene, finding: Finding, labels: np.ndarray) -> dict[str, str]:
    """AUC and F1 per Gaussian, F1 on the held-out views, and the verdict."""
    masks = [
        view_mask(scene.gaussians, camera, finding, rule="share")
        for camera in scene.cameras[HELDOUT]
    ]
    values = {
        "AUC per Gaussian": auc(finding.attribute, labels),
        "F1 per Gaussian": confusion(finding.labels, labels).f1,
        "F1 per view": mean_over_tampered_views(masks, scene.truths[HELDOUT]).f1,
        "verdict": finding.verdict or 0.0,
    }
    return {name: f"{value:.3f}" for name, value in values.items()}


def main(args: RealArgs) -> None:
    """Measure both scenes; print and write the table."""
    lines, heads = [], []
    for folder in sorted(path for path in args.data.iterdir() if path.is_dir()):
        scene, labels = load(folder), np.load(folder / "labels.npy")
        for name, finding in findings(scene, args.keep):
            own = scores(scene, finding, labels)
            heads = ["scene", "evidence", *own]
            lines.append([scene.name, name, *own.values()])
    text = markdown(heads, lines)
    print(text)
    write_section(args.out / "results.md", "native_real", text)


if __name__ == "__main__":
    start(main, __doc__)
