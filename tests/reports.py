"""Synthetic runs of `locate` with everything that a report shows, without rendering."""

import dataclasses
from collections.abc import Sequence
from html.parser import HTMLParser
from pathlib import Path
from typing import Any

import numpy as np

from gsc_jax.cli.located import Located
from gsc_jax.cli.outputs import write_report
from gsc_jax.cli.pictures import jpeg_path, overlay, write_jpeg
from gsc_jax.estimators.protocol import Prior, Reliability
from gsc_jax.estimators.robust.early_stopping import EarlyStopping
from gsc_jax.estimators.robust.estimator import RobustEstimator
from gsc_jax.forensics.traces import Trace
from gsc_jax.io.masks import image_path, write_mask, write_probability
from gsc_jax.io.ply import read_ply, save_ply
from gsc_jax.locate import Result
from gsc_jax.scene import Camera, Gaussians
from gsc_jax.scene.camera import intrinsics

COUNT, TAMPERED = 400, 100
KINDS: tuple[Reliability, ...] = ("reliable", "uninformative", "inverted", "unseen")
GREEN = (0.1, 0.6, 0.2)
"""The colour of every render."""
HOSTILE = (
    "folder/a view.with dots",
    "<script>document.title='pwned'</script>",
    "\"quoted\" 'name' onerror=alert(1)",
    "100%#fragment?query=1&amp;x",
    "javascript:alert(1)",
    "</style></script><!-- ü ☃",
    "right\u202eleft",
    "{{ 7 * 7 }} ${7 * 7}",
)
"""Names of cameras that attack the page or its links."""


@dataclasses.dataclass(frozen=True, kw_only=True)
class TracedPrior(Prior):
    """A prior with traces, like the forensic evidence of the attributes."""

    traces: tuple[Trace, ...]


class Page(HTMLParser):
    """The elements of a page with their attributes, and its visible text."""

    def __init__(self, html: str):
        super().__init__()
        self.elements: list[tuple[str, dict[str, str]]] = []
        self.words: list[str] = []
        self._inside = ""
        self.feed(html)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self._inside = tag
        self.elements.append((tag, {key: value or "" for key, value in attrs}))

    def handle_data(self, data: str) -> None:
        if self._inside not in ("style", "script"):
            self.words.append(data)

    def handle_endtag(self, tag: str) -> None:
        del tag
        self._inside = ""

    @property
    def text(self) -> str:
        return " ".join(" ".join(self.words).split())

    def all(self, tag: str) -> list[dict[str, str]]:
        return [attributes for name, attributes in self.elements if name == tag]


def run(
    folder: Path, names: Sequence[str], *, size: tuple[int, int] = (64, 48), **changes: Any
) -> Located:
    """A run of `robust` with a detector; a block in the middle of the views is tampered.

    Args:
        folder: Folder for the scene file.
        names: Names of the cameras.
        size: Width and height of the views.
        changes: Fields of the result, or `warnings`.
    """
    rng = np.random.default_rng(0)
    labels = np.arange(COUNT) < TAMPERED
    save_ply(folder / "scene.ply", _gaussians(rng, labels))
    cameras = [_camera(name, size) for name in names]
    masks = {name: _mask(size, i) for i, name in enumerate(names)}
    attribute = np.where(labels, 4, -4) + rng.normal(size=COUNT)
    result = Result(
        tamper=np.where(labels, 0.9, 0.1).astype(np.float32),
        labels=labels,
        attribute=attribute.astype(np.float32),
        verdict=0.97,
        reliability={name: KINDS[i % 4] for i, name in enumerate(names)},
        masks=masks,
        probabilities={name: _probability(mask) for name, mask in masks.items()},
        seen=np.arange(COUNT) < COUNT - 7,
        group_sizes=np.zeros((0, 3), np.int32),
        early_stopping=EarlyStopping(
            views=len(names), available=3 * len(names), changes=(0.3, 0.0125)
        ),
        prior=_prior(),
        estimator=RobustEstimator(),
        stages={},
        seconds=1.0,
        warnings=[],
    )
    warnings = changes.pop("warnings", ["The <b>masks</b> disagree."])
    return Located(
        scene=read_ply(folder / "scene.ply"),
        cameras=cameras,
        result=dataclasses.replace(result, **changes),
        stages={"load": _stage(0.26), "attributes": _stage(7.5), "write": _stage(3.25)},
        seconds=12.34,
        warnings=warnings,
    )


def write(folder: Path, located: Located, *, pictures: bool = True) -> Page:
    """Write the images of a report in plain colours, and the report."""
    result = located.result
    for camera in located.cameras:
        name, mask = camera.name, result.masks[camera.name]
        write_mask(image_path(folder / "masks", name), mask)
        if name in result.probabilities:
            write_probability(image_path(folder / "detector", name), result.probabilities[name])
        if pictures:
            render = np.full((*mask.shape, 3), GREEN, np.float32)
            write_jpeg(jpeg_path(folder / "render", name), render)
            write_jpeg(jpeg_path(folder / "overlay", name), overlay(render, mask))
    write_report(folder, {"scene": Path("some <i>scene</i>.ply"), "views": None}, located)
    return Page((folder / "report.html").read_text(encoding="utf-8"))


def _gaussians(rng: np.random.Generator, labels: np.ndarray) -> Gaussians:
    """Tampered Gaussians are smaller and more saturated."""
    count, shift = len(labels), labels.astype(np.float32)
    return Gaussians(
        means=rng.normal(size=(count, 3)).astype(np.float32),
        log_scales=rng.normal(-3, 0.5, (count, 3)).astype(np.float32) - shift[:, None],
        quats=rng.normal(size=(count, 4)).astype(np.float32),
        logit_opacities=rng.normal(size=count).astype(np.float32),
        sh=rng.normal(size=(count, 4, 3)).astype(np.float32) * (1 + shift[:, None, None]),
    )


def _camera(name: str, size: tuple[int, int]) -> Camera:
    K, viewmat = intrinsics(size[0], *size), np.eye(4, dtype=np.float32)
    return Camera(viewmat=viewmat, K=K, width=size[0], height=size[1], name=name)


def _mask(size: tuple[int, int], index: int) -> np.ndarray:
    """A block in the middle that grows with the index; every fourth mask is empty."""
    width, height = size
    mask = np.zeros((height, width), bool)
    if index % 4 < 3:
        share = 0.2 + 0.6 * (index % 8) / 8
        y, x = height // 2, width // 2
        rows, columns = int(share * y), int(share * x)
        mask[y - rows : y + rows, x - columns : x + columns] = True
    return mask


def _probability(mask: np.ndarray) -> np.ndarray:
    return np.where(np.roll(mask, 3, axis=1), 0.8, 0.1).astype(np.float16)


def _prior() -> TracedPrior:
    nothing = np.zeros(COUNT, np.float32)
    score = np.where(np.arange(COUNT) < TAMPERED, 0.9, 0).astype(np.float32)
    return TracedPrior(
        probability=score,
        verdict=0.83,
        known=np.ones(COUNT, bool),
        traces=(
            Trace(name="copy-move", score=nothing, explanation="No part occurs again."),
            Trace(name="quantisation", score=score, explanation="100 of 400 Gaussians are off."),
        ),
    )


def _stage(seconds: float) -> dict[str, float]:
    return {"seconds": seconds, "peak_mib": 1234.5}
