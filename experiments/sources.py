"""Does the classifier improve with more captures? Its AUC on sources that it never saw.

    python experiments/captures.py
    python experiments/sources.py [--keep .cues] [--quick] [--out docs]

A source is a scene with its captures. For each, networks are trained on the edits of growing random
sets of hosts of the other sources, and applied to edits of its own hosts, each after one exporter
or harmless history. With no host, novelty and discriminant decide, untrained. The objects that
are pasted were pasted into other hosts in training, too, and none is cut out of another source.
Edits are quick ones, of parts of the real hosts and of made ones of another seed. Novelty has the
weight of the classifier of the package, which was chosen on all sources.
"""

import dataclasses
import itertools
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path

import charts
import numpy as np
from bank import (
    BANK,
    FIRST_SEED,
    MADE_HOSTS,
    PROGRAM_SEEDS,
    SCENE_SEEDS,
    hosts,
    source_of,
    training_seeds,
)
from classifier_examples import Examples, draw_case, make_examples
from runner import Args, measured, refuse_unused, start
from single_network import scorer
from tables import Frame, Row, markdown, pivot, where, write_section
from tqdm import tqdm
from train_classifier import train_network

from gsc_jax.benchmark.tamper import EDITS, Edit
from gsc_jax.forensics.classifier import Layers

COUNTS = (1, 2, 4, 8, 16, 28, 36)
"""Numbers of hosts that networks are trained on, as far as there are hosts of other sources."""
ORDERS = 2
"""Random orders of the hosts, from which the sets are the first ones."""
HELDOUT = FIRST_SEED + PROGRAM_SEEDS + 100
"""First seed of the cases that are scored."""
COMPARED = (2, 4, 8)
"""Numbers of hosts at which sets of more and of fewer scenes are compared."""
Networks = Mapping[frozenset[str], Layers]
"""A network by the hosts that it was trained on."""


@dataclasses.dataclass(frozen=True, kw_only=True)
class SourcesArgs(Args):
    """Arguments of the experiment.

    Attributes:
        bank: The captures; without them only scenes of cases.py are edited.
        keep: Folder of the features, for a second run; that of train_classifier.py has the same.
    """

    bank: Path = BANK
    keep: Path = Path(".cues")


def quick_seeds(host: str) -> Sequence[int]:
    """Seeds of the cases of training with quick edits."""
    return [seed for seed in training_seeds(host) if seed >= FIRST_SEED + PROGRAM_SEEDS]


def host_sets(names: Sequence[str], source: str) -> Iterator[frozenset[str]]:
    """Growing random sets of hosts, none of which shows this source."""
    others = [name for name in names if source_of(name) != source]
    for order in range(ORDERS):
        shuffled = np.random.default_rng([order, *source.encode()]).permutation(others).tolist()
        yield from (frozenset(shuffled[:count]) for count in COUNTS if count <= len(others))


def train_networks(
    cases: Sequence[Examples], names: Sequence[str], sources: Sequence[str]
) -> Mapping[str, Networks]:
    """For each source, train networks on sets of hosts of other sources."""
    jobs = dict.fromkeys((source, some) for source in sources for some in host_sets(names, source))
    networks: dict[str, dict[frozenset[str], Layers]] = {source: {} for source in sources}
    for seed, (source, some) in enumerate(tqdm(jobs, desc="networks", disable=None)):
        own = [case for case in cases if case.host in some and source not in case.sources]
        if own:
            networks[source][some] = train_network(own, seed=seed)
    return networks


def rows_of(
    host: str, edit: Edit, seed: int, networks: Mapping[str, Networks], args: SourcesArgs
) -> Iterator[Row]:
    """Measure one case by every network that does not know its source."""
    case, source = draw_case(host, edit, seed, args.bank, args.data), source_of(host)
    # Networks are compared on the same cases, so no object may come from what some of them saw.
    if case is None or case.sources & networks.keys() != {source}:
        return
    score = scorer(case)
    key = {"source": source, "host": host, "method": edit, "seed": seed}
    yield key | {"hosts": 0, "names": "", "auc": score(None)}
    for names, layers in networks[source].items():
        known = {"hosts": len(names), "names": " ".join(sorted(names))}
        yield key | known | {"auc": score(layers)}


