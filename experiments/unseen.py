"""The attributes alone on sources that nothing was trained on, after every exporter.

    python experiments/unseen.py [--out docs] [--classifier .cues/bank.npz]

The classifier is that of the package, or one that `train_classifier.py` left in a file; both were
trained on other scenes and other objects. Edits are quick ones, those of the programs of editors,
and laundered ones (`editors.py`). Edited scenes are exported, and authentic ones have a harmless
history: an export, a crop, a motion.
"""

import dataclasses
import itertools
from collections.abc import Iterator
from pathlib import Path
from typing import get_args

import pandas as pd
from cases import CUT, UNSEEN, Case, make_case, without_edit
from editors import UNTOUCHED, Family, case_of_family, laundered_without_edit, source_of_object
from export import EXPORTERS, export
from heldout import ALARM, called, separation
from runner import Args, measured, start
from tables import Frame, Row, markdown, pivot, where, write_section
from tqdm import tqdm
from without_masks import WITH_TRACES, WITHOUT_TRACES, rows_without_masks, stored

from gsc_jax.forensics.classifier import Classifier, default_classifier
from gsc_jax.forensics.evidence import forensic_evidence
from gsc_jax.scene import InputError

AS_EDITED = "as edited"
LOSSY = ("8 bits", "spz", "compressed.ply", "palettes", "splat", "level of detail")
"""Exporters of edited scenes: those that change most numbers."""
FAMILIES: tuple[Family, ...] = get_args(Family)


@dataclasses.dataclass(frozen=True, kw_only=True)
class UnseenArgs(Args):
    """Arguments of the experiment, by default for the unseen scenes.

    Attributes:
        classifier: File of another classifier than that of the package.
    """

    scenes: tuple[str, ...] = UNSEEN
    seeds: int = 2
    classifier: Path | None = None


@dataclasses.dataclass(frozen=True, kw_only=True)
class FamilyArgs(UnseenArgs):
    """Arguments of this experiment.

    Attributes:
        families: How the edits are made.
    """

    families: tuple[Family, ...] = FAMILIES


def exported(case: Case, exporter: str) -> Case:
    """The case after an export, with its truth; held-out views show what they showed before."""
    if exporter == AS_EDITED:
        return case
    saved, rows = export(case.gaussians, exporter, seed=case.seed)
    return dataclasses.replace(case, gaussians=saved, labels=case.labels[rows])


def rows_of(
    case: Case, exporter: str, classifier: Classifier, family: str = UNTOUCHED
) -> Iterator[Row]:
    """Measure one case after one exporter."""
    own = exported(case, exporter)
    evidence = forensic_evidence(own.gaussians, classifier=classifier)
    for row in rows_without_masks(own, evidence):
        if family == "editor" and case.edit == "incorporation":
            row["donor"] = CUT + source_of_object(case.scene.name, case.seed)
        yield {**row, "export": exporter, "family": family}


def all_rows(args: FamilyArgs) -> Iterator[Iterator[Row]]:
    """Measure every edit after the lossy exporters, and every authentic scene after all."""
    if not (args.quick or (args.data / "scenes").is_dir()):
        raise InputError(f"{args.data}: no scenes; this experiment needs the real ones")
    classifier = stored(args.classifier) if args.classifier else default_classifier()
    lossy, histories = ((AS_EDITED, *some) for some in (LOSSY, EXPORTERS))
    jobs = args.jobs()
    both = list(itertools.product(jobs, args.families))
    if args.quick:
        lossy, histories = lossy[:3], histories[:3]
        both = list(zip(jobs, args.families, strict=False))
    for (scene, edit, seed), family in tqdm(both, desc="cases", disable=None):
        try:
            case = case_of_family(scene, edit, seed, family, args.data)
        except InputError as error:
            tqdm.write(f"{scene}, {edit}, seed {seed}, {family}: {error}")
            continue
        for exporter in lossy:
            yield rows_of(case, exporter, classifier, family)
    for scene in dict.fromkeys(scene for scene, *_ in jobs):
        case = without_edit(make_case(scene, "modification", args.first_seed, args.data))
        for exporter in tqdm(histories, desc=f"authentic {scene}", disable=None):
            yield rows_of(case, exporter, classifier)
        if "laundered" in args.families:
            trained = laundered_without_edit(case)
            for exporter in lossy:
                yield rows_of(trained, exporter, classifier, "laundered")


