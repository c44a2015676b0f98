"""Cases as the programs of editors make them: labels and truth belong to the edited scene."""

import editors
import numpy as np
import optimised
import pytest
from cases import QUICK, load_scene, make_case, siblings_of
from editors import case_of_family

from gsc_jax.benchmark.tamper import EDITS
from gsc_jax.scene import Gaussians


def rows_of(scene: Gaussians) -> list[bytes]:
    """The values of each Gaussian."""
    leaves = [np.asarray(leaf).reshape(len(scene), -1) for leaf in vars(scene).values()]
    return [row.tobytes() for row in np.concatenate(leaves, axis=1)]


@pytest.mark.slow
@pytest.mark.parametrize("edit", EDITS)
def test_the_program_of_an_editor_makes_a_case(edit):
    case, scene = case_of_family(QUICK, edit, 0, "editor"), load_scene(QUICK)
    assert case.edit == edit
    assert len(case.labels) == len(case.gaussians)
    assert 0.01 < case.truth.mean() < 0.2
    rows, known = rows_of(case.gaussians), set(rows_of(scene.gaussians))
    # A pasted object has its own rows; what is labelled is none of the scene, and all else is.
    assert [row in known for row in rows] == (~case.labels).tolist()
    word = {"incorporation": "lit like", "modification": "optimised", "removal": "inpainted"}[edit]
    assert word in case.description


def test_laundering_changes_authentic_gaussians_of_a_quick_edit(monkeypatch):
    def moved(gaussians, cameras):
        return optimised.refine(
            gaussians,
            cameras,
            optimised.renders(gaussians, cameras, optimised.NEAR),
            options=optimised.Refinement(steps=3, anchor=0.0),
        )

    monkeypatch.setattr(editors, "laundered", moved)
    quick, trained = (
        case_of_family(QUICK, "removal", 0, family) for family in ("quick", "laundered")
    )
    np.testing.assert_array_equal(quick.labels, trained.labels)
    np.testing.assert_array_equal(quick.labels, make_case(QUICK, "removal", 0).labels)
    moved_rows = np.asarray(trained.gaussians.means) != np.asarray(quick.gaussians.means)
    assert moved_rows[~quick.labels].any(axis=1).mean() > 0.5


def test_objects_are_cut_from_another_scene_of_the_group():
    assert siblings_of("hexbox")[1] == ["seal"]
    assert siblings_of("kitchen")[1] == ["playbot", "flowers"]
    assert QUICK not in siblings_of("garden")[1]
