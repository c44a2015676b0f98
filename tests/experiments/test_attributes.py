"""The picture that compares the attributes of both groups."""

import attributes
import numpy as np
import pytest
from cli_case import run

from gsc_jax.benchmark.scenes import tampered_room
from gsc_jax.io.ply import save_ply
from gsc_jax.scene import InputError


def test_distributions_of_both_groups_are_drawn(tmp_path, capsys):
    made = tampered_room(seed=0, count=3_000)
    save_ply(tmp_path / "scene.ply", made.gaussians)
    found = tmp_path / "found"
    assert run("locate", tmp_path / "scene.ply", "--out", found, "--views", 2).code == 0
    labels = np.load(found / "labels.npy")
    assert labels.any()
    capsys.readouterr()
    picture = tmp_path / "attributes.png"
    attributes.main(attributes.Args(found=found, out=picture))
    assert picture.stat().st_size > 20_000
    (size,) = [line for line in capsys.readouterr().out.splitlines() if line.startswith("Size")]
    decades = np.asarray(made.gaussians.log_scales).mean(axis=1) / np.log(10)
    assert f"{np.median(decades[labels]):.3g} labelled" in size
    assert f"{np.median(decades[~labels]):.3g} others" in size


def test_shares_add_up_and_include_outliers():
    groups = [np.append(np.linspace(0, 1, 999), 1e9), np.full(3, 0.5)]
    heights, edges = attributes.shares(groups, 20)
    assert [height.sum() for height in heights] == pytest.approx([1, 1])
    assert edges[-1] < 2
    assert len(edges) == 21


def test_one_group_alone_is_refused(tmp_path):
    made = tampered_room(seed=0, count=3_000)
    save_ply(tmp_path / "scene.ply", made.gaussians)
    argv = ["--out", tmp_path / "found", "--views", 2, "--threshold", 0.999999]
    assert run("locate", tmp_path / "scene.ply", *argv).code == 0
    with pytest.raises(InputError, match="nothing to compare"):
        attributes.main(attributes.Args(found=tmp_path / "found"))
