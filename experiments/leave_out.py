"""AUC of classifiers trained without the donor, editor, exporter or trainer of an edited scene.

    python experiments/captures.py
    python experiments/train_classifier.py --keep .cues
    python experiments/leave_out.py --keep .cues [--out docs]

For each case of two hosts of every source, a network is trained on the training cases that do not
show the source of its host. With "donor", none of them shows the source of the pasted object
either; with "editor", none is of the family of the case (quick edits, programs of editors, or
laundered ones whatever the editor); with "exporter", none was exported in the same way; with
"trainer", none has a host that was trained by the same strategy; with "all", none shares any of
these. One network scores, not an ensemble, with novelty, whose weight is that of the package, and
discriminant.
"""

import dataclasses
import itertools
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path

from bank import (
    BANK,
    FIRST_SEED,
    MADE_HOSTS,
    PROGRAM_SEEDS,
    BankCase,
    hosts,
    source_of,
    training_seeds,
)
from classifier_examples import Examples, make_examples, stored_case
from runner import measured, refuse_unused, start
from single_network import scorer
from tables import Frame, Row, markdown, where, write_section
from tqdm import tqdm
from train_classifier import train_network
from without_masks import KeepArgs

from gsc_jax.benchmark.tamper import EDITS, Edit
from gsc_jax.forensics.classifier import Layers

SCORED = FIRST_SEED + 1
"""Seed of the cases that are scored: whole hosts, also edited by programs."""
QUICK_SEEDS = FIRST_SEED + PROGRAM_SEEDS, FIRST_SEED + PROGRAM_SEEDS + 1
"""Seeds of a quick run, to train and to score: quick edits."""
HOSTS = 2
"""Hosts of each source whose cases are scored."""
LEAST = 8
"""Cases that a network is trained on at least."""

Shares = Callable[[Examples, str, BankCase], bool]
"""Whether a training case shares something with a case, whose host is given by its name."""


@dataclasses.dataclass(frozen=True, kw_only=True)
class LeaveOutArgs(KeepArgs):
    """Arguments of the experiment.

    Attributes:
        bank: The captures; without them only scenes of cases.py are edited.
    """

    bank: Path = BANK


def trainer_of(host: str) -> str:
    """Strategy of the training of a capture; other scenes were not trained here."""
    return host.rsplit("-", 1)[1] if "-" in host else ""


def same_host(one: Examples, host: str, _: BankCase) -> bool:
    """Whether a training case shows the source of the host."""
    return source_of(host) in one.sources


def same_donor(one: Examples, host: str, case: BankCase) -> bool:
    """Whether a training case shows the source of the pasted object."""
    return bool(one.sources & (case.sources - {source_of(host)}))


SHARED: Mapping[str, Shares] = {
    "donor": same_donor,
    "editor": lambda one, _, case: one.family == case.family,
    "exporter": lambda one, _, case: one.exporter == case.exporter,
    "trainer": lambda one, host, _: trainer_of(one.host) == trainer_of(host),
}
"""What may be left out besides the source of the host."""
LEFT_OUT: Mapping[str, tuple[str, ...]] = {
    "host": (),
    **{f"host and {name}": (name,) for name in SHARED},
    "all": tuple(SHARED),
}


def learned_of(
    cases: Sequence[Examples], host: str, case: BankCase, left_out: Sequence[str]
) -> list[int]:
    """Numbers of the training cases that share neither the host nor any of these with a case."""
    tests = [same_host, *(SHARED[name] for name in left_out)]
    return [k for k, one in enumerate(cases) if not any(test(one, host, case) for test in tests)]


class Trained:
    """Networks by the numbers of the cases that they were trained on, each trained once."""

    def __init__(self, cases: Sequence[Examples]) -> None:
        """`cases` are all that may be learned of."""
        self.cases = cases
        self._networks: dict[tuple[int, ...], Layers] = {}

    def network(self, learned: Sequence[int]) -> Layers:
        """The network of these cases."""
        key = tuple(learned)
        if key not in self._networks:
            own = [self.cases[k] for k in key]
            self._networks[key] = train_network(own, seed=len(self._networks))
        return self._networks[key]


