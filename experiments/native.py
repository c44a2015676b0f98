"""Forensic evidence from the attributes: alone, with traces, and fused with masks of a detector.

    python experiments/train_classifier.py --keep .cues
    python experiments/native.py --keep .cues [--quick] [--out docs]

Every scene is measured with a classifier that was trained on other scenes and other seeds, left by
`train_classifier.py`. Scenes are measured as edited, with all digits, and after an export that
stores host and object in 8 bits; so are authentic scenes.
"""

import dataclasses
import functools
import itertools
from collections.abc import Iterator, Mapping
from pathlib import Path

import charts
import numpy as np
import pandas as pd
from cases import QUICK, Case, calibrated_mixture, detector_masks, donor_name, without_edit
from export import export as export_scene
from matplotlib import pyplot as plt
from methods import ALL_METHODS, seeded
from observations import CaseObservation, Prediction, observe_regimes
from runner import Args, heldout_masks, judge, measured, scores, start
from scipy.special import expit
from tables import TRUTH, Row, markdown, pivot, where, write_section

from gsc_jax.benchmark.metrics import auc
from gsc_jax.benchmark.simulate import REGIMES, Failures
from gsc_jax.estimators import METHODS, Prior
from gsc_jax.forensics.classifier import Classifier, default_classifier, from_arrays
from gsc_jax.forensics.evidence import (
    ForensicEvidence,
    combine,
    estimate_from_attributes,
    forensic_evidence,
)
from gsc_jax.scene import InputError

EXPORTS = ("as edited", "8 bits")
WITHOUT_TRACES, WITH_TRACES = "Gaussians, no traces", "Gaussians"
MASKS, FUSED = "robust", "robust + Gaussians"
NO_MASKS = "no masks"
BASELINES = ("FlashSplat", "GS-Checker official")
"""The best method that takes all masks as reliable, and GS-Checker."""
FALSE_ALARMS = ("blobs", "consistent", "inverted", "mixture")
"""Failures of a detector that flag pixels of authentic scenes."""


@dataclasses.dataclass(frozen=True, kw_only=True)
class NativeArgs(Args):
    """Arguments of an experiment that needs the classifiers.

    Attributes:
        keep: Folder in which `train_classifier.py` left a classifier for every scene.
    """

    keep: Path = Path(".cues")


@functools.cache
def classifier_without(scene: str, keep: Path) -> Classifier:
    """The classifier that never saw a scene; in a quick run, that of the package."""
    if scene == QUICK:
        return default_classifier()
    return stored(keep / f"without-{scene}.npz")


def stored(path: Path) -> Classifier:
    """Read a classifier from a file that `train_classifier.py` wrote."""
    if not path.exists():
        raise InputError(f"{path}: does not exist; run experiments/train_classifier.py first")
    with np.load(path) as arrays:
        return from_arrays(arrays)


def rows_of(case: Case, mixture: Failures, keep: Path) -> Iterator[Row]:
    """Measure one case, as edited and exported: the attributes alone, and with masks."""
    for export in EXPORTS:
        if export == "as edited" and case.edit == "none" and case.seed > 0:
            continue  # the same scene as for seed 0
        saved = case.gaussians
        if export != "as edited":
            saved = export_scene(saved, export, seed=case.seed).gaussians
        own = dataclasses.replace(case, gaussians=saved)
        classifier = classifier_without(case.scene.name, keep)
        evidence = forensic_evidence(saved, classifier=classifier)
        yield from ({**row, "export": export} for row in rows_without_masks(own, evidence))
        failures = {**(REGIMES if export == "8 bits" else {}), "mixture": mixture}
        yield from ({**row, "export": export} for row in _with_masks(own, evidence, failures))


def rows_without_masks(case: Case, evidence: ForensicEvidence) -> Iterator[Row]:
    """Measure the attributes without masks."""
    pasted = donor_name(case.scene.name, case.seed) if case.edit == "incorporation" else ""
    both = {WITHOUT_TRACES: combine(evidence.classification, ()), WITH_TRACES: evidence}
    findings = {name: estimate_from_attributes(one) for name, one in both.items()}
    predictions = [Prediction(score=f.attribute, labels=f.labels) for f in findings.values()]
    masks = heldout_masks(case.gaussians, case.scene.heldout, predictions)
    for (name, own), prediction, mask in zip(both.items(), predictions, masks, strict=True):
        names = " ".join(trace.name for trace in own.traces if trace.found)
        row = {**case.key, "export": "", "regime": NO_MASKS, "method": name}
        row |= {"verdict": own.verdict, "traces": names, "donor": pasted}
        row["ece"] = calibration_error(expit(own.log_odds), case.labels)
        if case.labels.any():
            yield row | scores(case, prediction, mask)
        else:
            yield row | {"false_area": float(mask.mean())}


