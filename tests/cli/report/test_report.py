"""The report as a page that is complete without a browser: nothing lost, nothing let in."""

import base64
import hashlib
import itertools
import json
import re
from collections import Counter
from pathlib import Path
from urllib.parse import unquote

import imageio.v3 as iio
import numpy as np
import pytest
from reports import HOSTILE, WORTHS, Page, run, write
from scipy.ndimage import binary_dilation

from gsc_jax.cli.outputs import write_report, write_results
from gsc_jax.cli.report import wording as words
from gsc_jax.cli.report.charts import attribute_level
from gsc_jax.cli.report.thumbnails import LAYERS
from gsc_jax.estimators.gschecker import METHODS

NAMES = [f"view {i:02}" for i in range(8)]
ALL_LAYERS = [layer.name for layer in LAYERS]


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("report")
    write(folder, run(tmp_path_factory.mktemp("scene"), NAMES))
    return folder


@pytest.fixture(scope="module")
def page(folder: Path) -> Page:
    return Page((folder / "report.html").read_text(encoding="utf-8"))


def test_every_view_is_there_with_all_its_pictures(page: Page):
    pictures = [image for image in page.all("img") if "data-layer" in image]
    assert [image["data-layer"] for image in pictures] == ALL_LAYERS * len(NAMES)
    for name, image in zip(np.repeat(NAMES, 4), pictures, strict=True):
        assert name in image["alt"]
        assert name in unquote(image["data-full"])
        assert image["src"].startswith(("data:image/jpeg;base64,", "data:image/png;base64,"))
    items = [item for item in page.all("li") if "data-order" in item]
    assert [item["data-order"] for item in items] == [str(i + 1) for i in range(len(NAMES))]


def test_every_number_of_the_result_is_there(folder: Path, page: Page):
    report = json.loads((folder / "result.json").read_text())
    assert report["outputs"] == sorted(report["outputs"])
    assert {"report.html", "result.json"} <= set(report["outputs"])
    for said in (
        "Very probably, something in this scene was tampered with.",
        "97% probability that anything was tampered with",
        "100 of 400 Gaussians are labelled as tampered (25.0%)",
        words.share(report["tampered_share_of_views"]),
        "83% probability that something was edited",
        "100 of 400 Gaussians are off.",
        "No part occurs again.",
        "at 8 of 24 views: The last views changed 1.2% of what is labelled.",
        "12.3 s until this page was made",
        "7.50 1,234",
        "393",  # seen
        "The <b>masks</b> disagree.",
        "some <i>scene</i>.ply",
    ):
        assert said in page.text, said
    for view in report["per_view"]:
        assert f"{words.share(view['tampered_share'])} tampered" in page.text
        assert f"detector {words.share(view['detector_share'])}" in page.text
    for worth in WORTHS:
        assert page.text.count(words.WORTH[worth].short) >= 3, "in the list twice, and explained"
    for key, value in {**report["config"], **report["versions"], "seed": 0}.items():
        assert f"{key} {value if isinstance(value, str) else json.dumps(value)}" in page.text


def test_every_file_is_linked(folder: Path, page: Page):
    links = {unquote(link["href"]) for link in page.all("a") if "href" in link}
    for name in json.loads((folder / "result.json").read_text())["outputs"]:
        top, _, rest = name.partition("/")
        assert (f"{top}/" if rest else top) in links
    for link in links - {"#views", "#evidence", "#properties", "#run", "#files"}:
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
    assert not page.all("link")
    assert not any(key.startswith("on") for _, attributes in page.elements for key in attributes)


def test_the_page_is_well_built(page: Page):
    assert page.all("html") == [{"lang": "en"}]
    levels = [int(tag[1]) for tag, _ in page.elements if re.fullmatch(r"h[1-6]", tag)]
    assert levels[0] == 1
    assert levels.count(1) == 1
    assert all(after - before <= 1 for before, after in itertools.pairwise(levels))
    ids = Counter(attributes["id"] for _, attributes in page.elements if "id" in attributes)
    assert set(ids.values()) == {1}
    for _, attributes in page.elements:
        for key in ("aria-labelledby", "for"):
            assert attributes.get(key) in {None, *ids}
        if attributes.get("href", "").startswith("#"):
            assert attributes["href"][1:] in ids
    assert all(image["alt"] for image in page.all("img"))
    for landmark in ("header", "nav", "main", "footer"):
        assert len(page.all(landmark)) == 1


def test_charts_belong_to_the_page(folder: Path, page: Page):
    html = (folder / "report.html").read_text(encoding="utf-8")
    drawings = re.findall(r"<svg.*?</svg>", html, flags=re.DOTALL)
    assert len(drawings) == 2 + 7  # the attribute, the views, and seven properties
    for svg in drawings:
        assert "<style" not in svg
        assert "#0001" not in svg
        assert "var(--" in svg
        assert re.search(r'<svg [^>]*role="img"', svg)
        assert "<title" in svg
        for used in re.findall(r"(?:url\(#|href=\"#)([^)\"]+)", svg):
            assert f'id="{used}"' in svg
    titles = [drawing["aria-labelledby"] for drawing in page.all("svg")]
    assert len(set(titles)) == len(drawings)
    assert len(re.findall(r"Medians: .{,60}% in common\.", page.text)) == 7


def test_the_same_run_gives_the_same_page(tmp_path: Path):
    located = run(tmp_path, NAMES[:2])
    pages = []
    for _ in range(2):
        write(tmp_path / "out", located)
        html = (tmp_path / "out" / "report.html").read_text(encoding="utf-8")
        pages.append(re.sub(r"\d{4}-\d\d-\d\d(T[\d:+]+)?", "", html))
    assert pages[0] == pages[1]


