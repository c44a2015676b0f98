"""The baselines: cases worked by hand, the laws they obey, and SA3D held to its rendered loss."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import optax
import pytest
from baselines import (
    SA3D_LEVEL,
    flashsplat,
    inverse,
    mode_vote,
    sa3d,
    sagd_boundary,
    sagd_vote,
)
from hypothesis import assume, given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp
from scipy.spatial.transform import Rotation
from strategies import blobs, camera, floats, motions, random_scene, with_row

from gsc_jax.benchmark.metrics import iou
from gsc_jax.evidence.lifting import Evidence, view_evidence
from gsc_jax.render.tiles import make_view
from gsc_jax.splat import composite
from gsc_jax.vote import Tally, no_votes, tally

VIEWS, COUNT = 5, 7
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
        # tampered, authentic, abstained: inverse, mode, SAGD
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
    found = [rule(counts) for rule in (inverse, mode_vote, sagd_vote)]
    assert [(labels.dtype, labels.shape) for labels in found] == [(bool, (1,))] * 3
    assert tuple(bool(labels[0]) for labels in found) == expected


def test_the_agreement_that_sagd_asks_for_is_an_option():
    counts = tally(np.array([[1, 1], [1, 1], [1, 0], [0, 0]], np.int32))  # 3 and 2 of 4
    assert sagd_vote(counts, agreement=0.6).tolist() == [True, False]
    assert sagd_vote(counts, agreement=0.8).tolist() == [False, False]


def test_without_views_nothing_is_found():
    for rule in (inverse, mode_vote, sagd_vote):
        assert rule(no_votes(3)).tolist() == [False] * 3


@given(BALLOTS, ORDERS)
def test_votes_are_ever_stricter_and_know_no_order(votes, order):
    counts = tally(votes)
    assert np.all(sagd_vote(counts) <= mode_vote(counts))
    assert np.all(mode_vote(counts) <= inverse(counts))
    for rule in (inverse, mode_vote, sagd_vote):
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


@given(evidences(), ORDERS)
def test_flashsplat_knows_no_order_of_gaussians(evidence, order):
    np.testing.assert_array_equal(flashsplat(taken(evidence, order)), flashsplat(evidence)[order])


@given(evidences())
def test_complementing_the_masks_swaps_flashsplat_where_it_sees(evidence):
    complement = Evidence(total=evidence.total, tampered=evidence.total - evidence.tampered)
    tie = evidence.total.sum(0) == 2 * evidence.tampered.sum(0)
    labels, swapped = flashsplat(evidence), flashsplat(complement)
    np.testing.assert_array_equal(swapped, np.where(tie, False, ~labels))


def test_the_unseen_abstain_from_flashsplat_whatever_gamma():
    evidence = evidence_of([[0, 1]], [[0, 0.5]])
    assert flashsplat(evidence, gamma=-0.8).tolist() == [False, True]


def test_the_first_step_of_sa3d_is_the_learning_rate():
    # The sides meet at 0.3 / 1.3 = 23.08 %: 0.3 * 76 - 24 < 0 < 0.3 * 77 - 23. The last is unseen.
    evidence = evidence_of([[100, 100, 1e-4, 0]], [[24, 23, 1e-4, 0]])
    score = sa3d(evidence, passes=1)
    assert score.dtype == np.float32
    np.testing.assert_allclose(score, [1, -1, 1, 0], rtol=1e-5)
    np.testing.assert_allclose(sa3d(evidence, passes=1, learning_rate=0.25), score / 4, rtol=1e-5)
    assert sa3d(evidence, passes=1, price=0.4)[0] < 0  # now 0.4 / 1.4 = 28.6 %


# After a gradient g and then none, m = 0.09 g / (1 - 0.9^2) = 0.473684 g, and v =
# 0.000999 g^2 / (1 - 0.999^2) = 0.499750 g^2: the second step is 0.473684 / 0.706930.
MOMENTUM = 0.670058


def test_momentum_moves_what_a_later_view_does_not_see():
    evidence = evidence_of([[5, 2], [0, 0]], [[5, 0], [0, 0]])
    score = sa3d(evidence, passes=1)
    np.testing.assert_allclose(score, [1 + MOMENTUM, -1 - MOMENTUM], rtol=1e-4)


def test_the_second_pass_moves_only_what_the_first_has_kept():
    evidence = evidence_of([[5, 2, 0], [0, 0, 0]], [[5, 0, 0], [0, 0, 0]])
    first, second = sa3d(evidence, passes=1), sa3d(evidence)
    assert second[0] > first[0] + 1
    assert first[1] < 0
    assert second[1:].tolist() == [0, 0], "what was taken out has a score"


@given(evidences(), ORDERS)
def test_sa3d_knows_no_order_of_gaussians(evidence, order):
    np.testing.assert_array_equal(sa3d(taken(evidence, order)), sa3d(evidence)[order])


CAMERA = camera(17, 15)
SCENE = random_scene(40)


def turned(angle: float):
    """The camera, moved around what lies 3 before it."""
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
    assert np.ptp(r) > 2, "the scene moves nothing"
    np.testing.assert_allclose(sa3d(evidence, passes=1), r, rtol=1e-3, atol=1e-3)


def test_the_gate_skips_views_as_if_they_were_not_there():
    rng = np.random.default_rng(1)
    total = rng.random((3, 9)).astype(np.float32)
    evidence = Evidence(total=total, tampered=total * rng.random((3, 9), np.float32))
    without = Evidence(total=total[[0, 2]], tampered=evidence.tampered[[0, 2]])
    asked = []

    def overlap(view: int, r: np.ndarray) -> float:
        assert r.shape == (9,)
        asked.append(view)
        return 0.49 if view == 1 else 0.5  # at 0.5 a view is let through

    assert np.array_equal(sa3d(evidence, overlap=overlap), sa3d(without))
    assert asked == [1, 2, 0, 1, 2], "only the very first step is free"


def gated(masks: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """SA3D of three round Gaussians in a row seen from five sides, with the gate and without."""
    scene = blobs([[-1, 0, 3], [0, 0, 3], [1, 0, 3]], opacity=0.95)
    views = [make_view(scene, turned(angle)) for angle in np.linspace(-0.1, 0.1, 5)]
    evidence = jax.tree.map(
        lambda *leaves: np.stack(leaves),
        *(view_evidence(view, mask) for view, mask in zip(views, masks, strict=True)),
    )

    def overlap(view: int, r: np.ndarray) -> float:
        return iou(composite(views[view], jnp.asarray(r)[:, None])[..., 0], masks[view])

    return sa3d(evidence, overlap=overlap), sa3d(evidence)


def test_an_empty_first_mask_makes_the_gate_reject_all_that_follow():
    disc = np.hypot(*(np.indices((15, 17)) - np.array([7, 8])[:, None, None])) < 1.8
    masks = np.stack([disc] * 5)
    for score in gated(masks):
        assert (score > SA3D_LEVEL).tolist() == [False, True, False]
    with_gate, without_gate = gated(masks * (np.arange(5) > 0)[:, None, None])
    assert not np.any(with_gate > 0)
    assert without_gate[1] > SA3D_LEVEL


def test_more_views_of_as_many_gaussians_compile_nothing(count_compilations):
    evidence = evidence_of(np.ones((2, 11)), np.ones((2, 11)))
    sa3d(evidence)
    with count_compilations() as compiled:
        sa3d(jax.tree.map(lambda leaf: np.tile(leaf, (3, 1)), evidence), price=0.5)
    assert not compiled


# 8 pixels per unit at depth 4, so a standard deviation of 0.5 along x is 4 pixels: the segment runs
# from 26 to 38.
WIDE = camera(64, 64, focal=32.0)
NEEDLE = with_row(blobs([0, 0, 4], scale=0.05), "log_scales", np.log([0.5, 0.05, 0.05]))
LEFT = np.arange(64)[None].repeat(64, 0) < 35
"""0.75 of the needle is in it."""
SELECTED = np.array([True])


def assert_cut(cut, x: float, scale: float, *, depth: float = 4.0, tolerance: float = 0.012):
    np.testing.assert_allclose(cut.means[0], [x, 0, depth], atol=tolerance)
    np.testing.assert_allclose(np.exp(cut.log_scales[0, 0]), scale, atol=tolerance)


def test_a_boundary_gaussian_is_cut_back_by_hand():
    cut = sagd_boundary(NEEDLE, SELECTED, WIDE, LEFT)
    # rho 0.75: scaled by 0.6, moved by 0.5 * 0.25 * 3 * 0.5 = 0.1875 to the left.
    assert_cut(cut, -0.1875, 0.3)
    assert np.ptp(cut.log_scales - NEEDLE.log_scales) < 1e-6, "the axes shrink differently"
    # rho 0.25: scaled by 0.2, moved by 0.5 * 0.75 * 3 * 0.5 = 0.5625 to the right.
    assert_cut(sagd_boundary(NEEDLE, SELECTED, WIDE, ~LEFT), 0.5625, 0.1)
    for field in ("quats", "logit_opacities", "sh"):
        assert getattr(cut, field) is getattr(NEEDLE, field)


@pytest.mark.parametrize("sign", [-1, 1])
def test_a_turned_gaussian_is_cut_along_its_own_axis(sign):
    # A quarter turn about z lays the needle along y; either sign of the quaternion is that turn.
    quat = sign * np.array([np.sqrt(0.5), 0, 0, np.sqrt(0.5)])
    upright = with_row(NEEDLE, "quats", quat)
    cut = sagd_boundary(upright, SELECTED, WIDE, LEFT.T)
    np.testing.assert_allclose(cut.means[0], [0, -0.1875, 4], atol=0.01)
    # Half a quarter about y, away from the camera: the projection is sqrt(1/2) as long.
    slanted = with_row(
        NEEDLE, "quats", sign * np.array([np.cos(np.pi / 8), 0, -np.sin(np.pi / 8), 0])
    )
    cut = sagd_boundary(slanted, SELECTED, WIDE, np.arange(64)[None].repeat(64, 0) < 32)
    # rho 0.5: moved by 0.5 * 0.5 * 3 * 0.5 = 0.375 along (-1, 0, -1) / sqrt(2).
    assert_cut(cut, -0.265, 0.2, depth=4 - 0.265)


def test_away_from_the_axis_what_recedes_moves_to_the_middle_of_the_image():
    # At (2, 0, 4), in pixel 48, a needle along (0.2, 0, 0.98): its far end is to the right in space
    # and to the left in the image, since 0.2 - 0.98 * 2 / 4 < 0. So it must recede to go left.
    quat = Rotation.from_euler("y", -np.arctan2(0.98, 0.2)).as_quat(scalar_first=True)
    receding = with_row(with_row(NEEDLE, "means", [2, 0, 4]), "quats", quat)
    cut = sagd_boundary(receding, SELECTED, WIDE, np.arange(64)[None].repeat(64, 0) < 48)
    np.testing.assert_allclose(
        cut.means[0] - np.array([2, 0, 4]), [0.375 * 0.2, 0, 0.375 * 0.98], atol=0.01
    )


@given(motions())
def test_boundaries_move_with_the_scene(motion):
    quat, shift = motion
    rotation = Rotation.from_quat(quat, scalar_first=True)
    viewmat = np.eye(4)
    viewmat[:3, :3] = rotation.inv().as_matrix()
    viewmat[:3, 3] = -rotation.inv().apply(shift)

    def moved(scene):
        means = (rotation.apply(scene.means) + shift).astype(np.float32)
        quats = (rotation * Rotation.from_quat(scene.quats, scalar_first=True)).as_quat(
            scalar_first=True
        )
        return dataclasses.replace(scene, means=means, quats=quats.astype(np.float32))

    cut = sagd_boundary(moved(NEEDLE), SELECTED, dataclasses.replace(WIDE, viewmat=viewmat), LEFT)
    expected = moved(sagd_boundary(NEEDLE, SELECTED, WIDE, LEFT))
    np.testing.assert_allclose(cut.means, expected.means, atol=1e-5)
    np.testing.assert_allclose(cut.log_scales, expected.log_scales, atol=1e-5)


def test_outside_of_the_image_is_outside_of_the_mask():
    # Its centre is at x = 2 and its segment from -4 to 8: two thirds are in the image.
    left = with_row(NEEDLE, "means", [-3.75, 0, 4])
    cut = sagd_boundary(left, SELECTED, WIDE, np.ones((64, 64), bool))
    assert_cut(cut, -3.75 + 0.25, 0.8 * 2 / 3 * 0.5)


def test_what_is_not_at_the_boundary_stays():
    hole = np.ones((64, 64), bool)
    hole[:, 30:34] = False  # under the middle of the needle, whose ends are both inside
    behind = with_row(NEEDLE, "means", [0, 0, -4])
    for gaussians, labels, mask in (
        (NEEDLE, SELECTED, hole),
        (NEEDLE, SELECTED, ~hole),
        (NEEDLE, ~SELECTED, LEFT),
        (behind, SELECTED, LEFT),
    ):
        cut = sagd_boundary(gaussians, labels, WIDE, mask)
        assert np.array_equal(cut.means, gaussians.means)
        assert np.array_equal(cut.log_scales, gaussians.log_scales)


@pytest.mark.parametrize(("column", "cut"), [(33.4, False), (33.6, True)])
def test_the_low_pass_is_no_part_of_the_segment(column, cut):
    # A standard deviation of 1 pixel reaches 1.5; with the low-pass it would be 1.14 and 1.71. The
    # border is 1.6 or 1.4 pixels away.
    dot = blobs([(column - 32) / 8, 0, 4], scale=0.125)
    changed = sagd_boundary(dot, SELECTED, WIDE, LEFT).log_scales != dot.log_scales
    assert changed.all() == changed.any() == cut


@pytest.mark.usefixtures("nan_is_an_error")
def test_a_share_near_zero_leaves_a_small_gaussian():
    # The end at 38.001 is inside and next to nothing else.
    touching = with_row(NEEDLE, "means", [0.001 / 8, 0, 4])
    cut = sagd_boundary(touching, SELECTED, WIDE, np.arange(64)[None].repeat(64, 0) >= 38)
    assert np.isfinite(cut.log_scales).all()
    assert 0 < np.exp(cut.log_scales[0, 0]) < 0.02 * 0.5
    assert_cut(cut, 0.75, 0.0)


@given(hnp.arrays(bool, (15, 17)), hnp.arrays(bool, 40))
def test_a_boundary_only_shrinks_what_is_selected(mask, labels):
    cut = sagd_boundary(SCENE, labels, CAMERA, mask)
    shrunk = cut.log_scales - SCENE.log_scales
    assert np.isfinite(shrunk).all()
    assert np.all(shrunk <= 0)
    changed = shrunk[:, 0] < 0
    assert np.all(changed <= labels)
    np.testing.assert_array_equal(cut.means[~changed], SCENE.means[~changed])
    assume(changed.any())
    assert np.all(shrunk[changed] <= np.log(0.8) + 1e-5)


def test_a_cut_gaussian_shows_less_outside_of_the_mask():
    def share_inside(gaussians) -> float:
        evidence = view_evidence(make_view(gaussians, WIDE), LEFT)
        return float(evidence.tampered[0] / evidence.total[0])

    assert share_inside(NEEDLE) < 0.8
    assert share_inside(sagd_boundary(NEEDLE, SELECTED, WIDE, LEFT)) > 0.95


def test_boundaries_need_labels_and_a_mask_of_the_right_size():
    with pytest.raises(ValueError, match=r"mask must be \(64, 64\), got \(64, 63\)"):
        sagd_boundary(NEEDLE, SELECTED, WIDE, LEFT[:, 1:])
    with pytest.raises(ValueError, match=r"labels must be \(1,\), got \(2,\)"):
        sagd_boundary(NEEDLE, np.array([True, True]), WIDE, LEFT)


def test_sa3d_works_on_sets_of_masks_together_as_on_each_alone():
    rng = np.random.default_rng(0)
    total = rng.uniform(0, 9, (VIEWS, COUNT)).astype(np.float32)
    sets = (rng.random((3, VIEWS, COUNT)) < 0.5) * total
    agreement = rng.random((3, VIEWS))  # the gate lets other views pass in each set

    def gate(k: int | None):
        return lambda view, _r: agreement[:, view] if k is None else agreement[k, view]

    for gates in ((None, None, None, None), (gate(None), gate(0), gate(1), gate(2))):
        together = sa3d(Evidence(total=total, tampered=sets), overlap=gates[0])
        assert together.shape == (3, COUNT)
        for k, own in enumerate(sets):
            alone = sa3d(Evidence(total=total, tampered=own), overlap=gates[k + 1])
            np.testing.assert_allclose(together[k], alone, rtol=1e-5, atol=1e-5)