def report(rows: Frame) -> str:
    """All tables."""
    scenes = [len({source_of(name) for name in names.split()}) for names in rows.names]
    rows = rows.assign(scenes=scenes)
    return "\n\n".join(
        [
            pivot(rows, "hosts", "method", metric="auc", best=None),
            "**AUC by the number of different scenes among as many hosts** (cases, sets of hosts)",
            by_scenes(rows),
            "**Hosts of more against hosts of fewer scenes**, on the same cases",
            more_against_fewer(rows),
        ]
    )


def by_scenes(rows: Frame) -> str:
    """Tabulate the mean AUC by number of hosts and of different scenes among them."""
    numbers = range(1, int(rows.scenes.max()) + 1)
    lines = []
    for hosts_used in COMPARED:
        groups = [where(rows, hosts=hosts_used, scenes=number) for number in numbers]
        lines.append([hosts_used, *(_mean_with_counts(own) for own in groups)])
    return markdown(["hosts", *(f"{k} scene{'s' * (k > 1)}" for k in numbers)], lines)


def _mean_with_counts(rows: Frame) -> str:
    sets = len(rows[["source", "names"]].drop_duplicates())
    return f"{rows.auc.mean():.3f} ({len(rows)}, {sets})" if len(rows) else "-"


def more_against_fewer(rows: Frame) -> str:
    """Compare the two sets of a source that have as many hosts and not as many scenes."""
    lines = []
    for (hosts_used, source), own in rows.groupby(["hosts", "source"], sort=False):
        scenes = sorted(own.scenes.unique())
        if hosts_used in COMPARED and len(scenes) > 1:
            fewer, more = (where(own, scenes=scenes[k]).auc.mean() for k in (0, -1))
            pair = [f"{scenes[0]}: {fewer:.3f}", f"{scenes[-1]}: {more:.3f}"]
            lines.append([hosts_used, source, *pair, f"{more - fewer:+.3f}"])
    lines.sort(key=lambda line: line[0])
    return markdown(["hosts", "scored on", "fewer scenes", "more scenes", "difference"], lines)


def main(args: SourcesArgs) -> None:
    """Compute the features, train the networks, measure every case; write table and chart."""
    refuse_unused(args, "scenes", "edits")
    names, edits, first = tuple(hosts(args.bank, args.data)), EDITS, HELDOUT + args.first_seed
    scored, count = range(first, first + args.seeds), SCENE_SEEDS
    if args.quick:
        names, edits, scored, count = tuple(MADE_HOSTS), EDITS[1:2], scored[:1], 1
        args = dataclasses.replace(args, keep=args.out / "cues")

    def per_case() -> Iterator[Iterator[Row]]:
        args.keep.mkdir(parents=True, exist_ok=True)
        jobs: list[tuple[str, Edit, int]] = [
            (name, edit, seed)
            for name, edit in itertools.product(names, edits)
            for seed in quick_seeds(name)[:count]
        ]
        progress = tqdm(jobs, desc="cases", disable=None)
        made = [make_examples(*job, args.bank, args.data, args.keep) for job in progress]
        sources = sorted({source_of(name) for name in names})
        networks = train_networks([case for case in made if case.share > 0], names, sources)
        jobs = list(itertools.product(names, edits, scored))
        yield from (rows_of(*job, networks, args) for job in tqdm(jobs, disable=None))

    rows = measured(args, "sources", per_case())
    text = report(rows)
    print(text)
    write_section(args.out / "results.md", "sources", text)
    panels = {name: where(rows, source=name) for name in rows.source.unique()}
    labels = "hosts learned of", "AUC per Gaussian"
    panels["all sources"] = rows
    charts.curves(panels, args.out / "sources.png", x="hosts", y="auc", labels=labels)


if __name__ == "__main__":
    start(main, __doc__)
