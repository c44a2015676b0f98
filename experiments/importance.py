"""Permutation importance of the features: the loss of AUC when a group of them is shuffled.

    python experiments/train_classifier.py --keep .cues
    python experiments/importance.py --keep .cues [--out docs]

Every scene is measured with a classifier that never saw it, on the examples that
`train_classifier.py` left. The values of one group are shuffled among the Gaussians of a case. A
group that is correlated with others loses little.
"""

from collections.abc import Iterator
from pathlib import Path

import charts
import numpy as np
import pandas as pd
from bank import FIRST_SEED, source_of
from classifier_examples import Examples, read_examples
from matplotlib import pyplot as plt
from native import NativeArgs, classifier_without
from runner import measured, start
from tables import Row, pivot, write_section

from gsc_jax.benchmark.metrics import auc
from gsc_jax.forensics.classifier import BLOCK, Classifier, raw_log_odds
from gsc_jax.forensics.features import in_group
from gsc_jax.scene import InputError
from gsc_jax.scene.parallel import blocks

NOTHING = "nothing"
SEEDS = range(FIRST_SEED, FIRST_SEED + 6)
"""Seeds of the cases, so that every kind of edit has the same number."""


def rows_of(path: Path, keep: Path) -> Iterator[Row]:
    """Measure the AUC of one case, with every group shuffled in turn."""
    host, edit, seed = path.stem.rsplit("_", 2)
    case, classifier = read_examples(path), classifier_without(source_of(host), keep)
    whole = _auc(case, classifier, NOTHING)
    for group in (NOTHING, *dict.fromkeys(name.split(".")[0] for name in case.names)):
        value = _auc(case, classifier, group)
        key = {"scene": host, "edit": edit, "seed": int(seed), "shuffled": group}
        yield {**key, "auc": value, "loss": whole - value}


def _auc(case: Examples, classifier: Classifier, group: str) -> float:
    values = case.values.astype(np.float32)
    order = np.random.default_rng(0).permutation(len(values))
    columns = in_group(case.names, group)
    values[:, columns] = values[order][:, columns]
    parts = [values[part] for part in blocks(len(values), BLOCK)]
    raw = [raw_log_odds(part, classifier.networks) for part in parts]
    return auc(np.concatenate(raw), case.labels)


def all_rows(args: NativeArgs) -> Iterator[Iterator[Row]]:
    """Measure every case of these seeds."""
    paths = sorted(path for seed in SEEDS for path in args.keep.glob(f"*_*_{seed}.npz"))
    if not paths:
        raise InputError(
            f"{args.keep}: holds no examples; run experiments/train_classifier.py --keep "
            f"{args.keep} first"
        )
    for path in paths:
        if read_examples(path).share > 0:
            yield rows_of(path, args.keep)


def chart(rows: pd.DataFrame, path: Path) -> None:
    """Draw the loss by group and edit."""
    losses = rows[rows.shuffled != NOTHING].pivot_table("loss", "shuffled", "edit", sort=False)
    figure, axis = plt.subplots(figsize=(7, 4), layout="constrained")
    for k, (edit, values) in enumerate(losses.items()):
        places = np.arange(len(losses)) + 0.27 * (k - 1)
        axis.barh(places, values, 0.25, color=charts.COLORS[k], label=edit)
    axis.set_yticks(range(len(losses)), losses.index)
    axis.set(xlabel="loss of AUC per Gaussian when the group is shuffled")
    axis.invert_yaxis()
    axis.legend()
    charts.save(figure, path)


def main(args: NativeArgs) -> None:
    """Measure every group of every case; print and write the table and the chart."""
    rows = measured(args, "importance", all_rows(args))
    title = (
        "**Loss of AUC per Gaussian when a group of features is shuffled**, in scenes that the "
        "classifier never saw"
    )
    text = f"{title}\n\n{pivot(rows, 'shuffled', 'edit', metric='loss', digits=3)}"
    print(text)
    write_section(args.out / "results.md", "importance", text)
    chart(rows, args.out / "importance.png")


if __name__ == "__main__":
    start(main, __doc__)
