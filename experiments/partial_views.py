"""Scenes of which each view shows a small part: classes of the whole scene, or of its parts.

    python experiments/partial_views.py [--quick] [--out docs]

Three made scenes: a room that is looked at from its middle, a flight over a garden, and five rooms
side by side. An edit is where one of the cameras looks, so that few of the others see it. The
failures of the detector are those of `benchmark/simulate.py`; without the edit, those that need
none, for the verdict. "robust, undivided" fits its classes to whole scenes.
"""

import dataclasses
from collections.abc import Callable, Iterator, Mapping

import jax
import numpy as np
from cases import (
    HEIGHT,
    QUICK,
    WIDTH,
    Case,
    Scene,
    case_of,
    detector_masks,
    load_scene,
    tampered,
    without_edit,
)
from garden import make_garden
from methods import ALL_METHODS, predict_with, seeded
from observations import CaseObservation, Method, observe_regimes
from runner import ChosenArgs, judge, measured, start
from tables import Frame, Row, markdown, pivot, separation, where, write_section
from tqdm import tqdm

from gsc_jax.benchmark.scenes import make_object, make_room, room_cameras
from gsc_jax.benchmark.simulate import REGIMES
from gsc_jax.benchmark.surfaces import UP
from gsc_jax.benchmark.tamper import Edit
from gsc_jax.estimators import RobustEstimator
from gsc_jax.estimators.protocol import EVIDENCE_FROM
from gsc_jax.render.orbit import look_at
from gsc_jax.scene import Camera, Gaussians, InputError
from gsc_jax.scene.camera import intrinsics
from gsc_jax.scene.gaussians import concatenate

ROBUST = {
    "robust": RobustEstimator(),
    "robust, undivided": RobustEstimator(covisibility=0.0),
}
OTHERS = ("inverse projection", "mode vote", "SA3D", "GS-Checker official", "GS-Checker paper")
METHODS: Mapping[str, Method] = {
    **{name: ALL_METHODS[name] for name in OTHERS},
    **{name: predict_with(one) for name, one in ROBUST.items()},
}
FALSE_ALARMS = {name: REGIMES[name] for name in ("blobs", "consistent", "inverted", "mixture")}
"""Failures that authentic scenes have, too."""
ROOMS, APART = 5, np.array([6.0, 0, 0])
"""Rooms side by side, and metres from one to the next."""
FLIGHT, ABOVE, SPACING = 7, 3.0, 1.3
"""Cameras per side of the flight, and metres above the ground and between them."""
NEAR_THE_EDIT = 6
"""Cameras that look where one is to be edited."""


def outward_cameras(n: int, *, seed: int = 0, prefix: str = "outward") -> list[Camera]:
    """Make n cameras near the middle of a room, each of which looks outward at a wall."""
    rng = np.random.default_rng([seed, 7])
    turns = 2 * np.pi * (np.arange(n) + rng.random()) * 5 / n  # five times round
    ahead = np.stack([np.cos(turns), rng.uniform(-0.3, 0.4, n), np.sin(turns)], axis=1)
    places = rng.uniform([-0.4, -1.75, -0.4], [0.4, -1.25, 0.4], (n, 3)) + 0.5 * ahead * [1, 0, 1]
    return _looking(places, places + ahead, prefix)


def flight_cameras(side: int, *, seed: int = 0, prefix: str = "flight") -> list[Camera]:
    """Make side x side cameras above a garden that look down, in lines to and fro."""
    rng = np.random.default_rng([seed, 8])
    line, step = np.divmod(np.arange(side**2), side)
    x, z = (SPACING * (k - (side - 1) / 2) for k in (line, step))
    places = np.stack([x, np.full(side**2, -ABOVE), z], axis=1)
    places += rng.normal(0, 0.15, places.shape)
    ahead = np.stack([0 * x, np.full(side**2, ABOVE), np.where(line % 2, 2.0, -2.0)], axis=1)
    return _looking(places, places + ahead + rng.normal(0, [0.3, 0, 0.3], places.shape), prefix)


def _looking(places: np.ndarray, targets: np.ndarray, prefix: str) -> list[Camera]:
    K = intrinsics(0.75 * WIDTH, WIDTH, HEIGHT)
    views = [look_at(*pair, UP) for pair in zip(places, targets, strict=True)]
    return [
        Camera(viewmat=view, K=K, width=WIDTH, height=HEIGHT, name=f"{prefix}_{i:03d}")
        for i, view in enumerate(views)
    ]


def _outward() -> tuple[Gaussians, list[Camera], list[Camera]]:
    held_out = outward_cameras(20, seed=1, prefix="heldout")
    return make_room(), outward_cameras(40), held_out


def _flight() -> tuple[Gaussians, list[Camera], list[Camera]]:
    held_out = flight_cameras(FLIGHT - 1, seed=1, prefix="heldout")
    return make_garden(count=50_000), flight_cameras(FLIGHT), held_out


