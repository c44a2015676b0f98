"""What the Gaussians themselves say: alone, with exact traces, and beside the masks of a detector.

    python experiments/train_cues.py --keep .cues
    python experiments/native.py --keep .cues [--quick] [--out docs]

Every scene is judged by a model that was trained on the other scenes and on other seeds
(`train_cues.py` leaves them in its folder). Scenes are looked at as they were edited, with all
digits, and as they are after host and object were exported alike in 8 bits; untouched ones, too.
"""

import dataclasses
import functools
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path

import charts
import numpy as np
from cases import QUICK, Case, calibrated_mixture, detector_masks, donor_name, untouched
from export import exported
from looks import Answer, Look, look
from matplotlib import pyplot as plt
from methods import ALL_METHODS
from runner import REFERENCE, TRUTH, Args, heldout_masks, judge, measured, scores, start
from tables import Row, markdown, pivot, values_of, where, write_section

from gsc_jax.benchmark.metrics import auc, false_positive_area
from gsc_jax.benchmark.simulate import REGIMES, Failures
from gsc_jax.estimators.gschecker import find
from gsc_jax.estimators.robust.estimator import RobustConfig
from gsc_jax.estimators.robust.prior_fusion import Prior
from gsc_jax.forensics.classifier import Model, from_arrays, shipped_model
from gsc_jax.forensics.evidence import Native, find_native, native_evidence
from gsc_jax.scene import InputError

EXPORTS = ("as edited", "8 bits")
ALONE, TRACES = "Gaussians, no traces", "Gaussians"
MASKS, FUSED = "robust", "robust + Gaussians"
NO_MASKS = "no masks"


@dataclasses.dataclass(frozen=True, kw_only=True)
class NativeArgs(Args):
    """As the others, and where the models are.

    Attributes:
        keep: Folder in which `train_cues.py` left a model for every scene.
    """

    keep: Path = Path(".cues")


@functools.cache
def model_without(scene: str, keep: Path) -> Model:
    """The model that never saw a scene."""
    if scene == QUICK:  # whose numbers mean little
        return shipped_model()
    path = keep / f"without-{scene}.npz"
    if not path.exists():
        raise InputError(f"{path}: is not there; run experiments/train_cues.py --keep {keep} first")
    with np.load(path) as stored:
        return from_arrays(stored)


BASELINES = ("FlashSplat", "GS-Checker official")
"""The best of the methods that lift masks without asking what they are worth, and GS-Checker's."""
ALARMS = ("blobs", "consistent", "inverted", "mixture")
"""Of the failures those that flag something where nothing is tampered."""


def rows_of(case: Case, mixture: Failures, keep: Path) -> Iterator[Row]:
    """Everything about one scene: the Gaussians alone, as edited and exported, and with masks."""
    model = model_without(case.scene.name, keep)
    pasted = donor_name(case.scene.name, case.seed) if case.edit == "incorporation" else ""
    for export in EXPORTS:
        if export == "as edited" and case.edit == "none" and case.seed > 0:
            continue  # it is the same scene again
        seen = _exported(case, export)
        told = native_evidence(seen.gaussians, model=model)
        natives = {ALONE: told.without_traces, TRACES: told}
        answers = {name: _answer(native) for name, native in natives.items()}
        masks = heldout_masks(seen.gaussians, seen.scene.heldout, list(answers.values()))
        for (name, answer), predicted in zip(answers.items(), masks, strict=True):
            row = {**case.key, "export": export, "regime": NO_MASKS, "method": name}
            row |= {"verdict": natives[name].verdict, "traces": _found(natives[name])}
            row |= {"donor": pasted, "ece": calibration_error(natives[name], case.labels)}
            edited = case.labels.any()
            yield row | (scores(seen, answer, predicted) if edited else _false(predicted))
        failures = {**(REGIMES if export == "8 bits" else {}), "mixture": mixture}
        yield from ({**row, "export": export} for row in fused(seen, told, failures))


def calibration_error(native: Native, labels: np.ndarray) -> float:
    """Mean distance of probability and truth over ten bins, of all Gaussians."""
    bins = np.minimum((native.probability * 10).astype(int), 9)
    counts = np.bincount(bins, minlength=10)
    apart = np.bincount(bins, native.probability - labels, minlength=10)
    return float(np.abs(apart).sum() / counts.sum())


