"""The experiments: the runner against the library, tables by hand, every script in quick mode."""

import dataclasses
import importlib
import inspect
import sys
from pathlib import Path

import jax
import numpy as np
import pytest

from gsc_jax.benchmark.simulate import PROFILES, REGIMES
from gsc_jax.evidence.detector import as_detector
from gsc_jax.evidence.observation import observe
from gsc_jax.scene import InputError

ROOT = Path(__file__).resolve().parents[2]
SCRIPTS = (
    "ablation",
    "authentic",
    "beyond",
    "calibration",
    "backbones",
    "editing",
    "enough",
    "native",
    "parsimony",
    "robustness",
    "speed_accuracy",
    "stability",
)


def module(name: str):
    return importlib.import_module(name)


@pytest.fixture(autouse=True)
def experiments_are_importable(monkeypatch):
    monkeypatch.setattr(sys, "path", [str(ROOT / "experiments"), *sys.path])


@pytest.fixture(scope="module")
def case():
    sys.path.insert(0, str(ROOT / "experiments"))
    cases = module("cases")
    return cases.make_case(cases.QUICK, "incorporation", 0)


def test_one_look_lifts_every_regime_as_observing_each_would(case):
    cases = module("cases")
    masks = cases.detector_masks(case, {name: REGIMES[name] for name in ("clean", "mixture")})
    for regime, look in module("looks").look(case, masks).items():
        given = dict(zip([c.name for c in case.scene.cameras], masks[regime], strict=True))
        alone = observe(case.gaussians, case.scene.cameras, as_detector(given))
        lifted = look.observation
        np.testing.assert_allclose(lifted.evidence.total, alone.evidence.total, rtol=1e-4)
        difference = np.abs(lifted.evidence.tampered - alone.evidence.tampered)
        assert difference.max() < 1e-2
        assert np.array_equal(lifted.votes.tampered, alone.votes.tampered)


def test_the_true_labels_score_one_and_none_score_nothing(case):
    cases, runner = module("cases"), module("runner")
    looks = module("looks").look(case, cases.detector_masks(case, {"clean": REGIMES["clean"]}))
    nothing = {"nothing": lambda look: module("methods").labelled(np.zeros_like(look.case.labels))}
    itself, truth, none = runner.judge(looks, nothing)
    assert itself["method"] == runner.ITSELF
    assert itself["f1"] == pytest.approx(1)
    assert np.isnan(itself["f1_gaussians"])
    assert truth["method"] == runner.TRUTH
    assert truth["f1"] == truth["f1_gaussians"] == truth["auc"] == pytest.approx(1)
    assert truth["false_area"] == 0
    assert none["f1"] == none["f1_gaussians"] == none["false_area"] == 0
    assert none["auc"] == 0.5


def test_the_calibrated_mixture_leaves_the_inverse_projection_little(case):
    cases, runner = module("cases"), module("runner")
    masks = cases.detector_masks(case, {"mixture": cases.calibrated_mixture(case)})
    inverse = {"inverse projection": module("methods").ALL_METHODS["inverse projection"]}
    row = list(runner.judge(module("looks").look(case, masks), inverse))[-1]
    assert 0.1 <= row["f1"] <= 0.4


def test_a_case_is_made_again_from_its_key(case):
    cases = module("cases")
    again = cases.make_case(**{"name": cases.QUICK, "edit": "incorporation", "seed": 0})
    assert np.array_equal(case.labels, again.labels)
    assert np.array_equal(case.heldout_truth, again.heldout_truth)
    masks, others = (cases.detector_masks(one, REGIMES) for one in (case, again))
    assert all(np.array_equal(masks[name], others[name]) for name in REGIMES)


def test_chance_differs_between_scenes_edits_seeds_and_regimes(case):
    cases = module("cases")
    keys = [
        (dataclasses.replace(case, scene=scene, edit=edit, seed=seed), regime)
        for scene in (dataclasses.replace(case.scene, name=name) for name in ("room", "garden"))
        for edit in ("incorporation", "modification", "removal")
        for seed in (0, 1, 2)
        for regime in (*REGIMES, *PROFILES)
    ]
    assert len({cases._seed(*key) for key in keys}) == len(keys)


def test_a_table_has_means_spreads_and_the_best_in_bold():
    tables = module("tables")
    rows = [
        {"method": method, "regime": regime, "seed": seed, "f1": value + 0.1 * seed}
        for method, regime, value in [
            ("a", "x", 0.2),
            ("a", "y", 0.6),
            ("b", "x", 0.4),
            ("b", "y", 0.4),
            ("limit", "x", 0.9),
            ("limit", "y", float("nan")),
        ]
        for seed in (0, 1)
    ]
    text = tables.pivot(
        rows, "method", "regime", reference=("limit",), extra={"paper": {"a": "0.5"}}
    )
    assert text.splitlines() == [
        "| method | x | y | mean | paper |",
        "| --- | --- | --- | --- | --- |",
        "| a | 0.25 ± 0.07 | **0.65** ± 0.07 | **0.45** ± 0.07 | 0.5 |",
        "| b | **0.45** ± 0.07 | 0.45 ± 0.07 | **0.45** ± 0.07 |  |",
        "| limit | 0.95 ± 0.07 | - | 0.95 ± 0.07 |  |",
    ]


