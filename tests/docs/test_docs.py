"""The tutorial prints its documented output, its pictures are shown, and links have targets."""

import contextlib
import importlib.util
import io
import re
from pathlib import Path
from types import ModuleType

import imageio.v3 as iio
import jax
import numpy as np
import pytest

ROOT = Path(__file__).resolve().parents[2]
DOCS = ROOT / "docs"
PAGES = [ROOT / "README.md", *sorted(DOCS.rglob("*.md"))]
NUMBER = re.compile(r"(?<![\w.])-?\d[\d,]*(?:\.\d+)?")
LARGEST_PICTURE, ALL_PICTURES = 150_000, 1_000_000


def script(name: str) -> ModuleType:
    """Import a script of docs/."""
    spec = importlib.util.spec_from_file_location(f"docs_{name}", DOCS / f"{name}.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def same(printed: str, documented: str) -> bool:
    """Whether two texts have the same words, and numbers that are `alike`."""
    if NUMBER.split(printed.strip()) != NUMBER.split(documented.strip()):
        return False
    pairs = zip(NUMBER.findall(printed), NUMBER.findall(documented), strict=True)
    return all(alike(*(float(one.replace(",", "")) for one in pair)) for pair in pairs)


def alike(printed: float, documented: float) -> bool:
    """Whether numbers differ by no more than the machine and the rounding explain."""
    share = 0 <= documented <= 1
    return abs(printed - documented) <= (0.0101 if share else 0.05 * abs(documented))


@pytest.fixture
def user_settings(tmp_path, monkeypatch):
    """A folder with an empty `pictures`, and JAX without the strict settings of the tests."""
    (tmp_path / "pictures").mkdir()
    monkeypatch.chdir(tmp_path)
    with jax.numpy_dtype_promotion("standard"), jax.numpy_rank_promotion("allow"):
        yield tmp_path


@pytest.mark.slow
@pytest.mark.parametrize(("page", "least"), [("tutorial.md", 15), ("gradients.md", 2)])
def test_a_page_prints_its_documented_output(user_settings, page, least):
    names: dict = {}
    blocks = script("pictures").blocks(page)
    assert len(blocks) >= least
    for code, documented in blocks:
        with contextlib.redirect_stdout(io.StringIO()) as output:
            exec(compile(code, page, "exec"), names)
        printed = output.getvalue()
        assert same(printed, documented), f"{code}\nprints\n\n{printed}\nnot\n\n{documented}"
    saved = {picture.name for picture in (user_settings / "pictures").iterdir()}
    assert saved == set(pictures_of(DOCS / page))


def test_printed_output_is_compared_by_words_and_numbers():
    assert same("robust: F1 0.97, 1,990 found", "robust: F1 0.98, 2,000 found\n")
    assert not same("robust: F1 0.96", "robust: F1 0.98")
    assert not same("robust: F1 0.98", "paper: F1 0.98")
    assert not same("0.98", "0.98 0.98")


def pictures_of(page: Path) -> list[str]:
    return re.findall(r"!\[[^\]]+\]\((?:docs/)?pictures/([^)]+)\)", page.read_text("utf-8"))


def test_pictures_are_small_and_each_is_shown_on_a_page():
    sizes = {picture.name: picture.stat().st_size for picture in (DOCS / "pictures").iterdir()}
    assert set(sizes) == {name for page in PAGES for name in pictures_of(page)}
    assert max(sizes.values()) < LARGEST_PICTURE
    assert sum(sizes.values()) < ALL_PICTURES


def test_the_teaser_can_be_reproduced(user_settings):
    pictures, (large, small) = script("pictures"), (Path("large.png"), Path("teaser.png"))
    # The sizes of the tutorial, for which JAX has compiled already.
    pictures.teaser(large, pictures.made_case(count=20_000, width=320, height=240))
    pictures.shrink(large, small)
    large, small = iio.imread(large), iio.imread(small)
    assert small.shape[:2] == large.shape[:2] == (450, 1200)
    assert np.abs(small.astype(float)[..., :3] - large[..., :3]).mean() < 10


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_links_between_files_of_the_repository_lead_to_files(page):
    text = re.sub(r"^```.*?^```$", "", page.read_text("utf-8"), flags=re.DOTALL | re.MULTILINE)
    for target in re.findall(r"\]\(([^)#\s]+)(?:#[^)]*)?\)", text):
        if not target.startswith("https://"):
            assert (page.parent / target).exists(), f"{target} is linked but missing"
    assert not re.search(r"!\[\]", text), "a picture has no alt text"
