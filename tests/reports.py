"""Synthetic runs of `locate` with everything that a report shows, without rendering."""

import dataclasses
from collections.abc import Sequence
from html.parser import HTMLParser
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
from strategies import camera, random_scene

from gsc_jax.cli.outputs import Located, numbers, write_report
from gsc_jax.cli.pictures import layer_path, overlay
from gsc_jax.cli.report.wording import summary
from gsc_jax.estimators.protocol import Reliability
from gsc_jax.estimators.robust.early_stopping import EarlyStopping
from gsc_jax.estimators.robust.estimator import RobustEstimator
from gsc_jax.evidence.monitor import Monitor
from gsc_jax.forensics.traces import Trace
from gsc_jax.io.masks import image_path, write_image, write_mask, write_probability
from gsc_jax.io.ply import read_ply, save_ply
from gsc_jax.locate import Result
from gsc_jax.scene import Gaussians

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


class Page(HTMLParser):
    """The elements of a page with their attributes, and its visible text."""

    def __init__(self, html: str):
        super().__init__()
        self.elements: list[tuple[str, dict[str, str]]] = []
        self.words: list[str] = []
        self.feed(html)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.elements.append((tag, {key: value or "" for key, value in attrs}))

    def handle_data(self, data: str) -> None:
        if self.cdata_elem is None:  # neither in a style sheet nor in a script
            self.words.append(data)

    @property
    def text(self) -> str:
        return " ".join(" ".join(self.words).split())

    def all(self, tag: str) -> list[dict[str, str]]:
        return [attributes for name, attributes in self.elements if name == tag]


def run(
    folder: Path, names: Sequence[str], *, size: tuple[int, int] = (64, 48), **changes: Any
) -> Located:
    """A run of `robust` with a detector; a block in the middle of the views is tampered.

    `folder` receives the scene file; `changes` are fields of the result.
    """
    labels = np.arange(COUNT) < TAMPERED
    save_ply(folder / "scene.ply", _gaussians(labels))
    width, height = size
    cameras = [dataclasses.replace(camera(width, height, focal=width), name=name) for name in names]
    masks = {name: _mask(size, i) for i, name in enumerate(names)}
    result = Result(
        tamper=np.where(labels, 0.9, 0.1).astype(np.float32),
        labels=labels,
        attribute=np.where(labels, 4, -4).astype(np.float32),
        verdict=0.97,
        reliability={name: KINDS[i % 4] for i, name in enumerate(names)},
        masks=masks,
        probabilities={
            name: np.where(np.roll(mask, 3, axis=1), 0.8, 0.1).astype(np.float16)
            for name, mask in masks.items()
        },
        seen=np.arange(COUNT) < COUNT - 7,
        group_sizes=np.zeros((0, 3), np.int32),
        rank=0.02,
        early_stopping=EarlyStopping(
            views=len(names), available=3 * len(names), changes=(0.3, 0.0125)
        ),
        prior=_prior(),
        estimator=RobustEstimator(),
        stages={"attributes": {"seconds": 7.5, "peak_mib": 1234.5}},
        seconds=12.34,
        warnings=["The <b>masks</b> disagree."],
    )
    return Located(
        scene=read_ply(folder / "scene.ply"),
        cameras=cameras,
        result=dataclasses.replace(result, **changes),
        inputs={"scene.ply": {"bytes": 12345, "sha256": "5a" * 32}},
    )


def summarised(located: Located) -> list[str]:
    """The lines that the terminal shows of a run."""
    return summary(numbers({}, located), Path("out"))


def write(folder: Path, located: Located, *, pictures: bool = True) -> Page:
    """Write the images of a report in plain colours, and the report."""
    result = located.result
    for name, mask in result.masks.items():
        write_mask(image_path(folder / "masks", name), mask)
        if name in result.probabilities:
            write_probability(image_path(folder / "detector", name), result.probabilities[name])
        if pictures:
            render = np.full((*mask.shape, 3), GREEN, np.float32)
            write_image(layer_path(folder, "render", name), render)
            write_image(layer_path(folder, "overlay", name), overlay(render, mask))
    command = {"scene": Path("some <i>scene</i>.ply"), "views": None}
    write_report(folder, command, located, monitor=Monitor())
    return Page((folder / "report.html").read_text(encoding="utf-8"))


def _gaussians(labels: np.ndarray) -> Gaussians:
    """Tampered Gaussians are smaller and more saturated."""
    scene, shift = random_scene(len(labels)), labels.astype(np.float32)
    log_scales = scene.log_scales - 2 * shift[:, None]
    return dataclasses.replace(
        scene, log_scales=log_scales, sh=scene.sh * (1 + shift[:, None, None])
    )


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


def _prior() -> Any:
    """A prior with traces, like the forensic evidence of the attributes."""
    score = (np.arange(COUNT) < TAMPERED).astype(np.float32)
    traces = (
        Trace(name="copy-move", score=0 * score, explanation="No part occurs again."),
        Trace(name="quantisation", score=score, explanation="100 of 400 Gaussians are off."),
    )
    own = 0.1 + 0.7 * score + 0.1 * np.linspace(0, 1, COUNT)
    return SimpleNamespace(verdict=0.83, traces=traces, probability=own, known=np.ones(COUNT, bool))
