import dataclasses

import cases
import numpy as np
import pytest
from detector_strengths import PROFILES

from gsc_jax.benchmark.simulate import REGIMES


def test_a_case_is_reproduced_from_its_key():
    one, again = (cases.make_case(cases.QUICK, "incorporation", 0) for _ in range(2))
    assert np.array_equal(one.labels, again.labels)
    assert np.array_equal(one.heldout_truth, again.heldout_truth)
    masks, others = (cases.detector_masks(case, REGIMES) for case in (one, again))
    assert all(np.array_equal(masks[name], others[name]) for name in REGIMES)
    keys = [
        (dataclasses.replace(one, scene=scene, edit=edit, seed=seed), regime)
        for scene in (dataclasses.replace(one.scene, name=name) for name in ("room", "garden"))
        for edit in ("incorporation", "modification", "removal")
        for seed in (0, 1, 2)
        for regime in (*REGIMES, *PROFILES)
    ]
    assert len({cases._seed(*key) for key in keys}) == len(keys), "two masks share a seed"


@pytest.mark.parametrize("scene", ["kitchen", "room"])
def test_donors_alternate_with_the_seed(scene):
    names = {cases.donor_name(scene, seed) for seed in range(8)}
    assert any(name.startswith(cases.CUT) for name in names)
    assert cases.CUT + scene not in names
