"""The whole method: labels, and degenerate cases, which are defined and reported."""

import dataclasses

import numpy as np
import pytest
from data import TAMPERED, load_tampered, needs_data
from strategies import blobs, camera, cameras_in_a_row, with_row

from gsc_jax import (
    METHODS,
    InputError,
    Monitor,
    Prior,
    estimate,
    forensic_evidence,
    locate,
    observe,
    rendered_share,
    sweep,
)
from gsc_jax.benchmark.metrics import confusion
from gsc_jax.detectors.folder import FolderDetector
from gsc_jax.estimators import Method, configured
from gsc_jax.estimators.protocol import ALL_FLAGGED, NONE_FLAGGED, Finding
from gsc_jax.evidence.detector import as_detector, fit_to_view
from gsc_jax.loop import LoopConfig
from gsc_jax.scene import Camera

METHOD = pytest.mark.parametrize("method", ["paper", "official"])
EVERY_METHOD = pytest.mark.parametrize("method", [*METHODS])
ROW = [[x, y, 3] for x in np.linspace(-1.5, 1.5, 7) for y in np.linspace(-0.8, 0.8, 5)]
SCENE = blobs([*ROW, [0, 0, 30.0], [0, 0, -5.0]], opacity=0.95, scale=0.2)
TRUTH = np.array([x > 0.8 for x, _, _ in ROW] + [False, False])
BEHIND = -1


def cameras(count: int = 6) -> list[Camera]:
    return cameras_in_a_row(count, 48, 32, step=0.1)


def truths() -> dict[str, np.ndarray]:
    return {c.name: rendered_share(SCENE, c, TRUTH) for c in cameras()}


def everywhere(value: float) -> dict[str, np.ndarray]:
    return {c.name: np.full((32, 48), value, np.float32) for c in cameras()}


@EVERY_METHOD
def test_true_masks_find_the_tampered_gaussians(method):
    result = locate(SCENE, cameras(), truths(), method=method)
    assert result.method == method
    visible = result.seen
    assert np.mean(result.labels[visible] == TRUTH[visible]) > 0.9
    for name, truth in truths().items():
        overlap = np.mean(result.masks[name] == (truth > 0.5))
        assert overlap > 0.9, f"the mask of {name} does not show the tampered region"
    assert result.tamper.dtype == np.float32
    assert result.tamper.min() >= 0
    # What robust hands back is a probability; the others divide by the largest attribute.
    least = 0.9 if method == "robust" else 0.99
    assert least < result.tamper.max() <= 1
    assert not result.labels[BEHIND], "an unseen Gaussian is labelled"


@EVERY_METHOD
def test_empty_masks_label_nothing_and_full_masks_all_seen_gaussians(method):
    result = locate(SCENE, cameras(), everywhere(0.0), method=method)
    assert not result.labels.any()
    assert not result.tamper.any()
    assert not any(mask.any() for mask in result.masks.values())
    assert NONE_FLAGGED in result.warnings
    result = locate(SCENE, cameras(), everywhere(1.0), method=method)
    assert np.array_equal(result.labels, result.seen)
    assert result.seen.any()
    assert not result.seen.all()
    assert np.isfinite(result.attribute).all()
    assert ALL_FLAGGED in result.warnings


@EVERY_METHOD
def test_one_flagged_view_of_many_is_outvoted_and_nothing_flips_sign(method):
    masks = everywhere(0.0)
    masks["view_0"] = truths()["view_0"]
    result = locate(SCENE, cameras(), masks, method=method)
    assert not result.labels[~TRUTH].any()
    assert not any(mask.mean() > 0.5 for mask in result.masks.values())


@EVERY_METHOD
@pytest.mark.parametrize(
    ("name", "value"), [("quats", 0.0), ("sh", np.nan), ("sh", 2e9), ("means", np.nan)]
)
def test_an_invalid_row_is_neither_seen_nor_labelled(method, name, value):
    row = int(np.argmax(rendered_weight(SCENE) * TRUTH))
    scene = with_row(SCENE, name, value, row=row)
    result = locate(scene, cameras(), truths(), method=method, prior=False)
    assert any("1 of 37 Gaussians have invalid values" in text for text in result.warnings)
    assert (result.labels[row], result.tamper[row], result.seen[row]) == (False, 0, False)
    assert result.labels.any()


