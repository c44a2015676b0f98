"""Observations of a case under all of its mask sets: what methods get, and what they return.

The blending weights of a view do not depend on the masks, so they are computed once for all sets.
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
from gsc_jax.vote import Tally, cast_votes, no_votes, tally


@dataclasses.dataclass(frozen=True, kw_only=True, eq=False)
class AllRegimes:
    """The observations of one case under all regimes, and the views, for methods that render."""

    views: list[View]
    by_regime: dict[str, "CaseObservation"]


@dataclasses.dataclass(frozen=True, kw_only=True, eq=False)
class CaseObservation:
    """A case observed with one set of masks: the input of a method.

    Attributes:
        case: The case; methods must not use its truth.
        regime: Name of the mask set.
        observation: Evidence, votes and masks.
        shared: The observations under all regimes.
    """

    case: Case
    regime: str
    observation: Observation
    shared: AllRegimes


@dataclasses.dataclass(frozen=True, kw_only=True)
class Prediction:
    """Output of a method; a pixel is flagged where the rendered feature / alpha > level.

    Attributes:
        score: Score per Gaussian, larger where more tampered, shape (N,).
        labels: True where tampered, shape (N,).
        feature: Feature to render, shape (N,); the labels by default.
        level: Threshold on the rendered feature.
        absolute: Compare the rendered feature itself with the level, without dividing by alpha.
        gaussians: The scene as changed by a method that cuts Gaussians; that of the case if None.
    """

    score: np.ndarray
    labels: np.ndarray
    feature: np.ndarray | None = None
    level: float = 0.5
    absolute: bool = False
    gaussians: Gaussians | None = None

    @property
    def rendered(self) -> np.ndarray:
        """Feature to render, float32."""
        return np.asarray(self.labels if self.feature is None else self.feature, np.float32)


Method = Callable[[CaseObservation], Prediction]


@dataclasses.dataclass(frozen=True, kw_only=True)
class Tallied(Observation):
    """An observation with given votes: cast for all regimes at once, or also by other views."""

    votes: Tally  # pyright: ignore[reportIncompatibleVariableOverride]


def observe_regimes(case: Case, masks: Mapping[str, np.ndarray]) -> dict[str, CaseObservation]:
    """Lift each set of masks (V, H, W) of a case; one accumulation per view serves all sets."""
    if not masks:
        return {}
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
    shared = AllRegimes(views=views, by_regime={})
    for name, own in zip(names, tampered, strict=True):
        observation = Tallied(
            gaussians=gaussians,
            cameras=tuple(cameras),
            evidence=Evidence(total=total, tampered=own),
            votes=votes[name],
            masks=dict(zip([camera.name for camera in cameras], masks[name], strict=True)),
            probabilities={},
        )
        shared.by_regime[name] = CaseObservation(
            case=case, regime=name, observation=observation, shared=shared
        )
    return shared.by_regime
