"""The viewer in a browser: the served page and the written one, which have the same controls."""

import base64
import time
from collections.abc import Iterator

import numpy as np
import pytest
from browser import Browser
from results_folder import write_results
from selenium.webdriver import ActionChains, Keys
from selenium.webdriver.common.by import By
from viewer_page import (
    Shown,
    blue,
    floor_is_shown,
    only_ball_is_shown,
    red,
    shows_something,
    yellow,
)

from gsc_jax.cli.results import read_results
from gsc_jax.cli.viewer.contents import viewer_contents
from gsc_jax.cli.viewer.page import viewer_page
from gsc_jax.cli.viewer.server import serving, write_page
from gsc_jax.io.ply import read_ply, save_tampered
from gsc_jax.render.orbit import look_at
from gsc_jax.render.projection import project_centers
from gsc_jax.scene.camera import intrinsics

pytest.importorskip("viser")

pytestmark = pytest.mark.slow

ORDER = """
let order;
__viserMutable.scene.traverse((node) => {
  order ??= node.geometry?.attributes?.sortedIndex?.array;
});
return Array.from(order);
"""
"""Splats in the order in which viser draws them."""
SLOW = """
const { sorted } = view.motion, delay = arguments[0];
let last = 0, since = 0;
view.motion.sorted = (count) => {
  if (count !== last) [last, since] = [count, performance.now()];
  return performance.now() - since >= delay && sorted.call(view.motion, count);
};
"""
"""Let sorting take longer."""


@pytest.fixture(scope="module")
def shown(tmp_path_factory: pytest.TempPathFactory, browser: Browser) -> Shown:
    folder = tmp_path_factory.mktemp("page") / "found"
    write_results(folder)
    found = read_results(folder)
    contents, _ = viewer_contents(found, most=10**6)
    gaussians = found.scene.gaussians
    return Shown(browser=browser, folder=folder, contents=contents, gaussians=gaussians)


@pytest.fixture(scope="module")
def written(shown, tmp_path_factory) -> str:
    path = tmp_path_factory.mktemp("written") / "page.html"
    write_page(path, viewer_page(shown.contents))
    return path.as_uri()


@pytest.fixture(scope="module")
def served(shown) -> Iterator[str]:
    page, scene = viewer_page(shown.contents), shown.folder / "tamper.ply"
    with serving(page, scene, token="token", host="localhost", port=0) as port:
        yield f"http://localhost:{port}/token/"


@pytest.fixture(params=["written", "served"])
def page(shown, request) -> Iterator[Shown]:
    yield shown.open(request.getfixturevalue(request.param)).ready()
    shown.check_console()


def test_a_browser_without_webgl_is_told_so(shown, written):
    source = {"source": "HTMLCanvasElement.prototype.getContext = () => null"}
    run_before = "Page.addScriptToEvaluateOnNewDocument"
    script = shown.browser.execute_cdp_cmd(run_before, source)
    try:
        shown.open(written)
        assert "no WebGL 2" in shown.browser.find_element(By.TAG_NAME, "body").text
    finally:
        shown.browser.execute_cdp_cmd(run_before.replace("add", "remove"), script)


def test_without_a_graphics_card_few_gaussians_are_drawn_in_motion(shown, tmp_path, monkeypatch):
    monkeypatch.setattr("gsc_jax.cli.viewer.page.IN_MOTION", 300)
    write_page(tmp_path / "page.html", viewer_page(shown.contents))
    shown.open((tmp_path / "page.html").as_uri()).ready()
    total = len(shown.contents.rows)
    shown.until(lambda _: shown.count() == total)
    canvas = shown.canvas()
    ActionChains(shown.browser).move_to_element(canvas).click_and_hold().move_by_offset(
        30, 0
    ).perform()
    assert shown.count() == 300
    opacity = "return getComputedStyle(arguments[0]).opacity"
    assert shown.browser.execute_script(opacity, canvas) == "1", "the client fades it in"
    few = blue(shown.picture())
    ActionChains(shown.browser).release().perform()
    shown.until(lambda _: shown.count() == total)
    shown.becomes(lambda picture: blue(picture) > few + 0.01)


def test_on_a_phone_the_panel_is_closed_at_first(shown, written):
    shown.open(written, size=(390, 800)).ready()
    assert not shown.input("layer").is_displayed()
    shown.browser.find_element(By.CSS_SELECTOR, "#panel summary").click()
    assert shown.input("layer").is_displayed()


def test_picture_follows_layer_and_threshold(page):
    assert red(page.picture()) > 0.005
    assert page.contents.sentences[0] in page.browser.find_element(By.ID, "panel").text
    page.select("layer", "labelled only")
    page.becomes(only_ball_is_shown)
    page.input("threshold").send_keys(Keys.HOME)
    page.becomes(floor_is_shown)
    page.input("threshold").send_keys(Keys.END)
    page.becomes(lambda picture: red(picture) == 0)
    total = f"{len(page.contents.rows):,}"
    assert f"0 of {total} Gaussians" in page.input("above").text
    page.select("layer", "all but labelled")
    page.becomes(lambda picture: red(picture) > 0.005 and blue(picture) > 0.05)
    page.select("layer", "heat map")
    page.becomes(lambda picture: shows_something(picture) and red(picture) < 0.001)
    page.select("layer", "original")
    page.becomes(floor_is_shown)


