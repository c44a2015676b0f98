"""SAFIRE: an encoder and a decoder prompted by points, as a 2D detector.

SAFIRE (Kwon et al., "Segment Any Forged Image Region", AAAI 2025) is built on SAM: the encoder
turns the image into embeddings, once; the decoder says, for a point, which part of the image comes
from the same source. From its test code are the size of 1024 without keeping the aspect, SAM's
statistics of the channels, one foreground prompt at a time on a grid of 16 x 16, and the reading of
the masks, see `gsc_jax.detectors.sources`.

It is run from two ONNX files, whose tensors are known by their places; names are free:

| file | place | tensor | shape | type |
|---|---|---|---|---|
| encoder | input 0 | image, RGB, SAM's statistics | [1, 3, S, S] | float |
| | output 0 | embeddings | [1, C, H, W] | float |
| decoder | input 0 | embeddings | [1, C, H, W] | float |
| | input 1 | point_coords, x and y in pixels of S | [P, 1, 2] | float |
| | input 2 | point_labels, 1 | [P, 1] | float, int32, int64 |
| | output 0 | masks, logits | [P, 1, h, w] | float |
| | output 1 | confidences | [P, 1] | float |

Float is float32 or float16; S is 1024 where the encoder leaves it open; P may be open or any fixed
number; H divides h and W divides w; more outputs are ignored. docs/detectors.md tells how to export
them. Ours besides: the image is resized with a low-pass filter and not rounded to 8 bits.
"""

import functools
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from gsc_jax.detectors import sources
from gsc_jax.detectors.fitting import fit_image, to_tensor
from gsc_jax.detectors.ports import NUMBERS, Network, Port, compatible, shape_text
from gsc_jax.detectors.session import CPU, fingerprint, some
from gsc_jax.detectors.specs import OnnxSpec
from gsc_jax.scene import Camera, InputError

Size = tuple[int, ...]

FILES = ("encoder.onnx", "decoder.onnx")

SIZE = 1024
PROMPTS_AT_ONCE = 4
"""Where the decoder leaves it open. SAM's holds 55 MB for each; a CPU gains no time by more."""

SAM = OnnxSpec(scale=255.0, mean=(123.675, 116.28, 103.53), std=(58.395, 57.12, 57.375))
"""SAM's statistics of the channels, of levels 0 to 255."""

IMAGE = Port("image", (1, 3, None, None))
EMBEDDINGS = Port("embeddings", (1, None, None, None))
POINT_COORDS = Port("point_coords", (None, 1, 2))
POINT_LABELS = Port("point_labels", (None, 1), NUMBERS)
MASKS = Port("masks (one per point)", (None, 1, None, None))
CONFIDENCES = Port("confidences (one per point)", (None, 1))


