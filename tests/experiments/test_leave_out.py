import leave_out
import numpy as np
import pandas as pd
import pytest
from bank import BankCase
from learned_cases import examples

from gsc_jax.benchmark.scenes import make_object

CASES = [
    examples("b", 0),
    examples("b-0-mcmc", 0, family="editor"),
    examples("b-1-adaptive", 0, exporter="spz"),
    examples("c", 0, pasted_from="vase", family="editor", exporter="spz"),
    examples("a", 0),
    examples("b", 1, pasted_from="a"),
]
CASE = BankCase(
    gaussians=make_object(count=100),
    labels=np.arange(100) < 20,
    sources=frozenset({"a", "vase"}),
    edit="incorporation",
    family="editor",
    exporter="spz",
)


@pytest.mark.parametrize(
    ("left_out", "learned"),
    [
        ("host", [0, 1, 2, 3]),
        ("host and donor", [0, 1, 2]),
        ("host and editor", [0, 2]),
        ("host and exporter", [0, 1]),
        ("host and trainer", [0, 2, 3]),
        ("all", [0]),
    ],
)
def test_what_shares_something_with_a_case_is_left_out(left_out, learned):
    names = leave_out.LEFT_OUT[left_out]
    assert leave_out.learned_of(CASES, "a-3-mcmc", CASE, names) == learned


def test_a_network_is_trained_once_for_the_same_cases(monkeypatch):
    monkeypatch.setattr(leave_out, "train_network", lambda own, seed: (seed, len(own)))
    trained = leave_out.Trained(CASES)
    assert trained.network([0, 2]) == trained.network([0, 2]) == (0, 2)
    assert trained.network([1]) == (1, 1)


def test_only_cases_with_every_row_are_compared():
    key = {"edit": "removal", "cases": 9, "family": "quick", "export": "float"}
    rows = [
        {**key, "host": host, "left_out": name, "auc": value}
        for host, values in {"room": {"host": 0.9, "all": 0.7}, "vase": {"host": 0.1}}.items()
        for name, value in values.items()
    ]
    text = leave_out.report(pd.DataFrame(rows))
    assert "1 of removal" in text
    assert "| host | 9 | nan | nan | 0.900 | 0.900 |" in text


def test_captures_have_a_trainer_and_other_scenes_none():
    assert [leave_out.trainer_of(name) for name in ("a-3-mcmc", "a")] == ["mcmc", ""]
