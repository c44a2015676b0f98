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
from editors import UNTOUCHED, program_of
from export import EXPORTERS, export
from garden import make_garden
from optimised import laundered

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
"""Share of the whole captures, edited or not, that are trained a little more afterwards."""
BY_PROGRAM, DENSIFIED, ROUGH = 0.75, 0.5, 0.5
"""Share of the edits of whole captures that the programs of editors make, of the modifications
among them with densification, and of the objects cut from another host with some background."""
MAX_HOST = 60_000
"""Gaussians of a host whose edits programs may make, which takes minutes for large ones, and of a
part of a host."""
PROGRAM_SEEDS = 3
"""Seeds with whole hosts and the programs of editors; the others have parts and quick edits."""
FIRST_SEED, SCENE_SEEDS, CAPTURE_SEEDS = 1000, 10, 5
"""First seed of the cases of training, and numbers of seeds of a host and kind of edit. Each of the
many captures has fewer cases, of which two in five have whole hosts."""
Kind = Edit | Literal["none"]
NO_EDIT: Literal["none"] = "none"
MADE_HOSTS = {"room": make_room, "garden": make_garden}


@dataclasses.dataclass(frozen=True, kw_only=True, eq=False)
class BankCase:
    """A scene, edited or not, after an export.

    Attributes:
        gaussians: The scene as it was exported.
        labels: True where a Gaussian is tampered, shape (N,).
        sources: What the host and the donor are captures of.
        edit: Kind of the edit, or `NO_EDIT`.
        family: How the edit was made, see editors.py; `UNTOUCHED` for authentic scenes.
        exporter: The exporter or harmless history.
    """

    gaussians: Gaussians
    labels: np.ndarray
    sources: frozenset[str]
    edit: str
    family: str
    exporter: str


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
    """Draw an object of another source than the host, with at most `count` Gaussians.

    Captures that are trained by growth by error were added later. They are never donors, so that
    the earlier cases stay as they were.
    """
    captured, scanned = captures(bank, (*OBJECTS, "vase")), [*OBJECTS] if data.is_dir() else []
    others = [name for name in hosts(bank, data) if source_of(name) != source_of(host)]
    others = [name for name in others if not name.endswith("-error")]
    kind, seed = rng.integers(3), int(rng.integers(2**31))
    if kind == 0:
        source = load_host(name := str(rng.choice(others)), bank, data)
        rough = bool(rng.random() < ROUGH)
        return name, cut_object(source.gaussians, source.cameras, seed=seed, rough=rough)
    name = str(rng.choice((captured if kind == 1 else scanned) or ["vase"]))
    if name == "vase":
        return name, make_object(seed=seed)
    path = bank / name / "scene.ply" if "-" in name else data / "objects" / f"{name}.ply"
    return name, pruned(load_ply(path), count)


def change_of(
    edit: Edit, donor: Gaussians | None, *, quick: bool, rng: np.random.Generator
) -> Edit | Gaussians | tuple[Edit, Proposal]:
    """What `tamper` makes: a quick edit, or that of an editor's program."""
    if quick:
        return edit if donor is None else donor
    return edit, program_of(edit, donor, densify=bool(rng.random() < DENSIFIED))


def bank_case(host: str, edit: Kind, seed: int, bank: Path = BANK, data: Path = DATA) -> BankCase:
    """Draw a case.

    Raises:
        InputError: if the host has no place for such an edit.
    """
    scene, rng = load_host(host, bank, data), np.random.default_rng([seed, *host.encode()])
    whole = seed < FIRST_SEED + PROGRAM_SEEDS
    gaussians = scene.gaussians if whole else drawn_host(scene, seed, rng)
    small, labels = whole and len(gaussians) < MAX_HOST, np.zeros(len(gaussians), bool)
    sources, family = {source_of(host)}, UNTOUCHED
    if edit != NO_EDIT:
        donor = None
        if edit == "incorporation":
            name, donor = draw_donor(host, len(gaussians) // 4, bank, data, rng)
            sources.add(source_of(name))
        family = "editor" if small and rng.random() < BY_PROGRAM else "quick"
        change = change_of(edit, donor, quick=family == "quick", rng=rng)
        edited = tamper(gaussians, scene.cameras, change, seed=seed)
        gaussians, labels = edited.gaussians, edited.labels
    if small and rng.random() < LAUNDERED:
        gaussians, family = laundered(gaussians, scene.cameras), "laundered"
    exporter = str(rng.choice(list(EXPORTERS)))
    saved, rows = export(gaussians, exporter, seed=seed)
    return BankCase(
        gaussians=saved,
        labels=labels[rows],
        sources=frozenset(sources),
        edit=edit,
        family=family,
        exporter=exporter,
    )
