"""The HTML of the report: complete, escaped, without network."""

import base64
import dataclasses
import hashlib
import json
import re
from pathlib import Path
from urllib.parse import unquote

import imageio.v3 as iio
import numpy as np
import pytest
from reports import HOSTILE, KINDS, Page, run, write
from scipy.ndimage import binary_dilation
from skimage.util import img_as_ubyte

from gsc_jax import render
from gsc_jax.cli.outputs import write_report, write_results
from gsc_jax.cli.report import wording
from gsc_jax.cli.report.thumbnails import LAYERS
from gsc_jax.estimators import METHODS
from gsc_jax.evidence.masks import RENDER, SCORE
from gsc_jax.evidence.monitor import Monitor
from gsc_jax.evidence.storage import ArrayStore

NAMES = [f"view {i:02}" for i in range(8)]


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("report")
    write(folder, run(tmp_path_factory.mktemp("scene"), NAMES))
    return folder


@pytest.fixture(scope="module")
def page(folder: Path) -> Page:
    return Page((folder / "report.html").read_text(encoding="utf-8"))


def thumbnails(page: Page) -> list[dict[str, str]]:
    return [image for image in page.all("img") if "data-layer" in image]


def test_every_view_has_all_layers(page: Page):
    images = thumbnails(page)
    assert [image["data-layer"] for image in images] == [*LAYERS] * len(NAMES)
    shown = [image["alt"].rpartition(" of ")[2] for image in images]
    assert sorted(shown) == sorted(np.repeat(NAMES, 4).tolist())
    for name, image in zip(shown, images, strict=True):
        assert name in unquote(image["data-full"])
        assert image["src"].startswith("data:image/")


def test_the_reasons_stand_above_the_views(tmp_path: Path):
    located = dataclasses.replace(run(tmp_path, NAMES), contrasts={"size": 0.02})
    page = write(tmp_path, located)
    first, _, _ = page.text.partition("1 warning")
    for text in (
        "100 of 400 Gaussians are off.",
        "by the attributes alone, 83%",
        "smaller in 98% of the pairs",
        "It rests on the masks and on a trace",
    ):
        assert text in first, text
    assert json.loads((tmp_path / "result.json").read_text())["contrasts"] == {"size": 0.02}


def test_every_number_of_the_result_is_on_the_page(folder: Path, page: Page):
    report = json.loads((folder / "result.json").read_text())
    for text in (
        wording.headline(0.97, 100),
        "97% scene probability",
        "100 of 400 Gaussians (25.0%) are labelled as tampered",
        wording.share(report["tampered_share_of_views"]),
        "scene probability of 83%",
        "100 of 400 Gaussians are off.",
        "No part occurs again.",
        "8 of 24 used.",
        "12.3 s before this page was written",
        "7.50 s, peak 1,234 MiB",
        "393",  # seen
    ):
        assert text in page.text, text
    for view in report["per_view"]:
        assert f"{wording.share(view['tampered_share'])} tampered" in page.text
        assert f"detector {wording.share(view['detector_share'])}" in page.text
    for kind in KINDS:
        assert page.text.count(wording.RELIABILITY[kind][1]) >= 3, "two views and one count"
    for key, value in {**report["config"], **report["versions"], "seed": 0}.items():
        assert f"{key} {value if isinstance(value, str) else json.dumps(value)}" in page.text


def test_every_file_is_linked(folder: Path, page: Page):
    links = {unquote(link["href"]) for link in page.all("a") if "href" in link}
    for name in json.loads((folder / "result.json").read_text())["outputs"]:
        top, _, rest = name.partition("/")
        assert (f"{top}/" if rest else top) in links
    for link in links:
        assert (folder / link).exists(), link


def test_nothing_is_loaded_from_elsewhere_and_no_other_script_can_run(folder: Path, page: Page):
    html = (folder / "report.html").read_text(encoding="utf-8")
    script = re.findall(r"<script>(.*?)</script>", html, flags=re.DOTALL)
    assert len(script) == len(page.all("script")) == 1
    expected = base64.b64encode(hashlib.sha256(script[0].encode()).digest()).decode()
    policy = next(meta["content"] for meta in page.all("meta") if "http-equiv" in meta)
    assert f"script-src 'sha256-{expected}'" in policy
    assert "default-src 'none'" in policy
    assert "http" not in policy
    assert not re.search(r"(?:https?:)?//[a-z]", html), "an address of the network"
    assert not any(key.startswith("on") for _, attributes in page.elements for key in attributes)


def test_the_same_run_gives_the_same_page(tmp_path: Path):
    located = run(tmp_path, NAMES[:2])
    pages = []
    for _ in range(2):
        write(tmp_path / "out", located)
        html = (tmp_path / "out" / "report.html").read_text(encoding="utf-8")
        pages.append(re.sub(r"\d{4}-\d\d-\d\d(T[\d:+]+)?", "", html))
    assert pages[0] == pages[1]


