"""Training of the classifier: what is held out, calibration, and the stored file."""

import dataclasses
from types import SimpleNamespace

import bank
import chex
import classifier_examples
import jax
import numpy as np
import pytest
import sources
import train_classifier as train
from bank import FIRST_SEED, NO_EDIT, PROGRAM_SEEDS, bank_case
from classifier_examples import Examples, digest
from forensics_cases import room
from learned_cases import examples
from scipy.special import expit

from gsc_jax.benchmark.metrics import auc
from gsc_jax.benchmark.modification import modify_region
from gsc_jax.benchmark.scenes import make_room
from gsc_jax.forensics.classifier import (
    default_classifier,
    from_arrays,
    network,
    smoothed_log_odds,
)
from gsc_jax.forensics.features import compute_features
from gsc_jax.forensics.places import Places
from gsc_jax.scene import InputError
from gsc_jax.scene.neighbours import neighbourhoods

SCENES = ("a", "b", "c")
QUICK_SEED = FIRST_SEED + PROGRAM_SEEDS


def scene_output(edit: str, rng: np.random.Generator) -> train.SceneOutput:
    """A scene whose log odds are twice those of the networks, plus the novelty, less 1.

    Each Gaussian is a place of its own, with the same statistics, so that the discriminant is 0.
    """
    networks, novelty = rng.normal(-1, 1.5, 20_000), rng.normal(0, 1, 20_000)
    networks[:64] = 6 if edit != NO_EDIT else 1
    labels = rng.random(20_000) < expit(2 * networks + novelty - 1)
    means = np.linspace(0, 1, 20_000)[:, None] * np.ones(3)
    places = Places(
        rows=np.arange(20_000),
        starts=np.arange(20_000),
        centers=means,
        around=neighbourhoods(means.astype(np.float32), 2)[0],
        statistics=np.zeros((20_000, 1)),
        names=("size.0",),
    )
    return train.SceneOutput(
        edit=edit,
        networks=networks,
        places=places,
        novelty=novelty,
        labels=labels if edit != NO_EDIT else np.zeros(20_000, bool),
    )


@pytest.fixture
def cases(monkeypatch) -> list[Examples]:
    monkeypatch.setattr(train, "STEPS", 150)
    monkeypatch.setattr(train, "HIDDEN", (8,))
    own = [examples(scene, seed) for seed, scene in enumerate(SCENES)]
    return [*own, examples("c", 3, pasted_from="a")]


def test_logistic_fit_recovers_a_line():
    values = np.random.default_rng(0).normal(size=(4_000, 2))
    labels = np.random.default_rng(1).random(4_000) < expit(values @ [1.5, 0.5] - 0.7)
    line = train.logistic_fit(values, labels, np.ones(4_000))
    assert line == pytest.approx((1.5, 0.5, -0.7), abs=0.15)


def test_networks_never_see_a_source_that_is_left_out(cases, monkeypatch):
    seen = []
    monkeypatch.setattr(train, "train_network", lambda own, seed: seen.append(own) or (seed,))
    networks = train.train_networks(cases, SCENES)
    assert [len(own) for own in networks.values()] == 4 * [train.MEMBERS] + 3 * [1]
    in_order = [without for without, own in networks.items() for _ in own]
    for without, own in zip(in_order, seen, strict=True):
        assert set().union(*(case.sources for case in own)) == set(SCENES) - without
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
    outputs = [scene_output(e, rng) for e in ("removal", "removal", "modification", NO_EDIT)]
    classifier = train.calibrated(train.make_fold(None, cases, networks).classifier, outputs)
    assert classifier.calibration == pytest.approx((2, -1), abs=0.15), "as the labels were drawn"
    assert classifier.novelty == pytest.approx(0.5, abs=0.1), "in units of the networks' output"
    assert classifier.scene[0] > 0, "the peak of edited scenes is higher"
    train.save(tmp_path / "classifier.npz", classifier)
    with np.load(tmp_path / "classifier.npz") as stored:
        again = from_arrays(stored)
    assert again.names == classifier.names
    assert again.calibration == pytest.approx(classifier.calibration)
    assert again.novelty == pytest.approx(classifier.novelty)


