"""Training examples of the classifier: features of Gaussians of edited scenes, with labels.

The cases are those of `bank.py`; the tables use other edits, and other objects where it matters.
"""

import dataclasses
import hashlib
import pickle
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TypeVar

import jax
import numpy as np
from bank import FIRST_SEED, PROGRAM_SEEDS, BankCase, Kind, bank_case

from gsc_jax.benchmark.tamper import Edit
from gsc_jax.forensics.features import compute_features, with_finite_scales
from gsc_jax.io.files import atomic
from gsc_jax.scene import InputError

MAX_TAMPERED, MAX_AUTHENTIC = 3000, 6000
"""Gaussians per case."""
T = TypeVar("T")
RETRY, RETRIES = 10_000, 3
"""Step and number of the seeds that are tried where a host has no place for an edit."""


@dataclasses.dataclass(frozen=True, kw_only=True)
class Examples:
    """Features (M, F) float16 and labels (M,) of a sample of a case.

    `sources`, `family` and `exporter` are those of the case; `share` is the share of all its
    Gaussians that are tampered, which is 0 if the host has no place for such an edit.
    """

    host: str
    edit: str
    sources: frozenset[str]
    family: str
    exporter: str
    values: np.ndarray
    labels: np.ndarray
    share: float
    names: tuple[str, ...]


def stored_case(
    host: str, edit: Kind, seed: int, bank: Path, data: Path, keep: Path
) -> BankCase | None:
    """Draw a case as `draw_case` does, and keep it in a file if making its edit takes minutes."""
    if seed >= FIRST_SEED + PROGRAM_SEEDS:
        return draw_case(host, edit, seed, bank, data)
    path = keep / "cases" / f"{host}_{edit}_{seed}.pickle"
    return kept(path, lambda: _on_host(draw_case(host, edit, seed, bank, data)))


def kept(path: Path, make: Callable[[], T]) -> T:
    """What a file holds, or else what `make` returns, which is stored in it."""
    if not path.exists():
        path.parent.mkdir(parents=True, exist_ok=True)
        made = pickle.dumps(make())
        with atomic(path) as temporary:
            temporary.write_bytes(made)
    return pickle.loads(path.read_bytes())


def _on_host(case: BankCase | None) -> BankCase | None:
    return case and dataclasses.replace(case, gaussians=jax.tree.map(np.asarray, case.gaussians))


def draw_case(host: str, edit: Kind, seed: int, bank: Path, data: Path) -> BankCase | None:
    """Draw a case of the bank, or None if the host has no place for such an edit, or no object."""
    jax.clear_caches()  # cases differ in size: after hundreds, a process has too many memory maps
    for retry in range(RETRIES):
        try:
            return bank_case(host, edit, seed + RETRY * retry, bank, data)
        except InputError:
            continue
    return None


def make_examples(host: str, edit: Edit, seed: int, bank: Path, data: Path, keep: Path) -> Examples:
    """Compute the features of a sample of a case, or read them from a file in `keep`."""
    path = keep / f"{host}_{edit}_{seed}.npz"
    if not path.exists():
        case = stored_case(host, edit, seed, bank, data, keep)
        arrays = _sampled(case) if case else {"share": np.array(0.0)}
        with atomic(path) as temporary, temporary.open("wb") as file:
            np.savez(file, allow_pickle=False, **arrays)
    return read_examples(path)


def _sampled(case: BankCase) -> dict[str, np.ndarray]:
    rng = np.random.default_rng(0)
    features = compute_features(with_finite_scales(case.gaussians))
    tampered, authentic = np.flatnonzero(case.labels), np.flatnonzero(~case.labels)
    sample = [rng.permutation(tampered)[:MAX_TAMPERED], rng.permutation(authentic)[:MAX_AUTHENTIC]]
    rows = np.concatenate(sample)
    return {
        "values": features.rows(rows).astype(np.float16),
        "labels": case.labels[rows],
        "share": case.labels.mean(),
        "names": np.array(features.names),
        "sources": np.array(sorted(case.sources)),
        "family": np.array(case.family),
        "exporter": np.array(case.exporter),
    }


def digest(cases: Sequence[Examples]) -> str:
    """A hash, in 16 hexadecimal digits, of the features, labels, hosts and edits of all cases."""
    found = hashlib.blake2b(digest_size=8)
    for case in cases:
        found.update(repr((case.host, case.edit, sorted(case.sources), case.names)).encode())
        found.update(case.values.tobytes())
        found.update(case.labels.tobytes())
    return found.hexdigest()


def read_examples(path: Path) -> Examples:
    """Read examples; the name of the file holds host and edit."""
    host, edit, _ = path.stem.rsplit("_", 2)
    with np.load(path) as stored:
        found = bool(stored["share"] > 0)
        return Examples(
            host=host,
            edit=edit,
            sources=frozenset(stored["sources"].tolist() if found else ()),
            family=str(stored["family"]) if found else "",
            exporter=str(stored["exporter"]) if found else "",
            values=stored["values"] if found else np.zeros((0, 0), np.float16),
            labels=stored["labels"] if found else np.zeros(0, bool),
            share=float(stored["share"]),
            names=tuple(stored["names"].tolist() if found else ()),
        )