def test_a_section_is_replaced_and_the_rest_of_the_page_stays(tmp_path):
    tables = module("tables")
    page = tmp_path / "results.md"
    page.write_text("before\n<!-- one -->\nold\n<!-- /one -->\nafter\n")
    tables.write_section(page, "one", "new")
    tables.write_section(page, "two", "more")
    assert page.read_text() == (
        "before\n<!-- one -->\nnew\n<!-- /one -->\nafter\n\n<!-- two -->\nmore\n<!-- /two -->\n"
    )


@pytest.mark.slow
@pytest.mark.parametrize("name", SCRIPTS)
def test_every_script_runs_in_quick_mode(name, tmp_path):
    script = module(name)
    (takes,) = inspect.signature(script.main).parameters.values()
    script.main(takes.annotation(quick=True, out=tmp_path))
    with pytest.raises(InputError, match="another --out"):
        script.main(takes.annotation(quick=True, out=tmp_path))
    again = (tmp_path / "results.md").read_text()
    script.main(takes.annotation(quick=True, reprint=True, out=tmp_path))
    assert (tmp_path / "results.md").read_text() == again, "reprinting changed the page"
    assert f"<!-- {name} -->" in (tmp_path / "results.md").read_text()
    assert (tmp_path / f"{name}.png").stat().st_size > 5_000
    assert len((tmp_path / f"{name}.csv").read_text().splitlines()) > 1


def test_a_line_through_log_odds_is_found():
    train = module("train_cues")
    values = np.random.default_rng(0).normal(size=4_000)
    labels = np.random.default_rng(1).random(4_000) < 1 / (1 + np.exp(-(1.5 * values - 0.7)))
    factor, shift = train.logistic(values, labels, np.ones(4_000))
    assert factor == pytest.approx(1.5, abs=0.15)
    assert shift == pytest.approx(-0.7, abs=0.15)


def test_networks_learn_from_other_scenes_and_models_survive_a_file(tmp_path, monkeypatch):
    train = module("train_cues")
    monkeypatch.setattr(train, "STEPS", 150)
    monkeypatch.setattr(train, "HIDDEN", (8,))
    scenes = ("a", "b", "c")
    cases = [_examples(train, scene, seed) for seed, scene in enumerate(scenes)]
    cases.append(_examples(train, "c", 3, pasted_from="a"))
    seen = []
    trained = train.trained
    monkeypatch.setattr(
        train,
        "trained",
        lambda own, seed: seen.append([c.scenes for c in own]) or trained(own, seed),
    )
    with jax.numpy_dtype_promotion("standard"):  # optax adds floats and counts of steps
        networks = train.networks_of(cases, scenes)
    assert len(networks) == 7
    assert len(seen) == 4 * train.MEMBERS + 3
    assert [len(own) for own in networks.values()] == 4 * [train.MEMBERS] + 3 * [1]
    in_order = [without for without, own in networks.items() for _ in own]
    for without, own in zip(in_order, seen, strict=True):
        assert set().union(*own) == set(scenes) - without
        assert not any(within & without for within in own), "a part of it was seen"
        assert len(own) == 3 - len(without) + (not without & {"a", "c"})
    fold = train.fold_of("a", cases, networks)
    assert fold.model.networks is networks[frozenset({"a"})]
    assert set(fold.others) == {"b", "c"}
    assert all(own is networks[frozenset({"a", s})][0] for s, own in fold.others.items())
    rng = np.random.default_rng(0)
    heard = [_heard(train, edit, rng) for edit in ("removal", "removal", "modification", None)]
    fold = train.calibrated(fold, heard)
    factor, shift = fold.model.calibration
    assert (factor, shift) == pytest.approx((2, -1), abs=0.15), "as the labels were drawn"
    assert fold.model.scene[0] > 0, "the worst part of edited scenes is worse"
    train.save(tmp_path / "model.npz", fold.model)
    with np.load(tmp_path / "model.npz") as stored:
        again = module("gsc_jax.forensics.classifier").from_arrays(stored)
    assert again.names == fold.model.names
    assert again.calibration == pytest.approx(fold.model.calibration)
    values = cases[0].values.astype(np.float32)
    odds = np.asarray(module("gsc_jax.forensics.classifier").network(fold.others["b"], values))
    assert odds[cases[0].labels].mean() > odds[~cases[0].labels].mean() + 0.5


