"""The baselines: cases worked by hand, laws, and SA3D against its rendered loss."""

import jax
import jax.numpy as jnp
import numpy as np
import optax
import pytest
from baselines import SA3D_LEVEL, flashsplat, inverse_projection, mode_vote, sa3d, sagd_vote
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp
from scipy.spatial.transform import Rotation
from strategies import blobs, camera, floats, random_scene

from gsc_jax.benchmark.metrics import confusion
from gsc_jax.evidence.lifting import Evidence, view_evidence
from gsc_jax.render.tiles import make_view
from gsc_jax.splat import composite
from gsc_jax.vote import Tally, tally

VIEWS, COUNT = 5, 7
RULES = inverse_projection, mode_vote, sagd_vote
BALLOTS = hnp.arrays(np.int32, (VIEWS, COUNT), elements=st.integers(-1, 1))
ORDERS = st.permutations(range(COUNT)).map(np.array)


@st.composite
def evidences(draw) -> Evidence:
    """Weights in quarters, so that sums are exact and ties are ties."""
    total = np.round(4 * draw(floats((VIEWS, COUNT), 0, 9))) / 4
    share = draw(hnp.arrays(np.float32, total.shape, elements=st.sampled_from([0, 0.25, 0.5, 1])))
    return Evidence(total=total, tampered=(share * total).astype(np.float32))


def evidence_of(total, tampered) -> Evidence:
    return Evidence(total=np.array(total, np.float32), tampered=np.array(tampered, np.float32))


def taken(evidence: Evidence, columns) -> Evidence:
    return Evidence(total=evidence.total[:, columns], tampered=evidence.tampered[:, columns])


@pytest.mark.parametrize(
    ("votes", "expected"),
    [
        # tampered, authentic, abstained: inverse projection, mode vote, SAGD vote
        ((8, 1, 1), (True, True, True)),
        ((7, 3, 0), (True, True, False)),  # 7 of 10 is not more than 0.7
        ((63, 27, 0), (True, True, False)),  # nor is 63 of 90, though 0.7 * 90 < 63 in float64
        ((64, 26, 0), (True, True, True)),
        ((7, 0, 3), (True, True, False)),  # of all views, not of those that see it
        ((4, 3, 3), (True, True, False)),
        ((4, 2, 4), (True, False, False)),  # a tie with the abstentions
        ((1, 9, 0), (True, False, False)),
        ((0, 0, 10), (False, False, False)),
        ((0, 0, 0), (False, False, False)),
    ],
)
def test_votes_by_hand(votes, expected):
    counts = (np.array([count], np.int32) for count in votes)
    counts = Tally(**dict(zip(("tampered", "authentic", "abstained"), counts, strict=True)))
    found = [rule(counts) for rule in RULES]
    assert [(labels.dtype, labels.shape) for labels in found] == [(bool, (1,))] * 3
    assert tuple(bool(labels[0]) for labels in found) == expected


@given(BALLOTS, ORDERS)
def test_rules_are_nested_and_permutation_equivariant(votes, order):
    counts = tally(votes)
    assert np.all(sagd_vote(counts) <= mode_vote(counts))
    assert np.all(mode_vote(counts) <= inverse_projection(counts))
    for rule in RULES:
        np.testing.assert_array_equal(rule(tally(votes[:, order])), rule(counts)[order])


def test_flashsplat_by_hand():
    # Summed over two views (A0, A1) is (4, 3), of length 5: (0.8, 0.6), so the sides meet at -0.2.
    evidence = evidence_of([[3], [4]], [[3], [0]])
    assert not flashsplat(evidence)[0]
    assert not flashsplat(evidence, gamma=-0.19)[0]
    assert flashsplat(evidence, gamma=-0.21)[0]
    # (36, 64) / 73.4 differ by 0.381, (35, 65) / 73.8 by 0.406.
    evidence = evidence_of([[100, 100]], [[64, 65]])
    assert flashsplat(evidence).tolist() == [True, True]
    assert flashsplat(evidence, gamma=0.4).tolist() == [False, True]


@given(evidences(), st.sampled_from([-0.8, -0.3, 0.0, 0.4, 0.75]))
def test_flashsplat_is_a_threshold_on_the_share_inside(evidence, gamma):
    total, inside = evidence.total.sum(0), evidence.tampered.sum(0)
    share = np.divide(inside, total, out=np.zeros(COUNT), where=total > 0)
    threshold = (1 + gamma / np.sqrt(2 - gamma**2)) / 2
    clear = np.abs(share - threshold) > 1e-9
    expected = evidence.seen & (share > threshold)
    np.testing.assert_array_equal(flashsplat(evidence, gamma=gamma)[clear], expected[clear])


@given(evidences())
def test_complementing_the_masks_swaps_the_labels_of_flashsplat(evidence):
    complement = Evidence(total=evidence.total, tampered=evidence.total - evidence.tampered)
    tie = evidence.total.sum(0) == 2 * evidence.tampered.sum(0)
    labels, swapped = flashsplat(evidence), flashsplat(complement)
    np.testing.assert_array_equal(swapped, np.where(tie, False, ~labels))


def test_the_first_step_of_sa3d_is_the_learning_rate():
    # The sides meet at 0.3 / 1.3 = 23.08 %: 0.3 * 76 - 24 < 0 < 0.3 * 77 - 23. The last is unseen.
    evidence = evidence_of([[100, 100, 1e-4, 0]], [[24, 23, 1e-4, 0]])
    score = sa3d(evidence, passes=1)
    assert score.dtype == np.float32
    np.testing.assert_allclose(score, [1, -1, 1, 0], rtol=1e-5)
    np.testing.assert_allclose(sa3d(evidence, passes=1, learning_rate=0.25), score / 4, rtol=1e-5)
    assert sa3d(evidence, passes=1, price=0.4)[0] < 0  # now 0.4 / 1.4 = 28.6 %


