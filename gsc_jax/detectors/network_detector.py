"""Base class of the detectors that run networks on rendered views."""

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import ClassVar

import numpy as np

from gsc_jax.scene import Camera, InputError


class NetworkDetector(ABC):
    """A detector that computes a probability map from the image alone.

    Attributes:
        model: The model, for messages.
        needs_image: True.
        anomalies: Warning text for each anomaly in the output, with its "{count}".
        diagnostics: Counts of the anomalies by view.
    """

    needs_image = True
    anomalies: ClassVar[Mapping[str, str]] = {}

    def __init__(self, model: Path):
        self.model = model
        self.diagnostics: dict[str, dict[str, int]] = {}

    def select(self, cameras: Sequence[Camera]) -> list[Camera]:
        """All cameras, since a network accepts any image; raises InputError if there are none."""
        if not cameras:
            raise InputError(f"{self.model}: there are no cameras to run the detector on")
        return list(cameras)

    def __call__(self, image: np.ndarray | None, camera: Camera) -> np.ndarray:
        """Probability of tampering in a view at the resolution of the network, (h, w) float32.

        Raises InputError if the network fails on the image (H, W, 3) or its output is invalid.
        """
        if image is None:
            raise ValueError(f"{type(self).__name__} needs the rendered image")
        probability, self.diagnostics[camera.name] = self.detect(image, camera.name)
        return probability

    @abstractmethod
    def detect(self, image: np.ndarray, view: str) -> tuple[np.ndarray, dict[str, int]]:
        """Probability of tampering in the image of a view, and counts of anomalies."""

    @property
    def warnings(self) -> tuple[str, ...]:
        """Anomalies in the outputs of the views so far."""
        found = []
        for anomaly, text in self.anomalies.items():
            counts = {
                view: all_[anomaly] for view, all_ in self.diagnostics.items() if all_[anomaly]
            }
            if counts:
                found.append(
                    f"{self.model}: {text.format(count=sum(counts.values()))} in {len(counts)} of "
                    f"{len(self.diagnostics)} views (first in {next(iter(counts))!r})"
                )
        return tuple(found)