def calibration_error(probability: np.ndarray, labels: np.ndarray) -> float:
    """Expected calibration error over ten bins."""
    bins = np.minimum((probability * 10).astype(int), 9)
    differences = np.bincount(bins, probability - labels, minlength=10)
    return float(np.abs(differences).sum() / len(labels))


def _with_masks(
    case: Case, evidence: ForensicEvidence, failures: Mapping[str, Failures]
) -> Iterator[Row]:
    """Measure baselines and `robust` with masks of failing detectors, without and with a prior."""
    verdicts: dict[tuple[str, str], float] = {}

    def method(observed: CaseObservation, *, name: str, prior: Prior | None) -> Prediction:
        finding = seeded(METHODS["robust"], case.seed).estimate(observed.observation, prior)
        verdicts[observed.regime, name] = finding.verdict or 0.0
        return Prediction(score=finding.attribute, labels=finding.labels)

    priors = {MASKS: None, FUSED: evidence}
    methods = {name: ALL_METHODS[name] for name in BASELINES} | {
        name: functools.partial(method, name=name, prior=prior) for name, prior in priors.items()
    }
    if not case.labels.any():
        failures = {name: failures[name] for name in FALSE_ALARMS if name in failures}
    for row in judge(observe_regimes(case, detector_masks(case, failures)), methods):
        if row["method"] != TRUTH:
            verdict = verdicts.get((row["regime"], row["method"]), np.nan)
            yield {**row, "verdict": verdict, "traces": "", "donor": ""}


def all_rows(args: NativeArgs) -> Iterator[Iterator[Row]]:
    """Measure every edit, and every authentic scene once per seed."""
    for case in args.cases():
        mixture = calibrated_mixture(case)
        yield rows_of(case, mixture, args.keep)
        if case.edit == "modification":
            yield rows_of(without_edit(case), mixture, args.keep)


def _named(rows: pd.DataFrame) -> pd.DataFrame:
    """The rows with a column of method and export."""
    return rows.assign(evidence=rows.method + ", " + rows.export)


def report(rows: pd.DataFrame) -> str:
    """All tables."""
    return "\n\n".join([*_tables_without_masks(rows), *_tables_with_masks(rows)])


def _tables_without_masks(rows: pd.DataFrame) -> list[str]:
    alone = _named(where(rows[rows.edit != "none"], regime=NO_MASKS))
    bare = where(alone, export="8 bits", method=WITHOUT_TRACES)
    table = functools.partial(pivot, alone, "evidence", "edit", best=None)
    detail = functools.partial(pivot, across="edit", metric="auc", digits=3, best=None)
    return [
        "**AUC per Gaussian, no 2D detector**, each scene by a classifier that never saw it",
        table(metric="auc", digits=3),
        "**F1 per held-out view, no 2D detector**",
        table(),
        "**IoU per held-out view, no 2D detector**",
        table(metric="iou"),
        "**F1 per Gaussian, no 2D detector**",
        table(metric="f1_gaussians"),
        "**AUC per Gaussian of incorporations by what was pasted, 8 bits, no traces.** The "
        "scanned objects and the vase were pasted into other scenes in training; what was cut "
        "from another scene was not",
        detail(where(bare, edit="incorporation"), "donor", total=False),
        "**Expected calibration error of the probability per Gaussian**",
        table(metric="ece", digits=3),
        "**AUC per Gaussian by scene, 8 bits, no traces**",
        detail(bare, "scene"),
        "**Number of cases in which each trace was found**",
        traces_found(where(rows, regime=NO_MASKS, method=WITH_TRACES)),
    ]


