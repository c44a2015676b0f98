"""Training of the classifier: what is held out, calibration, and the stored file."""

import jax
import numpy as np
import pytest
import train_classifier as train
from cases import CUT, OBJECTS, donor_name, edit_scene
from classifier_examples import Examples, scenes_in
from scipy.special import expit

from gsc_jax.benchmark.metrics import auc
from gsc_jax.forensics.classifier import default_classifier, from_arrays, network

SCENES = ("a", "b", "c")


def examples(scene: str, seed: int, *, pasted_from: str | None = None) -> Examples:
    rng = np.random.default_rng(seed)
    labels = rng.random(400) < 0.3
    values = rng.normal(size=(400, 3))
    values[:, 0] += 2 * labels
    return Examples(
        scene=scene,
        edit=("removal", "modification")[seed % 2],
        scenes=frozenset({scene, pasted_from or scene}),
        values=values.astype(np.float16),
        labels=labels,
        share=0.1,
        names=("x", "y", "z"),
    )


def scene_output(edit, rng: np.random.Generator) -> train.SceneOutput:
    """A scene whose log odds are twice the raw ones, less 1."""
    raw = rng.normal(-1, 1.5, 20_000)
    labels = rng.random(20_000) < expit(2 * raw - 1) if edit else np.zeros(20_000, bool)
    return train.SceneOutput(edit=edit, raw=raw, labels=labels, peak=6.0 if edit else 1.0)


@pytest.fixture
def cases(monkeypatch) -> list[Examples]:
    monkeypatch.setattr(train, "STEPS", 150)
    monkeypatch.setattr(train, "HIDDEN", (8,))
    own = [examples(scene, seed) for seed, scene in enumerate(SCENES)]
    return [*own, examples("c", 3, pasted_from="a")]


def test_logistic_fit_recovers_a_line():
    values = np.random.default_rng(0).normal(size=4_000)
    labels = np.random.default_rng(1).random(4_000) < expit(1.5 * values - 0.7)
    line = train.logistic_fit(values, labels, np.ones(4_000))
    assert line == pytest.approx((1.5, -0.7), abs=0.15)


def test_networks_never_see_a_scene_that_is_left_out(cases, monkeypatch):
    seen = []
    monkeypatch.setattr(train, "train_network", lambda own, seed: seen.append(own) or (seed,))
    networks = train.train_networks(cases, SCENES)
    assert [len(own) for own in networks.values()] == 4 * [train.MEMBERS] + 3 * [1]
    in_order = [without for without, own in networks.items() for _ in own]
    for without, own in zip(in_order, seen, strict=True):
        assert set().union(*(case.scenes for case in own)) == set(SCENES) - without
        assert len(own) == 3 - len(without) + (not without & {"a", "c"})
    fold = train.make_fold("a", cases, networks)
    assert fold.classifier.networks is networks[frozenset({"a"})]
    assert fold.others == {s: networks[frozenset({"a", s})][0] for s in ("b", "c")}


def test_trained_network_separates_and_survives_a_file(cases, tmp_path):
    with jax.numpy_dtype_promotion("standard"):  # optax adds floats and counts of steps
        layers = train.train_network(cases, seed=0)
    log_odds = np.asarray(network(layers, cases[0].values.astype(np.float32)))
    assert auc(log_odds, cases[0].labels) > 0.7
    networks = {frozenset(some): (layers,) for some in ((), "a", "b", "c")}
    rng = np.random.default_rng(0)
    outputs = [scene_output(e, rng) for e in ("removal", "removal", "modification", None)]
    classifier = train.calibrated(train.make_fold(None, cases, networks).classifier, outputs)
    assert classifier.calibration == pytest.approx((2, -1), abs=0.15), "as the labels were drawn"
    assert classifier.scene[0] > 0, "the peak of edited scenes is higher"
    train.save(tmp_path / "classifier.npz", classifier)
    with np.load(tmp_path / "classifier.npz") as stored:
        again = from_arrays(stored)
    assert again.names == classifier.names
    assert again.calibration == pytest.approx(classifier.calibration)


def test_object_cut_from_a_scene_belongs_to_it():
    pasted = {seed: donor_name("kitchen", seed) for seed in range(8)}
    cut = next(seed for seed, name in pasted.items() if name.startswith(CUT))
    scanned = next(seed for seed, name in pasted.items() if name in OBJECTS)
    source = pasted[cut].removeprefix(CUT)
    assert scenes_in("kitchen", "incorporation", cut) == {"kitchen", source}
    assert scenes_in("kitchen", "incorporation", scanned) == {"kitchen"}
    assert scenes_in("kitchen", "removal", cut) == {"kitchen"}


def test_whole_scenes_calibrate_only_folds_that_saw_no_part_of_them(monkeypatch):
    case = edit_scene("small room", "removal", 0)
    monkeypatch.setattr(train, "scenes_in", lambda *_: frozenset({"a", "b"}))
    monkeypatch.setattr(train, "load_scene", lambda *_: case)
    monkeypatch.setattr(train, "edit_scene", lambda *_: case)
    classifier = default_classifier()
    folds = [
        train.Fold(heldout=heldout, classifier=classifier, others={"a": classifier.networks[0]})
        for heldout in (None, "a", "b", "c")
    ]
    outputs = train.scene_outputs("a", "removal", 1, train.Args(), folds)
    assert set(outputs) == {None, "c"}
    assert len(outputs["c"].raw) == len(outputs["c"].labels) <= train.SAMPLE
    assert 0 < outputs["c"].labels.mean() < 0.1
    assert outputs["c"].peak >= np.median(outputs["c"].raw)
