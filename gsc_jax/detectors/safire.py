"""SAFIRE, an encoder and a point-prompted decoder, as a 2D detector.

SAFIRE (Kwon et al., "Segment Any Forged Image Region", AAAI 2025) builds on SAM. The encoder
computes embeddings of the image; for a point, the decoder segments the part of the image that has
the same source. From its test code: input size 1024 without keeping the aspect ratio, the channel
statistics of SAM, a grid of 16 x 16 single-point prompts, and `safire_regions`.

Two ONNX files, whose tensors are identified by position and listed below (docs/detectors.md).
"""

import functools
from collections.abc import Sequence
from pathlib import Path
from typing import ClassVar

import numpy as np

from gsc_jax.detectors import network
from gsc_jax.detectors.preprocessing import fit_image, to_tensor
from gsc_jax.detectors.safire_regions import forged_region, point_grid
from gsc_jax.detectors.session import CPU, fingerprint
from gsc_jax.detectors.specs import OnnxSpec
from gsc_jax.scene import InputError

FILES = ("encoder.onnx", "decoder.onnx")
SIDE_PIXELS = 1024
"""Input size of SAM, for an encoder with a free size."""
PROMPTS_PER_BATCH = 4
"""For a decoder with a free number. SAM's needs 55 MB per prompt; more do not help a CPU."""

SAM = OnnxSpec(scale=255.0, mean=(123.675, 116.28, 103.53), std=(58.395, 57.12, 57.375))
"""Channel statistics of SAM, for levels 0 to 255."""

IMAGE = network.TensorSpec("image", (1, 3, "S", "S"))
EMBEDDINGS = network.TensorSpec("embeddings", (1, "C", "H", "W"))
POINT_COORDS = network.TensorSpec("point_coords", ("P", 1, 2))  # x and y in pixels of the image
POINT_LABELS = network.TensorSpec("point_labels", ("P", 1), network.NUMBERS)  # 1: foreground
MASKS = network.TensorSpec("masks (one per point)", ("P", 1, None, None))  # logits
CONFIDENCES = network.TensorSpec("confidences (one per point)", ("P", 1))


class SafireDetector(network.NetworkDetector):
    """A 2D detector that runs SAFIRE on the rendered views."""

    anomalies: ClassVar = {
        "one_source": "the most confident mask was taken, as all masks are of one source,",
        "unusable": "{count} masks are empty or not finite and were ignored",
    }

    def __init__(
        self,
        folder_or_encoder: str | Path,
        decoder: str | Path | None = None,
        *,
        grid: int = 16,
        seed: int = 0,
        providers: Sequence[str] = CPU,
        threads: int = 0,
    ):
        """Load encoder.onnx and decoder.onnx of a folder, or an encoder and a decoder.

        The `grid` is the number of prompts per side of the image, at least 2, and the `seed` that
        of the clustering of the masks; `open_session` explains the others. InputError if a file is
        no valid model, or its tensors differ from those above.
        """
        if not (isinstance(grid, int) and grid >= 2):
            raise InputError(f"SAFIRE: grid is {grid!r}, expected 2 or more points per side")
        self.encoder, self.decoder = _model_files(Path(folder_or_encoder), decoder)
        super().__init__(self.decoder)
        self.grid, self.seed = grid, seed
        run = {"providers": providers, "threads": threads}
        self._encoder = network.Network(self.encoder, [IMAGE], {0: EMBEDDINGS}, **run)
        inputs = [EMBEDDINGS, POINT_COORDS, POINT_LABELS]
        self._decoder = network.Network(self.decoder, inputs, {0: MASKS, 1: CONFIDENCES}, **run)
        given, taken = self._encoder.outputs[0].shape, self._decoder.inputs[0].shape
        if given and not network.fits(taken, given, {}):
            raise InputError(
                f"{self.decoder}: takes embeddings of shape {network.shape_text(taken)}, "
                f"the encoder gives {network.shape_text(given)}; export both from one network"
            )
        self._side = self._encoder.sides.get("S", SIDE_PIXELS)
        self._batch = self._decoder.sides.get("P") or PROMPTS_PER_BATCH

    def detect(self, image: np.ndarray, view: str) -> tuple[np.ndarray, dict[str, int]]:
        """Probability map (S, S), and the counts of `forged_region`."""
        square, _ = fit_image(image, (self._side, self._side), fit="resize")
        (embeddings,) = self._encoder.run(to_tensor(square, SAM), view=view)
        points = point_grid(self.grid, side=self._side)
        labels = np.ones((self._batch, 1), np.float32)
        runs = []
        for start in range(0, len(points), self._batch):
            # Repeats of the last point fill the last batch, since the batch size may be fixed.
            rows = np.arange(start, start + self._batch).clip(max=len(points) - 1)
            runs.append(self._decoder.run(embeddings, points[rows, None], labels, view=view))
        masks, sure = (np.concatenate(parts)[: len(points), 0] for parts in zip(*runs, strict=True))
        return forged_region(masks, sure, embeddings[0], side=self._side, seed=self.seed)

    @functools.cached_property
    def fingerprint(self) -> str:
        """Key for `CachedDetector`: a digest of everything that determines the map of an image."""
        options = ("safire", self.grid, self.seed, self._side, self._batch)
        encoder = fingerprint(self.encoder, options, self._encoder.providers)
        return encoder + fingerprint(self.decoder, self._decoder.providers)


def _model_files(folder: Path, decoder: str | Path | None) -> tuple[Path, Path]:
    """Paths of encoder and decoder; given files are checked when they are loaded."""
    if decoder is not None:  # then the other path is the encoder
        return folder, Path(decoder)
    if missing := [name for name in FILES if not (folder / name).is_file()]:
        found = f"holds no {' and no '.join(missing)}" if folder.is_dir() else "is not a folder"
        raise InputError(
            f"{folder}: {found}, expected a folder with {' and '.join(FILES)} (SAFIRE is two "
            "networks, see docs/detectors.md), or the encoder and the decoder as two files"
        )
    return folder / FILES[0], folder / FILES[1]