def test_hostile_names_are_text_and_their_pictures_are_found(tmp_path: Path):
    page = write(tmp_path / "out", run(tmp_path, HOSTILE, warnings=list(HOSTILE)))
    assert len(page.all("script")) == 1
    assert len(page.all("style")) == 1
    for name in HOSTILE:
        said = " ".join(name.split())
        assert page.text.count(said) == 2, "as a view and as a warning"
    for image in page.all("img"):
        assert (tmp_path / "out" / unquote(image["data-full"])).is_file()
        assert re.fullmatch(r"[\w./%~-]+", image["data-full"], flags=re.ASCII)


def test_without_a_detector_there_is_none_on_the_page(tmp_path: Path):
    located = run(tmp_path, NAMES[:3], detections={}, reliability={}, effort=None)
    page = write(tmp_path / "out", located)
    assert [radio["value"] for radio in page.all("input")] == ["render", "masks", "overlay"]
    assert "No 2D detector was asked" in page.text
    assert "detector mask" not in page.text.lower()
    assert "worth" not in [option["value"] for option in page.all("option")]


def test_views_that_the_detector_or_nobody_looked_at_say_so(tmp_path: Path):
    located = run(tmp_path, NAMES[:3])
    del located.result.detections[NAMES[1]], located.result.reliability[NAMES[1]]
    page = write(tmp_path / "out", located)
    assert page.text.count("The detector was not asked about this view.") == 1
    assert "judged 2 of 3 views" in page.text
    page = write(tmp_path / "plain", located, pictures=False)
    assert [radio["value"] for radio in page.all("input")] == ["detector", "masks"]


def test_where_nothing_was_found_the_page_says_so(tmp_path: Path):
    nothing = np.zeros(400, bool)
    changes = {"labels": nothing, "tamper": np.zeros(400, np.float32), "verdict": 0.004}
    located = run(tmp_path, NAMES[:2], **changes, reliability={}, warnings=[])
    page = write(tmp_path / "out", located)
    assert "Very probably, nothing in this scene was tampered with." in page.text
    assert "<1% probability" in page.text
    assert "none of 400, in 2 views" in page.text
    assert "called tampered are 0" in page.text
    assert not [section for section in page.all("section") if section.get("id") == "properties"]
    assert not [section for section in page.all("section") if section.get("class") == "warnings"]


def test_what_was_found_without_a_verdict_for_it_is_told_with_a_doubt(tmp_path: Path):
    page = write(tmp_path / "out", run(tmp_path, NAMES[:1], verdict=0.49))
    assert "It is unclear whether anything" in page.text
    assert "If something was: 100 of 400" in page.text
    assert "1 view show" in page.text.replace("shows", "show")


@pytest.mark.parametrize("method", ["official", "paper"])
def test_methods_without_a_verdict(tmp_path: Path, method: str):
    sizes = np.array([[5, 30, 365], [9, 20, 371], [0, 0, 0]], np.int32)
    changes = {"verdict": None, "reliability": {}, "native": None, "effort": None}
    attribute = np.linspace(-1e5, 3e6, 400, dtype=np.float32)[::-1]
    located = run(
        tmp_path,
        NAMES[:2],
        method=method,
        config=METHODS[method],
        group_sizes=sizes,
        attribute=attribute,
        **changes,
    )
    page = write(tmp_path / "out", located)
    assert "Something was labelled; whether" in page.text
    assert "probability that anything" not in page.text
    assert f"the method {method} goes by the masks alone" in page.text
    assert f"the method {method} believes all views alike" in page.text
    assert "loop.lambda2" in page.text
    assert "Groups of the optimisation" in page.text
    assert attribute_level(located.result) == pytest.approx(0.1 * attribute.max())


DEGENERATE = {
    "one value": {"attribute": np.zeros(400, np.float32)},
    "all tampered": {"labels": np.ones(400, bool)},
    "nothing seen": {"seen": np.zeros(400, bool), "labels": np.zeros(400, bool)},
    "no threshold": {"attribute": np.full(400, -1, np.float32), "config": METHODS["paper"]},
}


@pytest.mark.parametrize("changes", DEGENERATE.values(), ids=DEGENERATE)
def test_degenerate_results_have_a_page_without_nonsense(tmp_path: Path, changes: dict):
    page = write(tmp_path / "out", run(tmp_path, NAMES[:1], **changes))
    assert "Histogram of the attribute" in page.text
    assert not re.search(r"\b(nan|inf|None(?! of)|undefined)\b", page.text)


def test_every_view_is_pictured(tmp_path: Path):
    located, out = run(tmp_path, NAMES[:5]), tmp_path / "out"
    told: list[tuple[str, int, int]] = []

    def progress(stage: str, done: int, total: int) -> None:
        told.append((stage, done, total))

    write_results(out, located.scene, located.cameras, located.result, progress=progress)
    write_report(out, {"scene": "x"}, located, progress=progress)
    assert len([*(out / "render").iterdir()]) == len([*(out / "overlay").iterdir()]) == 5
    assert Path(out / "overview.png").is_file()
    assert told.count(("write", 5, 5)) == told.count(("report", 5, 5)) == 1
    render, marked = (iio.imread(out / kind / "view 00.jpg") for kind in ("render", "overlay"))
    mask = located.result.masks["view 00"]
    inside = np.asarray(binary_dilation(mask, iterations=4), bool)
    assert np.abs(render[inside].astype(int) - marked[inside]).mean() > 20
    assert np.abs(render[~inside].astype(int) - marked[~inside]).mean() < 2
