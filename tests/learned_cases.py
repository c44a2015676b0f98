"""Examples that a network learns in a moment."""

import numpy as np
from classifier_examples import Examples


def examples(
    host: str,
    seed: int,
    *,
    pasted_from: str | None = None,
    family: str = "quick",
    exporter: str = "float",
) -> Examples:
    """Three numbers of 400 Gaussians, of which the first tells what is tampered."""
    rng = np.random.default_rng(seed)
    labels = rng.random(400) < 0.3
    values = rng.normal(size=(400, 3))
    values[:, 0] += 2 * labels
    return Examples(
        host=host,
        edit=("removal", "modification")[seed % 2],
        sources=frozenset({host.split("-")[0], pasted_from or host.split("-")[0]}),
        family=family,
        exporter=exporter,
        values=values.astype(np.float16),
        labels=labels,
        share=0.1,
        names=("x", "y", "z"),
    )
