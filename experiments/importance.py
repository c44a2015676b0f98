"""Which cues the network lives on: what it loses when a group of them is shuffled.

    python experiments/train_cues.py --keep .cues
    python experiments/importance.py --keep .cues [--out docs]

Every scene is judged by the model that never saw it, on the rows that `train_cues.py` described.
The values of one group of cues are shuffled among the rows of a case, and the area under the curve
is measured again; a group that others stand in for loses little.
"""

from collections.abc import Iterator
from pathlib import Path

import charts
import numpy as np
from matplotlib import pyplot as plt
from native import NativeArgs, model_without
from runner import measured, start
from tables import Row, pivot, values_of, where, write_section
from train_cues import FIRST_SEED, Examples, read_examples

from gsc_jax.benchmark.metrics import auc
from gsc_jax.forensics.classifier import Model, raw_odds
from gsc_jax.forensics.features import select
from gsc_jax.scene import InputError

NOTHING = "nothing"
SEEDS = range(FIRST_SEED, FIRST_SEED + 6)
"""Of the cases that were described: as many of each kind of edit."""


def rows_of(path: Path, keep: Path) -> Iterator[Row]:
    """AUC of one case, with every group shuffled in turn."""
    scene, edit, seed = path.stem.split("-")
    case, model = read_examples(path), model_without(scene, keep)
    groups = dict.fromkeys(name.split(".")[0] for name in case.names)
    whole = _auc(case, model, None)
    for group in (NOTHING, *groups):
        value = whole if group == NOTHING else _auc(case, model, group)
        key = {"scene": scene, "edit": edit, "seed": int(seed), "shuffled": group}
        yield {**key, "auc": value, "loss": whole - value}


def _auc(case: Examples, model: Model, group: str | None) -> float:
    values = case.values.astype(np.float32)
    if group is not None:
        order = np.random.default_rng(0).permutation(len(values))
        columns = select(case.names, group)
        values[:, columns] = values[order][:, columns]
    return auc(raw_odds(values, model.networks), case.labels)


def all_rows(args: NativeArgs) -> Iterator[Iterator[Row]]:
    """Every case of these seeds."""
    paths = sorted(path for seed in SEEDS for path in args.keep.glob(f"*-*-{seed}.npz"))
    if not paths:
        raise InputError(
            f"{args.keep}: holds no cases; run experiments/train_cues.py --keep {args.keep} first"
        )
    for path in paths:
        yield rows_of(path, args.keep)


def chart(rows: list[Row], path: Path) -> None:
    """Loss by group and edit."""
    groups = [name for name in values_of(rows, "shuffled") if name != NOTHING]
    figure, axis = plt.subplots(figsize=(7, 4), layout="constrained")
    for k, edit in enumerate(values_of(rows, "edit")):
        losses = [np.mean([r["loss"] for r in where(rows, edit=edit, shuffled=g)]) for g in groups]
        places = np.arange(len(groups)) + 0.27 * (k - 1)
        axis.barh(places, losses, 0.25, color=charts.COLORS[k], label=edit)
    axis.set_yticks(range(len(groups)), groups)
    axis.set(xlabel="loss of AUC per Gaussian when the group is shuffled")
    axis.invert_yaxis()
    axis.legend()
    charts.save(figure, path)


def main(args: NativeArgs) -> None:
    """Shuffle every group of every case; print and write the table and the chart."""
    rows = measured(args, "importance", all_rows(args))
    text = "\n\n".join(
        [
            "**Loss of AUC per Gaussian when a group of cues is shuffled**, in scenes that the "
            "model never saw",
            pivot(rows, "shuffled", "edit", metric="loss", digits=3),
        ]
    )
    print(text)
    write_section(args.out / "results.md", "importance", text)
    chart(rows, args.out / "importance.png")


if __name__ == "__main__":
    start(main, __doc__)
