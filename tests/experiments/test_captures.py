"""The bank of captures: varied, reproducible, and continued where it was interrupted."""

import dataclasses
import json

import captures
import numpy as np
import pytest
from captures import Args, make_recipe, photographed, recipes
from cases import UNSEEN, UNSEEN_OBJECTS
from data import DATA, needs_data

from gsc_jax import load_cameras, load_ply
from gsc_jax.render.visibility import check_views
from gsc_jax.scene import InputError


@pytest.fixture
def small(monkeypatch):
    """Captures of a few steps on few small images."""
    for name, value in {"VIEWS": 11, "WIDTHS": (48,), "STEPS": (4, 5), "BUDGETS": (900,)}.items():
        monkeypatch.setattr(captures, name, value)


def test_nothing_unseen_is_in_the_bank():
    assert not {*captures.CAPTURES, *captures.BY_ERROR} & {*UNSEEN, *UNSEEN_OBJECTS}


def test_standard_captures_differ_in_their_strategy_only():
    one, other = recipes(Args(standard=True, sources=("room",)))
    assert one.config.strategy != other.config.strategy
    assert dataclasses.replace(one, config=other.config) == other


@needs_data
def test_the_whole_bank_is_varied():
    made = list(recipes(Args()))
    assert len({recipe.name for recipe in made}) == len(made) == 51
    for values in zip(
        *((r.config.strategy, r.config.sh_degree, r.width) for r in made), strict=True
    ):
        counts = np.unique(values, return_counts=True)[1]
        assert counts.min() > 3
        assert len(counts) > 1
    assert list(recipes(Args())) == made


def test_a_share_of_the_bank_has_every_source(tmp_path):
    some = list(recipes(Args(share=0.1, data=tmp_path / "none")))
    assert sorted(recipe.source for recipe in some) == sorted(captures.MADE)
    with pytest.raises(InputError, match="expected some of"):
        list(recipes(Args(sources=("castle",))))
    with pytest.raises(InputError, match="--share 2"):
        list(recipes(Args(share=2)))


def test_a_second_run_makes_only_what_is_missing(tmp_path, small, monkeypatch):
    args = Args(bank=tmp_path / "bank", sources=("vase",), share=0.1, out=tmp_path)
    captures.main(args)
    (folder,) = (tmp_path / "bank").iterdir()
    facts = json.loads((folder / "recipe.json").read_text())
    assert len(load_ply(folder / "scene.ply")) == facts["gaussians"]
    assert len(load_cameras(folder / "cameras.json")) == 11
    assert f"{facts['psnr']:.1f}" in (tmp_path / "results.md").read_text()

    def refused(*_):
        raise AssertionError("it was there")

    monkeypatch.setattr(captures, "make_capture", refused)
    captures.main(args)
    facts["width"] = 64  # of other options
    (folder / "recipe.json").write_text(json.dumps(facts))
    with pytest.raises(AssertionError, match="was there"):
        captures.main(args)


@needs_data
@pytest.mark.parametrize("source", ["kitchen", "plant"])
def test_the_cameras_of_a_capture_see_its_source(source, small):
    scene, cameras = photographed(make_recipe(source, 0), DATA)
    assert not check_views(scene, cameras)
    assert len({camera.name for camera in cameras}) == 11


def test_images_differ_by_their_exposure_only():
    images = np.full((4, 2, 2, 3), 0.5, np.float32)
    rng = np.random.default_rng(0)
    np.testing.assert_allclose(captures.exposed(images, 0.0, rng), 0.5, atol=1 / 255)
    exposed = captures.exposed(images, 0.1, rng)
    assert np.ptp(exposed, axis=(1, 2, 3)).max() == 0
    assert np.ptp(exposed[:, 0, 0, 0]) > 0.02