def rows_of(host: str, case: BankCase, trained: Trained, least: int) -> Iterator[Row]:
    """AUC of one case with each choice of what is left out; none where hardly any case is left."""
    score = scorer(case)
    key = {"host": host, "edit": case.edit, "family": case.family, "export": case.exporter}
    for name, left_out in LEFT_OUT.items():
        learned = learned_of(trained.cases, host, case, left_out)
        if len(learned) >= least:
            found = {"cases": len(learned), "auc": score(trained.network(learned))}
            yield key | {"left_out": name} | found
    yield key | {"left_out": "no network", "cases": 0, "auc": score(None)}


def report(rows: Frame) -> str:
    """AUC by what is left out, of the cases that have all of the rows, and paired differences."""
    counts = rows.groupby(["host", "edit"]).left_out.transform("size")
    rows = rows[counts == counts.max()]
    by_case, lines = rows.pivot_table("auc", ["host", "edit"], "left_out"), []
    for name in rows.left_out.unique():
        own = where(rows, left_out=name)
        scores = [f"{where(own, edit=edit).auc.mean():.3f}" for edit in EDITS]
        change = by_case[name] - by_case["host"]
        scores += [f"{own.auc.mean():.3f}", f"{change.mean():+.3f} ± {change.sem():.3f}"]
        lines.append([name, f"{own.cases.mean():.0f}", *scores])
    scored = where(rows, left_out="host")
    counted = ", ".join(f"{int((scored.edit == edit).sum())} of {edit}" for edit in EDITS)
    table = markdown(["left out", "learned of", *EDITS, "all", "difference"], lines)
    return (
        f"**AUC per Gaussian by what is left out of the training**, cases: {counted}; difference "
        f"to the first row, case by case, ± its standard error\n\n{table}"
    )


def chosen(args: LeaveOutArgs) -> tuple[list[str], Sequence[Edit], Path]:
    """Hosts, kinds of edits and folder; a quick run has made hosts, one kind, its own folder."""
    if args.quick:
        return list(MADE_HOSTS), EDITS[1:2], args.out / "cues"
    return hosts(args.bank, args.data), EDITS, args.keep


def examples_of(args: LeaveOutArgs) -> list[Examples]:
    """All training cases, those of a host together."""
    names, edits, keep = chosen(args)
    keep.mkdir(parents=True, exist_ok=True)
    made = [
        make_examples(host, edit, seed, args.bank, args.data, keep)
        for host, edit in tqdm(list(itertools.product(names, edits)), desc="examples", disable=None)
        for seed in (QUICK_SEEDS[:1] if args.quick else training_seeds(host))
    ]
    return [one for one in made if one.share > 0]


def scored_cases(args: LeaveOutArgs) -> Iterator[tuple[str, BankCase]]:
    """Whole cases with their hosts, `HOSTS` of each source, those of a source together."""
    names, edits, keep = chosen(args)
    sources = itertools.groupby(sorted(names, key=source_of), key=source_of)
    scored = [name for _, own in sources for name in itertools.islice(own, HOSTS)]
    seed = QUICK_SEEDS[1] if args.quick else SCORED
    jobs = list(itertools.product(scored[:1] if args.quick else scored, edits))
    for host, edit in tqdm(jobs, desc="cases", disable=None):
        if case := stored_case(host, edit, seed, args.bank, args.data, keep):
            yield host, case


def all_rows(args: LeaveOutArgs) -> Iterator[Iterator[Row]]:
    """Train and measure case by case."""
    trained = Trained(examples_of(args))
    for host, case in scored_cases(args):
        yield rows_of(host, case, trained, 1 if args.quick else LEAST)


def main(args: LeaveOutArgs) -> None:
    """Measure every case; print and write the table."""
    refuse_unused(args, "scenes", "edits", "seeds", "first_seed")
    rows = measured(args, "leave_out", all_rows(args))
    text = report(rows)
    print(text)
    write_section(args.out / "results.md", "leave_out", text)


if __name__ == "__main__":
    start(main, __doc__)
