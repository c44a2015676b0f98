"""How well `gsc_jax/evidence/mask_checks.py` tells masks of detectors from masks without evidence.

    python experiments/mask_checks.py [--quick] [--out docs]

One edit of each kind in each scene. The masks are the truth, simulated detectors, thresholds on the
image, false blobs alone, and the true masks of other views. `gsc_jax/evidence/mask_checks.py` has
the bounds.
"""

import dataclasses
from collections.abc import Iterator

import numpy as np
from cases import Case, calibrated_mixture, detector_masks
from observations import observe_regimes
from runner import FewArgs, measured, start
from tables import Frame, Row, markdown, where, write_section

from gsc_jax.benchmark.simulate import REGIMES, Failures
from gsc_jax.evidence.mask_checks import (
    MIN_ACCURACY,
    MIN_CORRELATION,
    agreement,
    best_property,
    doubts,
)
from gsc_jax.splat import render

THRESHOLDS = {
    "red > 0.6": lambda image: image[..., 0] > 0.6,
    "brightness < 0.25": lambda image: image.mean(axis=-1) < 0.25,
}
ONLY_BLOBS = Failures(misses=1.0, blobs=2.0)
SHIFT = 5
"""Views by which true masks are shifted to be those of other views."""


def masks_of(case: Case, images: list[np.ndarray]) -> dict[str, np.ndarray]:
    """Masks (V, H, W) by their origin."""
    simulated = {
        "true masks": REGIMES["clean"],
        "misses": REGIMES["misses"],
        "mixture": calibrated_mixture(case),
        "false blobs alone": ONLY_BLOBS,
    }
    masks = detector_masks(case, simulated)
    masks |= {name: np.stack([*map(rule, images)]) for name, rule in THRESHOLDS.items()}
    return masks | {"of other views": np.roll(masks["true masks"], SHIFT, axis=0)}


def rows_of(case: Case) -> Iterator[Row]:
    """Both measures of all masks of a case, and the number of reasons why they are no evidence."""
    images = [np.asarray(render(case.gaussians, camera)[0]) for camera in case.scene.cameras]
    for name, observed in observe_regimes(case, masks_of(case, images)).items():
        observation = observed.observation
        measures = {
            "accuracy": round(best_property(observation)[1], 4),
            "agreement": agreement(observation.evidence),
            "reasons": len(doubts(observation)),
        }
        yield {**case.key, "masks": name, **measures}


def report(rows: Frame) -> str:
    """Range of both measures by the origin of the masks, and how many are called no evidence."""
    lines = []
    for name in rows["masks"].unique():
        own = where(rows, masks=name)
        cells = [f"{v.min():.2f} to {v.max():.2f}" for v in (own.accuracy, own.agreement)]
        lines.append([name, *cells, f"{(own.reasons > 0).sum()} of {len(own)}"])
    heads = ["masks", "accuracy of the best property", "agreement of views", "no evidence"]
    return (
        "**Masks that are called no evidence**: a property separates what they flag with a "
        f"balanced accuracy of {MIN_ACCURACY}, the correlation of a view with the others is below "
        f"{MIN_CORRELATION}, or all flag the same pixels\n\n{markdown(heads, lines)}"
    )


@dataclasses.dataclass(frozen=True, kw_only=True)
class CheckArgs(FewArgs):
    """Arguments of this experiment, with seeds on which the bounds were not chosen."""

    first_seed: int = 1


def main(args: CheckArgs) -> None:
    """Measure every case; print and write the table."""
    cases = args.one_edit_each() if args.quick else args.cases()
    text = report(measured(args, "mask_checks", (list(rows_of(case)) for case in cases)))
    print(text)
    write_section(args.out / "results.md", "mask_checks", text)


if __name__ == "__main__":
    start(main, __doc__)