def rendered_weight(scene) -> np.ndarray:
    return observe(scene, cameras(), truths()).evidence.weight


@pytest.mark.parametrize("count", [1, 3, 100])
@pytest.mark.parametrize("share", [0.0, 0.5, 1.0])
def test_a_prior_of_another_number_of_gaussians_is_an_error(count, share):
    masks = {name: mask * share > 0.25 for name, mask in truths().items()}
    known = np.ones(count, bool)
    prior = Prior(probability=np.full(count, 0.9, np.float32), verdict=0.9, known=known)
    with pytest.raises(
        ValueError, match=f"the prior has {count} Gaussians, the scene {len(SCENE)}"
    ):
        estimate(SCENE, cameras(), observe(SCENE, cameras(), masks), prior=prior)


def test_an_estimator_may_return_more_than_a_finding():
    @dataclasses.dataclass(frozen=True, kw_only=True)
    class More(Finding):
        more: int

    @dataclasses.dataclass(frozen=True, kw_only=True)
    class Own(type(METHODS["robust"])):
        def estimate(self, observation, prior=None):
            return More(**vars(super().estimate(observation, prior)), more=1)

    assert locate(SCENE, cameras(), truths(), config=Own(), prior=False).labels.any()


@EVERY_METHOD
def test_a_huge_but_finite_row_never_becomes_nan(method):
    scene = with_row(SCENE, "means", [1e19, 0, 3], row=0)
    result = locate(scene, cameras(), truths(), method=method)
    assert np.isfinite(result.attribute).all()
    assert 0 <= result.tamper.min() <= result.tamper.max() <= 1 + 1e-6


@METHOD
@pytest.mark.parametrize("attributes", ["paper", "official", "standardised"])
def test_rows_that_are_not_finite_are_counted_and_leave_the_others_alone(method, attributes):
    config = dataclasses.replace(METHODS[method], attributes=attributes)
    alone = locate(SCENE, cameras(), truths(), config=config)
    broken = SCENE
    for row, (field, value) in enumerate([("means", np.nan), ("sh", np.inf)]):
        broken = with_row(broken, field, value, row=BEHIND - row)
    result = locate(broken, cameras(), truths(), config=config)
    assert np.isfinite(result.attribute).all()
    assert np.array_equal(result.labels, alone.labels)
    assert any(text.startswith("2 of 37 Gaussians have invalid values") for text in result.warnings)


@EVERY_METHOD
def test_a_hidden_gaussian_does_not_set_the_scale(method):
    wall = [[0, 0, 2]] * 4
    behind = [[0, 0, 40 + i] for i in range(30)]
    scene = blobs([*wall, *behind], opacity=0.999, scale=1.5)
    maps = everywhere(1.0) | {"view_0": np.zeros((32, 48))}
    result = locate(scene, cameras(), maps, method=method, prior=False)
    assert not result.seen[-1], "the scene hides nothing"
    assert not result.tamper[~result.seen].any()
    assert not result.attribute[~result.seen].any()


def test_a_sweep_equals_separate_estimates():
    observation = observe(SCENE, cameras(), truths())
    configs = [
        dataclasses.replace(METHODS[name], loop=LoopConfig(lambda2=lambda2), threshold=threshold)
        for name, lambda2, threshold in [("official", 1.0, 0.1), ("paper", 5.0, 0.3)]
    ]
    found = list(sweep(observation, configs))
    for finding, config in zip(found, configs, strict=True):
        alone = estimate(SCENE, cameras(), observation, config=config)
        assert np.array_equal(finding.attribute, alone.attribute)
        assert np.array_equal(finding.labels, alone.labels)
    assert not np.array_equal(found[0].attribute, found[1].attribute)


