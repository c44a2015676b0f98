"""What each group of features adds: networks are trained without it, and score unseen hosts.

    python experiments/captures.py
    python experiments/train_classifier.py --keep .cues
    python experiments/importance.py --keep .cues [--together size opacity] [--out docs]

For each source and each group, networks are trained on the cases of the other sources without the
columns of the group, and score cases of two hosts of the source; novelty and discriminant are
computed without the group, too. The last rows leave out novelty, the networks, and the
discriminant. Groups may replace each other: two that lose nothing alone may lose something
together, which `--together` measures. The weight of the novelty is that of the package.
"""

import dataclasses
import itertools
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path

import charts
import numpy as np
from bank import BankCase, source_of
from classifier_examples import Examples
from leave_out import LeaveOutArgs, examples_of, scored_cases
from matplotlib import pyplot as plt
from runner import measured, refuse_unused, start
from tables import Frame, Row, pivot, where, with_columns, write_section
from tqdm import tqdm
from train_classifier import train_network

from gsc_jax.benchmark.metrics import auc
from gsc_jax.forensics.classifier import (
    Classifier,
    default_classifier,
    smoothed_log_odds,
    with_places,
)
from gsc_jax.forensics.features import Features, compute_features, in_group, with_finite_scales
from gsc_jax.forensics.novelty import novelty
from gsc_jax.forensics.places import find_places
from gsc_jax.scene import InputError

NOTHING, NO_NOVELTY, NO_NETWORKS = "nothing", "novelty", "networks"
NO_DISCRIMINANT = "discriminant"
PARTS = NO_NOVELTY, NO_NETWORKS, NO_DISCRIMINANT
MEMBERS = 2
"""Networks of an ensemble: AUC varies between those of other seeds."""
ERRORS = 2
"""A mean loss of AUC below this many of its standard errors may be chance."""
Groups = tuple[str, ...]


@dataclasses.dataclass(frozen=True, kw_only=True)
class ImportanceArgs(LeaveOutArgs):
    """Arguments of the experiment.

    Attributes:
        together: Groups that are left out together in one more row.
    """

    together: tuple[str, ...] = ()


@dataclasses.dataclass(frozen=True, kw_only=True)
class ReducedFeatures(Features):
    """Features of N Gaussians without what tells them apart by some groups: these columns are 0.

    Attributes:
        without: Names of the groups, the first parts of the names of their columns.
    """

    without: Groups

    def own(self) -> Iterator[np.ndarray]:
        """Yield the numbers of the Gaussians themselves, a few at a time, (N, D)."""
        first = 0
        for values in super().own():
            names = self.names[first : first + values.shape[1]]
            yield np.where(kept_columns(names, self.without), values, np.float32(0))
            first += values.shape[1]


def kept_columns(names: Sequence[str], without: Groups) -> np.ndarray:
    """Mask of the columns of all other groups, shape (F,) bool."""
    return ~in_group(names, *without)


def groups_of(names: Sequence[str]) -> list[str]:
    """Names of the groups, in the order of their columns."""
    return list(dict.fromkeys(name.split(".")[0] for name in names))


def choices(names: Sequence[str], together: Groups) -> dict[str, Groups]:
    """Groups that are left out, by the name of the row."""
    known = groups_of(names)
    if unknown := [name for name in together if name not in known]:
        raise InputError(f"--together {unknown[0]!r}: expected some of {', '.join(known)}")
    chosen: dict[str, Groups] = {NOTHING: (), **{name: (name,) for name in known}}
    return chosen | ({" + ".join(together): together} if together else {})


def trained_without(
    cases: Sequence[Examples], source: str, without: Groups, members: int = MEMBERS
) -> Classifier:
    """A classifier of the cases that do not show a source, without some groups of features."""
    columns = kept_columns(cases[0].names, without)
    own = [
        dataclasses.replace(one, values=one.values[:, columns])
        for one in cases
        if source not in one.sources
    ]
    networks = tuple(train_network(own, seed=seed) for seed in range(members))
    names = tuple(np.array(cases[0].names)[columns].tolist())
    return dataclasses.replace(default_classifier(), networks=networks, names=names)