def _tables_with_masks(rows: pd.DataFrame) -> list[str]:
    edited, authentic = rows[rows.edit != "none"], where(rows, edit="none")
    fresh, saved = (where(edited[edited.regime != NO_MASKS], export=name) for name in EXPORTS)
    mixture = where(saved, regime="mixture")
    flagged = _named(authentic).assign(flagged=100 * authentic.false_area)
    lifted = functools.partial(pivot, digits=3)
    return [
        "**Was anything edited? AUC of the verdict**, edited against authentic scenes",
        verdicts(rows),
        "**With the masks of a detector: F1 per held-out view**, all edits, 8 bits. The "
        "detector itself is scored on the views that it was shown",
        lifted(saved, "method", "regime"),
        "**The same by kind of edit, mixture of failures**",
        lifted(mixture, "method", "edit"),
        "**The same: IoU**",
        lifted(mixture, "method", "edit", metric="iou"),
        "**The same as edited, with traces: F1**",
        lifted(fresh, "method", "edit"),
        "**Authentic scenes: percent of the pixels flagged**, in held-out views except for the "
        "detector itself",
        pivot(flagged, "evidence", "regime", metric="flagged", best=None, total=False),
    ]


def traces_found(rows: pd.DataFrame) -> str:
    """Tabulate how often each trace was found, by export and edit."""
    found = rows.traces.str.get_dummies(sep=" ")
    groups = found.groupby([rows.export, rows.edit])
    lines = [[*key, *(f"{count} of {len(own)}" for count in own.sum())] for key, own in groups]
    return markdown(
        ["export", "edit", *found], sorted(lines, key=lambda line: EXPORTS.index(line[0]))
    )


def verdicts(rows: pd.DataFrame) -> str:
    """Tabulate the AUC of the verdict by evidence, for each kind of edit."""
    kinds = [kind for kind in rows.edit.unique() if kind != "none"]
    rows, lines = rows.dropna(subset="verdict"), []
    for regime in rows.regime.unique():
        own = where(rows, regime=regime)
        for name, export in itertools.product(own.method.unique(), EXPORTS):
            some = where(own, method=name, export=export)
            authentic = where(some, edit="none").verdict
            if authentic.empty:  # a failure that flags nothing
                continue
            values = [_verdict_auc(some, kind) for kind in kinds]
            cells = [f"{value:.2f}" for value in (*values, np.mean(values))]
            called = f"{(authentic > 0.5).mean():.0%}"
            lines.append([f"{name}, {regime}, {export}", *cells, called])
    return markdown(["evidence", *kinds, "mean", "authentic called edited"], lines)


def _verdict_auc(rows: pd.DataFrame, kind: str) -> float:
    edited = (rows.edit == kind).to_numpy()
    some = edited | (rows.edit == "none").to_numpy()
    return auc(rows.verdict.to_numpy()[some], edited[some])


def chart(rows: pd.DataFrame, path: Path) -> None:
    """Draw AUC per Gaussian and F1 per view of every case, by edit and scene."""
    shown = where(rows[rows.edit != "none"], regime=NO_MASKS, export="8 bits", method=WITH_TRACES)
    kinds, scenes = list(shown.edit.unique()), shown.scene.unique()
    figure, axes = plt.subplots(1, 2, figsize=(9, 3.6), layout="constrained", sharex=True)
    metrics = {"auc": "AUC per Gaussian", "f1": "F1 per view"}
    for axis, (metric, label) in zip(axes, metrics.items(), strict=True):
        for k, scene in enumerate(scenes):
            own = where(shown, scene=scene)
            places = [kinds.index(edit) + 0.12 * (k - len(scenes) / 2) for edit in own.edit]
            style = {"color": charts.COLORS[k], "label": scene, "ms": 5}
            axis.plot(places, own[metric], charts.MARKERS[k], **style)
        axis.set_xticks(range(len(kinds)), kinds)
        axis.set(ylabel=label, ylim=(-0.03, 1.03))
        axis.grid(visible=True, alpha=0.25)
    axes[0].legend(fontsize=8)
    charts.save(figure, path)


def main(args: NativeArgs) -> None:
    """Measure every case; print and write the tables and the chart."""
    rows = measured(args, "native", all_rows(args))
    text = report(rows)
    print(text)
    write_section(args.out / "results.md", "native", text)
    chart(rows, args.out / "native.png")


if __name__ == "__main__":
    start(main, __doc__)
