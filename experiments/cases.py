"""Cases of the experiments: edits of scenes with exact truth, and simulated detectors.

A case is one edit of one scene with everything that the methods and the metrics need. It follows
from scene, edit and seed, so that every row of every table can be reproduced.
"""

import dataclasses
import functools
import hashlib
from collections.abc import Mapping, Sequence
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
from baselines import inverse_projection
from cut_object import cut_object
from detector_strengths import calibrated
from garden import garden_cameras, make_garden

from gsc_jax import load_cameras, load_ply
from gsc_jax.benchmark.metrics import mean_over_tampered_views, truth_mask
from gsc_jax.benchmark.scenes import make_object, make_room, room_cameras
from gsc_jax.benchmark.simulate import REGIMES, Failures, decoy_labels, simulate
from gsc_jax.benchmark.tamper import Edit, Proposal, Tampered, tamper
from gsc_jax.evidence.detector import Detector, fit_to_view
from gsc_jax.render.projection import project_centers
from gsc_jax.scene import Camera, Gaussians, InputError
from gsc_jax.splat import render
from gsc_jax.vote import cast_votes, tally

DATA = Path(__file__).resolve().parents[2] / "shared" / "data"
REAL, MADE = ("kitchen", "playbot", "flowers"), ("room", "garden")
QUICK = "small room"
"""Scene of a quick run: a tenth of the work."""
OBJECTS = ("statue", "guitar", "plant")
UNSEEN, UNSEEN_OBJECTS = ("hexbox", "seal"), ("kettle", "skull")
"""Real scenes and objects on which nothing was trained or tuned, with an exception: "copy-move",
"quantisation" and "quaternion-convention" were corrected after these traces had named authentic
Gaussians in them."""
CUT = "cut from "
HELDOUT_EVERY = 4
"""Every fourth camera of a real scene is held out for the metrics."""
WIDTH, HEIGHT = 360, 270
RETRIES = 3
"""Further seeds to try where a scene has no place for an edit."""


@dataclasses.dataclass(frozen=True, kw_only=True, eq=False)
class Scene:
    """An authentic scene, with cameras for the methods and held-out cameras for the metrics."""

    name: str
    gaussians: Gaussians
    cameras: list[Camera]
    heldout: list[Camera]


@dataclasses.dataclass(frozen=True, kw_only=True, eq=False)
class Case:
    """One edit of one scene.

    Attributes:
        scene: The authentic scene.
        edit: Kind of the edit: incorporation, modification, removal or none.
        seed: Seed of the edit and of the detectors.
        gaussians: The edited scene.
        labels: True where a Gaussian is tampered, shape (N,).
        truth: Tampered pixels of the cameras, shape (V, H, W).
        heldout_truth: Tampered pixels of the held-out cameras, shape (U, H, W).
        decoy: Masks of an authentic region that a detector may flag, shape (V, H, W).
        description: What was done, in a sentence.
    """

    scene: Scene
    edit: str
    seed: int
    gaussians: Gaussians
    labels: np.ndarray
    truth: np.ndarray
    heldout_truth: np.ndarray
    decoy: np.ndarray
    description: str

    @property
    def key(self) -> dict[str, object]:
        """Columns that identify the case in a table."""
        return {"scene": self.scene.name, "edit": self.edit, "seed": self.seed}


def available(data: Path = DATA) -> tuple[str, ...]:
    """Names of the made scenes, and of the real ones if their files exist."""
    return (REAL if (data / "scenes").is_dir() else ()) + MADE


@functools.lru_cache(maxsize=2)
def load_scene(name: str, data: Path = DATA) -> Scene:
    """Load a scene by name."""
    gaussians, cameras, heldout = _made(name) if name in (*MADE, QUICK) else _real(name, data)
    gaussians = jax.tree.map(np.asarray, gaussians)
    return Scene(name=name, gaussians=gaussians, cameras=cameras, heldout=heldout)


