"""The report as a page that is complete without a browser: nothing lost, nothing let in."""

import base64
import dataclasses
import hashlib
import itertools
import json
import re
from collections import Counter
from pathlib import Path
from urllib.parse import unquote

import hypothesis.strategies as st
import imageio.v3 as iio
import numpy as np
import pytest
from hypothesis import given
from reports import HOSTILE, WORTHS, Page, run, write
from scipy.ndimage import binary_dilation, gaussian_filter
from skimage.data import astronaut

from gsc_jax.app import words
from gsc_jax.app.outputs import write_report, write_results
from gsc_jax.app.pictures import overlay, write_jpeg
from gsc_jax.app.publish import replacing
from gsc_jax.app.reporting.charts import attribute_level
from gsc_jax.app.reporting.properties import properties
from gsc_jax.app.reporting.thumbnails import LAYERS, MANY, SIDE, thumbnail, thumbnail_side, url
from gsc_jax.io.masks import write_mask, write_probability
from gsc_jax.method import METHODS

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
        "100 of 400 Gaussians are tampered (25.0%)",
        words.share(report["tampered_share_of_views"]),
        "83% probability that something was edited",
        "100 of 400 Gaussians are off.",
        "No part occurs again.",
        "at 8 of 24 views: The last views changed 1.2% of what is labelled.",
        "12.3 s in all",
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
    for key, value in {**report["config"], **report["versions"], "views": None}.items():
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


@given(st.text(min_size=1).filter(lambda name: "\0" not in name and name not in (".", "..")))
def test_a_link_leads_to_its_file_whatever_the_name(name: str):
    try:
        name.encode()
    except UnicodeEncodeError:
        return
    path = Path("folder") / "render" / name.replace("/", "_")
    link = url(path, Path("folder"))
    assert Path("folder") / unquote(link) == path
    assert re.fullmatch(r"[\w./%~-]+", link, flags=re.ASCII)


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
    assert "Tampered Gaussians were found." in page.text
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


def test_more_views_have_smaller_pictures():
    assert thumbnail_side(1) == thumbnail_side(MANY) == SIDE
    assert thumbnail_side(4 * MANY) == SIDE // 2
    assert thumbnail_side(10**6) > 60


def test_two_hundred_views_fit_into_an_email(tmp_path: Path):
    picture = astronaut()[:384] / 255  # as detailed as a photograph, and 4:3
    mask = picture[..., 0] > 0.7
    write_jpeg(tmp_path / "render.jpg", picture)
    write_jpeg(tmp_path / "overlay.jpg", overlay(picture, mask))
    write_mask(tmp_path / "masks.png", mask)
    write_probability(tmp_path / "detector.png", gaussian_filter(mask.astype(float), 3))
    side = thumbnail_side(200)
    bytes_of = {path.stem: len(thumbnail(path, side)[0]) for path in tmp_path.iterdir()}
    assert 200 * sum(bytes_of.values()) < 14e6, bytes_of
    assert bytes_of["masks"] < bytes_of["render"] / 2


def test_a_thumbnail_has_the_shape_and_the_colours_of_its_picture(tmp_path: Path):
    write_jpeg(tmp_path / "wide.jpg", np.full((90, 640, 3), (0.8, 0.2, 0.4)))
    write_mask(tmp_path / "high.png", np.arange(700)[:, None] < np.full(40, 350))
    pixels = {}
    for name, size in {"wide.jpg": (320, 45), "high.png": (18, 320)}.items():
        source, *shape = thumbnail(tmp_path / name, 320)
        pixels[name] = iio.imread(base64.b64decode(source.partition(",")[2]))
        assert tuple(shape) == size == pixels[name].shape[1::-1]
    np.testing.assert_allclose(pixels["wide.jpg"], np.full((45, 320, 3), (204, 51, 102)), atol=3)
    assert pixels["high.png"][:150].min() > 250
    assert pixels["high.png"][-150:].max() < 5


def test_properties_tell_groups_apart_and_leave_the_unseen_out(tmp_path: Path):
    located = run(tmp_path, NAMES[:1])
    told = {one.name: one for one in properties(located.scene.gaussians, *_groups(located))}
    assert len(told) == 7
    for one in told.values():
        assert (len(one.tampered), len(one.authentic)) == (100, 293)
        for density in one.densities(20)[:2]:
            assert density.sum() == pytest.approx(1)
            assert (density >= 0).all()
    size, rotation = told["size"], told["rotation"]
    assert np.median(size.tampered) < np.median(size.authentic) - 0.3
    assert 0 <= rotation.tampered.min() <= rotation.tampered.max() <= 180
    tampered, authentic, _ = told["size"].densities(20)
    assert np.minimum(tampered, authentic).sum() < 0.5, "they overlap little"
    flat = located.scene.gaussians.take(np.arange(400))
    flat = dataclasses.replace(flat, sh=flat.sh[:, :1])
    assert len(properties(flat, *_groups(located))) == 6


def _groups(located) -> tuple[np.ndarray, np.ndarray]:
    return located.result.labels, located.result.seen


def test_the_summary_names_the_report_first(tmp_path: Path):
    lines = words.summary(run(tmp_path, NAMES), Path("out"))
    look = [line for line in lines if line.startswith("look at")]
    assert look == [f"look at  {Path('out') / 'report.html'}"]
    assert any(line.startswith("trace    100 of 400") for line in lines)
    assert any("finding it 2, missing it 2, inverted 2, of views without it 2" in x for x in lines)


def test_words_for_numbers():
    assert [words.percent(p) for p in (0, 0.009, 0.5, 0.991, 1)] == [
        "<1%",
        "<1%",
        "50%",
        ">99%",
        ">99%",
    ]
    shares = [words.share(part) for part in (0, 1e-6, 0.123, 0.9999, 1)]
    assert shares == ["0%", "<0.1%", "12.3%", ">99.9%", "100%"]
    least = [bound for bound, _ in words.LIKELY]
    assert least == sorted(least, reverse=True)
    assert least[-1] == 0


def test_results_are_pictured_and_what_another_run_pictured_is_gone(tmp_path: Path):
    located, out = run(tmp_path, NAMES[:5]), tmp_path / "out"
    told: list[tuple[str, int, int]] = []

    def progress(stage: str, done: int, total: int) -> None:
        told.append((stage, done, total))

    for pictured in (None, 2):
        with replacing(out) as folder:
            write_results(
                folder,
                located.scene,
                located.cameras,
                located.result,
                pictured=pictured,
                progress=progress,
            )
            write_report(folder, {"scene": "x"}, located, progress=progress)
        rendered = pictured or 5
        assert len([*(out / "render").iterdir()]) == len([*(out / "overlay").iterdir()]) == rendered
        page = Page((out / "report.html").read_text(encoding="utf-8"))
        assert page.text.count("This view was not rendered.") == 2 * (5 - rendered)
        assert Path(out / "overview.png").is_file()
    assert told.count(("write", 5, 5)) == told.count(("report", 5, 5)) == 2
    render, marked = (iio.imread(out / kind / "view 00.jpg") for kind in ("render", "overlay"))
    mask = located.result.masks["view 00"]
    inside = np.asarray(binary_dilation(mask, iterations=4), bool)
    assert np.abs(render[inside].astype(int) - marked[inside]).mean() > 20
    assert np.abs(render[~inside].astype(int) - marked[~inside]).mean() < 2