class SafireDetector:
    """A 2D detector that runs SAFIRE on the rendered views.

    Attributes:
        encoder: The file of the encoder.
        decoder: The file of the decoder.
        grid: Prompts per side of the image.
        seed: Of the clustering.
        needs_image: True.
        notes: By view, in counts, what is odd about its output; `warnings` sums them up.
    """

    needs_image = True

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
        """Loads the two networks and checks their inputs and outputs.

        Args:
            folder_or_encoder: A folder with encoder.onnx and decoder.onnx, or the encoder alone.
            decoder: The decoder, unless a folder is given.
            grid: Prompts per side of the image, at least 2.
            seed: Of the clustering of the masks.
            providers: onnxruntime's execution providers, the preferred one first, by their names
                or as people say them ("cuda").
            threads: Threads of one inference, 0 for all the cores.

        Raises:
            InputError: If a file is no model that can be loaded, or its tensors do not fit.
        """
        if not (isinstance(grid, int) and grid >= 2):
            raise InputError(f"SAFIRE: grid is {grid!r}, expected 2 or more points per side")
        self.encoder, self.decoder = _files(Path(folder_or_encoder), decoder)
        self.grid, self.seed = grid, seed
        given = {"providers": providers, "threads": threads}
        self._encoder = Network(self.encoder, [IMAGE], [EMBEDDINGS], **given)
        self._decoder = Network(
            self.decoder,
            [EMBEDDINGS, POINT_COORDS, POINT_LABELS],
            [MASKS, CONFIDENCES],
            **given,
        )
        self._side = self._checked_side()
        self._batch = self._checked_batch()
        self.notes: dict[str, dict[str, int]] = {}

    def select(self, cameras: Sequence[Camera]) -> list[Camera]:
        """All the cameras: a network can speak on any image.

        Raises:
            InputError: If there are none.
        """
        return some(cameras, self.encoder)

    def __call__(self, image: np.ndarray | None, camera: Camera) -> np.ndarray:
        """The probability of tampering in a view.

        Args:
            image: The rendered view in [0, 1], shape (H, W, 3) float32.
            camera: Its camera; only the name is used, in messages.

        Returns:
            Probability in [0, 1], shape (S, S) float32, covering the whole view; 0 everywhere where
            nothing is flagged.

        Raises:
            InputError: If a network fails on the image or gives other tensors than expected.
        """
        if image is None:
            raise ValueError("a SafireDetector needs the rendered image")
        square, _ = fit_image(image, (self._side, self._side), fit="resize")
        (embeddings,) = self._encoder.run(to_tensor(square, SAM), view=camera.name)
        logits, confidences = self._decode(embeddings, camera.name)
        probability, self.notes[camera.name] = sources.forged_region(
            logits, confidences, embeddings[0], side=self._side, seed=self.seed
        )
        return probability

    @property
    def warnings(self) -> tuple[str, ...]:
        """Where nothing was flagged, and why, and predictions that were left out."""
        found = []
        for name, reason in {
            "one_source": "all masks belong to one group, so the image looks like of one source",
            "unsure": f"a confidence is not above {sources.MIN_CONFIDENCE}",
        }.items():
            views = [view for view, note in self.notes.items() if note[name]]
            if views:
                found.append(
                    f"{self.decoder}: nothing flagged in {len(views)} of {len(self.notes)} views, "
                    f"because {reason} (first in {views[0]!r})"
                )
        views = [view for view, note in self.notes.items() if note["unusable"]]
        if views:
            total = sum(note["unusable"] for note in self.notes.values())
            found.append(
                f"{self.decoder}: {total} of {self.grid**2 * len(self.notes)} masks are empty or "
                f"not finite and were left out, in {len(views)} of {len(self.notes)} views (first "
                f"in {views[0]!r})"
            )
        return tuple(found)

    @functools.cached_property
    def fingerprint(self) -> str:
        """What decides its output besides the image, as a key for `CachedDetector`."""
        options = ("safire", self.grid, self.seed, self._side, self._batch)
        return fingerprint(self.encoder, options, self._encoder.providers) + fingerprint(
            self.decoder, self._decoder.providers
        )

    def _checked_side(self) -> int:
        """S, of an encoder and a decoder that belong together."""
        height, width = self._encoder.takes(0)[2:]
        fixed = [side for side in (height, width) if isinstance(side, int)]
        if len(set(fixed)) > 1:
            raise InputError(
                f"{self.encoder}: the image is {shape_text([height, width])}, expected a square; "
                f"export it for [{SIZE}, {SIZE}]"
            )
        given, taken = self._encoder.gives(0), self._decoder.takes(0)
        if given and not compatible(given, taken):
            raise InputError(
                f"{self.decoder}: takes embeddings of shape {shape_text(taken)}, the encoder gives "
                f"{shape_text(given)}; export both from one network"
            )
        return fixed[0] if fixed else SIZE

    def _checked_batch(self) -> int:
        """How many prompts the decoder is given at once."""
        stated = [self._decoder.takes(place)[0] for place in (1, 2)]
        fixed = [count for count in stated if isinstance(count, int)]
        if len(set(fixed)) > 1 or 0 in fixed:
            raise InputError(
                f"{self.decoder}: takes {stated[0]} points with {stated[1]} labels, expected as "
                "many of both; export it with one number of prompts"
            )
        return fixed[0] if fixed else PROMPTS_AT_ONCE

    def _decode(self, embeddings: np.ndarray, view: str) -> tuple[np.ndarray, np.ndarray]:
        """Masks (P, h, w) and confidences (P,) of the whole grid, a batch of prompts at a time."""
        points = sources.point_grid(self.grid, side=self._side)
        labels = np.ones((self._batch, 1), np.float32)
        masks, confidences = [], []
        for start in range(0, len(points), self._batch):
            # The last batch is filled up, for a decoder with a fixed number of prompts.
            places = np.arange(start, start + self._batch).clip(max=len(points) - 1)
            some, trust = self._decoder.run(embeddings, points[places, None], labels, view=view)
            self._check_masks(some.shape, trust.shape, embeddings.shape)
            masks.append(some[:, 0])
            confidences.append(trust[:, 0])
        count = len(points)
        return np.concatenate(masks)[:count], np.concatenate(confidences)[:count]

    def _check_masks(self, masks: Size, confidences: Size, embeddings: Size) -> None:
        found = f"{self.decoder}: gives masks {shape_text(masks)}"
        if not masks[0] == confidences[0] == self._batch:
            raise InputError(
                f"{found} and confidences {shape_text(confidences)} of {self._batch} points, "
                "expected one of each per point; export it with every point as a prompt of its own"
            )
        if masks[2] % embeddings[2] or masks[3] % embeddings[3]:
            raise InputError(
                f"{found} of embeddings {shape_text(embeddings)}, expected sides that are "
                "multiples of theirs; export the decoder with its own low resolution"
            )


def _files(folder_or_encoder: Path, decoder: str | Path | None) -> tuple[Path, Path]:
    """Encoder and decoder; what is wrong with them as files is said when they are loaded."""
    if decoder is not None:
        return folder_or_encoder, Path(decoder)
    encoder, beside = (folder_or_encoder / name for name in FILES)
    if not folder_or_encoder.is_dir():
        found = "is a file" if folder_or_encoder.exists() else "does not exist"
        raise InputError(
            f"{folder_or_encoder}: {found}, expected a folder with {' and '.join(FILES)} (SAFIRE "
            "is two networks); give the folder, or the decoder as well"
        )
    missing = [path.name for path in (encoder, beside) if not path.is_file()]
    if missing:
        raise InputError(
            f"{folder_or_encoder}: holds no {' and no '.join(missing)}, expected "
            f"{' and '.join(FILES)}; export SAFIRE as docs/detectors.md says"
        )
    return encoder, beside
