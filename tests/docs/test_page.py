"""The site of the documentation builds without a warning and works in a real browser."""

import functools
import os
import pkgutil
import subprocess
import sys
import threading
from collections.abc import Iterator
from html.parser import HTMLParser
from http.server import SimpleHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from urllib.parse import unquote, urlsplit

import pytest
from browser import SECONDS, Browser
from selenium.webdriver.common.by import By
from selenium.webdriver.support.wait import WebDriverWait

import gsc_jax

pytestmark = pytest.mark.slow
ROOT = Path(__file__).resolve().parents[2]
CODE = ("code", "pre", "script", "style")
OPENED = (
    *("index", "tutorial", "commands", "method", "architecture", "formats", "detectors", "results"),
    *("performance", "security", "limits", "changelog", "reference/index", "reference/method"),
)
"""Pages that the browser opens; links are checked in the files of all pages."""


class Page(HTMLParser):
    """Anchors, links, loaded files and text of a page."""

    def __init__(self, file: Path) -> None:
        super().__init__()
        self.anchors: set[str] = set()
        self.targets: set[str] = set()
        self.loaded: set[str] = set()
        self.without_alt: set[str] = set()
        self.text, self.prose, self._code = "", "", 0
        self.feed(file.read_text(encoding="utf-8"))

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        known = {key: value or "" for key, value in attrs}
        self.anchors.add(known.get("id", ""))
        self.targets |= {known[key] for key in ("href", "src") if key in known}
        self.loaded |= {known["src"]} if "src" in known else set()
        self.loaded |= {known.get("href", "")} if tag == "link" else set()
        self.without_alt |= {known["src"]} if tag == "img" and not known.get("alt") else set()
        self._code += tag in CODE

    def handle_endtag(self, tag: str) -> None:
        self._code -= tag in CODE

    def handle_data(self, data: str) -> None:
        self.text += data
        self.prose += "" if self._code else data


@pytest.fixture(scope="module")
def site(tmp_path_factory) -> Path:
    """The site as `make docs` builds it."""
    folder = tmp_path_factory.mktemp("site")
    built = subprocess.run(
        [sys.executable, "-m", "mkdocs", "build", "--strict", "--site-dir", folder],
        cwd=ROOT,
        env={**os.environ, "NO_MKDOCS_2_WARNING": "1"},
        capture_output=True,
        text=True,
    )
    assert built.returncode == 0, built.stderr
    return folder


@pytest.fixture(scope="module")
def pages(site) -> dict[Path, Page]:
    return {file: Page(file) for file in site.rglob("*.html") if file.name != "404.html"}


def test_every_link_has_a_target(pages, site):
    for file, page in pages.items():
        for target in page.targets:
            place = urlsplit(target)
            if place.scheme:
                continue
            path = (file.parent / unquote(place.path)).resolve() if place.path else file
            path = path / "index.html" if path.is_dir() else path
            assert path.is_file(), f"{file.relative_to(site)} links to {target}, which is missing"
            if place.fragment and path in pages:
                anchors = pages[path].anchors
                assert unquote(place.fragment) in anchors, f"{file.name}: {target} has no anchor"


def test_pages_load_no_foreign_files_and_pictures_have_alt_texts(pages):
    for file, page in pages.items():
        assert not [url for url in page.loaded if urlsplit(url).scheme or urlsplit(url).netloc]
        assert not page.without_alt, f"{file.name} has pictures without alt text"


def test_no_markdown_is_left_in_the_text(pages):
    for file, page in pages.items():
        for sign in ("| ---", "--8<--", "<!--", "](", "```", "**"):
            assert sign not in page.prose, f"{file.name} shows {sign}"


def test_modules_and_public_names_are_documented(pages, site):
    anchors = set().union(*(page.anchors for page in pages.values()))
    modules = {module.name for module in pkgutil.walk_packages(gsc_jax.__path__, "gsc_jax.")}
    assert modules <= anchors
    index = pages[site / "reference" / "index.html"]
    links = {link.split("#")[-1] for link in index.targets}
    for name in set(gsc_jax.__all__) - {"accumulate"}:  # is accumulate_maps in its module
        assert any(link.endswith(f".{name}") for link in links), name


def test_the_help_texts_of_all_commands_are_shown(pages, site):
    text = " ".join(pages[site / "commands.html"].text.split())
    for command in ("locate", "render", "tamper", "demo", "view", "evaluate"):
        assert f"usage: gsc-jax {command}" in text


class Quiet(SimpleHTTPRequestHandler):
    def log_message(self, format, *args):
        pass


@pytest.fixture(scope="module")
def address(site) -> Iterator[str]:
    """Address of a server of the site; the search needs one."""
    with ThreadingHTTPServer(("127.0.0.1", 0), functools.partial(Quiet, directory=site)) as server:
        threading.Thread(target=server.serve_forever, daemon=True).start()
        yield f"http://127.0.0.1:{server.server_port}"
        server.shutdown()


def wait(browser: Browser) -> WebDriverWait:
    return WebDriverWait(browser, SECONDS)


def assert_no_errors(browser: Browser) -> None:
    assert browser.errors() == []
    assert browser.foreign_requests() == []


def test_pages_open_with_their_pictures(browser, address):
    for page in OPENED:
        browser.get(f"{address}/{page}.html")
        assert wait(browser).until(lambda b: b.find_element(By.CSS_SELECTOR, "article h1").text)
        sizes = browser.execute_script(
            "return [...document.querySelectorAll('article img')].map(i => i.naturalWidth)"
        )
        assert all(sizes), f"{page} shows a missing picture"
    assert_no_errors(browser)


def test_the_search_finds_a_function(browser, address):
    browser.get(f"{address}/index.html")
    browser.find_element(By.CSS_SELECTOR, "[data-md-component=search-query]").send_keys("contrast")
    results = "[data-md-component=search-result] a"
    wait(browser).until(lambda b: "loss_3d" in _text(b, results))
    assert_no_errors(browser)


def _text(browser: Browser, selector: str) -> str:
    return browser.execute_script(
        "return [...document.querySelectorAll(arguments[0])].map(e => e.textContent).join(' ')",
        selector,
    )


def test_the_choice_of_light_or_dark_is_kept(browser, address):
    browser.get(f"{address}/index.html")
    before = _background(browser)
    browser.execute_script("document.querySelector('label[for^=__palette_]:not([hidden])').click()")
    wait(browser).until(lambda b: _background(b) != before)
    after = _background(browser)
    browser.get(f"{address}/method.html")
    assert _background(browser) == after, "the next page ignores the choice"
    assert_no_errors(browser)


def _background(browser: Browser) -> str:
    return browser.execute_script("return getComputedStyle(document.body).backgroundColor")


def test_the_site_can_be_read_without_a_server(browser, site):
    browser.get((site / "index.html").as_uri())
    browser.find_element(By.LINK_TEXT, "Tutorial").click()
    wait(browser).until(lambda b: b.current_url.endswith("tutorial.html"))
    wait(browser).until(lambda b: "A scene with a known truth" in _text(b, "article"))
    assert browser.foreign_requests() == []


def test_pages_fit_on_a_narrow_screen(browser, address):
    browser.set_window_size(500, 900)
    for page in ("index", "method", "results", "reference/method"):
        browser.get(f"{address}/{page}.html")
        width = browser.execute_script(
            "return [document.documentElement.scrollWidth, window.innerWidth]"
        )
        assert width[0] <= width[1], f"{page} is wider than the screen"