def fused(case: Case, native: Native, failures: Mapping[str, Failures]) -> Iterator[Row]:
    """What masks of detectors that fail say: by baselines, by `robust`, and with the Gaussians."""
    config = RobustConfig(seed=case.seed)
    verdicts: dict[tuple[str, str], float] = {}

    def method(one: Look, *, name: str, prior: Prior | None) -> Answer:
        found = find(case.gaussians, case.scene.cameras, one.observation, config, prior)
        verdicts[one.regime, name] = found.verdict or 0.0
        return Answer(score=found.attribute, labels=found.labels)

    priors = {MASKS: None, FUSED: native.prior}
    methods = {name: ALL_METHODS[name] for name in BASELINES} | {
        name: functools.partial(method, name=name, prior=prior) for name, prior in priors.items()
    }
    if not case.labels.any():
        failures = {name: failures[name] for name in ALARMS if name in failures}
    masks = detector_masks(case, failures)
    for row in judge(look(case, masks), methods):
        if row["method"] != TRUTH:
            said = verdicts.get((row["regime"], row["method"]), np.nan)
            yield {**row, "verdict": said, "traces": "", "donor": "", "ece": np.nan}


def _exported(case: Case, export: str) -> Case:
    if export != "8 bits":
        return case
    return dataclasses.replace(case, gaussians=exported(case.gaussians, seed=case.seed))


def _answer(native: Native) -> Answer:
    found = find_native(native)
    return Answer(score=found.attribute, labels=found.labels)


def _found(native: Native) -> str:
    return " ".join(trace.name for trace in native.traces if trace.found)


def _false(predicted: np.ndarray) -> dict[str, float]:
    nothing = dict.fromkeys(("f1", "iou", "precision", "recall", "f1_gaussians", "auc"), np.nan)
    return {**nothing, "false_area": float(false_positive_area(list(predicted)).mean())}


def all_rows(args: NativeArgs) -> Iterator[Iterator[Row]]:
    """Every edit, and every scene as it was, once per seed."""
    for case in args.cases():
        mixture = calibrated_mixture(case)
        yield rows_of(case, mixture, args.keep)
        if case.edit == "modification":
            yield rows_of(untouched(case), mixture, args.keep)


def report(rows: Sequence[Row]) -> str:
    """The tables."""
    edited = [row for row in rows if row["edit"] != "none"]
    alone = where(edited, regime=NO_MASKS)
    named = [{**row, "evidence": f"{row['method']}, {row['export']}"} for row in alone]
    masked = [row for row in edited if row["regime"] != NO_MASKS]
    saved, fresh = (where(masked, export=export) for export in reversed(EXPORTS))
    tables = functools.partial(pivot, named, "evidence", "edit", best=None)
    lifted = functools.partial(pivot, digits=3, reference=REFERENCE)
    return "\n\n".join(
        [
            "**AUC per Gaussian, no 2D detector**, each scene by a model that never saw it",
            tables(metric="auc", digits=3),
            "**F1 per held-out view, no 2D detector**",
            tables(),
            "**IoU per held-out view, no 2D detector**",
            tables(metric="iou"),
            "**F1 per Gaussian, no 2D detector**",
            tables(metric="f1_gaussians"),
            "**AUC per Gaussian of incorporations by what was pasted, 8 bits, no traces.** The "
            "scanned objects and the vase were pasted into other scenes in training; what was cut "
            "from another scene was not",
            pivot(
                where(alone, export="8 bits", method=ALONE, edit="incorporation"),
                "donor",
                "edit",
                metric="auc",
                digits=3,
                best=None,
                total=False,
            ),
            "**Expected calibration error of the probability per Gaussian**",
            tables(metric="ece", digits=3),
            "**AUC per Gaussian by scene, 8 bits, no traces**",
            pivot(
                where(alone, export="8 bits", method=ALONE),
                "scene",
                "edit",
                metric="auc",
                digits=3,
                best=None,
            ),
            "**Which traces were found**, in how many of the edits",
            traces_found(where(rows, regime=NO_MASKS, method=TRACES)),
            "**Is anything tampered with? Area under the curve of the verdict**, edited against "
            "untouched scenes",
            verdicts(rows),
            "**With the masks of a detector: F1 per held-out view**, all edits, 8 bits. The "
            "detector itself is judged on the views that it was shown",
            lifted(saved, "method", "regime"),
            "**The same by kind of edit, mixture of failures**",
            lifted(where(saved, regime="mixture"), "method", "edit"),
            "**The same: IoU**",
            lifted(where(saved, regime="mixture"), "method", "edit", metric="iou"),
            "**The same as edited, with exact traces where there are any: F1**",
            lifted(fresh, "method", "edit"),
            "**Untouched scenes: percent of the pixels flagged**, held out but for the detector's",
            flagged([row for row in rows if row["edit"] == "none"]),
        ]
    )


