"""A finished run of `locate`, the input of the report and of the summary."""

import dataclasses

from gsc_jax.io.ply import PlyScene
from gsc_jax.locate import Result
from gsc_jax.scene import Camera


@dataclasses.dataclass(frozen=True, kw_only=True)
class Located:
    """A finished run of `locate`; the masks of the result are files in the folder by now.

    Attributes:
        cameras: The views that have a mask in the result.
        stages: Seconds and peak memory in MiB of each stage, reading and writing included.
        seconds: Wall time, reading and writing included.
        visible_share: Tampered share of a view, averaged over the views.
    """

    scene: PlyScene
    cameras: list[Camera]
    result: Result
    stages: dict[str, dict[str, float]]
    seconds: float
    warnings: list[str]
    visible_share: float