@EVERY_METHOD
def test_a_prior_is_used_or_a_warning_reports_that_it_is_not(method: Method):
    observation = observe(SCENE, cameras(), truths())
    prior = Prior(
        probability=np.where(TRUTH, 0.01, 0.99).astype(np.float32),
        verdict=0.9,
        known=np.ones(len(TRUTH), bool),
    )
    alone, fused = (
        estimate(SCENE, cameras(), observation, method=method, prior=p) for p in (None, prior)
    )
    used = not np.array_equal(alone.attribute, fused.attribute)
    warned = any("not used" in warning for warning in fused.warnings)
    assert used == (method == "robust"), "only robust uses a prior"
    assert warned == (not used)
    evidence = forensic_evidence(SCENE)
    result = locate(SCENE, cameras(), truths(), method=method, prior=evidence)
    assert any("not used" in warning for warning in result.warnings) == (not used)
    assert (result.prior is evidence) == used


WRONG = {
    "mask_rule": "shar",
    "path": "y",
    "threshold": -1.0,
    "epochs": 0,
    "near": 0.0,
    "seed": -1,
}


@pytest.mark.parametrize("name", WRONG)
def test_values_out_of_range_are_errors(name):
    with pytest.raises(ValueError, match=name):
        dataclasses.replace(METHODS["paper"], **{name: WRONG[name]})


@pytest.mark.parametrize(("method", "config"), [("paper", "robust"), ("official", "paper")])
def test_a_configuration_of_another_method_is_an_error(method, config):
    with pytest.raises(ValueError, match=f"config is of the method '{config}', got .*'{method}'"):
        locate(SCENE, cameras(), truths(), method=method, config=METHODS[config])
    assert configured(config=METHODS[config]) is METHODS[config]


@pytest.mark.parametrize("rule", ["attribute", "share", "per-view"])
def test_the_second_run_compiles_nothing(rule, count_compilations):
    config = dataclasses.replace(METHODS["official"], mask_rule=rule)
    locate(SCENE, cameras(), truths(), config=config)
    shifted = {name: np.roll(mask, 5, axis=1) for name, mask in truths().items()}
    with count_compilations() as compiled:
        locate(SCENE, cameras(), shifted, config=config)
    assert not compiled


def test_results_depend_on_the_seed_but_not_on_earlier_runs():
    rng = np.random.default_rng(0)
    noisy = as_detector({c.name: rng.random((32, 48)) for c in cameras()})
    first = locate(SCENE, cameras(), noisy, method="paper")
    locate(SCENE, cameras(2), noisy, method="paper")
    second = locate(SCENE, cameras(), noisy, method="paper")
    assert np.array_equal(first.attribute, second.attribute)
    other = locate(SCENE, cameras(), noisy, config=dataclasses.replace(METHODS["paper"], seed=1))
    assert not np.array_equal(first.attribute, other.attribute)


def test_a_function_gets_every_render_once():
    seen = []

    def detector(image):
        seen.append(image)
        return image[..., 0] > 0.4

    result = locate(SCENE, cameras(2), detector)
    assert len(seen) == 2
    assert seen[0].shape == (32, 48, 3)
    assert seen[0].dtype == np.float32
    assert 0 <= seen[0].min() < seen[0].max() <= 1, "the image is empty"
    assert set(result.probabilities) == {"view_0", "view_1"}


class Tensor:
    """What a tensor of torch does that is no array: it has a gradient, or is in half precision."""

    def __init__(self, values: np.ndarray, *, plain: bool = False) -> None:
        self.values, self.plain = values, plain

    def detach(self) -> "Tensor":
        return self

    cpu = detach

    def float(self) -> "Tensor":
        return Tensor(self.values, plain=True)

    def __array__(self, dtype=None, copy=None) -> np.ndarray:
        if not self.plain:
            raise RuntimeError("Can't call numpy() on Tensor that requires grad.")
        return self.values.astype(dtype)


def test_tensors_are_taken_and_the_image_can_be_written_to():
    def flags(image):
        image[..., 0] += 1
        return Tensor((image[..., 0] > 1.2)[None, None])

    image, view = np.full((32, 48, 3), 0.5, np.float32), cameras()[0]
    image.setflags(write=False)
    assert fit_to_view(as_detector(flags)(image, view), view).all()
    assert image.max() == 0.5


def test_a_module_of_torch_is_refused_with_the_remedy():
    class Module:
        def named_parameters(self):
            return []

        __call__ = named_parameters

    with pytest.raises(InputError, match="wrap it"):
        as_detector(Module())


