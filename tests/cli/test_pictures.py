"""Pictures for people."""

import numpy as np

from gsc_jax.cli.pictures import contact_sheet, overlay


def test_overlay_marks_the_mask_and_nothing_far_from_it():
    image = np.random.default_rng(0).random((60, 80, 3)).astype(np.float32)
    mask = np.zeros((60, 80), bool)
    mask[20:40, 30:50] = True
    marked = overlay(image, mask)
    changed = (marked != image).any(axis=-1)
    assert changed[mask].all()
    assert not changed[:17].any()
    assert changed.sum() < 1.6 * mask.sum()
    np.testing.assert_array_equal(overlay(image, ~np.ones_like(mask)), image)
    assert ((marked >= 0) & (marked <= 1)).all()


def test_a_name_with_signs_of_formulas_is_a_label(tmp_path):
    picture = np.zeros((4, 6, 3))
    contact_sheet(tmp_path / "sheet.png", {"cost_$5_to_$10_0": [picture]}, titles=["render"])
    assert (tmp_path / "sheet.png").exists()
