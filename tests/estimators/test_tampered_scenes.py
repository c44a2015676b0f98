"""`robust` on the real tampered scenes, with the masks of their detector."""

import numpy as np
import pytest
from data import TAMPERED, load_tampered, needs_data

from gsc_jax import FolderDetector, RobustEstimator
from gsc_jax.benchmark.metrics import confusion
from gsc_jax.evidence.observation import observe


@needs_data
@pytest.mark.slow
@pytest.mark.parametrize("name", TAMPERED)
def test_robust_finds_the_edit_with_any_seed_and_little_else_with_most(name):
    scene = load_tampered(name)
    detector = FolderDetector(scene.folder / "detector")
    observation = observe(scene.gaussians, scene.cameras, detector)
    weight, shares = observation.evidence.weight, []
    for seed in range(3):
        found = RobustEstimator(seed=seed).estimate(observation)
        both = weight[found.labels & scene.labels].sum()
        assert both > 0.93 * weight[scene.labels].sum()
        shares.append(2 * both / (weight[found.labels].sum() + weight[scene.labels].sum()))
        assert confusion(found.labels, scene.labels).precision > 0.8
        assert np.isfinite(found.tamper).all()
    assert shares[RobustEstimator().seed] > 0.95, f"F1 by weight {shares}"
    assert min(shares) > 0.8, f"F1 by weight {shares}"
    assert sorted(shares)[1] > 0.95, f"F1 by weight {shares}"