def _rooms() -> tuple[Gaussians, list[Camera], list[Camera]]:
    rooms = [moved(make_room(seed=k, count=15_000), k * APART) for k in range(ROOMS)]
    size = {"width": WIDTH, "height": HEIGHT}
    sets = {"cameras": 9, "heldout": 3}
    cameras = [
        [
            _shifted(camera, k * APART)
            for k in range(ROOMS)
            for camera in room_cameras(n, seed=10 * k + own, prefix=f"{prefix}_{k}", **size)
        ]
        for own, (prefix, n) in enumerate(sets.items())
    ]
    return concatenate(rooms), cameras[0], cameras[1]


def moved(gaussians: Gaussians, by: np.ndarray) -> Gaussians:
    """The Gaussians moved by a vector in metres."""
    return dataclasses.replace(gaussians, means=gaussians.means + by.astype(np.float32))


def _shifted(camera: Camera, by: np.ndarray) -> Camera:
    view = np.array(camera.viewmat)
    view[:3, 3] -= view[:3, :3] @ by
    return dataclasses.replace(camera, viewmat=view)


SCENES: Mapping[str, Callable[[], tuple[Gaussians, list[Camera], list[Camera]]]] = {
    "room from its middle": _outward,
    "flight": _flight,
    "five rooms": _rooms,
}


def made(name: str) -> Scene:
    """One of the scenes; a quick run has an ordinary small one."""
    if name == QUICK:
        return load_scene(name)
    if name not in SCENES:
        raise InputError(f"--scenes {name!r}: expected some of {', '.join(SCENES)}")
    gaussians, cameras, heldout = SCENES[name]()
    gaussians = jax.tree.map(np.asarray, gaussians)
    return Scene(name=name, gaussians=gaussians, cameras=cameras, heldout=heldout)


def edited(scene: Scene, edit: Edit, seed: int) -> Case:
    """Edit a scene at a place that a few neighbouring cameras look at."""
    centers = np.stack([camera.center for camera in scene.cameras])
    ahead = np.stack([np.asarray(camera.viewmat)[2, :3] for camera in scene.cameras])
    looked_at = centers + 2 * ahead
    rng = np.random.default_rng([seed, 9])
    distance = np.linalg.norm(looked_at - looked_at[rng.integers(len(looked_at))], axis=1)
    close = [scene.cameras[i] for i in np.argsort(distance)[:NEAR_THE_EDIT]]
    change = make_object(seed=seed) if edit == "incorporation" else edit
    return case_of(scene, tampered(dataclasses.replace(scene, cameras=close), change, seed), seed)


def rows_of(case: Case, methods: Mapping[str, Method]) -> Iterator[Row]:
    """Measure F1 under every failure, and the verdicts on the scene with and without the edit."""
    observed = observe_regimes(case, detector_masks(case))
    for row in judge(observed, methods):
        yield {**row, "verdict": _verdict(observed[str(row["regime"])], str(row["method"]))}
    before = without_edit(case)
    for regime, one in observe_regimes(before, detector_masks(before, FALSE_ALARMS)).items():
        for name in [name for name in ROBUST if name in methods]:
            own = {**before.key, "regime": regime, "method": name, "f1": np.nan}
            yield {**own, "false_area": np.nan, "verdict": _verdict(one, name)}


def _verdict(observed: CaseObservation, name: str) -> float | None:
    if name not in ROBUST:
        return np.nan
    return seeded(ROBUST[name], observed.case.seed).estimate(observed.observation).verdict


def verdicts(rows: Frame) -> str:
    """Tabulate how well the scene probability separates edited from authentic scenes."""
    lines = []
    for name in ROBUST:
        own = where(rows, method=name)
        untouched = own[own.edit == "none"]
        changed = own[(own.edit != "none") & own.regime.isin(FALSE_ALARMS)]
        shares = [f"{(some.verdict >= EVIDENCE_FROM).mean():.0%}" for some in (changed, untouched)]
        lines.append([name, f"{separation(changed, untouched):.3f}", *shares])
    return markdown(["method", "AUC", "edited: evidence", "authentic: evidence"], lines)


def report(rows: Frame) -> str:
    """All tables."""
    changed = rows[rows.edit != "none"]
    parts = [
        "**F1 in the held-out views, by scene**",
        pivot(changed, "method", "scene"),
        "**By failure**",
        pivot(changed, "method", "regime"),
        "**Verdicts**, with the failures that authentic scenes have, too: AUC between edited and "
        f"authentic scenes, and which share of them has evidence ({EVIDENCE_FROM} and more)",
        verdicts(rows),
    ]
    return "\n\n".join(parts)


def main(args: ChosenArgs) -> None:
    """Measure every case; print and write the tables."""
    scenes = (QUICK,) if args.quick else args.scenes or tuple(SCENES)
    methods = args.among(METHODS)
    jobs = dataclasses.replace(args, scenes=scenes).jobs()

    def per_case() -> Iterator[Iterator[Row]]:
        for name, edit, seed in tqdm(jobs, desc="cases", disable=None):
            yield rows_of(edited(made(name), edit, seed), methods)

    rows = measured(args, "partial_views", per_case())
    text = report(rows)
    print(text)
    write_section(args.out / "results.md", "partial_views", text)


if __name__ == "__main__":
    start(main, __doc__)
