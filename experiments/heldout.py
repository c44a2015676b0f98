"""The attributes alone on cases of the bank, by classifiers that never saw their hosts.

    python experiments/captures.py
    python experiments/train_classifier.py --keep .cues
    python experiments/heldout.py --keep .cues [--out docs]

Hosts vary in capture, edits in program and donor, and every case has one exporter or harmless
history. The objects that are pasted were pasted into other hosts in training, too. Traces are left
out of the scores, since an export may remove them, and have a table of their own. The level of
labelling was chosen on these cases by their F1.
"""

import dataclasses
import itertools
from collections.abc import Iterator
from pathlib import Path

import numpy as np
from bank import (
    BANK,
    FIRST_SEED,
    MADE_HOSTS,
    NO_EDIT,
    PROGRAM_SEEDS,
    BankCase,
    Kind,
    hosts,
    source_of,
)
from classifier_examples import stored_case
from runner import measured, refuse_unused, start
from tables import Frame, Row, markdown, pivot, separation, where, write_section
from tqdm import tqdm
from without_masks import KeepArgs, classifier_without

from gsc_jax.benchmark.metrics import auc, confusion
from gsc_jax.benchmark.tamper import EDITS
from gsc_jax.cli.report.wording import TRACES
from gsc_jax.forensics.classifier import default_classifier
from gsc_jax.forensics.evidence import (
    ForensicEvidence,
    combine,
    estimate_from_attributes,
    forensic_evidence,
)

SEEDS = {
    FIRST_SEED + 1: "whole hosts, editors and quick edits",
    FIRST_SEED + PROGRAM_SEEDS + 1: "parts of hosts, quick edits",
}
"""Seeds, and how they choose what is edited."""
ALARM = 0.5
"""Scene probability from which a scene is called edited."""
KINDS: tuple[Kind, ...] = (*EDITS, NO_EDIT)


@dataclasses.dataclass(frozen=True, kw_only=True)
class HeldoutArgs(KeepArgs):
    """Arguments of the experiment.

    Attributes:
        bank: The captures; without them only scenes of cases.py are edited.
    """

    bank: Path = BANK


def rows_of(host: str, kind: Kind, seed: int, args: HeldoutArgs) -> Iterator[Row]:
    """Measure one case; nothing if the host has no place for the edit."""
    case = stored_case(host, kind, seed, args.bank, args.data, args.keep)
    if case is None:
        return
    classifier = (
        default_classifier() if args.quick else classifier_without(source_of(host), args.keep)
    )
    evidence = forensic_evidence(case.gaussians, classifier=classifier)
    marked = {trace.name: trace.score > 0.5 for trace in evidence.traces if trace.found}
    shares = {name: case.labels[rows].mean() for name, rows in marked.items()}
    row = measure(case, combine(evidence.classification, ()), host, seed)
    yield row | {trace.name: shares.get(trace.name, np.nan) for trace in evidence.traces}


def measure(case: BankCase, evidence: ForensicEvidence, host: str, seed: int) -> Row:
    """Scores of the Gaussians of an edited case, and the scene probability."""
    row = {"host": host, "edit": case.edit, "seed": seed, "export": case.exporter}
    row |= {"family": case.family, "verdict": evidence.verdict, "regime": "no masks"}
    if case.edit == NO_EDIT:
        return row
    labels = estimate_from_attributes(evidence).labels
    scores = {"auc": auc(evidence.log_odds, case.labels)}
    return row | scores | {"f1_gaussians": confusion(labels, case.labels).f1}


def report(rows: Frame) -> str:
    """All tables."""
    edited = rows[rows.edit != NO_EDIT]
    edited = edited.assign(selection=edited.seed.map(SEEDS))
    tables = ["**Number of edited cases by family**", cases_by_family(edited)]
    for metric, name in (("auc", "AUC"), ("f1_gaussians", "F1")):
        for column in ("regime", "selection", "family", "export", "host"):
            tables.append(
                f"**{name} per Gaussian by {column}**, hosts that nothing was trained on; ± is the "
                "standard deviation over hosts"
            )
            tables.append(pivot(edited, column, "edit", metric=metric, over="host", best=None))
    authentic = where(rows, edit=NO_EDIT)
    tables += ["**Cases with a trace**", traces(edited, authentic)]
    return "\n\n".join([*tables, *scene_probabilities(edited, authentic)])


def traces(edited: Frame, authentic: Frame) -> str:
    """Tabulate in how many cases each trace was found, and how often it marks the edit."""
    head = ["trace", "authentic", "edited", "half of the marked Gaussians or more are edited"]
    lines = []
    for name in TRACES:
        found, false = edited[name].dropna(), int(authentic[name].notna().sum())
        counts = f"{false} of {len(authentic)}", f"{len(found)} of {len(edited)}"
        lines.append([name, *counts, int((found >= 0.5).sum())])
    return markdown(head, lines)


def cases_by_family(edited: Frame) -> str:
    """Tabulate the number of cases by family and kind of edit."""
    lines = []
    for name in edited.family.unique():
        own = where(edited, family=name)
        counts = [int((own.edit == kind).sum()) for kind in EDITS]
        lines.append([name, *counts, sum(counts)])
    return markdown(["family", *EDITS, "all"], lines)


def scene_probabilities(edited: Frame, authentic: Frame) -> Iterator[str]:
    """AUC of the scene probability, of all edits and by kind, and how many are called edited."""
    yield (
        f"Scene probability: AUC {separation(edited, authentic):.2f}; it is {ALARM} or more for "
        f"{called(authentic)} authentic and {called(edited)} edited cases."
    )
    some = [(kind, where(edited, edit=kind)) for kind in EDITS]
    lines = [[kind, f"{separation(own, authentic):.2f}", called(own)] for kind, own in some]
    yield f"**AUC of the scene probability by edit**, against all {len(authentic)} authentic cases"
    yield markdown(["edit", "AUC", f"probability of {ALARM} or more"], lines)


def called(rows: Frame) -> str:
    """Number of cases that are called edited, and of all, such as "3 of 14"."""
    return f"{int((rows.verdict >= ALARM).sum())} of {len(rows)}"


def main(args: HeldoutArgs) -> None:
    """Measure every case; print and write the tables."""
    refuse_unused(args, "scenes", "edits", "seeds", "first_seed")
    names = list(MADE_HOSTS)[:1] if args.quick else hosts(args.bank, args.data)
    jobs = list(itertools.product(names, KINDS, list(SEEDS)[args.quick :]))
    progress = tqdm(jobs, desc="cases", disable=None)
    rows = measured(args, "heldout", (rows_of(*job, args) for job in progress))
    text = report(rows)
    print(text)
    write_section(args.out / "results.md", "heldout", text)


if __name__ == "__main__":
    start(main, __doc__)