def test_cameras_are_selected_and_the_layer_stays(page):
    for button, index in (("next", 1), ("previous", 0), ("previous", 2)):
        page.input(button).click()
        page.shows_camera(index)
    page.select("layer", "labelled only")
    page.becomes(only_ball_is_shown)
    before = page.picture()
    page.select("camera", page.contents.poses[1].name)
    page.becomes(lambda picture: only_ball_is_shown(picture) and abs(picture - before).max() > 0.2)
    page.select("layer", "result")
    page.shows_camera(1)


def test_splats_are_drawn_in_the_order_of_their_depth(page):
    page.input("next").click()
    page.shows_camera(1)
    check_order(page)
    assert page.browser.title.startswith("found")


@pytest.mark.parametrize("delay", [0, 600])
def test_at_rest_all_are_drawn_in_the_order_of_their_depth(shown, tmp_path, monkeypatch, delay):
    """Also if the client has sorted the first only after the time at which all are drawn."""
    monkeypatch.setattr("gsc_jax.cli.viewer.page.IN_MOTION", 300)
    write_page(tmp_path / "page.html", viewer_page(shown.contents))
    shown.open((tmp_path / "page.html").as_uri()).ready()
    shown.until(lambda _: shown.count() == len(shown.contents.rows))
    shown.browser.execute_script(SLOW, delay)
    shown.input("next").click()
    shown.shows_camera(1)
    shown.until(lambda _: shown.count() == len(shown.contents.rows))
    time.sleep(1)
    shown.until(lambda _: shown.count() == len(shown.contents.rows))
    check_order(shown)


def check_order(page: Shown) -> None:
    """Check that the Gaussians are drawn from back to front, as seen from the second camera."""
    order = page.browser.execute_script(ORDER)
    pose = page.contents.poses[1]
    viewmat = look_at(pose.position, pose.look_at, pose.up)
    depths = (page.contents.splats.centers @ viewmat[:3, :3].T + viewmat[:3, 3])[order, 2]
    assert sorted(order) == list(range(len(order)))
    assert (np.diff(depths) < 1e-3 * np.ptp(depths)).all()


def test_places_and_hits_are_those_of_the_renderer(page):
    """The pixel of each splat, and the splat of largest blending weight at some pixels."""
    canvas, pose, splats = page.canvas().size, page.contents.poses[0], page.contents.splats
    page.shows_camera(0)
    height, width = canvas["height"], canvas["width"]
    viewmat = look_at(pose.position, pose.look_at, pose.up)
    K = intrinsics(height / 2 / np.tan(pose.fov / 2), width, height)
    pixels, depths = project_centers(splats.centers, viewmat, K)
    places = page.browser.execute_script(
        "return Array.from(placesOf(view.original, __viserMutable, view.matrix()))"
    )
    np.testing.assert_allclose(np.reshape(places, (-1, 2)), pixels, atol=0.5)
    script = "return splatAt(view.painted, __viserMutable, view.matrix(), arguments[0])"
    for x, y in np.random.default_rng(0).uniform(0.2, 0.8, (20, 2)) * [width, height]:
        found = page.browser.execute_script(script, [x, y])
        ray = viewmat[:3, :3].T @ [(x - width / 2) / K[0, 0], (y - height / 2) / K[1, 1], 1]
        weights = blending_weights(splats, np.asarray(depths), pose.position, ray)
        if found is None:
            assert weights.max() < 0.02
        else:
            assert weights[found] > weights.max() - 0.02


def blending_weights(splats, depths, origin, ray) -> np.ndarray:
    """Weights (N,) of the splats along a ray, exactly, in the order of their depths."""
    ray = ray / np.linalg.norm(ray)
    precision = np.linalg.inv(splats.covariances.astype(np.float64))
    offset = splats.centers - origin
    along, cross = precision @ ray, np.einsum("nij,ni->nj", precision, offset)
    squared = np.einsum("nj,nj->n", cross, offset) - (cross @ ray) ** 2 / (along @ ray)
    alpha = splats.opacities[:, 0] * np.exp(-squared / 2) * (depths > 0)
    order, weights = np.argsort(depths), np.empty(len(alpha))
    weights[order] = alpha[order] * np.cumprod(np.append(1, 1 - alpha[order]))[:-1]
    return weights


def test_a_click_shows_the_values_in_the_file(page):
    page.canvas().click()
    page.until(lambda _: "position" in page.message())
    found = dict(line.split(" ", 1) for line in page.message().splitlines()[1:])
    vertex = read_ply(page.folder / "tamper.ply").ply["vertex"]
    row = int(found["row"].replace(",", ""))
    assert found["score"] == f"{vertex['tamper'][row]:.3f}"
    assert found["traces"] == "none"
    page.browser.execute_script("view.traces = {a: [], b: view.scores.map((_, i) => i)}")
    page.canvas().click()
    page.until(lambda _: "traces b" in page.message())
    for name, expected in (
        ("position", [vertex[axis][row] for axis in "xyz"]),
        ("scales", [np.exp(vertex[f"scale_{axis}"][row]) for axis in range(3)]),
    ):
        np.testing.assert_allclose([float(x) for x in found[name].split(",")], expected, rtol=6e-3)