def test_cameras_without_a_mask_are_counted_and_still_get_one():
    some = {name: mask for name, mask in truths().items() if name != "view_3"}
    result = locate(SCENE, cameras(), some)
    assert set(result.masks) == {c.name for c in cameras()}
    assert "view_3" not in result.probabilities
    assert any("1 of 6 cameras" in w and "view_3" in w for w in result.warnings)


def test_progress_and_stages_are_recorded():
    calls = []
    result = locate(
        SCENE, cameras(2), truths(), monitor=Monitor(progress=lambda *step: calls.append(step))
    )
    assert ("views", 2, 2) in calls
    assert ("masks", 2, 2) in calls
    assert {"project", "detect", "lift", "optimise", "masks"} <= set(result.stages)
    assert all(stage["seconds"] >= 0 for stage in result.stages.values())


@pytest.mark.parametrize(
    ("masks", "message"),
    [
        ({"elsewhere": np.zeros((4, 4))}, "No camera has a mask"),
        ({"view_0": np.full((4, 4), 255)}, "not a probability"),
        ({"view_0": np.full((4, 4), np.nan)}, "not a probability.*NaN in 16 pixels"),
        ({"view_0": np.zeros((4, 4, 3))}, "one probability per pixel"),
        ({"view_0": np.zeros((1, 1))}, "at least 4 x 4 pixels"),
        ({"view_0": np.zeros((48, 32))}, "has 32 x 48 pixels, the view 48 x 32"),
        (lambda _: np.zeros((200, 4)), "has 4 x 200 pixels, the view 48 x 32"),
        (lambda _: "x", "is a str, expected an array"),
        (lambda _: None, "one probability per pixel"),
        (lambda _: [[0.5], [0.5, 0.5]], "is a list, expected an array"),
    ],
)
def test_unusable_masks_are_one_clear_error(masks, message):
    with pytest.raises(InputError, match=message) as raised:
        locate(SCENE, cameras(), masks)
    assert "\n" not in str(raised.value)


def test_an_unknown_method_and_a_name_used_twice_are_errors():
    with pytest.raises(ValueError, match="robust, official, paper"):
        locate(SCENE, cameras(), truths(), method="magic")  # type: ignore[arg-type]
    with pytest.raises(InputError, match="'view_0'"):
        locate(SCENE, cameras(1) * 2, truths())


def test_a_mask_is_resized_as_a_probability_and_thresholded_once_strictly():
    view = camera(4, 2)
    resized = fit_to_view(np.array([[0, 1], [0, 1]]), view)
    assert resized.shape == (2, 4)
    assert 0 < resized[0, 1] < 0.5 < resized[0, 2] < 1, "thresholded before resizing"
    half = fit_to_view(np.full((1, 2, 4), 0.5), view)
    assert not (half > 0.5).any()
    assert as_detector({"": half}).needs_image is False


@pytest.mark.parametrize("shape", [(1, 1), (40, 1), (1, 40)])
@pytest.mark.parametrize("axes", [(), (0,), (-1,), (0, -1), (0, 1)])
def test_further_axes_of_a_map_are_dropped_also_where_a_view_is_one_pixel_wide(shape, axes):
    view = camera(shape[1], shape[0])
    values = np.random.default_rng(0).random(shape).astype(np.float32)
    output = np.expand_dims(values, axes) if axes else values
    assert np.array_equal(fit_to_view(output, view), values)


def test_a_probability_may_exceed_its_bounds_by_rounding():
    view = camera(8, 8)
    assert fit_to_view(np.full((8, 8), 1 + 1e-6), view).max() == 1
    assert fit_to_view(np.full((8, 8), -1e-6), view).min() == 0
    with pytest.raises(InputError, match="not a probability"):
        fit_to_view(np.full((8, 8), 1.01), view)


@needs_data
@EVERY_METHOD
@pytest.mark.slow
@pytest.mark.parametrize("name", TAMPERED)
def test_the_truth_masks_of_the_real_scenes_lead_to_their_gaussians(name, method):
    data = load_tampered(name)
    views = [c.scaled(0.5) for c in data.cameras[::2]]
    result = locate(data.gaussians, views, FolderDetector(data.folder / "truth"), method=method)
    found = result.labels[result.seen]
    truth = data.labels[result.seen]
    overlap = confusion(found, truth)
    assert overlap.precision > 0.75
    assert overlap.recall > 0.6
