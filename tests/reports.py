"""Made runs of `locate` with all that a report tells of, without rendering anything."""

import dataclasses
from collections.abc import Sequence
from html.parser import HTMLParser
from pathlib import Path
from typing import Any

import numpy as np

from gsc_jax.cli.located import Located
from gsc_jax.cli.outputs import write_report
from gsc_jax.cli.pictures import jpeg_path, overlay, write_jpeg
from gsc_jax.estimators.protocol import Reliability
from gsc_jax.estimators.robust.early_stopping import Effort
from gsc_jax.estimators.robust.estimator import RobustConfig
from gsc_jax.forensics.evidence import Native
from gsc_jax.forensics.traces import Trace
from gsc_jax.io.masks import image_path, write_mask, write_probability
from gsc_jax.io.ply import read_ply, save_ply
from gsc_jax.locate import Result
from gsc_jax.scene import Camera, Gaussians

COUNT, FOUND = 400, 100
WORTHS: tuple[Reliability, ...] = ("finds", "misses", "inverted", "unseen")
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
"""Names that no file is called, unless somebody means harm."""


class Page(HTMLParser):
    """The elements of a page with their attributes, and all of the text that people read."""

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
    """A run of `robust` with a detector, in which a block in the middle of each view was found.

    Args:
        folder: Where the scene is kept.
        names: Of the cameras.
        size: Width and height of the views.
        changes: Fields of the result, or `warnings`.
    """
    rng = np.random.default_rng(0)
    labels = np.arange(COUNT) < FOUND
    save_ply(folder / "scene.ply", _gaussians(rng, labels))
    cameras = [_camera(name, size) for name in names]
    masks = {name: _mask(size, i) for i, name in enumerate(names)}
    attribute = np.where(labels, 4, -4) + rng.normal(size=COUNT)
    result = Result(
        tamper=np.where(labels, 0.9, 0.1).astype(np.float32),
        labels=labels,
        attribute=attribute.astype(np.float32),
        verdict=0.97,
        reliability={name: WORTHS[i % 4] for i, name in enumerate(names)},
        masks=masks,
        detections={name: _said(mask) for name, mask in masks.items()},
        seen=np.arange(COUNT) < COUNT - 7,
        group_sizes=np.zeros((0, 3), np.int32),
        effort=Effort(views=len(names), available=3 * len(names), changes=(0.3, 0.0125)),
        native=_native(),
        method="robust",
        config=RobustConfig(),
        stages={},
        seconds=1.0,
        warnings=[],
    )
    warnings = changes.pop("warnings", ["The <b>masks</b> disagree."])
    return Located(
        scene=read_ply(folder / "scene.ply"),
        cameras=cameras,
        result=dataclasses.replace(result, **changes),
        stages={"load": _stage(0.26), "native": _stage(7.5), "write": _stage(3.25)},
        seconds=12.34,
        warnings=warnings,
    )


def write(folder: Path, located: Located, *, pictures: bool = True) -> Page:
    """Writes what `write_results` writes for a report, in plain colours, and the report."""
    result = located.result
    for camera in located.cameras:
        name, mask = camera.name, result.masks[camera.name]
        write_mask(image_path(folder / "masks", name), mask)
        if name in result.detections:
            write_probability(image_path(folder / "detector", name), result.detections[name])
        if pictures:
            render = np.full((*mask.shape, 3), GREEN, np.float32)
            write_jpeg(jpeg_path(folder / "render", name), render)
            write_jpeg(jpeg_path(folder / "overlay", name), overlay(render, mask))
    write_report(folder, {"scene": Path("some <i>scene</i>.ply"), "views": None}, located)
    return Page((folder / "report.html").read_text(encoding="utf-8"))


def _gaussians(rng: np.random.Generator, labels: np.ndarray) -> Gaussians:
    """Tampered ones are small and gaudy."""
    count, shift = len(labels), labels.astype(np.float32)
    return Gaussians(
        means=rng.normal(size=(count, 3)).astype(np.float32),
        log_scales=rng.normal(-3, 0.5, (count, 3)).astype(np.float32) - shift[:, None],
        quats=rng.normal(size=(count, 4)).astype(np.float32),
        logit_opacities=rng.normal(size=count).astype(np.float32),
        sh=rng.normal(size=(count, 4, 3)).astype(np.float32) * (1 + shift[:, None, None]),
    )


def _camera(name: str, size: tuple[int, int]) -> Camera:
    width, height = size
    intrinsics = np.array([[width, 0, width / 2], [0, width, height / 2], [0, 0, 1]], np.float32)
    return Camera(
        viewmat=np.eye(4, dtype=np.float32), K=intrinsics, width=width, height=height, name=name
    )


def _mask(size: tuple[int, int], which: int) -> np.ndarray:
    """A block in the middle, the larger the later the view; every fourth view is without."""
    width, height = size
    mask = np.zeros((height, width), bool)
    if which % 4 < 3:
        share = 0.2 + 0.6 * (which % 8) / 8
        y, x = height // 2, width // 2
        rows, columns = int(share * y), int(share * x)
        mask[y - rows : y + rows, x - columns : x + columns] = True
    return mask


def _said(mask: np.ndarray) -> np.ndarray:
    return np.where(np.roll(mask, 3, axis=1), 0.8, 0.1).astype(np.float16)


def _native() -> Native:
    odds, nothing = np.full(COUNT, -2, np.float32), np.zeros(COUNT, np.float32)
    found = np.where(np.arange(COUNT) < FOUND, 0.9, 0).astype(np.float32)
    return Native(
        known=np.ones(COUNT, bool),
        learned=odds,
        learned_verdict=0.6,
        log_odds=odds,
        base=-2.0,
        worst=-1.0,
        verdict=0.83,
        traces=(
            Trace(name="copied", score=nothing, explanation="No part occurs again."),
            Trace(name="lattice", score=found, explanation="100 of 400 Gaussians are off."),
        ),
    )


def _stage(seconds: float) -> dict[str, float]:
    return {"seconds": seconds, "peak_mib": 1234.5}
