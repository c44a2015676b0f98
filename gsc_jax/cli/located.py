"""A finished run of `locate`, the input of the report and of the summary."""

import dataclasses

import numpy as np

from gsc_jax.io.ply import PlyScene
from gsc_jax.locate import Result
from gsc_jax.scene import Camera


@dataclasses.dataclass(frozen=True, kw_only=True)
class Located:
    """A finished run of `locate`.

    Attributes:
        cameras: The views that have a mask in the result.
        stages: Seconds and peak memory in MiB of each stage, reading and writing included.
        seconds: Wall time, reading and writing included.
    """

    scene: PlyScene
    cameras: list[Camera]
    result: Result
    stages: dict[str, dict[str, float]]
    seconds: float
    warnings: list[str]

    @property
    def visible_share(self) -> float:
        """Tampered share of a view, averaged over the views."""
        return float(np.mean([mask.mean() for mask in self.result.masks.values()]))
