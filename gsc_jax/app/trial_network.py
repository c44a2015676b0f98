"""What a 2D network takes for a view, and whether it has to be asked at all."""

import copy
import dataclasses
import time
from collections.abc import Sequence
from typing import Any

import numpy as np

from gsc_jax.app.asked import Asked
from gsc_jax.detection import Detector
from gsc_jax.detectors.cached import CachedDetector
from gsc_jax.scene import Camera


@dataclasses.dataclass(frozen=True, kw_only=True)
class Network:
    """What a 2D network takes.

    Attributes:
        seconds: Of one view; 0 where all the views tried are kept from an earlier run.
        kept: How many of the views tried are.
        tried: Number of views tried.
    """

    seconds: float
    kept: int
    tried: int


def try_network(asked: Asked, shown: Sequence[tuple[np.ndarray, Camera]]) -> Network:
    """Asks the network about one of the views that it need not remember.

    Args:
        asked: Who is asked, a network among them. Its answer is kept for the run.
        shown: Rendered views and their cameras.

    Raises:
        InputError: if the network fails on the view.
    """
    detector = asked.detector
    assert detector is not None
    new = [(image, camera) for image, camera in shown if not _is_kept(detector, image, camera)]
    begin = time.perf_counter()
    for image, camera in new[:1]:
        detector(image, camera)
    seconds = time.perf_counter() - begin if new else 0.0
    return Network(seconds=seconds, kept=len(shown) - len(new), tried=len(shown))


def _is_kept(detector: Detector, image: np.ndarray, camera: Camera) -> bool:
    """Whether the network's answer to this image is kept from an earlier run."""
    if not isinstance(detector, CachedDetector):
        return False

    def nobody(*view: object) -> np.ndarray:
        raise LookupError(view)

    memory: Any = copy.copy(detector)
    memory.detector = nobody
    try:
        memory(image, camera)
    except LookupError:
        return False
    return True
