"""The documentation: the tutorial runs as written, and nothing public lacks a place in it."""

import contextlib
import importlib.util
import io
import pkgutil
import re
from pathlib import Path
from types import ModuleType

import imageio.v3 as iio
import jax
import numpy as np
import pytest

import gsc_jax

ROOT = Path(__file__).resolve().parents[2]
DOCS = ROOT / "docs"
PAGES = [ROOT / "README.md", *sorted(DOCS.rglob("*.md"))]
NUMBER = re.compile(r"(?<![\w.])-?\d[\d,]*(?:\.\d+)?")
LARGEST_PICTURE, ALL_PICTURES = 150_000, 1_000_000


def script(name: str) -> ModuleType:
    """One of the scripts in docs/, as a module."""
    spec = importlib.util.spec_from_file_location(f"docs_{name}", DOCS / f"{name}.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def same(printed: str, written: str) -> bool:
    """Whether two texts are the same words, with numbers that may differ a little."""
    found, expected = NUMBER.findall(printed), NUMBER.findall(written)
    if NUMBER.split(printed.strip()) != NUMBER.split(written.strip()):
        return False
    pairs = zip(found, expected, strict=True)
    return all(value(a) == pytest.approx(value(b), rel=0.05, abs=0.02) for a, b in pairs)


def value(number: str) -> float:
    return float(number.replace(",", ""))


@pytest.fixture
def as_people_run_it(tmp_path, monkeypatch):
    """An empty folder but for `pictures`, and JAX as it is without the strictness of the tests."""
    (tmp_path / "pictures").mkdir()
    monkeypatch.chdir(tmp_path)
    with jax.numpy_dtype_promotion("standard"), jax.numpy_rank_promotion("allow"):
        yield tmp_path


def test_the_tutorial_runs_and_prints_what_it_says(as_people_run_it):
    names: dict = {}
    blocks = script("pictures").blocks()
    assert len(blocks) >= 15
    for code, written in blocks:
        with contextlib.redirect_stdout(io.StringIO()) as printed:
            exec(compile(code, "tutorial.md", "exec"), names)
        found = printed.getvalue()
        assert same(found, written), f"{code}\nprints\n\n{found}\nbut the page says\n\n{written}"
    saved = {picture.name for picture in (as_people_run_it / "pictures").iterdir()}
    assert saved == set(pictures_of(DOCS / "tutorial.md"))


def test_what_is_printed_is_compared_by_words_and_by_numbers():
    assert same("robust: F1 0.97, 1,990 found", "robust: F1 0.98, 2,000 found\n")
    assert not same("robust: F1 0.90", "robust: F1 0.98")
    assert not same("robust: F1 0.98", "paper: F1 0.98")
    assert not same("0.98", "0.98 0.98")
    assert not same("", "0.98")


def pictures_of(page: Path) -> list[str]:
    return re.findall(r"!\[[^\]]+\]\((?:docs/)?pictures/([^)]+)\)", page.read_text("utf-8"))


def test_the_pictures_are_small_and_shown():
    sizes = {picture.name: picture.stat().st_size for picture in (DOCS / "pictures").iterdir()}
    assert set(sizes) == {name for page in PAGES for name in pictures_of(page)}
    assert max(sizes.values()) < LARGEST_PICTURE
    assert sum(sizes.values()) < ALL_PICTURES


def test_the_first_picture_can_be_made_again(as_people_run_it):
    pictures, (large, small) = script("pictures"), (Path("large.png"), Path("teaser.png"))
    # Of the sizes in the tutorial, for which all is compiled by now.
    pictures.teaser(large, pictures.made_case(count=20_000, width=320, height=240))
    pictures.shrink(large, small)
    large, small = iio.imread(large), iio.imread(small)
    assert small.shape[:2] == large.shape[:2] == (450, 1200)
    assert np.abs(small.astype(float)[..., :3] - large[..., :3]).mean() < 10


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_what_pages_link_to_is_there_for_readers_of_the_repository(page):
    text = re.sub(r"^```.*?^```$", "", page.read_text("utf-8"), flags=re.DOTALL | re.MULTILINE)
    for target in re.findall(r"\]\(([^)#\s]+)(?:#[^)]*)?\)", text):
        if not target.startswith("https://"):
            assert (page.parent / target).exists(), f"{target} is linked but missing"
    assert not re.search(r"!\[\]", text), "a picture has no alt text"


def modules() -> set[str]:
    """Every module of the package; the packages only hold them."""
    walked = pkgutil.walk_packages(gsc_jax.__path__, "gsc_jax.")
    return {module.name for module in walked if not module.ispkg}


def test_every_module_has_one_place_in_the_reference():
    shown = [
        name
        for page in (DOCS / "reference").glob("*.md")
        for name in re.findall(r"^::: (\S+)$", page.read_text("utf-8"), flags=re.MULTILINE)
    ]
    assert not modules() - set(shown), "these modules have no place in docs/reference/"
    assert not set(shown) - modules(), "the reference shows modules that are gone"
    assert len(shown) == len(set(shown)), "a module is shown twice"


def test_every_public_name_is_in_the_table_of_the_reference():
    table = (DOCS / "reference" / "index.md").read_text("utf-8")
    listed = re.findall(r"^\| \[`(\w+)`\]", table, flags=re.MULTILINE)
    assert sorted(listed) == sorted(gsc_jax.__all__)