def test_the_second_pass_moves_only_positive_scores():
    evidence = evidence_of([[5, 2, 0], [0, 0, 0]], [[5, 0, 0], [0, 0, 0]])
    first, second = sa3d(evidence, passes=1), sa3d(evidence)
    assert second[0] > first[0] + 1
    assert first[1] < 0
    assert second[1:].tolist() == [0, 0], "a frozen Gaussian has a score"


@given(evidences(), ORDERS)
def test_sa3d_is_permutation_equivariant(evidence, order):
    np.testing.assert_array_equal(sa3d(taken(evidence, order)), sa3d(evidence)[order])


CAMERA = camera(17, 15)
SCENE = random_scene(40)


def turned(angle: float):
    """The camera, rotated about the point 3 in front of it."""
    viewmat = np.eye(4)
    viewmat[:3, :3] = Rotation.from_euler("y", angle).as_matrix()
    viewmat[:3, 3] = [0, 0, 3] - viewmat[:3, :3] @ [0, 0, 3]
    return camera(17, 15, viewmat=viewmat)


def test_sa3d_is_adam_on_the_rendered_loss():
    views = [make_view(SCENE, turned(angle)) for angle in (-0.4, 0.0, 0.4)]
    masks = np.random.default_rng(0).random((3, 15, 17)).astype(np.float32)  # soft

    def rendered_loss(r, view, mask):
        rendered = composite(view, r[:, None])[..., 0]
        return -jnp.sum(mask * rendered) + 0.3 * jnp.sum((1 - mask) * rendered)

    adam = optax.adam(1.0, eps=1e-15)
    r = jnp.zeros(40)
    state = adam.init(r)
    for view, mask in zip(views, masks, strict=True):
        gradient = jax.grad(rendered_loss)(r, view, mask)
        one = view_evidence(view, mask)
        np.testing.assert_allclose(
            gradient, 0.3 * (one.total - one.tampered) - one.tampered, rtol=1e-4, atol=1e-4
        )
        with jax.numpy_dtype_promotion("standard"):
            updates, state = adam.update(gradient, state)
        r = jnp.asarray(optax.apply_updates(r, updates))
    evidence = jax.tree.map(
        lambda *leaves: np.stack(leaves),
        *(view_evidence(view, mask) for view, mask in zip(views, masks, strict=True)),
    )
    assert np.ptp(r) > 2, "the scores hardly move"
    np.testing.assert_allclose(sa3d(evidence, passes=1), r, rtol=1e-3, atol=1e-3)


def test_skipped_views_have_no_effect():
    rng = np.random.default_rng(1)
    total = rng.random((3, 9)).astype(np.float32)
    evidence = Evidence(total=total, tampered=total * rng.random((3, 9), np.float32))
    without = Evidence(total=total[[0, 2]], tampered=evidence.tampered[[0, 2]])
    calls = []

    def overlap(view: int, r: np.ndarray) -> float:
        assert r.shape == (9,)
        calls.append(view)
        return 0.49 if view == 1 else 0.5  # a view at 0.5 passes

    assert np.array_equal(sa3d(evidence, overlap=overlap), sa3d(without))
    assert calls == [1, 2, 0, 1, 2], "only the first step is free"


def gated(masks: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """SA3D of three round Gaussians in a row seen from five sides, with the gate and without."""
    scene = blobs([[-1, 0, 3], [0, 0, 3], [1, 0, 3]], opacity=0.95)
    views = [make_view(scene, turned(angle)) for angle in np.linspace(-0.1, 0.1, 5)]
    evidence = jax.tree.map(
        lambda *leaves: np.stack(leaves),
        *(view_evidence(view, mask) for view, mask in zip(views, masks, strict=True)),
    )

    def overlap(view: int, r: np.ndarray) -> float:
        rendered = composite(views[view], jnp.asarray(r)[:, None])[..., 0]
        return confusion(rendered, masks[view]).iou

    return sa3d(evidence, overlap=overlap), sa3d(evidence)


def test_an_empty_first_mask_makes_the_gate_reject_all_others():
    disc = np.hypot(*(np.indices((15, 17)) - np.array([7, 8])[:, None, None])) < 1.8
    masks = np.stack([disc] * 5)
    for score in gated(masks):
        assert (score > SA3D_LEVEL).tolist() == [False, True, False]
    with_gate, without_gate = gated(masks * (np.arange(5) > 0)[:, None, None])
    assert not np.any(with_gate > 0)
    assert without_gate[1] > SA3D_LEVEL


def test_sa3d_of_sets_of_masks_equals_that_of_each_alone():
    rng = np.random.default_rng(0)
    total = rng.uniform(0, 9, (VIEWS, COUNT)).astype(np.float32)
    sets = (rng.random((3, VIEWS, COUNT)) < 0.5) * total
    agreement = rng.random((3, VIEWS))  # other views pass the gate in each set

    def gate(k: int | None):
        return lambda view, _r: agreement[:, view] if k is None else agreement[k, view]

    for gates in ((None, None, None, None), (gate(None), gate(0), gate(1), gate(2))):
        together = sa3d(Evidence(total=total, tampered=sets), overlap=gates[0])
        assert together.shape == (3, COUNT)
        for k, own in enumerate(sets):
            alone = sa3d(Evidence(total=total, tampered=own), overlap=gates[k + 1])
            np.testing.assert_allclose(together[k], alone, rtol=1e-5, atol=1e-5)
