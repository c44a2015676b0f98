"""What a 2D network takes for a view, and whether it has to be asked at all."""

import dataclasses
import time
from collections.abc import Sequence

import numpy as np

from gsc_jax.cli.detector_choice import Asked
from gsc_jax.detectors.cache import CachedDetector
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
    kept = detector.holds if isinstance(detector, CachedDetector) else lambda _: False
    new = [one for one in shown if not kept(one[0])]
    begin = time.perf_counter()
    for image, camera in new[:1]:
        detector(image, camera)
    seconds = time.perf_counter() - begin if new else 0.0
    return Network(seconds=seconds, kept=len(shown) - len(new), tried=len(shown))
