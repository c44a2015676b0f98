"""The scene probability from masks, and from masks and attributes together.

    python experiments/beside_masks.py [--quick] [--out docs]

From masks alone, an edit that is missed in 40 % of the views looks like an authentic region that is
flagged in 60 % of them. On scenes and objects that the classifier of the package never saw, changed
regions and removals are compared with the same scenes before the edit, where the detector flags the
region of the edit. The attributes are those after an export. A wrong prior is certain of another
region.
"""

from collections.abc import Iterator

import numpy as np
from authentic import FAILURES
from cases import Case, detector_masks, failures_without, without_edit
from fusion import EXPORTER, FusionArgs, attributes, wrong_prior
from methods import seeded
from observations import observe_regimes
from runner import CASE_KEYS, measured, start
from scipy.spatial import KDTree
from tables import Frame, Row, markdown, separation, where, write_section

from gsc_jax.benchmark.metrics import confusion
from gsc_jax.benchmark.simulate import REGIMES, Failures
from gsc_jax.estimators import METHODS, Prior
from gsc_jax.estimators.protocol import Outcome, outcome

OUTCOMES: tuple[Outcome, ...] = ("evidence", "inconclusive", "none")
PRIORS = ("none", "attributes", "wrong")
RIVALS = "misses and consistent"
STRENGTHS = {**REGIMES, RIVALS: Failures(misses=0.4, decoy=0.6)}
"""In the last one, an edit and an authentic region are flagged in as many views."""
PAIR = {"edited": "misses", "authentic": "consistent"}
"""Failures that the masks alone cannot tell from each other."""


def rows_of(case: Case) -> Iterator[Row]:
    """Measure the scene probability of a case and of the scene without its edit."""
    pristine, failures = without_edit(case), failures_without(case.edit, FAILURES)
    for own, regimes in ((case, STRENGTHS), (pristine, failures)):
        key = {**case.key, "kind": "authentic" if own is pristine else "edited"}
        priors = {"none": None, "attributes": attributes(own), **wrong_priors(case, own)}
        for regime, one in observe_regimes(own, detector_masks(own, regimes)).items():
            for name, prior in priors.items():
                finding = seeded(METHODS["robust"], case.seed).estimate(one.observation, prior)
                f1 = confusion(finding.labels, own.labels).f1
                found = {"verdict": finding.verdict, "rank": finding.rank, "f1": f1}
                yield {**key, "regime": regime, "prior": name, **found}


def wrong_priors(case: Case, own: Case) -> dict[str, Prior]:
    """A prior that marks another region than the edit, for the edited or the authentic scene `own`.

    Empty if the edit is so large that no other region is far enough away.
    """
    try:
        wrong = wrong_prior(case)
    except ValueError:
        return {}
    places = KDTree(np.asarray(case.gaussians.means))
    probability = wrong.probability[places.query(np.asarray(own.gaussians.means))[1]]
    known = np.ones(len(probability), bool)
    return {"wrong": Prior(probability=probability, verdict=wrong.verdict, known=known)}


def separations(rows: Frame) -> tuple[int, str]:
    """Number of edits that have every prior, and AUC of the scene probability with each prior."""
    rows = rows[rows.edit != "incorporation"]  # which have no counterpart
    keys = CASE_KEYS[:-1]
    rows = rows[rows.groupby(keys).prior.transform("nunique") == len(PRIORS)]
    lines = []
    for name in PRIORS:
        own = where(rows, prior=name)
        alike = own[own.regime.isin(FAILURES)]
        kinds = (where(alike, kind=kind) for kind in PAIR)
        pair = (where(own, kind=kind, regime=regime) for kind, regime in PAIR.items())
        lines.append([name, f"{separation(*kinds):.3f}", f"{separation(*pair):.3f}"])
    heads = ["prior", ", ".join(FAILURES), "edit missed, or authentic region flagged"]
    return len(rows[keys].drop_duplicates()), markdown(heads, lines)


def report(rows: Frame) -> str:
    """AUC by prior, and the outcomes by kind of scene, failure and prior."""
    counts = []
    for (kind, regime, name), own in rows.groupby(["kind", "regime", "prior"], sort=False):
        found = own.verdict.map(outcome)
        numbers = [str((found == one).sum()) for one in OUTCOMES]
        counts.append([kind, regime, name, *numbers, f"{own.verdict.median():.2f}"])
    edited = where(rows, kind="edited")
    f1 = edited.pivot_table("f1", index=CASE_KEYS, columns="prior")
    labels = []
    for regime in STRENGTHS:
        own = f1.xs(regime, level="regime")[[*PRIORS]]
        worst = own.sub(own["none"], axis=0).min()
        labels.append([regime, *(f"{own[n].mean():.3f} ({worst[n]:+.3f})" for n in PRIORS)])
    ranks = [
        [*name, *(f"{value:.3f}" for value in own["rank"].quantile([0.25, 0.5, 0.75]))]
        for name, own in where(rows, prior="attributes").groupby(["kind", "regime"], sort=False)
        if own["rank"].notna().any()
    ]
    scenes = len(rows.drop_duplicates(["scene", "edit", "seed"]))
    compared, by_prior = separations(rows)
    return "\n\n".join(
        [
            f"**AUC of the scene probability** for {compared} changed regions and removals in "
            "unseen scenes, all that have each prior, against these scenes before the edit, with "
            f"the same failures; attributes after an export ({EXPORTER})",
            by_prior,
            f"**F1 per Gaussian over {scenes} edits**, and its worst change by a prior",
            markdown(["failure", *PRIORS], labels),
            "**Outcomes**: how many scenes",
            markdown(["scene", "failure", "prior", *OUTCOMES, "median probability"], counts),
            "**Rank of what is labelled**, by the attributes: quartiles",
            markdown(["scene", "failure", "lower", "median", "upper"], ranks),
        ]
    )


def main(args: FusionArgs) -> None:
    """Measure every case; print and write the tables."""
    rows = measured(args, "beside_masks", (rows_of(case) for case in args.cases()))
    text = report(rows)
    print(text)
    write_section(args.out / "results.md", "beside_masks", text)


if __name__ == "__main__":
    start(main, __doc__)