def traces_found(rows: Sequence[Row]) -> str:
    """By export and edit, how often each trace was found."""
    names = sorted({name for row in rows for name in str(row["traces"]).split() if name != "nan"})
    lines = []
    for export in EXPORTS:
        for edit in values_of(rows, "edit"):
            own = where(rows, export=export, edit=edit)
            counts = [sum(name in str(row["traces"]).split() for row in own) for name in names]
            lines.append([export, edit, *(f"{count} of {len(own)}" for count in counts)])
    return markdown(["export", "edit", *names], lines)


def verdicts(rows: Sequence[Row]) -> str:
    """Area under the curve by evidence, for all edits and for each kind."""
    kinds = [kind for kind in values_of(rows, "edit") if kind != "none"]
    lines = []
    for regime in values_of(rows, "regime"):
        for name in values_of(where(rows, regime=regime), "method"):
            for export in values_of(where(rows, regime=regime, method=name), "export"):
                own = where(rows, regime=regime, method=name, export=export)
                own = [row for row in own if not np.isnan(row["verdict"])]
                pristine = where(own, edit="none")
                if not pristine:  # a method without a verdict, or a failure that flags nothing
                    continue
                values = [_verdict_auc(own, kind) for kind in kinds]
                called = np.mean([row["verdict"] > 0.5 for row in pristine])
                cells = [f"{value:.2f}" for value in (*values, np.mean(values))]
                lines.append([f"{name}, {regime}, {export}", *cells, f"{called:.0%}"])
    return markdown(["evidence", *kinds, "mean", "untouched called tampered"], lines)


def _verdict_auc(rows: Sequence[Row], kind: str) -> float:
    some = [row for row in rows if row["edit"] in (kind, "none")]
    values = np.array([row["verdict"] for row in some], float)
    return float(auc(values, np.array([row["edit"] != "none" for row in some])))


def flagged(rows: Sequence[Row]) -> str:
    """Percent flagged by evidence and regime."""
    named = [
        {**row, "flagged": 100 * row["false_area"], "evidence": f"{row['method']}, {row['export']}"}
        for row in rows
    ]
    return pivot(named, "evidence", "regime", metric="flagged", digits=2, best=None, total=False)


def chart(rows: Sequence[Row], path: Path) -> None:
    """AUC per Gaussian of every case, by edit and evidence."""
    alone = [row for row in where(rows, regime=NO_MASKS) if row["edit"] != "none"]
    kinds, scenes = values_of(alone, "edit"), values_of(alone, "scene")
    figure, axes = plt.subplots(1, 2, figsize=(9, 3.6), layout="constrained", sharex=True)
    for axis, metric, label in zip(
        axes, ("auc", "f1"), ("AUC per Gaussian", "F1 per view"), strict=True
    ):
        for k, scene in enumerate(scenes):
            own = where(alone, scene=scene, export="8 bits", method=TRACES)
            places = [kinds.index(row["edit"]) + 0.12 * (k - len(scenes) / 2) for row in own]
            style = {"color": charts.COLORS[k], "label": scene, "ms": 5}
            axis.plot(places, [row[metric] for row in own], charts.MARKERS[k], **style)
        axis.set_xticks(range(len(kinds)), kinds)
        axis.set(ylabel=label, ylim=(-0.03, 1.03))
        axis.grid(visible=True, alpha=0.25)
    axes[0].legend(fontsize=8)
    charts.save(figure, path)


def main(args: NativeArgs) -> None:
    """Ask the Gaussians of every case; print and write the tables and the chart."""
    rows = measured(args, "native", all_rows(args))
    text = report(rows)
    print(text)
    write_section(args.out / "results.md", "native", text)
    chart(rows, args.out / "native.png")


if __name__ == "__main__":
    start(main, __doc__)
