"""Until what strength of each failure a method holds, and what it does where nothing can be said.

    python experiments/stability.py [--quick] [--out docs]

One edit of each scene. Each failure of the detector grows alone, up to an extreme; the views that
are missed, inverted or flagged wrongly at one strength are so at all greater ones (blobs are drawn
anew). SA3D's gate is left out, since it renders twice per view and strength, and what is `robust`
once more. The degenerate cases are of the made room.
"""

import dataclasses
from collections.abc import Iterator, Mapping, Sequence

import charts
import jax
import jax.numpy as jnp
import numpy as np
from cases import Case, detector_masks, reduced
from looks import look
from methods import ALL_METHODS
from runner import REFERENCE, FewArgs, judge, measured, start
from tables import Row, markdown, mean, values_of, where, write_section

from gsc_jax.benchmark.metrics import truth_mask
from gsc_jax.benchmark.simulate import REGIMES, Failures
from gsc_jax.estimators.gschecker import find
from gsc_jax.estimators.robust.estimator import RobustConfig
from gsc_jax.scene import Array, Gaussians

LEFT_OUT = "SA3D, gate", "robust, rendered"
COMPARED = {name: method for name, method in ALL_METHODS.items() if name not in LEFT_OUT}
STRENGTHS = (0.0, 0.25, 0.5, 1.0, 1.5, 2.0)
FAILURES: Mapping[str, tuple[Failures, float, str]] = {
    "boundary": (Failures(boundary=16.0), 16.0, "px"),
    "misses": (Failures(misses=0.5), 50, "% of the views"),
    "blobs": (Failures(blobs=6.0), 6.0, "blobs per view"),
    "consistent": (Failures(decoy=0.5), 50, "% of the views"),
    "inverted": (Failures(inverted=0.35), 35, "% of the views"),
    "mixture": (REGIMES["mixture"].scaled(2.0), 2.0, "x the mixture"),
}
"""Each failure at strength 1, what number that is, and of what."""
RELEASED = {
    "no view says tampered": "NaN in comparisons; right by luck",
    "every view says everything": "r becomes NaN",
    "a single view": "groups may be empty: NaN in r, an empty model",
    "one view inverted": "believed",
    "object in one view only": "each view divided by its own maximum: noise becomes 1",
    "NaN and Inf rows, infinite opacity": "illegal access or NaN",
    "all Gaussians alike but for their place": "-",
    "half of the object unseen": "votes although nothing of it is seen",
}
"""The degenerate cases, and what the released code does."""


def rows_of(case: Case, strengths: Sequence[float]) -> Iterator[Row]:
    """Every failure, strength and method on one edit; a look per failure bounds the memory."""
    for failure, (base, unit, _) in FAILURES.items():
        masks = {
            f"{unit * s:g}": detector_masks(case, {failure: base.scaled(s)})[failure]
            for s in strengths
        }
        for row in judge(look(case, masks), COMPARED):
            if row["method"] not in REFERENCE:
                yield {**row, "regime": failure, "strength": float(row["regime"])}


def breaks_at(rows: Sequence[Row], unit: str) -> str:
    """Where F1 falls below half of what it is without failures, between two strengths."""
    strengths = sorted(values_of(rows, "strength"))
    f1 = [mean(where(rows, strength=s)) for s in strengths]
    k = next((k for k, value in enumerate(f1) if value < f1[0] / 2), None)
    if k is None:
        return "holds"
    part = (f1[k - 1] - f1[0] / 2) / (f1[k - 1] - f1[k])
    return f"{strengths[k - 1] + part * (strengths[k] - strengths[k - 1]):.2g} {unit}"


