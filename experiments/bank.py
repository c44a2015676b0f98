"""Cases of which the classifier learns: hosts, donors, edits and exporters that vary.

Hosts are the scenes of cases.py and their captures of the bank, which captures.py makes; donors are
objects, captures of objects, and objects cut out of another host. A case follows from its host,
edit and seed; its sources are what a fold leaves out.
"""

import dataclasses
import functools
from pathlib import Path
from typing import Literal

import jax
import numpy as np
from cases import DATA, Scene, available, load_scene, pruned
from cut_object import cut_object
from export import EXPORTERS, export
from garden import make_garden
from inpainted import inpaint_region
from optimised import laundered, optimise_region

from gsc_jax import load_cameras, load_ply
from gsc_jax.benchmark.scenes import make_object, make_room
from gsc_jax.benchmark.tamper import Edit, Proposal, tamper
from gsc_jax.scene import Gaussians

BANK = Path(__file__).resolve().parents[1] / ".captures"
OBJECTS = ("statue", "guitar", "plant", "bust", "wooden_figure", "kneeling_angel")
"""Objects that are pasted and captured, without those on which nothing may be trained."""
VIEWS = 24
"""Cameras of a capture that an edit looks through; every fourth of them is held out."""
LAUNDERED = 0.25
"""Share of the edits of captures after which the whole scene is trained a little more."""
OPTIMISED = 0.5
"""Share of the modifications and removals of captures that are made as optimising editors do."""
MAX_HOST = 60_000
"""Gaussians of a host whose edits may be optimised, which takes minutes for large ones, and of a
part of a host."""
PROGRAM_SEEDS = 2
"""Seeds with whole hosts and the programs of editors; the others have parts and quick edits."""
FIRST_SEED, SCENE_SEEDS, CAPTURE_SEEDS = 1000, 10, 4
"""First seed of the cases of training, and numbers of seeds of a host and kind of edit. Each of the
many captures has fewer cases, of which one in four has the programs of editors."""
Kind = Edit | Literal["none"]
NO_EDIT: Literal["none"] = "none"
MADE_HOSTS = {"room": make_room, "garden": make_garden}
PROGRAMS: dict[Edit, Proposal] = {"modification": optimise_region, "removal": inpaint_region}


@dataclasses.dataclass(frozen=True, kw_only=True, eq=False)
class BankCase:
    """A scene, edited or not, after an export.

    Attributes:
        gaussians: The scene as it was exported.
        labels: True where a Gaussian is tampered, shape (N,).
        sources: What the host and the donor are captures of.
        edit: Kind of the edit, or `NO_EDIT`.
        how: What was done, with the exporter last.
    """

    gaussians: Gaussians
    labels: np.ndarray
    sources: frozenset[str]
    edit: str
    how: tuple[str, ...]


def source_of(name: str) -> str:
    """What a scene or object is a capture of."""
    return name.split("-")[0]


def captures(bank: Path, names: tuple[str, ...]) -> list[str]:
    """Names of the complete captures of these sources."""
    found = sorted(path.parent.name for path in bank.glob("*/recipe.json"))
    return [name for name in found if source_of(name) in names]


def hosts(bank: Path, data: Path = DATA) -> list[str]:
    """Scenes that may be edited for training: those of the development, and their captures."""
    scenes = available(data)
    return [*scenes, *captures(bank, scenes)]


def training_seeds(host: str) -> range:
    """Seeds of the cases that the classifier learns from, for a host and each kind of edit."""
    if "-" in host:
        return range(FIRST_SEED + 1, FIRST_SEED + 1 + CAPTURE_SEEDS)
    return range(FIRST_SEED, FIRST_SEED + SCENE_SEEDS)


@functools.lru_cache(maxsize=4)
def load_host(name: str, bank: Path, data: Path = DATA) -> Scene:
    """Load a scene of cases.py, or a capture with some of its cameras."""
    if "-" not in name:
        return load_scene(name, data)
    cameras = load_cameras(bank / name / "cameras.json")[::2][:VIEWS]
    heldout = cameras[2::4]
    others = [camera for k, camera in enumerate(cameras) if k % 4 != 2]
    gaussians = load_ply(bank / name / "scene.ply")
    return Scene(name=name, gaussians=gaussians, cameras=others, heldout=heldout)


def drawn_host(scene: Scene, seed: int, rng: np.random.Generator) -> Gaussians:
    """A made scene of the seed, or the `MAX_HOST` Gaussians of a box around a random one."""
    if scene.name in MADE_HOSTS:
        return jax.tree.map(np.asarray, MADE_HOSTS[scene.name](seed=seed))
    gaussians, means = scene.gaussians, np.asarray(scene.gaussians.means)
    apart = np.abs(means - means[rng.integers(len(means))]).max(axis=1)
    return gaussians.take(np.sort(np.argsort(apart)[:MAX_HOST]))


def draw_donor(
    host: str, count: int, bank: Path, data: Path, rng: np.random.Generator
) -> tuple[str, Gaussians]:
    """Draw an object of another source than the host, with at most `count` Gaussians."""
    captured, scanned = captures(bank, (*OBJECTS, "vase")), [*OBJECTS] if data.is_dir() else []
    others = [name for name in hosts(bank, data) if source_of(name) != source_of(host)]
    kind, seed = rng.integers(3), int(rng.integers(2**31))
    if kind == 0:
        source = load_host(name := str(rng.choice(others)), bank, data)
        return name, cut_object(source.gaussians, source.cameras, seed=seed)
    name = str(rng.choice((captured if kind == 1 else scanned) or ["vase"]))
    if name == "vase":
        return name, make_object(seed=seed)
    path = bank / name / "scene.ply" if "-" in name else data / "objects" / f"{name}.ply"
    return name, pruned(load_ply(path), count)


def bank_case(host: str, edit: Kind, seed: int, bank: Path = BANK, data: Path = DATA) -> BankCase:
    """Draw a case.

    Raises:
        InputError: if the host has no place for such an edit.
    """
    scene, rng = load_host(host, bank, data), np.random.default_rng([seed, *host.encode()])
    quick = seed >= FIRST_SEED + PROGRAM_SEEDS
    gaussians = drawn_host(scene, seed, rng) if quick else scene.gaussians
    labels = np.zeros(len(gaussians), bool)
    sources, how = {source_of(host)}, []
    if edit != NO_EDIT:
        change: Edit | Gaussians | tuple[Edit, Proposal] = edit
        if edit == "incorporation":
            name, change = draw_donor(host, len(gaussians) // 4, bank, data, rng)
            sources.add(source_of(name))
        elif not quick and len(gaussians) < MAX_HOST and rng.random() < OPTIMISED:
            change = edit, PROGRAMS[edit]
        edited = tamper(gaussians, scene.cameras, change, seed=seed)
        gaussians, labels = edited.gaussians, edited.labels
        how.append(edited.description)
        if not quick and len(gaussians) < MAX_HOST and rng.random() < LAUNDERED:
            gaussians = laundered(gaussians, scene.cameras)
            how.append("laundered")
    exporter = str(rng.choice(list(EXPORTERS)))
    saved, rows = export(gaussians, exporter, seed=seed)
    return BankCase(
        gaussians=saved,
        labels=labels[rows],
        sources=frozenset(sources),
        edit=edit,
        how=(*how, exporter),
    )