def report(rows: Frame) -> str:
    """All tables. Those by exporter show quick edits or, if there are none, the first family."""
    own = where(rows, method=WITH_TRACES)
    edited, authentic = own[own.edit != "none"], where(own, edit="none")
    after = edited[edited.export != AS_EDITED]
    first = "quick" if "quick" in set(edited.family) else edited.family.iloc[0]
    counts = edited.groupby(["family", "edit", "export"]).size()
    lines = []
    for metric, name in (("auc", "AUC per Gaussian"), ("f1", "F1 per held-out view")):
        by_export = _hardest_first(where(edited, family=first), metric)
        lines += [
            f"**{name}, no 2D detector, unseen scenes and objects**, {first} edits, the hardest "
            "export first",
            pivot(by_export, "export", "edit", metric=metric, best=None),
            f"**{name} by family**, mean over the exports, without the files as edited; "
            f"at least {counts.min()} edits of each kind and export",
            pivot(after, "family", "edit", metric=metric, best=None),
        ]
    ranks = _scene_aucs(rows[rows.export != AS_EDITED])
    return "\n\n".join([*lines, *ranks, *_probabilities(edited, authentic)])


def _hardest_first(rows: Frame, metric: str) -> Frame:
    order = rows.groupby("export")[metric].mean().sort_values().index
    return pd.concat([where(rows, export=export) for export in order])


def _scene_aucs(rows: Frame) -> Iterator[str]:
    """AUC of the scene probability by family and edit, against authentic scenes like them.

    Laundered edits are compared with laundered authentic scenes, others with untouched ones.
    """
    yield (
        "**AUC of the scene probability by family**, after an export, against exports of the "
        "authentic scenes, for laundered edits laundered ones; without traces in brackets; the "
        f"last columns: called edited ({ALARM} or more)"
    )
    edits = [edit for edit in rows.edit.unique() if edit != "none"]
    lines = []
    for family in rows[rows.edit != "none"].family.unique():
        like = "laundered" if family == "laundered" else UNTOUCHED
        some, authentic = where(rows, family=family), where(rows, family=like, edit="none")
        edited = some[some.edit != "none"]
        parts = [where(edited, edit=edit) for edit in edits]
        aucs = [_both_aucs(part, authentic) for part in (*parts, edited)]
        counts = [called(where(part, method=WITH_TRACES)) for part in (edited, authentic)]
        lines.append([family, *aucs, *counts])
    yield markdown(["family", *edits, "all", "edited", "authentic"], lines)


def _both_aucs(edited: Frame, authentic: Frame) -> str:
    """AUC of the scene probability with traces, and in brackets without; - if there is none."""
    if edited.empty or authentic.empty:
        return "-"
    with_traces, without = (
        separation(where(edited, method=method), where(authentic, method=method))
        for method in (WITH_TRACES, WITHOUT_TRACES)
    )
    return f"{with_traces:.2f} ({without:.2f})"


def _probabilities(edited: Frame, authentic: Frame) -> Iterator[str]:
    """Scene probabilities of authentic scenes by history, and how many are called edited."""
    authentic = where(authentic, family=UNTOUCHED)
    scenes = list(authentic.scene.unique())
    lines = []
    for history in authentic.export.unique():
        values = [where(authentic, export=history, scene=scene).verdict.iloc[0] for scene in scenes]
        lines.append([history.replace(AS_EDITED, "untouched"), *(f"{v:.2f}" for v in values)])
    yield f"**Scene probability of authentic scenes by history**; {ALARM} or more is a false alarm"
    yield markdown(["history", *scenes], lines)
    yield (
        f"Called edited: {called(authentic)} authentic scenes with these histories, and "
        f"{called(edited)} edited scenes."
    )


def main(args: FamilyArgs) -> None:
    """Measure every case; print and write the tables."""
    rows = measured(args, "unseen", all_rows(args))
    text = report(rows)
    print(text)
    write_section(args.out / "results.md", "unseen", text)


if __name__ == "__main__":
    start(main, __doc__)
