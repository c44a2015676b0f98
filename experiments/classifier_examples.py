"""Training examples of the classifier: features of Gaussians of edited scenes, with labels.

The seeds differ from those of the tables, and every scene is requantised, so that host and pasted
object have the same digits.
"""

import dataclasses
from pathlib import Path

import numpy as np
from cases import CUT, donor_name, edit_scene

from gsc_jax.benchmark.export import export
from gsc_jax.benchmark.tamper import Edit
from gsc_jax.forensics.features import compute_features
from gsc_jax.io.files import atomic
from gsc_jax.scene import Gaussians

FIRST_SEED = 10
"""First seed; the tables use seeds 0 to 2."""
MAX_TAMPERED, MAX_AUTHENTIC = 4000, 8000
"""Gaussians per case."""


@dataclasses.dataclass(frozen=True, kw_only=True)
class Examples:
    """Features (M, F) float16 and labels (M,) of a sample of a case.

    `scenes` are the edited scene and the one that a pasted object was cut from; `share` is the
    share of all its Gaussians that are tampered.
    """

    scene: str
    edit: str
    scenes: frozenset[str]
    values: np.ndarray
    labels: np.ndarray
    share: float
    names: tuple[str, ...]


def requantised(gaussians: Gaussians, seed: int) -> Gaussians:
    """The scene as an export stores it, with 8 bits for even seeds and noise for odd ones."""
    return export(gaussians, ("8 bits", "float")[seed % 2], seed=seed).gaussians


def make_examples(scene: str, edit: Edit, seed: int, data: Path, keep: Path) -> Examples:
    """Compute the features of a sample of a case, or read them from a file in `keep`."""
    path = keep / f"{scene}-{edit}-{seed}.npz"
    if path.exists():
        return read_examples(path)
    case = edit_scene(scene, edit, seed, data)
    rng = np.random.default_rng(seed)
    features = compute_features(requantised(case.gaussians, seed))
    tampered, authentic = np.flatnonzero(case.labels), np.flatnonzero(~case.labels)
    sample = [rng.permutation(tampered)[:MAX_TAMPERED], rng.permutation(authentic)[:MAX_AUTHENTIC]]
    rows = np.concatenate(sample)
    with atomic(path) as temporary, temporary.open("wb") as file:
        np.savez(
            file,
            values=features.values[rows].astype(np.float16),
            labels=case.labels[rows],
            share=case.labels.mean(),
            names=np.array(features.names),
        )
    return read_examples(path)


def read_examples(path: Path) -> Examples:
    """Read examples; the name of the file holds scene, edit and seed."""
    scene, edit, seed = path.stem.split("-")
    with np.load(path) as stored:
        return Examples(
            scene=scene,
            edit=edit,
            scenes=scenes_in(scene, edit, int(seed)),
            values=stored["values"],
            labels=stored["labels"],
            share=float(stored["share"]),
            names=tuple(stored["names"].tolist()),
        )


def scenes_in(scene: str, edit: str | None, seed: int) -> frozenset[str]:
    """The scene of a case and the one that a pasted object was cut from."""
    pasted = donor_name(scene, seed) if edit == "incorporation" else ""
    return frozenset({scene, pasted.removeprefix(CUT)} if pasted.startswith(CUT) else {scene})
