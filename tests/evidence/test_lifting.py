"""Evidence: values for two Gaussians, bounds, and equality with the gradient of the 2D loss."""

import jax
import jax.numpy as jnp
import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp
from strategies import blobs, camera, random_scene

from gsc_jax.evidence.lifting import Evidence, SparseEvidence, sparse, view_evidence
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


@st.composite
def dense(draw):
    """Evidence of V views of N Gaussians, most of it zero."""
    shape = draw(st.tuples(st.integers(1, 4), st.integers(1, 30)))
    weights = hnp.arrays(np.float32, shape, elements=st.sampled_from([0.0, 0.0, 0.0, 0.5, 2e-30]))
    total = draw(weights)
    return Evidence(total=total, tampered=np.minimum(total, draw(weights)))


@given(dense(), st.data())
def test_sparse_evidence_reads_as_the_dense_one(evidence, data):
    views, count = evidence.shape
    entries = [sparse(view) for view in evidence.views()]
    thin = SparseEvidence(entry=entries.__getitem__, shape=(views, count))
    assert thin.shape == evidence.shape
    for name in ("total", "tampered", "seen", "weight", "none_flagged", "all_flagged"):
        assert np.array_equal(getattr(thin, name), getattr(evidence, name)), name
    start, end = sorted(data.draw(st.tuples(*[st.integers(0, count)] * 2)))
    some = data.draw(hnp.arrays(int, 5, elements=st.integers(0, count - 1)))
    for rows in (slice(start, end), slice(start, None), some):
        for found, expected in zip(thin.of(rows), evidence.of(rows), strict=True):
            assert np.array_equal(found, expected)
    assert isinstance(thin.expanded(8 * views * count), Evidence)
    assert thin.expanded(8 * views * count - 1) is thin
