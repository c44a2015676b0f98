"""Invalid arguments of the public functions: each is a ValueError, and nothing is silently NaN."""

import dataclasses
from collections.abc import Callable

import jax
import numpy as np
import pytest
from strategies import camera, random_scene, with_row

import gsc_jax
from gsc_jax.estimators.protocol import Finding
from gsc_jax.evidence.masks import Labelled
from gsc_jax.forensics.evidence import estimate_from_attributes, forensic_evidence

COUNT = 20
SCENE, VIEW = random_scene(COUNT), camera()
ALL = Labelled(np.ones(COUNT), np.ones(COUNT, bool))
NAN = float("nan")


def scored(value: float) -> Labelled:
    return Labelled(np.full(COUNT, value), np.ones(COUNT, bool))


def big_endian(values: object) -> np.ndarray:
    return np.asarray(values).astype(">f4")


def prior(probability=0.5, verdict=0.5, shape=(COUNT,)) -> gsc_jax.Prior:
    return gsc_jax.Prior(
        probability=np.full(shape, probability), verdict=verdict, known=np.ones(shape, bool)
    )


WRONG: dict[str, Callable[[], object]] = {
    "near": lambda: gsc_jax.make_view(SCENE, VIEW, near=NAN),
    "near inf": lambda: gsc_jax.render(SCENE, VIEW, near=float("inf")),
    "near None": lambda: gsc_jax.render(SCENE, VIEW, near=None),  # type: ignore
    "near of one": lambda: gsc_jax.render(SCENE, VIEW, near=np.array([0.2])),  # type: ignore
    "big-endian scene": lambda: gsc_jax.render(jax.tree.map(big_endian, SCENE), VIEW),
    "big-endian camera": lambda: gsc_jax.render(
        SCENE, dataclasses.replace(VIEW, viewmat=big_endian(VIEW.viewmat))
    ),
    "lockstep 0": lambda: gsc_jax.make_view(SCENE, VIEW, lockstep=0),
    "lockstep -1": lambda: gsc_jax.make_view(SCENE, VIEW, lockstep=-1),
    "touching, of fewer": lambda: gsc_jax.make_view(SCENE, VIEW, touching=np.ones(COUNT - 1, bool)),
    "touching, numbers": lambda: gsc_jax.make_view(SCENE, VIEW, touching=np.ones(COUNT)),
    "background": lambda: gsc_jax.render(SCENE, VIEW, background=(0.0, NAN, 0.0)),
    "background of a view": lambda: gsc_jax.render_view(
        gsc_jax.make_view(SCENE, VIEW), SCENE, VIEW, background=(0.0, NAN, 0.0)
    ),
    "background of two": lambda: gsc_jax.render(SCENE, VIEW, background=(0.0, 0.0)),  # type: ignore
    "features": lambda: gsc_jax.render_features(SCENE, VIEW, np.full((COUNT, 1), NAN)),
    "maps": lambda: gsc_jax.accumulate(SCENE, VIEW, np.full((15, 17, 1), NAN)),
    "feature": lambda: gsc_jax.rendered_share(SCENE, VIEW, np.full(COUNT, NAN)),
    "feature of fewer": lambda: gsc_jax.rendered_share(SCENE, VIEW, np.ones(COUNT - 1)),
    "rule": lambda: gsc_jax.view_mask(SCENE, VIEW, ALL, rule="shares"),  # type: ignore
    "threshold": lambda: gsc_jax.view_mask(SCENE, VIEW, ALL, threshold=NAN),
    "threshold None": lambda: gsc_jax.view_mask(SCENE, VIEW, ALL, threshold=None),  # type: ignore
    "a class as configuration": lambda: gsc_jax.locate(
        SCENE,
        [VIEW],
        None,
        config=gsc_jax.RobustEstimator,  # type: ignore
    ),
    "scores": lambda: gsc_jax.view_mask(SCENE, VIEW, scored(NAN)),
    "scores per view": lambda: gsc_jax.view_mask(SCENE, VIEW, scored(NAN), rule="per-view"),
    "width 0": lambda: camera(0, 15),
    "height -1": lambda: camera(17, -1),
    "width True": lambda: dataclasses.replace(VIEW, width=True),
    "name with a lone surrogate": lambda: dataclasses.replace(VIEW, name="a\ud800"),
    "name of bytes": lambda: dataclasses.replace(VIEW, name=b"a"),  # type: ignore
    "width 1.5": lambda: dataclasses.replace(VIEW, width=1.5),
    "probability": lambda: prior(probability=NAN),
    "verdict": lambda: prior(verdict=NAN),
    "verdict None": lambda: prior(verdict=None),  # type: ignore
    "shape of a prior": lambda: prior(shape=(COUNT, 1)),
    "min_verdict": lambda: estimate_from_attributes(forensic_evidence(SCENE), min_verdict=NAN),
    "shape of means": lambda: reshaped("means", (COUNT, 2)),
    "shape of opacities": lambda: reshaped("logit_opacities", (COUNT, 1)),
    "number of scales": lambda: reshaped("log_scales", (COUNT - 1, 3)),
    "degree": lambda: reshaped("sh", (COUNT, 3, 3)),
}


def reshaped(field: str, shape: tuple[int, ...]) -> object:
    scene = dataclasses.replace(SCENE, **{field: np.zeros(shape, np.float32)})
    return gsc_jax.locate(scene, [VIEW], {"": np.ones((15, 17), bool)})


@pytest.mark.parametrize("name", WRONG)
def test_invalid_arguments_are_value_errors(name):
    with pytest.raises(ValueError, match=r"must|expected") as raised:
        WRONG[name]()
    assert "\n" not in str(raised.value)


@pytest.mark.parametrize("value", [NAN, np.inf, -np.inf, 1e30])
@pytest.mark.parametrize("field", ["means", "log_scales", "quats", "logit_opacities", "sh"])
def test_no_row_makes_an_image_nan(field, value):
    for row in range(3):
        image = gsc_jax.render(with_row(SCENE, field, value, row=row), VIEW)
        assert all(np.isfinite(leaf).all() for leaf in jax.tree.leaves(image))


def test_scores_that_are_not_finite_are_refused():
    zeros = np.zeros(3, np.float32)
    for field in ("tamper", "attribute"):
        values = {"tamper": zeros, "attribute": zeros, field: np.full(3, NAN)}
        with pytest.raises(ValueError, match="not finite"):
            Finding(labels=zeros > 0, warnings=[], **values)


def test_features_may_be_traced():
    def total(features):
        return gsc_jax.render_features(SCENE, VIEW, features)[0].sum()

    gradient = jax.grad(total)(jax.numpy.ones((COUNT, 1)))
    assert np.isfinite(gradient).all()
    assert gradient.any()
