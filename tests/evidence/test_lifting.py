"""Evidence: values for two Gaussians, bounds, and equality with the gradient of the 2D loss."""

import jax
import jax.numpy as jnp
import numpy as np
from hypothesis import given
from hypothesis.extra import numpy as hnp
from strategies import blobs, camera, random_scene

from gsc_jax.evidence.lifting import view_evidence
from gsc_jax.evidence.storage import blank_evidence
from gsc_jax.losses import loss_2d, loss_2d_from_evidence
from gsc_jax.render.tiles import make_view
from gsc_jax.splat import accumulate, composite

CAMERA = camera(17, 15)
SCENE = random_scene(40)
VIEW = make_view(SCENE, CAMERA)


def test_a_hidden_gaussian_has_no_evidence_and_is_not_seen():
    wall = [[0, 0, 1]] * 3
    scene = blobs([*wall, [0, 0, 5]], opacity=0.999, scale=5.0)
    evidence = view_evidence(make_view(scene, CAMERA), np.ones((15, 17), bool))
    assert evidence.seen.tolist()[0] is True
    assert not evidence.seen[3], "the hidden Gaussian is seen through three opaque walls"


@given(hnp.arrays(bool, (15, 17)))
def test_tampered_weight_is_part_of_the_total(mask):
    evidence = view_evidence(VIEW, mask)
    assert np.all(np.asarray(evidence.tampered) >= 0)
    unclamped = accumulate(VIEW, jnp.asarray(mask, jnp.float32)[..., None])[:, 0]
    assert np.all(unclamped <= evidence.total * (1 + 1e-6) + 1e-6)
    complement = view_evidence(VIEW, ~mask)
    np.testing.assert_allclose(evidence.tampered + complement.tampered, evidence.total, atol=1e-4)


@given(hnp.arrays(bool, (15, 17)))
def test_the_gradient_from_evidence_is_that_of_the_rendered_loss(mask):
    def rendered_loss(r):
        return loss_2d(composite(VIEW, r[:, None])[..., 0], mask)

    r = jnp.linspace(-1, 1, 40)
    gradient = jax.grad(loss_2d_from_evidence)(r, view_evidence(VIEW, mask))
    np.testing.assert_allclose(jax.grad(rendered_loss)(r), gradient, rtol=1e-4, atol=1e-4)


def test_large_evidence_lies_in_a_file_and_reads_the_same():
    filled = [blank_evidence(3, 5, max_bytes_in_memory=limit) for limit in (0, 2**20)]
    on_disk, in_memory = filled
    assert isinstance(on_disk.total, np.memmap)
    assert not isinstance(in_memory.total, np.memmap)
    for evidence in filled:
        assert evidence.none_flagged
        assert not evidence.seen.any()
        evidence.total[1], evidence.tampered[1] = np.arange(5), np.arange(5)
        assert evidence.seen.tolist() == [False, True, True, True, True]
        assert evidence.all_flagged
        evidence.tampered[1, 2] = 0
        assert not evidence.none_flagged
        assert not evidence.all_flagged
    assert np.array_equal(on_disk.tampered, in_memory.tampered)