def test_what_was_cut_from_a_scene_belongs_to_it():
    cases, train = module("cases"), module("train_cues")
    pasted = {seed: cases.donor_name("kitchen", seed) for seed in range(8)}
    cut = next(seed for seed, name in pasted.items() if name.startswith(cases.CUT))
    scanned = next(seed for seed, name in pasted.items() if name in cases.OBJECTS)
    source = pasted[cut].removeprefix(cases.CUT)
    assert train.scenes_in("kitchen", "incorporation", cut) == {"kitchen", source}
    assert train.scenes_in("kitchen", "incorporation", scanned) == {"kitchen"}
    assert train.scenes_in("kitchen", "removal", cut) == {"kitchen"}


def test_whole_scenes_calibrate_only_those_that_saw_no_part_of_them(monkeypatch):
    train = module("train_cues")
    case = module("cases").edit_scene("small room", "removal", 0)
    monkeypatch.setattr(train, "scenes_in", lambda *_: frozenset({"a", "b"}))
    monkeypatch.setattr(train, "load_scene", lambda *_: case)
    monkeypatch.setattr(train, "edit_scene", lambda *_: case)
    model = module("gsc_jax.forensics.classifier").shipped_model()
    folds = [
        train.Fold(heldout=heldout, model=model, others={"a": model.networks[0]})
        for heldout in (None, "a", "b", "c")
    ]
    heard = train.hear("a", "removal", 1, train.Args(), folds)
    assert set(heard) == {None, "c"}
    assert len(heard["c"].raw) == len(heard["c"].labels) <= train.SAMPLE
    assert 0 < heard["c"].labels.mean() < 0.1
    assert heard["c"].worst >= np.median(heard["c"].raw)


def test_each_kind_of_edit_weighs_alike():
    weights = module("train_cues").balanced(["a", "b", "b", "b"])
    np.testing.assert_allclose(weights, [1 / 2, 1 / 6, 1 / 6, 1 / 6])


def _heard(train, edit: str | None, rng: np.random.Generator):
    """A scene in which the log odds of a Gaussian are twice the raw ones, less 1."""
    raw = rng.normal(-1, 1.5, 20_000)
    labels = rng.random(20_000) < 1 / (1 + np.exp(1 - 2 * raw)) if edit else np.zeros(20_000, bool)
    return train.Heard(edit=edit, raw=raw, labels=labels, worst=6.0 if edit else 1.0)


def _examples(train, scene: str, seed: int, *, pasted_from: str | None = None):
    rng = np.random.default_rng(seed)
    labels = rng.random(400) < 0.3
    values = rng.normal(size=(400, 3))
    values[:, 0] += 2 * labels
    return train.Examples(
        scene=scene,
        edit=("removal", "modification")[seed % 2],
        scenes=frozenset({scene, pasted_from or scene}),
        values=values.astype(np.float16),
        labels=labels,
        share=0.1,
        names=("x", "y", "z"),
    )


def test_some_methods_are_measured_beside_the_rows_of_the_others(tmp_path):
    runner, tables = module("runner"), module("tables")
    key = {"scene": "room", "edit": "removal", "seed": 0, "regime": "clean"}

    def row(name: str, f1: float) -> dict:
        return {**key, "method": name, "f1": f1}

    before = [row(runner.TRUTH, 1.0), row("a", 0.1), row("b", 0.2)]
    tables.write_csv(tmp_path / "x.csv", before)
    args = runner.ChosenArgs(out=tmp_path, methods=("b", "c"))
    new = [row(runner.TRUTH, 1.0), row("b", 0.3), row("c", 0.4)]
    rows = runner.measured(args, "x", [new])
    assert (
        rows == [*before[:2], row("b", 0.3), row("c", 0.4)] == tables.read_csv(tmp_path / "x.csv")
    )
    with pytest.raises(InputError, match="other cases"):
        runner.measured(args, "x", [[{**row("b", 0.3), "seed": 1}]])
    with pytest.raises(InputError, match="other masks"):
        runner.measured(args, "x", [[row(runner.TRUTH, 0.9), row("b", 0.3)]])
    with pytest.raises(InputError, match="expected some of a, b"):
        args.among({"a": None, "b": None})


def test_rows_are_read_back_as_they_were(tmp_path):
    tables = module("tables")
    rows = [{"a": 1, "b": "x, y", "c": 0.25}, {"a": 2, "b": "", "d": 1e-9}]
    tables.write_csv(tmp_path / "rows.csv", rows)
    first, second = tables.read_csv(tmp_path / "rows.csv")
    assert (first["a"], first["b"], first["c"]) == (1, "x, y", 0.25)
    assert np.isnan(first["d"])
    assert (second["b"], second["d"]) == ("", 1e-9)