def test_boxes_and_the_brush_select_until_it_is_cleared(page):
    page.select("layer", "original")
    for kind, held in (("turns the scene", True), ("selects a box (Shift)", False)):
        page.select("drag", kind)
        page.drag(-60, 60, shift=held)
        page.becomes(lambda picture: yellow(picture) > 0.01)
        assert "Gaussians are selected" in page.message()
        page.input("clear").click()
        page.becomes(lambda picture: yellow(picture) < 0.001)
        assert page.message() == "0 Gaussians are selected."
    page.select("drag", "selects with a brush")
    before = page.picture()
    page.drag(-60, 60)
    page.until(lambda _: "Gaussians are selected" in page.message())
    count = int(page.message().split()[0].replace(",", ""))
    assert 0 < count < len(page.contents.rows) / 4, "fewer than in a box"
    page.becomes(lambda picture: float(abs(picture - before).max()) > 0.2)
    page.input("clear").click()
    page.shows_camera(0)  # which no drag has turned


def test_exports_are_rows_of_the_file_with_all_properties(page, tmp_path):
    downloads = {"behavior": "allow", "downloadPath": str(tmp_path)}
    page.browser.execute_cdp_cmd("Browser.setDownloadBehavior", downloads)
    whole = read_ply(page.folder / "tamper.ply").ply["vertex"].data
    labelled = np.load(page.folder / "labels.npy")
    page.select("drag", "selects a box (Shift)")
    page.drag(-60, 60)
    chosen = np.array(page.browser.execute_script("return Array.from(view.selected)"), bool)
    selected = np.isin(np.arange(len(whole)), page.contents.rows[chosen])
    assert 0 < selected.sum() < len(whole) - 100
    for part, expected in (
        ("only labelled", labelled),
        ("all but labelled", ~labelled),
        ("only selected", selected),
        ("all but selected", ~selected),
    ):
        page.select("part", part)
        page.export()
        path = tmp_path / f"found {part}.ply".replace(" ", "_")
        page.until(lambda _: path.exists())  # noqa: B023
        written = read_ply(path).ply["vertex"].data
        assert written.dtype == whole.dtype
        assert written.tobytes() == whole[expected].tobytes()
    page.input("clear").click()
    page.select("part", "only selected")
    page.input("export").click()
    page.until(lambda _: "No Gaussian is selected" in page.message())
    page.browser.execute_script("view.input('threshold').value = 1")
    page.select("part", "only labelled")
    page.export()
    page.until(lambda _: "No Gaussian was chosen" in page.message())


def test_a_score_at_the_threshold_is_not_above_it(page):
    """As in NumPy, which compares float32 with the threshold in single precision."""
    above = "view.scores[0] = 0.1; view.input('threshold').value = 0.1; return view.scores[0] > "
    assert page.browser.execute_script(above + "0.1")
    assert not page.browser.execute_script(above + "view.threshold")


def test_comments_of_the_vertices_are_kept(shown, written, tmp_path):
    scene = read_ply(shown.folder / "tamper.ply")
    scene.ply["vertex"].comments = ["made by hand"]
    path, tamper = tmp_path / "tamper.ply", np.load(shown.folder / "tamper.npy")
    save_tampered(path, scene, tamper[scene.rows])
    header = path.read_bytes().partition(b"end_header")[0]
    assert b"comment made by" in header
    shown.open(written).ready()
    script = """
const [text, done] = arguments, bytes = Uint8Array.from(atob(text), (sign) => sign.charCodeAt(0));
const part = new Blob(view.part(bytes).pieces);
part.arrayBuffer().then((all) => done(Array.from(new Uint8Array(all))));
"""
    shown.select("part", "only labelled")
    encoded = base64.b64encode(path.read_bytes()).decode()
    path.write_bytes(bytes(shown.browser.execute_async_script(script, encoded)))
    exported, labels = read_ply(path).ply["vertex"], np.load(shown.folder / "labels.npy")
    assert exported.comments == scene.ply["vertex"].comments
    assert len(exported.data) == labels.sum()


def test_other_files_are_refused(shown, written, tmp_path):
    shown.open(written).ready()
    other, text = tmp_path / "other.ply", tmp_path / "text.ply"
    scene = read_ply(shown.folder / "tamper.ply")
    save_tampered(other, scene, np.full(len(scene.rows), 0.5, np.float32))
    text.write_text("ply\nformat ascii 1.0\nend_header\n")
    for file, expected in (
        (other, "not tamper.ply of these results"),
        (text, "Expected tamper.ply"),
    ):
        shown.export(file)
        shown.until(lambda _: expected in shown.message())  # noqa: B023
