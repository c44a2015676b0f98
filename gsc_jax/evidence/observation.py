"""Observation of a scene: render every view, run the 2D detector, lift its masks to the Gaussians.

No other step renders for the optimisation. An observation holds the votes (GS-Checker, eq. 5) and
the evidence, which replaces rendering in eq. 9 and 10; any estimator of any configuration uses it.
"""

import dataclasses
import functools
import json
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from typing import Any

import jax
import numpy as np

from gsc_jax.evidence.detector import Detector, as_detector, fit_to_view
from gsc_jax.evidence.lifting import EvidenceOfViews, SparseEvidence, sparse, view_evidence
from gsc_jax.evidence.monitor import Monitor
from gsc_jax.evidence.storage import ArrayStore, ByView
from gsc_jax.render.projection import NEAR, project_centers
from gsc_jax.render.tiles import View, make_view
from gsc_jax.scene import Camera, Gaussians, InputError
from gsc_jax.scene.camera import check_camera
from gsc_jax.scene.gaussians import filled_up
from gsc_jax.scene.parallel import ViewThreads, bounded_map
from gsc_jax.scene.pytree import short_repr
from gsc_jax.splat import render_view
from gsc_jax.vote import Tally, cast_votes, no_votes, tally

MAP, EVIDENCE, DIAGNOSTICS = "map", "evidence", "diagnostics"
"""Kinds of arrays of a view in a store: the probability map, what `sparse` returns, and the entry
of the view in the `diagnostics` of the detector, as JSON."""


@dataclasses.dataclass(frozen=True, kw_only=True)
class Observation:
    """A scene, V cameras, and what a 2D detector makes of the views.

    Attributes:
        gaussians: N Gaussians.
        cameras: The V cameras.
        evidence: Blending weights of the V views, shapes (V, N).
        masks: Thresholded probability maps, (H, W) bool, by camera name.
        probabilities: Probability maps of the detector, (H, W) float16, by camera name.
    """

    gaussians: Gaussians
    cameras: tuple[Camera, ...]
    evidence: EvidenceOfViews
    masks: Mapping[str, np.ndarray]
    probabilities: Mapping[str, np.ndarray]

    __repr__ = short_repr

    @functools.cached_property
    def votes(self) -> Tally:
        """Tally of the votes of all views (GS-Checker, eq. 5), shapes (N,)."""
        views = (votes_of_view(self.gaussians, c, self.masks[c.name]) for c in self.cameras)
        return sum(views, no_votes(len(self.gaussians)))


