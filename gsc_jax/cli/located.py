"""A finished run of `locate`, as those who tell of it are given it."""

import dataclasses

import numpy as np

from gsc_jax.io.ply import PlyScene
from gsc_jax.locate import Result
from gsc_jax.scene import Camera


@dataclasses.dataclass(frozen=True, kw_only=True)
class Located:
    """A finished run of `locate`: the scene file, the cameras looked from, and what was found."""

    scene: PlyScene
    cameras: list[Camera]
    result: Result
    stages: dict[str, dict[str, float]]
    seconds: float
    warnings: list[str]

    @property
    def visible_share(self) -> float:
        """Mean share of a view that is tampered."""
        return float(np.mean([mask.mean() for mask in self.result.masks.values()]))