def degenerate(case: Case) -> Iterator[tuple[Case, np.ndarray]]:
    """The cases of `RELEASED`, in its order, each with its masks."""
    cameras, scene, truth = case.scene.cameras, case.gaussians, case.truth
    yield case, np.zeros_like(truth)
    yield case, np.ones_like(truth)
    single, said = reduced(case, {"": truth}, 1)
    yield single, said[""]
    yield case, np.concatenate([~truth[:1], truth[1:]])
    about = np.diag([-1.0, 1.0, -1.0, 1.0]).astype(np.float32)
    away = [dataclasses.replace(c, viewmat=about @ np.asarray(c.viewmat)) for c in cameras[1:]]
    turned = dataclasses.replace(case.scene, cameras=[cameras[0], *away])
    seen = [truth_mask(scene, camera, case.labels) for camera in turned.cameras]
    yield dataclasses.replace(case, scene=turned), np.stack(seen)
    for broken in damaged(case):
        yield dataclasses.replace(case, gaussians=broken), truth


def damaged(case: Case) -> Iterator[Gaussians]:
    """Scenes with rows that cannot be rendered, with nothing to compare, with unseen Gaussians."""
    scene, rows = case.gaussians, np.arange(len(case.gaussians)) % 100
    means = np.where(rows[:, None] == 0, np.nan, scene.means)
    scales = np.where(rows[:, None] == 1, np.inf, scene.log_scales)
    logits = np.select([rows == 2, rows == 3], [np.inf, -np.inf], scene.logit_opacities)
    parts = {"means": means, "log_scales": scales, "logit_opacities": logits}
    yield _with(scene, **parts)
    same = jax.tree.map(lambda leaf: np.broadcast_to(leaf[:1], leaf.shape), scene)
    yield _with(same, means=scene.means)
    unseen = case.labels & (np.cumsum(case.labels) % 2 == 0)
    yield _with(scene, logit_opacities=np.where(unseen, -np.inf, scene.logit_opacities))


def _with(scene: Gaussians, **parts: Array) -> Gaussians:
    changed = dataclasses.replace(scene, **parts)
    return jax.tree.map(lambda leaf: jnp.asarray(leaf, jnp.float32), changed)


def degenerate_table(case: Case) -> str:
    """What every method labels, and whether it is finite."""
    lines = []
    for (name, reference), (one, masks) in zip(RELEASED.items(), degenerate(case), strict=True):
        looked = look(one, {name: masks})[name]
        cells = []
        for method in COMPARED.values():
            answer = method(looked)
            lost = ~(np.isfinite(answer.score) & np.isfinite(answer.rendered))
            cells.append(
                f"{answer.labels.mean():.1%}" + (f", NaN {lost.mean():.1%}" if lost.any() else "")
            )
        found = find(one.gaussians, one.scene.cameras, looked.observation, RobustConfig())
        lines.append([name, *cells, " ".join(found.warnings) or "-", reference])
    return markdown(["case", *COMPARED, "robust says", "the released code"], lines)


def breaking_table(rows: Sequence[Row]) -> str:
    """The strength at which each method breaks."""
    lines = []
    for name in COMPARED:
        own = where(rows, method=name)
        cells = [breaks_at(where(own, regime=f), unit) for f, (_, _, unit) in FAILURES.items()]
        lines.append([name, f"{mean(where(own, strength=0.0)):.2f}", *cells])
    return markdown(["method", "F1 without failures", *FAILURES], lines)


def main(args: FewArgs) -> None:
    """Strain every case; print and write the tables and the chart."""
    strengths = STRENGTHS[::2] if args.quick else STRENGTHS
    cases = args.one_edit_each()
    rows = measured(args, "stability", (rows_of(case, strengths) for case in cases))
    room = next(dataclasses.replace(args, scenes=("room",)).cases(("modification",)))
    text = (
        "**Strength at which F1 falls below half of what it is without failures**\n\n"
        f"{breaking_table(rows)}\n\nThe decoy (consistent) is no larger than the object: who takes "
        "both keeps an F1 of about 2/3, and so holds.\n\n**Degenerate cases: share of Gaussians "
        f"labelled, with {room.labels.mean():.1%} tampered. Scores are finite but where a cell "
        f"says of what share they are not**\n\n{degenerate_table(room)}"
    )
    print(text)
    write_section(args.out / "results.md", "stability", text)
    panels = {f"{f}, {unit}": where(rows, regime=f) for f, (_, _, unit) in FAILURES.items()}
    charts.curves(panels, args.out / "stability.png", x="strength", labels=("strength", "F1"))


if __name__ == "__main__":
    start(main, __doc__)