def observe(
    gaussians: Gaussians,
    cameras: Iterable[Camera],
    detector: Detector | Callable[[np.ndarray], Any] | Mapping[str, Any] | Iterable[Any],
    *,
    near: float = NEAR,
    store: ArrayStore | None = None,
    monitor: Monitor | None = None,
) -> Observation:
    """Render a scene from every camera, run the detector, lift its masks by voting and splatting.

    Args:
        gaussians: N Gaussians.
        cameras: V cameras, for all of which the detector has an output.
        detector: A 2D detector, a function of the image, or probability maps: by camera name, or
            one for each camera in a sequence, array or generator. Called in this thread only.
        near: Near plane in world units.
        store: Where the maps and the evidence of the views are kept; a new one by default. Views
            that it holds are neither judged nor lifted again.
        monitor: Records the time of each stage and the progress over views.

    Returns:
        The observation, with views in the order of the cameras.

    Raises:
        InputError: if there is no camera, two have one name, or the detector has no output for one.
        ValueError: if the detector is none.
    """
    cameras = check_cameras(cameras)
    monitor, detector = monitor or Monitor(), as_detector(detector, cameras)
    names = tuple(camera.name for camera in cameras)
    store, filled = store or ArrayStore(), filled_up(gaussians)
    missing = [c for c in cameras if not (store.has(EVIDENCE, c.name) and store.has(MAP, c.name))]
    _restore_diagnostics(detector, names, store)

    def prepare(camera: Camera) -> tuple[View, np.ndarray | None]:
        with monitor.stage("project"):
            view = make_view(filled, camera, near=near)
        if detector.needs_image and not store.has(MAP, camera.name):
            with monitor.stage("render"):
                return view, np.asarray(render_view(view, filled, camera)[0])
        return view, None

    def detect() -> Iterator[tuple[Camera, View]]:
        for camera, (view, image) in zip(missing, bounded_map(pool, prepare, missing), strict=True):
            if not store.has(MAP, camera.name):
                with monitor.stage("detect"):
                    _judge(detector, image, camera, store)
            yield camera, view

    def lift(job: tuple[Camera, View]) -> None:
        camera, view = job
        with monitor.stage("lift"):
            mask = store.get(MAP, camera.name) > 0.5
            store.put(EVIDENCE, camera.name, sparse(view_evidence(view, mask)))

    with ViewThreads(len(gaussians)) as pool:
        lifted = bounded_map(pool, lift, detect())
        list(monitor.track("views", lifted, len(cameras), len(cameras) - len(missing)))
    shape = len(names), len(gaussians)
    evidence = SparseEvidence(entry=lambda view: store.get(EVIDENCE, names[view]), shape=shape)
    return Observation(
        gaussians=gaussians,
        cameras=tuple(cameras),
        evidence=evidence.expanded(store.max_bytes),
        masks=ByView(names, lambda name: store.get(MAP, name) > 0.5),
        probabilities=ByView(names, lambda name: np.array(store.get(MAP, name))),
    )


def check_cameras(cameras: Camera | Iterable[Camera], *, least: int = 1) -> list[Camera]:
    """List the cameras; InputError for fewer than `least`, other types, or two of one name."""
    cameras = [cameras] if isinstance(cameras, Camera | None) else list(cameras)
    if others := {type(camera).__name__ for camera in cameras if not isinstance(camera, Camera)}:
        raise InputError(f"cameras must be Camera objects, got {', '.join(sorted(others))}")
    for camera in cameras:
        check_camera(camera)
    if len(names := [camera.name for camera in cameras]) < least:
        raise InputError("no cameras: expected at least one view of the scene")
    if duplicates := sorted({name for name in names if names.count(name) > 1}):
        raise InputError(
            f"Two cameras have the name {duplicates[0]!r}; masks are stored by camera name."
        )
    return cameras


def votes_of_view(gaussians: Gaussians, camera: Camera, mask: np.ndarray) -> Tally:
    """Votes of one view on N Gaussians by their projected centres (GS-Checker, eq. 5)."""
    centers, depths = project_centers(gaussians.means, camera.viewmat, camera.K)
    return jax.block_until_ready(tally(cast_votes(centers, depths, mask)[None]))


def _judge(detector: Detector, image: np.ndarray | None, camera: Camera, store: ArrayStore) -> None:
    """Run the detector on a view, and store its map and diagnostics."""
    probability = fit_to_view(detector(image, camera), camera)
    if (counts := getattr(detector, "diagnostics", {}).get(camera.name)) is not None:
        encoded = json.dumps(counts, default=float).encode()
        store.put(DIAGNOSTICS, camera.name, np.frombuffer(encoded, np.uint8))
    store.put(MAP, camera.name, half_precision(probability))


def _restore_diagnostics(detector: Detector, names: Sequence[str], store: ArrayStore) -> None:
    """Put the diagnostics of the views that were judged before back into those of the detector."""
    diagnostics = getattr(detector, "diagnostics", {})
    for name in names:
        if name not in diagnostics and store.has(DIAGNOSTICS, name):
            diagnostics[name] = json.loads(bytes(store.get(DIAGNOSTICS, name)))


def half_precision(probability: np.ndarray) -> np.ndarray:
    """Round a probability map to float16, without moving a pixel across the threshold of 0.5."""
    rounded = probability.astype(np.float16)
    above = np.nextafter(np.float16(0.5), np.float16(1))
    return np.where(probability > 0.5, np.maximum(rounded, above), rounded)
