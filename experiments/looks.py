"""One look at a case for all of its mask sets: what a method is given, and what it answers.

The blending weights of a view do not depend on the masks, so they are summed once for all of them.
"""

import dataclasses
from collections.abc import Callable, Mapping

import jax.numpy as jnp
import numpy as np
from cases import Case

from gsc_jax.evidence.lifting import Evidence
from gsc_jax.evidence.observation import Observation
from gsc_jax.render.projection import project_centers
from gsc_jax.render.tiles import View, make_view
from gsc_jax.scene import Gaussians
from gsc_jax.splat import accumulate
from gsc_jax.vote import cast_votes, no_votes, tally


@dataclasses.dataclass(frozen=True, kw_only=True, eq=False)
class Shared:
    """What the looks at one case share: the views, for a method that has to render, and each other.

    Attributes:
        views: The views of the cameras.
        looks: The looks by regime.
    """

    views: list[View]
    looks: dict[str, "Look"]


@dataclasses.dataclass(frozen=True, kw_only=True, eq=False)
class Look:
    """What one set of masks makes of a case: all that a method may know.

    Attributes:
        case: The case; its truth is for the metrics, and for the upper bound.
        regime: Name of the mask set.
        observation: Evidence, votes and masks.
        shared: With the other mask sets.
    """

    case: Case
    regime: str
    observation: Observation
    shared: Shared


@dataclasses.dataclass(frozen=True, kw_only=True)
class Answer:
    """What a method says: flagged in a view is where the rendered feature / alpha > level.

    Attributes:
        score: A number per Gaussian, larger where more tampered, shape (N,).
        labels: Tampered Gaussians, shape (N,).
        feature: What is rendered, shape (N,); by default the labels.
        level: Above which a pixel is tampered.
        absolute: Do not divide by alpha.
        gaussians: The scene as a method leaves it that cuts Gaussians; by default the case's.
    """

    score: np.ndarray
    labels: np.ndarray
    feature: np.ndarray | None = None
    level: float = 0.5
    absolute: bool = False
    gaussians: Gaussians | None = None

    @property
    def rendered(self) -> np.ndarray:
        """The feature, or the labels where there is none."""
        return np.asarray(self.labels if self.feature is None else self.feature, np.float32)


Method = Callable[[Look], Answer]


def look(case: Case, masks: Mapping[str, np.ndarray]) -> dict[str, Look]:
    """Lift every set of masks (V, H, W) of a case, the blending weights computed once."""
    gaussians, cameras, names = case.gaussians, case.scene.cameras, list(masks)
    views = [make_view(gaussians, camera) for camera in cameras]
    total = np.zeros((len(cameras), len(gaussians)), np.float32)
    tampered = np.zeros((len(names), *total.shape), np.float32)
    votes = dict.fromkeys(names, no_votes(len(gaussians)))
    for j, (camera, view) in enumerate(zip(cameras, views, strict=True)):
        flagged = np.stack([masks[name][j] for name in names])
        maps = jnp.asarray(np.concatenate([np.ones_like(flagged[:1]), flagged]), jnp.float32)
        sums = np.asarray(accumulate(view, jnp.moveaxis(maps, 0, -1))).T
        total[j], tampered[:, j] = sums[0], np.minimum(sums[1:], sums[:1])
        centers, depths = project_centers(gaussians.means, camera.viewmat, camera.K)
        for name, mask in zip(names, flagged, strict=True):
            votes[name] += tally(cast_votes(centers, depths, mask)[None])
    shared = Shared(views=views, looks={})
    for name, own in zip(names, tampered, strict=True):
        observation = Observation(
            evidence=Evidence(total=total, tampered=own),
            votes=votes[name],
            masks=dict(zip([camera.name for camera in cameras], masks[name], strict=True)),
            detections={},
        )
        shared.looks[name] = Look(case=case, regime=name, observation=observation, shared=shared)
    return shared.looks