def _made(name: str) -> tuple[Gaussians, list[Camera], list[Camera]]:
    make, cameras = (make_garden, garden_cameras) if name == "garden" else (make_room, room_cameras)
    count, views, shrink = (10_000, 8, 3) if name == QUICK else (50_000, 18, 1)
    view = functools.partial(cameras, width=WIDTH // shrink, height=HEIGHT // shrink)
    return make(count=count), view(views), view(views // 3, seed=1, prefix="heldout")


def _real(name: str, data: Path) -> tuple[Gaussians, list[Camera], list[Camera]]:
    cameras = load_cameras(data / "scenes" / f"{name}.cameras.json")
    cameras = [camera.resized(WIDTH, HEIGHT) for camera in cameras]
    heldout = cameras[HELDOUT_EVERY // 2 :: HELDOUT_EVERY]
    others = [c for i, c in enumerate(cameras) if i % HELDOUT_EVERY != HELDOUT_EVERY // 2]
    return load_ply(data / "scenes" / f"{name}.ply"), others, heldout


def siblings_of(scene: str) -> tuple[tuple[str, ...], list[str]]:
    """All scenes of the kind of this one (real, unseen or made), and those to cut objects from."""
    siblings = next(some for some in (REAL, UNSEEN, (*MADE, QUICK)) if scene in some)
    return siblings, [name for name in siblings if name not in (scene, QUICK)]


def donor_name(scene: str, seed: int) -> str:
    """Name of the object to paste: by seed a scanned, a made or a cut one."""
    siblings, others = siblings_of(scene)
    objects = {REAL: OBJECTS, UNSEEN: UNSEEN_OBJECTS}.get(siblings, ("vase",))
    choices = [*objects, f"{CUT}{others[seed % len(others)]}"]
    # Different scenes begin with different objects.
    return choices[(seed + sum(scene.encode())) % len(choices)]


def donor(scene: Scene, seed: int, data: Path = DATA) -> Gaussians:
    """Object to paste into a scene, upright with up = -y."""
    name = donor_name(scene.name, seed)
    if name in UNSEEN_OBJECTS:
        return pruned(load_ply(data / "objects" / f"{name}.ply"), len(scene.gaussians) // 4)
    if name in OBJECTS:
        return load_ply(data / "objects" / f"{name}.ply")
    if name.startswith(CUT):
        source = load_scene(name.removeprefix(CUT), data)
        return cut_object(source.gaussians, source.cameras, seed=seed)
    return make_object(seed=seed)


def pruned(gaussians: Gaussians, count: int) -> Gaussians:
    """The Gaussians that cover most, so that an object does not outnumber the scene."""
    scales = np.sort(np.asarray(gaussians.log_scales), axis=1)
    covers = np.log(np.asarray(gaussians.opacities)) + scales[:, 1:].sum(axis=1)
    return gaussians.take(np.sort(np.argsort(-covers)[:count]))


def make_case(name: str, edit: Edit, seed: int, data: Path = DATA) -> Case:
    """Edit a scene and render the truth in all views."""
    return case_of(load_scene(name, data), edit_scene(name, edit, seed, data), seed)


def case_of(scene: Scene, edited: Tampered, seed: int) -> Case:
    """The case of an edited scene, with the truth in all views."""
    gaussians, labels = jax.tree.map(jnp.asarray, edited.gaussians), edited.labels
    decoy = _decoy(edited.gaussians, labels, seed)
    return Case(
        scene=scene,
        edit=edited.edit,
        seed=seed,
        gaussians=gaussians,
        labels=labels,
        truth=_masks(gaussians, scene.cameras, labels),
        heldout_truth=_masks(gaussians, scene.heldout, labels),
        decoy=_masks(gaussians, scene.cameras, decoy),
        description=edited.description,
    )


def edit_scene(name: str, edit: Edit, seed: int, data: Path = DATA) -> Tampered:
    """Edit a scene with a seed, or with that plus 100, 200 or 300 if there is no place for it."""
    scene = load_scene(name, data)
    return tampered(scene, donor(scene, seed, data) if edit == "incorporation" else edit, seed)


def tampered(scene: Scene, change: Edit | Gaussians | tuple[Edit, Proposal], seed: int) -> Tampered:
    """Edit a scene as `tamper` does, with further seeds if there is no place for the edit."""
    for retry in range(RETRIES + 1):
        try:
            return tamper(scene.gaussians, scene.cameras, change, seed=seed + 100 * retry)
        except InputError:
            if retry == RETRIES:
                raise
    raise AssertionError("unreachable")


def seen_from(case: Case, cameras: list[Camera]) -> Case:
    """The case with other cameras."""
    decoy = _decoy(case.gaussians, case.labels, case.seed)
    return dataclasses.replace(
        case,
        scene=dataclasses.replace(case.scene, cameras=cameras),
        truth=_masks(case.gaussians, cameras, case.labels),
        decoy=_masks(case.gaussians, cameras, decoy),
    )


def failures_without(edit: str, failures: Mapping[str, Failures]) -> dict[str, Failures]:
    """Failures of the detector to measure on the authentic scene of an edit of this kind.

    The region of the edit is the decoy. Before an incorporation, the masks of the object correspond
    to no surface, so nothing is measured; without a decoy, all kinds of edit have the same masks.
    """
    if edit == "incorporation":
        return {}
    return {name: one for name, one in failures.items() if one.decoy or edit == "modification"}


def without_edit(edited: Case) -> Case:
    """The scene of a case without its edit; the decoy is the region of the edit."""
    return dataclasses.replace(
        edited,
        edit="none",
        gaussians=jax.tree.map(jnp.asarray, edited.scene.gaussians),
        labels=np.zeros(len(edited.scene.gaussians), bool),
        truth=np.zeros_like(edited.truth),
        heldout_truth=np.zeros_like(edited.heldout_truth),
        decoy=edited.truth,
        description="Untouched.",
    )


def _decoy(gaussians: Gaussians, labels: np.ndarray, seed: int) -> np.ndarray:
    """An authentic region that a detector may flag, (N,) bool; empty where there is no place."""
    try:
        return decoy_labels(gaussians, labels, seed=seed)
    except ValueError:
        return np.zeros(len(labels), bool)


def _masks(gaussians: Gaussians, cameras: list[Camera], labels: np.ndarray) -> np.ndarray:
    return np.stack([truth_mask(gaussians, camera, labels) for camera in cameras])


def detector_masks(case: Case, regimes: Mapping[str, Failures] = REGIMES) -> dict[str, np.ndarray]:
    """Masks (V, H, W) of simulated detectors by regime."""
    return {
        regime: simulate(case.truth, case.decoy, seed=_seed(case, regime), failures=failures) > 0.5
        for regime, failures in regimes.items()
    }


def masks_of(detector: Detector, gaussians: Gaussians, cameras: Sequence[Camera]) -> np.ndarray:
    """Masks (V, H, W) of a detector that is shown renders of a scene."""
    images = [np.asarray(render(gaussians, camera)[0]) for camera in cameras]
    pairs = zip(images, cameras, strict=True)
    return np.stack([fit_to_view(detector(image, c), c) > 0.5 for image, c in pairs])


def calibrated_mixture(case: Case) -> Failures:
    """Mixture of failures under which the inverse projection has an F1 between 0.1 and 0.4."""
    centers = [project_centers(case.gaussians.means, c.viewmat, c.K) for c in case.scene.cameras]

    def inverse_f1(failures: Failures) -> float:
        masks = detector_masks(case, {"mixture": failures})["mixture"]
        votes = [cast_votes(*place, mask) for place, mask in zip(centers, masks, strict=True)]
        labels = inverse_projection(tally(jnp.stack(votes)))
        flagged = _masks(case.gaussians, case.scene.heldout, labels)
        return mean_over_tampered_views(list(flagged), list(case.heldout_truth)).f1

    return calibrated(REGIMES["mixture"], inverse_f1)


def _seed(case: Case, regime: str) -> int:
    # From the names, so that a regime does not depend on which others are measured.
    key = f"{case.scene.name} {case.edit} {case.seed} {regime}"
    return int.from_bytes(hashlib.blake2b(key.encode(), digest_size=8).digest())


def reduced(
    case: Case, masks: Mapping[str, np.ndarray], views: int, scale: float = 1.0
) -> tuple[Case, dict[str, np.ndarray]]:
    """The case and its masks with fewer cameras, evenly spread, and smaller images."""
    total = len(case.scene.cameras)
    chosen = [k * total // views for k in range(views)]
    cameras = [case.scene.cameras[k].scaled(scale) for k in chosen]
    smaller = {
        name: np.stack(
            [fit_to_view(mask[k], c) > 0.5 for k, c in zip(chosen, cameras, strict=True)]
        )
        for name, mask in masks.items()
    }
    scene = dataclasses.replace(case.scene, cameras=cameras)
    return dataclasses.replace(case, scene=scene), smaller
