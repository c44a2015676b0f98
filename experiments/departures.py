"""GS-Checker as released, with one thing changed at a time: what each departure is worth.

    python experiments/departures.py [--quick] [--out docs]

The released code rounds projected centres to pixels, also counts the votes of Gaussians that no
view sees, and makes the mask of a view from the survivors alone, divided by the maximum of the
view. The rows change one of these, or one of its definitions to that of the paper.
"""

import dataclasses
import functools
from collections.abc import Iterator, Mapping

import numpy as np
import pandas as pd
from cases import Case, calibrated_mixture, detector_masks
from methods import without_3d
from observations import CaseObservation, Prediction, observe_regimes
from runner import FewArgs, measured, scores, start
from tables import Frame, Row, markdown, write_section

from gsc_jax.benchmark.simulate import REGIMES
from gsc_jax.estimators.gschecker import OFFICIAL, PAPER, GSChecker
from gsc_jax.estimators.protocol import Finding
from gsc_jax.evidence.masks import Labelled, MaskRule, normalise, view_mask
from gsc_jax.evidence.observation import Observation
from gsc_jax.render.projection import project_centers
from gsc_jax.vote import Tally, cast_votes, no_votes, official_consensus, tally

RELEASED, HERE = "as released", "`official`: centres and unseen Gaussians as here"


class Unseen(GSChecker):
    """GS-Checker whose Gaussians that no view sees keep their votes, as in the released code."""

    def initial_attribute(self, observation: Observation) -> np.ndarray:
        """The votes of all Gaussians."""
        return np.asarray(official_consensus(observation.votes))

    def _decide(self, attribute: np.ndarray, group_sizes: np.ndarray, seen: np.ndarray) -> Finding:
        del group_sizes, seen
        tamper = np.asarray(normalise(attribute), np.float32)
        labels = tamper > self.threshold
        return Finding(tamper=tamper, labels=labels, attribute=attribute, warnings=[])


@dataclasses.dataclass(frozen=True)
class Variant:
    """An estimator, how centres become pixels, and how labels become a mask."""

    estimator: GSChecker
    rounded: bool = True
    rule: MaskRule = "per-view"


def _unseen(estimator: GSChecker) -> Unseen:
    fields = dataclasses.fields(estimator)
    return Unseen(**{field.name: getattr(estimator, field.name) for field in fields})


BASE = _unseen(OFFICIAL)
VARIANTS: Mapping[str, Variant] = {
    RELEASED: Variant(BASE),
    "centres are cut to pixels, as here": Variant(BASE, rounded=False),
    "unseen Gaussians start at 0, as here": Variant(OFFICIAL),
    "masks: the rendered attribute, all Gaussians occlude": Variant(BASE, rule="attribute"),
    "masks: more than half of the weight of a pixel": Variant(BASE, rule="share"),
    "views in random order": Variant(dataclasses.replace(BASE, shuffle=True)),
    "five epochs": Variant(dataclasses.replace(BASE, epochs=5)),
    "no 3D loss": Variant(_unseen(without_3d(OFFICIAL))),
    HERE: Variant(OFFICIAL, rounded=False),
    "`paper`: the printed equations": Variant(PAPER, rounded=False, rule="attribute"),
}


def votes(case: Case, masks: np.ndarray, *, rounded: bool) -> Tally:
    """Votes of all views, with centres rounded to the nearest integer, or cut to their pixel."""
    counts = no_votes(len(case.gaussians))
    for camera, mask in zip(case.scene.cameras, masks, strict=True):
        centers, depths = project_centers(case.gaussians.means, camera.viewmat, camera.K)
        counts += tally(cast_votes(centers + 0.5 * rounded, depths, mask)[None])
    return counts


def measure(observed: CaseObservation, variant: Variant) -> dict[str, float]:
    """Scores of a variant on the held-out views of a case."""
    case = observed.case
    masks = np.stack(list(observed.observation.masks.values()))
    own = dataclasses.replace(
        observed.observation, votes=votes(case, masks, rounded=variant.rounded)
    )
    finding = dataclasses.replace(variant.estimator, seed=case.seed).estimate(own)
    labels = Labelled(finding.tamper, finding.labels)
    mask_of = functools.partial(view_mask, case.gaussians, scored=labels, rule=variant.rule)
    found = np.stack([mask_of(camera) for camera in case.scene.heldout])
    return scores(case, Prediction(score=finding.attribute, labels=finding.labels), found)


def rows_of(case: Case) -> Iterator[Row]:
    """Scores of every variant under three of the failures."""
    regimes = {name: REGIMES[name] for name in ("clean", "blobs")}
    regimes["mixture"] = calibrated_mixture(case)
    for regime, observed in observe_regimes(case, detector_masks(case, regimes)).items():
        for name, variant in VARIANTS.items():
            yield {**case.key, "regime": regime, "variant": name, **measure(observed, variant)}


def table(rows: Frame) -> str:
    """F1 of each variant by failure, and its mean difference to the released code."""
    names, regimes = list(VARIANTS), list(dict.fromkeys(rows.regime))
    pivot = rows.pivot_table(index="variant", columns="regime", values="f1").loc[names, regimes]
    cases = rows.pivot_table(index=["scene", "edit", "seed", "regime"], columns="variant")["f1"]
    gain = cases.sub(cases[RELEASED], axis=0)
    lines = []
    for name in names:
        cells = [f"{value:.2f}" for value in (*pivot.loc[name], pivot.loc[name].mean())]
        worth = "" if name == RELEASED else f"{gain[name].mean():+.3f}"
        span = "" if name == RELEASED else f"{gain[name].min():+.2f} to {gain[name].max():+.2f}"
        lines.append([name, *cells, worth, span])
    return markdown(["GS-Checker", *regimes, "mean", "difference", "by case"], lines)


def main(args: FewArgs) -> None:
    """Measure every case; print and write the table."""
    cases = args.one_edit_each() if args.quick else args.cases()
    rows = measured(args, "departures", (list(rows_of(case)) for case in cases))
    count = len(pd.DataFrame(rows)[["scene", "edit", "seed"]].drop_duplicates())
    text = f"**Mean F1 per held-out view of {count} cases, by failure**\n\n{table(rows)}"
    print(text)
    write_section(args.out / "results.md", "departures", text)


if __name__ == "__main__":
    start(main, __doc__)
