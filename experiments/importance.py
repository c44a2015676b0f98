"""Permutation importance of the features: the loss of AUC when a group of them is shuffled.

    python experiments/importance.py [--quick] [--out docs] [--classifier .cues/bank.npz]

The classifier is that of the package, on scenes and objects that nothing was trained on, after an
export. The values of one group are shuffled among the Gaussians of a case for the networks only;
novelty keeps its features. The last rows leave out novelty and the networks. A group that is
correlated with others loses little, and no network was trained without it.
"""

import dataclasses
from collections.abc import Iterator
from pathlib import Path

import charts
import jax
import numpy as np
from cases import Case
from matplotlib import pyplot as plt
from native import stored
from runner import measured, start
from tables import Frame, Row, pivot, where, write_section
from unseen import UnseenArgs, exported

from gsc_jax.benchmark.metrics import auc
from gsc_jax.forensics.classifier import (
    Classifier,
    default_classifier,
    smoothed_log_odds,
    smoothed_novelty,
)
from gsc_jax.forensics.features import Features, compute_features, in_group, with_finite_scales
from gsc_jax.scene import InputError
from gsc_jax.scene.gaussians import usable_rows
from gsc_jax.scene.neighbours import order_of_leaves

EXPORTER = "8 bits"
NOTHING, NO_NOVELTY, NO_NETWORKS = "nothing", "novelty left out", "networks left out"
LEFT_OUT = NO_NOVELTY, NO_NETWORKS
SMALL = 0.0005
"""Mean loss of AUC below which a group loses nothing: the table rounds it to 0."""


@dataclasses.dataclass(frozen=True, kw_only=True)
class ShuffledFeatures(Features):
    """Features of N Gaussians whose columns of a group come from other Gaussians.

    Attributes:
        group: Name of the group, the first part of the names of its columns.
        order: Gaussian from which each takes the values of the group, shape (N,).
    """

    group: str
    order: np.ndarray

    def rows(self, rows: np.ndarray | slice = slice(None)) -> np.ndarray:
        """The values of some Gaussians, by default of all, shape (M, F) float32."""
        values, columns = super().rows(rows), in_group(self.names, self.group)
        values[:, columns] = super().rows(self.order[rows])[:, columns]
        return values


def groups_of(features: Features) -> list[str]:
    """Names of the groups, in the order of their columns."""
    return list(dict.fromkeys(name.split(".")[0] for name in features.names))


def shuffled(features: Features, group: str, seed: int) -> ShuffledFeatures:
    """Features with one group shuffled among the Gaussians."""
    own = {field.name: getattr(features, field.name) for field in dataclasses.fields(features)}
    random = np.random.default_rng([seed, *group.encode()])
    order = random.permutation(len(features.neighbourhoods.nearest))
    return ShuffledFeatures(**own, group=group, order=order)


def variants(
    features: Features, means: np.ndarray, classifier: Classifier, seed: int
) -> Iterator[tuple[str, np.ndarray]]:
    """Yield raw log odds (N,) with all features, with each group shuffled and with parts left out.

    Args:
        features: Features of N Gaussians.
        means: Their means, shape (N, 3).
        classifier: Networks and the weight of the novelty.
        seed: Seed of the permutations, one for each group.
    """
    novelty = classifier.novelty * smoothed_novelty(features, means)
    networks = smoothed_log_odds(features, classifier)
    yield NOTHING, networks + novelty
    for group in groups_of(features):
        yield group, smoothed_log_odds(shuffled(features, group, seed), classifier) + novelty
    yield NO_NOVELTY, networks
    yield NO_NETWORKS, novelty


def rows_of(case: Case, classifier: Classifier) -> Iterator[Row]:
    """Measure the AUC of one case after an export, with every group shuffled in turn."""
    own = exported(case, EXPORTER)
    host = jax.tree.map(np.asarray, own.gaussians)
    rows = np.flatnonzero(usable_rows(host))
    rows = rows[order_of_leaves(host.means[rows])]  # neighbours are close in memory, thus faster
    sound, labels = with_finite_scales(host.take(rows)), own.labels[rows]
    means, whole = np.asarray(sound.means, np.float32), np.nan
    for name, log_odds in variants(compute_features(sound), means, classifier, case.seed):
        value = auc(log_odds, labels)
        whole = value if name == NOTHING else whole
        yield {**case.key, "shuffled": name, "auc": value, "loss": whole - value}


def all_rows(args: UnseenArgs) -> Iterator[Iterator[Row]]:
    """Measure every case."""
    if not (args.quick or (args.data / "scenes").is_dir()):
        raise InputError(f"{args.data}: no scenes; this experiment needs the real ones")
    classifier = stored(args.classifier) if args.classifier else default_classifier()
    for case in args.cases():
        yield rows_of(case, classifier)


def report(rows: Frame) -> str:
    """The table, the AUC that the losses refer to, and the groups that lose nothing."""
    whole, losses = where(rows, shuffled=NOTHING), rows[rows.shuffled != NOTHING]
    groups = losses[~losses.shuffled.isin(LEFT_OUT)].groupby("shuffled", sort=False).loss.mean()
    idle = groups[groups < SMALL].index
    means = whole.groupby("edit", sort=False).auc.mean()
    return "\n\n".join(
        [
            "**Loss of AUC per Gaussian when a group of features is shuffled**, unseen scenes and "
            f"objects after an export ({EXPORTER}), no traces",
            pivot(losses, "shuffled", "edit", metric="loss", best=None, digits=3),
            f"{len(idle)} of {len(groups)} groups lose nothing (less than {SMALL} in the mean)"
            f"{': ' if len(idle) else ''}{', '.join(idle)}. AUC of the {len(whole)} cases with all "
            f"features: {', '.join(f'{edit} {value:.3f}' for edit, value in means.items())}.",
        ]
    )


def chart(rows: Frame, path: Path) -> None:
    """Draw the mean loss by group and edit."""
    losses = rows[rows.shuffled != NOTHING].pivot_table("loss", "shuffled", "edit", sort=False)
    figure, axis = plt.subplots(figsize=(7, 4.6), layout="constrained")
    for k, (edit, values) in enumerate(losses.items()):
        places = np.arange(len(losses)) + 0.27 * (k - 1)
        axis.barh(places, values, 0.25, color=charts.COLORS[k], label=edit)
    axis.set_yticks(range(len(losses)), losses.index)
    axis.set(xlabel="loss of AUC per Gaussian when the group is shuffled or the part left out")
    axis.axvline(0, color=charts.BLACK, lw=0.6)
    axis.axhline(len(losses) - len(LEFT_OUT) - 0.5, color="#999999", lw=0.8, ls=":")
    axis.invert_yaxis()
    axis.legend()
    charts.save(figure, path)


def main(args: UnseenArgs) -> None:
    """Measure every group of every case; print and write the table and the chart."""
    rows = measured(args, "importance", all_rows(args))
    text = report(rows)
    print(text)
    write_section(args.out / "results.md", "importance", text)
    chart(rows, args.out / "importance.png")


if __name__ == "__main__":
    start(main, __doc__)
