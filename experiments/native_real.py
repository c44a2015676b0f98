"""The Gaussians' own evidence on the two scenes that others tampered with.

    python experiments/train_cues.py --keep .cues
    python experiments/native_real.py --keep .cues [--data ../shared/data/tampered] [--out docs]

Each by the model that never saw the scene; nothing was tuned on these two. As they are, and after
host and object were exported alike in 8 bits; by themselves, and with the masks that lie there.
"""

import dataclasses
from collections.abc import Iterator, Mapping
from pathlib import Path

import numpy as np
from export import exported
from native import EXPORTS, model_without
from real_scenes import Args, Scene, load
from runner import start
from tables import markdown, write_section

from gsc_jax import RobustConfig, view_mask
from gsc_jax.benchmark.metrics import auc, confusion, mean_over_tampered_views
from gsc_jax.estimators.gschecker import find
from gsc_jax.estimators.protocol import Finding
from gsc_jax.forensics.evidence import find_native, native_evidence


@dataclasses.dataclass(frozen=True, kw_only=True)
class RealArgs(Args):
    """As the others, and where the models are."""

    keep: Path = Path(".cues")


def findings(scene: Scene, keep: Path) -> Iterator[tuple[str, Finding]]:
    """What is found in a scene, by what it was found from."""
    model = model_without(scene.name.split("-")[0], keep)
    saved = {EXPORTS[0]: scene.gaussians, EXPORTS[1]: exported(scene.gaussians)}
    asked = {export: native_evidence(own, model=model) for export, own in saved.items()}
    for export, told in asked.items():
        names = ", ".join(trace.name for trace in told.traces if trace.found) or "no trace"
        yield f"Gaussians, no traces, {export}", find_native(told.without_traces)
        yield f"Gaussians, {export} ({names})", find_native(told)
    look = scene.gaussians, scene.cameras["looked at"], scene.observation, RobustConfig()
    yield "masks", find(*look)
    for export, told in asked.items():
        yield f"masks + Gaussians, {export}", find(*look, told.prior)


def scores(scene: Scene, finding: Finding, labels: np.ndarray) -> Mapping[str, str]:
    """AUC and F1 per Gaussian, F1 on the held-out views, and the verdict."""
    cameras, truths = scene.cameras["held out"], scene.truths["held out"]
    masks = [
        view_mask(scene.gaussians, camera, finding.tamper, finding.labels, rule="share")
        for camera in cameras
    ]
    values = {
        "AUC per Gaussian": auc(finding.attribute, labels),
        "F1 per Gaussian": confusion(finding.labels, labels).f1,
        "F1 per view": mean_over_tampered_views(masks, truths).f1,
        "verdict": finding.verdict or 0.0,
    }
    return {name: f"{value:.3f}" for name, value in values.items()}


def main(args: RealArgs) -> None:
    """Look at both scenes; print and write the table."""
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