def test_hostile_names_are_escaped_and_their_images_are_found(tmp_path: Path):
    page = write(tmp_path / "out", run(tmp_path, HOSTILE, warnings=list(HOSTILE)))
    assert len(page.all("script")) == 1
    assert len(page.all("style")) == 1
    for name in HOSTILE:
        assert page.text.count(" ".join(name.split())) == 2, "one view and one warning"
    for image in thumbnails(page):
        assert (tmp_path / "out" / unquote(image["data-full"])).is_file()
        assert re.fullmatch(r"[\w./%~-]+", image["data-full"], flags=re.ASCII)


def test_page_without_a_detector(tmp_path: Path):
    located = run(tmp_path, NAMES[:3], probabilities={}, reliability={}, early_stopping=None)
    page = write(tmp_path / "out", located)
    assert [radio["value"] for radio in page.all("input")] == ["render", "masks", "overlay"]
    assert "No 2D detector was used" in page.text
    assert "probability map" not in page.text.lower()
    assert "reliability" not in [option["value"] for option in page.all("option")]


def test_missing_layers_are_explained(tmp_path: Path):
    located = run(tmp_path, NAMES[:3])
    del located.result.reliability[NAMES[1]]
    maps = {name: located.result.probabilities[name] for name in (NAMES[0], NAMES[2])}
    located = dataclasses.replace(
        located, result=dataclasses.replace(located.result, probabilities=maps)
    )
    page = write(tmp_path / "out", located)
    assert page.text.count("The detector was not run on this view.") == 1
    assert "probability maps of 2 of 3 views" in page.text
    page = write(tmp_path / "plain", located, pictures=False)
    assert [radio["value"] for radio in page.all("input")] == ["detector", "masks"]


def test_page_of_an_authentic_scene(tmp_path: Path):
    nothing = np.zeros(400, bool)
    changes = {"labels": nothing, "tamper": np.zeros(400, np.float32), "verdict": 0.004}
    page = write(tmp_path / "out", run(tmp_path, NAMES[:2], **changes, reliability={}, warnings=[]))
    assert wording.headline(0.004, 0) in page.text
    assert "<1% scene probability" in page.text
    assert "None of 400 Gaussians" in page.text
    assert not {"attributes", "warnings"} & {section.get("id") for section in page.all("section")}


@pytest.mark.parametrize("method", ["official", "paper"])
def test_methods_without_a_scene_probability(tmp_path: Path, method: str):
    changes = {"verdict": None, "reliability": {}, "prior": None, "early_stopping": None}
    located = run(tmp_path, NAMES[:2], estimator=METHODS[method], **changes)
    page = write(tmp_path / "out", located)
    assert wording.headline(None, 100) in page.text
    assert "scene probability: that" not in page.text
    assert f"the method {method} uses masks only" in page.text
    assert f"the method {method} trusts all masks equally" in page.text


DEGENERATE = {
    "one value": {"tamper": np.zeros(400, np.float32)},
    "all tampered": {"labels": np.ones(400, bool)},
    "nothing seen": {"seen": np.zeros(400, bool), "labels": np.zeros(400, bool)},
}


@pytest.mark.parametrize("changes", DEGENERATE.values(), ids=DEGENERATE)
def test_degenerate_results_have_a_page(tmp_path: Path, changes: dict):
    page = write(tmp_path / "out", run(tmp_path, NAMES[:1], **changes))
    assert "Histogram of the scores" in page.text
    assert not re.search(r"\b(nan|inf|None(?! of)|undefined)\b", page.text)


def test_every_view_is_rendered_and_marked(tmp_path: Path):
    located, out = run(tmp_path, NAMES[:5]), tmp_path / "out"
    steps: list[tuple[str, int, int]] = []
    monitor = Monitor(progress=lambda *step: steps.append(step))
    scene, cameras = located.scene, located.cameras
    store = ArrayStore()
    for view in cameras:
        store.put(RENDER, view.name, img_as_ubyte(render(scene.gaussians, view)[0]))
        store.put(SCORE, view.name, np.full((view.height, view.width), 1 / 3, np.float32))
    write_results(out, located, store, monitor=monitor)
    write_report(out, {"scene": "x"}, located, monitor=monitor)
    assert len([*(out / "render").iterdir()]) == len([*(out / "overlay").iterdir()]) == 5
    assert (out / "overview.png").is_file()
    levels = iio.imread(out / "scores" / "view 00.png")
    assert levels.dtype == np.uint16
    assert (levels == round(65535 / 3)).all()
    assert steps.count(("write", 5, 5)) == steps.count(("report", 5, 5)) == 1
    rendered, marked = (iio.imread(out / kind / "view 00.jpg") for kind in ("render", "overlay"))
    mask = located.result.masks["view 00"]
    inside = np.asarray(binary_dilation(mask, iterations=4), bool)
    assert np.abs(rendered[inside].astype(int) - marked[inside]).mean() > 20
    assert np.abs(rendered[~inside].astype(int) - marked[~inside]).mean() < 2