def rows_of(
    host: str, case: BankCase, classifiers: Mapping[str, tuple[Groups, Classifier]]
) -> Iterator[Row]:
    """AUC of a case by each classifier, and without novelty, networks or discriminant."""
    features = compute_features(with_finite_scales(case.gaussians))
    own = {field.name: getattr(features, field.name) for field in dataclasses.fields(features)}
    means = np.asarray(case.gaussians.means, np.float32)
    log_odds = {}
    for name, (without, classifier) in classifiers.items():
        reduced = ReducedFeatures(**own, without=without)
        places = find_places(reduced, means)
        novel = classifier.novelty * novelty(places)
        networks = smoothed_log_odds(features, classifier)
        log_odds[name] = with_places(networks, places, novel)
        if name == NOTHING:
            log_odds[NO_DISCRIMINANT] = networks + places.spread_out(novel)
            log_odds[NO_NOVELTY] = with_places(networks, places, 0.0)
            log_odds[NO_NETWORKS] = with_places(np.zeros(len(means)), places, novel)
    scores = {name: auc(values, case.labels) for name, values in log_odds.items()}
    key = {"host": host, "seed": 0, "edit": case.edit, "family": case.family}
    for name, score in scores.items():
        yield {**key, "left_out": name, "auc": score, "loss": scores[NOTHING] - score}


def all_rows(args: ImportanceArgs) -> Iterator[Iterator[Row]]:
    """Train for one source after the other, and measure its cases."""
    cases = examples_of(args)
    chosen = choices(cases[0].names, args.together)
    members = MEMBERS
    if args.quick:
        chosen, members = dict(itertools.islice(chosen.items(), 2)), 1
    source, classifiers = "", {}
    for host, case in scored_cases(args):
        if source != source_of(host):
            source = source_of(host)
            progress = tqdm(chosen.items(), desc=f"networks without {source}", disable=None)
            classifiers = {
                name: (without, trained_without(cases, source, without, members))
                for name, without in progress
            }
        yield rows_of(host, case, classifiers)


def report(rows: Frame) -> str:
    """The table, the AUC that the losses refer to, and the groups that add nothing."""
    whole, losses = where(rows, left_out=NOTHING), rows[rows.left_out != NOTHING]
    own = losses.groupby("left_out", sort=False).loss
    errors = {name: f"{error:.3f}" for name, error in own.sem().items()}
    groups = own.agg(["mean", "sem"]).drop(list(PARTS), errors="ignore")
    idle = groups[~(groups["mean"] >= ERRORS * groups["sem"])].index
    means = whole.groupby("edit", sort=False).auc.mean()
    table = pivot(_parts_last(losses), "left_out", "edit", metric="loss", best=None, digits=3)
    return "\n\n".join(
        [
            "**Loss of AUC per Gaussian when networks are trained without a group of features**, "
            "hosts that nothing was trained on, no traces",
            with_columns(table, {"standard error": errors}),
            f"{len(idle)} of {len(groups)} choices lose less than {ERRORS} standard errors of "
            f"the mean over all cases{': ' if len(idle) else ''}{', '.join(idle)}. AUC of the "
            f"{len(whole)} cases with all features: "
            f"{', '.join(f'{edit} {value:.3f}' for edit, value in means.items())}.",
        ]
    )


def _parts_last(losses: Frame) -> Frame:
    return losses.sort_values("left_out", key=lambda names: names.isin(PARTS), kind="stable")


def chart(rows: Frame, path: Path) -> None:
    """Draw the mean loss by group and edit."""
    losses = _parts_last(rows[rows.left_out != NOTHING])
    losses = losses.pivot_table("loss", "left_out", "edit", sort=False)
    figure, axis = plt.subplots(figsize=(7, 4.6), layout="constrained")
    for k, (edit, values) in enumerate(losses.items()):
        places = np.arange(len(losses)) + 0.27 * (k - 1)
        axis.barh(places, values, 0.25, color=charts.COLORS[k], label=edit)
    axis.set_yticks(range(len(losses)), losses.index)
    axis.set(xlabel="loss of AUC per Gaussian without the group or part")
    axis.axvline(0, color=charts.BLACK, lw=0.6)
    axis.axhline(len(losses) - len(PARTS) - 0.5, color="#999999", lw=0.8, ls=":")
    axis.invert_yaxis()
    axis.legend()
    charts.save(figure, path)


def main(args: ImportanceArgs) -> None:
    """Measure every group on every case; print and write the table and the chart."""
    refuse_unused(args, "scenes", "edits", "seeds", "first_seed")
    rows = measured(args, "importance", all_rows(args))
    text = report(rows)
    print(text)
    write_section(args.out / "results.md", "importance", text)
    chart(rows, args.out / "importance.png")


if __name__ == "__main__":
    start(main, __doc__)