@pytest.fixture
def small_rooms(monkeypatch):
    """Rooms of 4,000 Gaussians as the only host, without a bank or real scenes."""
    monkeypatch.setitem(bank.MADE_HOSTS, "room", lambda seed: make_room(seed=seed, count=4_000))


def test_captures_by_growth_by_error_are_no_donors(monkeypatch, tmp_path):
    names = ["room", "room-0-mcmc", "garden-0-mcmc", "garden-10-error"]
    monkeypatch.setattr(bank, "hosts", lambda *_: names)
    monkeypatch.setattr(
        bank, "load_host", lambda name, *_: SimpleNamespace(gaussians=name, cameras=[])
    )
    for made in ("cut_object", "make_object"):
        monkeypatch.setattr(bank, made, lambda *_, **__: room())
    place = tmp_path, tmp_path / "absent"
    rngs = [np.random.default_rng(k) for k in range(40)]
    drawn = {bank.draw_donor("room", 9, *place, rng)[0] for rng in rngs}
    assert drawn == {"garden-0-mcmc", "vase"}


def test_cases_of_a_seed_are_the_same_and_have_their_sources(small_rooms, tmp_path):
    one, other = (
        bank_case("room", "removal", QUICK_SEED, tmp_path, tmp_path / "absent") for _ in range(2)
    )
    np.testing.assert_array_equal(one.gaussians.means, other.gaussians.means)
    assert 0 < one.labels.sum() < len(one.labels) == len(one.gaussians)
    assert one.sources == {"room"}
    pasted = bank_case("room", "incorporation", QUICK_SEED, tmp_path, tmp_path / "absent")
    assert pasted.sources in ({"room", "vase"}, {"room", "garden"}), "no real object is at hand"
    authentic = bank_case("room", NO_EDIT, QUICK_SEED, tmp_path, tmp_path / "absent")
    assert not authentic.labels.any()
    assert (one.family, authentic.family) == ("quick", "none"), "parts of hosts are edited quickly"


@pytest.mark.parametrize(("laundered", "family"), [(0, "editor"), (1, "laundered")])
def test_whole_hosts_are_edited_by_programs(laundered, family, tmp_path, monkeypatch):
    asked = []

    def program_of(edit, donor, *, densify):
        asked.append((edit, densify))
        return modify_region

    monkeypatch.setattr(bank, "program_of", program_of)
    monkeypatch.setattr(bank, "laundered", lambda gaussians, _: gaussians)
    monkeypatch.setattr(bank, "BY_PROGRAM", 1)
    monkeypatch.setattr(bank, "LAUNDERED", laundered)
    place = (tmp_path, tmp_path / "absent")
    assert bank_case("room", "modification", FIRST_SEED, *place).family == family
    assert [edit for edit, _ in asked] == ["modification"]
    authentic = bank_case("room", NO_EDIT, FIRST_SEED, *place)
    assert authentic.family == (family if laundered else "none")


def test_examples_are_kept_and_a_host_without_a_place_has_none(small_rooms, tmp_path, monkeypatch):
    arguments = ("room", "removal", QUICK_SEED, tmp_path, tmp_path / "absent", tmp_path)
    monkeypatch.setattr(classifier_examples, "MAX_AUTHENTIC", 1_000)
    made = classifier_examples.make_examples(*arguments)
    assert made.values.shape == (len(made.labels), len(made.names))
    assert 0 < made.share < made.labels.mean() < 1, "authentic Gaussians are thinned out"

    def no_place(*_: object):
        raise InputError("no place")

    monkeypatch.setattr(classifier_examples, "bank_case", no_place)
    again = classifier_examples.make_examples(*arguments)
    np.testing.assert_array_equal(again.values, made.values)
    absent = classifier_examples.make_examples("room", "modification", *arguments[2:])
    assert absent.share == 0
    assert not len(absent.labels)


