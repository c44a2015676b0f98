"""The optimisation: single steps by hand, the start of the 3D loss, and both paths."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from data import TAMPERED, load_tampered, needs_data
from strategies import camera, random_scene

from gsc_jax.detectors.folder import FolderDetector
from gsc_jax.estimators.gschecker import ATTRIBUTES, OFFICIAL, PAPER
from gsc_jax.evidence.lifting import Evidence, view_evidence
from gsc_jax.locate import locate
from gsc_jax.loop import MAX_WEIGHT, LoopConfig, fit, fit_rendered, init, resolved, step, view_order
from gsc_jax.render.tiles import make_view

ATTRIBUTES_OF_SIX = np.array([[1.0, 1.0, 0.9, 0.1, 0.0, 0.0]], np.float32)
R = np.array([9.0, 9.0, 0.5, 0.5, -9.0, -9.0], np.float32)


def zero_loss(r):
    return 0.0 * jnp.sum(r)


def test_the_first_step_has_the_length_of_the_learning_rate():
    config = LoopConfig(contrastive_start=9, learning_rate=0.25)
    state, info = step(init(R), lambda r: 5 * r[0] - 1e-6 * r[1], ATTRIBUTES_OF_SIX, config=config)
    np.testing.assert_allclose(state.r - R, [-0.25, 0.25, 0, 0, 0, 0], rtol=1e-4, atol=1e-6)
    assert info.loss_2d == pytest.approx(5 * 9 - 9e-6)
    assert info.group_sizes.tolist() == [2, 2, 2]
    default = step(
        init(R), lambda r: r[0], ATTRIBUTES_OF_SIX, config=LoopConfig(contrastive_start=9)
    )
    np.testing.assert_allclose(default[0].r - R, [-1, 0, 0, 0, 0, 0], rtol=1e-4, atol=1e-6)


def test_the_3d_loss_starts_at_the_configured_iteration():
    state, config = init(R), LoopConfig(contrastive_start=2)
    for _ in range(2):
        state, info = step(state, zero_loss, ATTRIBUTES_OF_SIX, config=config)
    assert np.array_equal(state.r, R), "the 3D loss acted in the first phase"
    state, info = step(state, zero_loss, ATTRIBUTES_OF_SIX, config=config)
    moved = np.sign(state.r - R)
    assert moved.tolist() == [0, 0, 1, -1, 0, 0], "the 3D loss did nothing in the second phase"
    assert info.loss_3d == 0  # the two cancel


def test_the_3d_loss_is_reported_as_0_before_it_starts():
    r = np.array([9.0, 9.0, 0.5, 0.25, -9.0, -9.0], np.float32)
    for start, loss in ((1, 0), (0, -(0.5 - 0.25) / 2)):
        config = LoopConfig(contrastive_start=start)
        _, info = step(init(r), zero_loss, ATTRIBUTES_OF_SIX, config=config)
        assert info.loss_3d == pytest.approx(loss)


def test_the_3d_loss_starts_after_half_of_the_iterations_by_default():
    evidence = Evidence(total=np.zeros((4, 6), np.float32), tampered=np.zeros((4, 6), np.float32))
    order = view_order(4, epochs=1)
    default = fit(evidence, R, ATTRIBUTES_OF_SIX, order, config=LoopConfig())[0]
    explicit = fit(evidence, R, ATTRIBUTES_OF_SIX, order, config=LoopConfig(contrastive_start=2))[0]
    never = fit(evidence, R, ATTRIBUTES_OF_SIX, order, config=LoopConfig(contrastive_start=4))[0]
    assert np.array_equal(default, explicit)
    assert np.array_equal(never, R)
    assert not np.array_equal(default, R)


@pytest.mark.usefixtures("nan_is_an_error")
@pytest.mark.parametrize("r", [np.zeros(6), -np.ones(6), np.ones(6)])
def test_empty_groups_give_no_nan(r):
    evidence = Evidence(total=np.ones((4, 6), np.float32), tampered=np.zeros((4, 6), np.float32))
    order, r = view_order(4, epochs=2), r.astype(np.float32)
    fitted, infos = fit(evidence, r, ATTRIBUTES_OF_SIX, order, config=LoopConfig())
    assert jnp.isfinite(fitted).all()
    assert jnp.isfinite(infos.loss_3d).all()


def test_the_defaults_are_those_of_the_paper():
    assert (PAPER.epochs, PAPER.shuffle, PAPER.threshold) == (5, True, 0.1)
    assert PAPER.seed == 0
    loop = LoopConfig()
    assert PAPER.loop == loop
    assert (loop.lambda1, loop.lambda2, loop.beta, loop.gamma) == (1, 10, 1, 10)
    assert (loop.learning_rate, loop.per_feature) == (1, False)


@pytest.mark.parametrize(("beta", "gamma", "rises"), [(2, 10, True), (3, 10, False), (3, 13, True)])
def test_the_losses_are_weighted_by_beta_and_gamma(beta, gamma, rises):
    """The 2D loss has the slope 2 in the attribute that the 3D loss raises with the slope 1/2."""
    config = LoopConfig(contrastive_start=0, beta=beta, gamma=gamma)
    state, _ = step(init(R), lambda r: 2 * r[2], ATTRIBUTES_OF_SIX, config=config)
    assert (state.r[2] > R[2]) == rises


def test_half_of_the_iterations_are_rounded_down():
    assert [resolved(LoopConfig(), n).contrastive_start for n in (0, 1, 7, 10)] == [0, 0, 3, 5]


def test_the_order_of_views_is_reproducible_and_complete():
    assert view_order(3, epochs=2).tolist() == [0, 1, 2, 0, 1, 2]
    shuffled = view_order(20, epochs=3, shuffle=True, seed=1)
    assert np.array_equal(shuffled, view_order(20, epochs=3, shuffle=True, seed=1))
    default = view_order(20, epochs=3, shuffle=True)
    assert np.array_equal(default, view_order(20, epochs=3, shuffle=True, seed=0))
    assert not np.array_equal(shuffled, view_order(20, epochs=3, shuffle=True, seed=2))
    assert np.bincount(shuffled).tolist() == [3] * 20
    assert view_order(3, epochs=0).size == 0


def test_fit_can_be_vmapped_over_configurations():
    total, share = np.random.default_rng(0).random((2, 4, 6), np.float32)
    evidence = Evidence(total=total, tampered=total * share)
    order, configs = view_order(4, epochs=2), [LoopConfig(lambda2=l2) for l2 in (0.5, 1.0, 10.0)]
    stacked = jax.tree.map(
        lambda *leaves: jnp.stack([jnp.asarray(x, jnp.float32) for x in leaves]), *configs
    )
    together = jax.vmap(lambda c: fit(evidence, R, ATTRIBUTES_OF_SIX, order, config=c)[0])(stacked)
    for config, r in zip(configs, together, strict=True):
        alone = fit(evidence, R, ATTRIBUTES_OF_SIX, order, config=config)[0]
        np.testing.assert_allclose(r, alone, rtol=1e-5, atol=1e-5)
    assert not np.allclose(together[0], together[2]), "lambda2 does nothing"


@pytest.mark.parametrize("config", [PAPER, OFFICIAL], ids=lambda config: config.name)
def test_both_paths_take_the_same_trajectory(config):
    scene = random_scene(60, seed=3)
    cameras = [camera(33, 15, focal=f) for f in (15.0, 20.0, 25.0, 30.0)]
    rng = np.random.default_rng(5)
    masks = [rng.random((15, 33)) > 0.3 for _ in cameras]
    views = [make_view(scene, c) for c in cameras]
    attributes = ATTRIBUTES[config.attributes](scene)
    order = view_order(4, epochs=config.epochs, shuffle=config.shuffle)
    r = rng.integers(0, 4, 60).astype(np.float32)
    of_views = [view_evidence(v, m) for v, m in zip(views, masks, strict=True)]
    evidence = jax.tree.map(lambda *leaves: jnp.stack(leaves), *of_views)
    fast, fast_info = fit(evidence, r, attributes, order, config=config.loop)
    slow, slow_info = fit_rendered(
        lambda index: (views[index], masks[index]), r, attributes, order, config=config.loop
    )
    assert not np.allclose(fast, r), "the optimisation does nothing"
    np.testing.assert_allclose(fast, slow, rtol=1e-3, atol=1e-3)
    np.testing.assert_allclose(fast_info.loss_2d, slow_info.loss_2d, rtol=1e-3, atol=1e-2)


@needs_data
@pytest.mark.slow
@pytest.mark.parametrize(("name", "config"), [(TAMPERED[0], OFFICIAL), (TAMPERED[1], PAPER)])
def test_both_paths_agree_on_real_scenes(name, config):
    data = load_tampered(name)
    cameras = [c.scaled(0.25) for c in data.cameras]
    detector = FolderDetector(data.folder / "detector")
    configs = [dataclasses.replace(config, path=path) for path in ("evidence", "rendered")]
    fast, slow = (
        locate(data.gaussians, cameras, detector, method=config.name, config=c) for c in configs
    )
    error = np.linalg.norm(fast.attribute - slow.attribute) / np.linalg.norm(slow.attribute)
    assert error < 1e-3
    assert np.mean(fast.labels != slow.labels) < 1e-4


@pytest.mark.parametrize("value", [-1.0, float("nan"), float("inf"), 1e300, True, "1"])
@pytest.mark.parametrize("name", ["lambda1", "lambda2", "beta", "gamma", "learning_rate"])
def test_weights_out_of_range_are_errors(name, value):
    with pytest.raises(ValueError, match=name):
        LoopConfig(**{name: value})


def test_the_largest_numbers_are_valid_and_larger_ones_are_errors():
    LoopConfig(lambda1=1e6, contrastive_start=2**31 - 1)
    with pytest.raises(ValueError, match="lambda1"):
        LoopConfig(lambda1=float(np.nextafter(1e6, np.inf)))
    for start in (2**31, 1.5, "1"):
        with pytest.raises(ValueError, match="contrastive_start must be a whole number in"):
            LoopConfig(contrastive_start=start)  # pyright: ignore[reportArgumentType]


def test_the_largest_weights_give_finite_attributes():
    evidence = Evidence(total=np.full((4, 6), 1e5, np.float32), tampered=np.eye(4, 6, dtype="f4"))
    largest = dict.fromkeys(("lambda1", "lambda2", "beta", "gamma", "learning_rate"), MAX_WEIGHT)
    config = LoopConfig(**largest)
    order = view_order(4, epochs=2)
    assert jnp.isfinite(fit(evidence, R, ATTRIBUTES_OF_SIX, order, config=config)[0]).all()
