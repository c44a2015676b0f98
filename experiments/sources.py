"""Does the classifier improve with more sources? Its AUC on sources that it never saw.

    python experiments/sources.py [--keep .cues] [--quick] [--out docs]

A source is a scene, with its captures if there is a bank. For each, networks are trained on every
set of other sources, and applied to other edits of it, each after one exporter or harmless history.
With no source, novelty alone decides, which needs no training. The objects that are pasted
were pasted into other hosts in training, too, and none is cut out of another source. Edits are
quick ones, of parts of the real hosts and of made ones of another seed. Novelty has the weight of
the classifier of the package, which was chosen on all sources.
"""

import dataclasses
import itertools
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path

import charts
import numpy as np
from bank import BANK, FIRST_SEED, MADE_HOSTS, PROGRAM_SEEDS, hosts, source_of
from classifier_examples import Examples, draw_case, make_examples
from runner import Args, measured, start
from tables import Row, pivot, where, write_section
from tqdm import tqdm
from train_classifier import train_network

from gsc_jax.benchmark.metrics import auc
from gsc_jax.benchmark.tamper import EDITS, Edit
from gsc_jax.forensics.classifier import (
    Layers,
    default_classifier,
    smoothed_log_odds,
    smoothed_novelty,
)
from gsc_jax.forensics.features import compute_features, with_finite_scales

TRAINED = range(FIRST_SEED + PROGRAM_SEEDS, FIRST_SEED + PROGRAM_SEEDS + 8)
"""Seeds of the cases that networks are trained on."""
HELDOUT = FIRST_SEED + PROGRAM_SEEDS + 100
"""First seed of the cases that are scored."""
Networks = Mapping[frozenset[str], Layers]


@dataclasses.dataclass(frozen=True, kw_only=True)
class SourcesArgs(Args):
    """Arguments of the experiment.

    Attributes:
        bank: The captures; without them only scenes of cases.py are edited.
        keep: Folder of the features, for a second run; that of train_classifier.py has the same.
    """

    bank: Path = BANK
    keep: Path = Path(".cues")


def subsets(sources: Sequence[str]) -> Iterator[frozenset[str]]:
    """All subsets of the sources, except the empty one and the whole."""
    for count in range(1, len(sources)):
        yield from map(frozenset, itertools.combinations(sources, count))


def train_networks(
    cases: Sequence[Examples], sources: Sequence[str]
) -> dict[frozenset[str], Layers]:
    """Train a network on each set of sources."""
    networks = {}
    for seed, some in enumerate(tqdm(list(subsets(sources)), desc="networks", disable=None)):
        own = [case for case in cases if case.sources & {*sources} <= some]
        networks[some] = train_network(own, seed=seed)
    return networks


def rows_of(
    host: str, edit: Edit, seed: int, networks: Networks, args: SourcesArgs
) -> Iterator[Row]:
    """Measure one case by every network that never saw its sources."""
    case, learned = draw_case(host, edit, seed, args.bank, args.data), frozenset().union(*networks)
    # All numbers of sources on the same cases: none of a donor that some of the networks saw.
    if case is None or case.sources & learned != {source_of(host)}:
        return
    features = compute_features(with_finite_scales(case.gaussians))
    classifier = default_classifier()
    means = np.asarray(case.gaussians.means, np.float32)
    novelty = classifier.novelty * smoothed_novelty(features, means)
    key = {"host": host, "method": edit, "seed": seed}
    yield key | {"sources": 0, "names": "", "auc": auc(novelty, case.labels)}
    for names, layers in networks.items():
        if not names & case.sources:
            one = dataclasses.replace(classifier, networks=(layers,))
            score = auc(smoothed_log_odds(features, one) + novelty, case.labels)
            yield key | {"sources": len(names), "names": " ".join(sorted(names)), "auc": score}


def main(args: SourcesArgs) -> None:
    """Compute the features, train the networks, measure every case; write table and chart."""
    names, edits, first = tuple(hosts(args.bank, args.data)), EDITS, HELDOUT + args.first_seed
    trained, scored = TRAINED, range(first, first + args.seeds)
    if args.quick:
        names, edits, trained, scored = tuple(MADE_HOSTS), EDITS[1:2], TRAINED[:1], scored[:1]
        args = dataclasses.replace(args, keep=args.out / "cues")

    def per_case() -> Iterator[Iterator[Row]]:
        args.keep.mkdir(parents=True, exist_ok=True)
        jobs = list(itertools.product(names, edits, trained))
        progress = tqdm(jobs, desc="cases", disable=None)
        made = [make_examples(*job, args.bank, args.data, args.keep) for job in progress]
        sources = sorted({source_of(name) for name in names})
        networks = train_networks([case for case in made if case.share > 0], sources)
        jobs = list(itertools.product(names, edits, scored))
        yield from (rows_of(*job, networks, args) for job in tqdm(jobs, disable=None))

    rows = measured(args, "sources", per_case())
    text = pivot(rows, "sources", "method", metric="auc", best=None)
    print(text)
    write_section(args.out / "results.md", "sources", text)
    panels = {host: where(rows, host=host) for host in rows.host.unique()} | {"all hosts": rows}
    labels = "sources learned of", "AUC per Gaussian"
    charts.curves(panels, args.out / "sources.png", x="sources", y="auc", labels=labels)


if __name__ == "__main__":
    start(main, __doc__)