def test_networks_of_other_examples_are_kept_apart():
    first, second = examples("a-0", 0), examples("b-0", 1)
    assert digest([first, second]) == digest([first, second])
    changed = dataclasses.replace(first, labels=~first.labels)
    others = [[first], [changed, second], [first, dataclasses.replace(second, host="c-0")]]
    names = {digest(cases) for cases in ([first, second], *others)}
    assert len(names) == 4


def test_hosts_of_a_curve_grow_and_leave_out_a_source():
    names = ["a", "a-0-mcmc", "b", "b-0-mcmc", "b-1-adaptive", "c"]
    sets = list(sources.host_sets(names, "a"))
    assert [len(some) for some in sets] == [1, 2, 4] * sources.ORDERS
    assert all(some <= set(names[2:]) for some in sets)
    for smaller, larger in ((0, 1), (1, 2), (3, 4), (4, 5)):
        assert sets[smaller] < sets[larger]


def test_networks_of_a_curve_know_neither_host_nor_donor_of_the_source(monkeypatch):
    def train_network(own, seed):
        return [(case.host, case.sources) for case in own]

    monkeypatch.setattr(sources, "train_network", train_network)
    pasted = examples("b", 2, pasted_from="a")
    cases = [examples("a", 0), examples("b", 1), pasted, examples("c", 3)]
    networks = sources.train_networks(cases, ["a", "b", "c"], ["a", "b", "c"])
    learned = networks["a"]
    assert sorted(learned[frozenset("bc")]) == [("b", {"b"}), ("c", {"c"})]
    assert learned.keys() <= {frozenset("b"), frozenset("c"), frozenset("bc")}
    assert sum(len(own) for own in networks["b"].values()) >= 3


def test_only_cases_that_may_take_minutes_are_stored(small_rooms, tmp_path, monkeypatch):
    place = (tmp_path, tmp_path / "absent")
    case, drawn = bank_case("room", "removal", QUICK_SEED, *place), []

    def draw_case(host: str, edit: bank.Kind, seed: int, *_: object) -> bank.BankCase | None:
        drawn.append(seed)
        return case if edit == "removal" else None

    monkeypatch.setattr(classifier_examples, "draw_case", draw_case)
    for seed in (FIRST_SEED, QUICK_SEED):
        for _ in range(2):
            again = classifier_examples.stored_case("room", "removal", seed, *place, tmp_path)
            assert again is not None
            chex.assert_trees_all_equal(again.gaussians, case.gaussians)
            np.testing.assert_array_equal(again.labels, case.labels)
            assert (again.sources, again.edit, again.exporter) == (
                case.sources,
                "removal",
                case.exporter,
            )
            nothing = classifier_examples.stored_case("room", NO_EDIT, seed, *place, tmp_path)
            assert nothing is None, "a host without a place for the edit"
    assert drawn == [FIRST_SEED] * 2 + [QUICK_SEED] * 4


def test_whole_cases_calibrate_only_folds_that_saw_no_part_of_them(small_rooms, tmp_path):
    case = bank_case("room", "removal", QUICK_SEED, tmp_path, tmp_path / "absent")
    classifier = default_classifier()
    folds = [
        train.Fold(heldout=heldout, classifier=classifier, others={"room": classifier.networks[0]})
        for heldout in (None, "room", "b")
    ]
    outputs = train.scene_outputs(case, "room-1-mcmc", folds)
    assert set(outputs) == {None, "b"}
    assert outputs["b"].columns().shape == (len(case.labels), 2)
    assert outputs["b"].raw(classifier).shape == case.labels.shape
    assert outputs["b"].edit == "removal"


def test_stored_classifier_gives_the_same_log_odds():
    features, classifier = compute_features(room()), default_classifier()
    again = from_arrays(train.as_arrays(classifier))
    assert (again.names, again.calibration) == (classifier.names, classifier.calibration)
    assert (again.base, again.scene) == (classifier.base, classifier.scene)
    before, after = (smoothed_log_odds(features, c) for c in (classifier, again))
    np.testing.assert_array_equal(before, after)
