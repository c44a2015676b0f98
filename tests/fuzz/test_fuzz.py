"""Damaged files of every format are read or refused, and the fuzzer reports planted faults."""

from pathlib import Path

import numpy as np
import pytest
from fuzz import harness, planted
from fuzz.formats import FORMATS
from fuzz.harness import fuzz, table

INPUTS, SEED = 20_000, 0
PLANTED_INPUTS = 12
"""Inputs of every planted reader, of which one in four is faulty."""


@pytest.mark.slow
def test_damaged_input_gives_a_valid_object_or_an_error_that_names_the_file(tmp_path):
    tallies = fuzz(list(FORMATS.values()), SEED, INPUTS, tmp_path)
    assert [finding for tally in tallies for finding in tally.findings] == [], table(tallies)
    for tally in tallies:
        assert tally.accepted + tally.refused == tally.inputs
        # Damage that never or always leaves a valid file tests one half of a reader only.
        assert 0.05 < tally.accepted / tally.inputs < 0.6, table(tallies)


@pytest.mark.parametrize("name", FORMATS)
def test_an_input_is_a_function_of_format_seed_and_index(tmp_path, name):
    contents = []
    for repetition in range(2):
        for seed, index in ((0, 5), (0, 6), (1, 5)):
            folder = tmp_path / f"{repetition}-{seed}-{index}"
            folder.mkdir()
            FORMATS[name].make(harness.input_rng(FORMATS[name], seed, index), folder)
            files = (path for path in folder.rglob("*") if path.is_file())
            contents.append({str(p.relative_to(folder)): p.read_bytes() for p in files})
    assert contents[:3] == contents[3:]
    assert len({str(content) for content in contents[:3]}) == 3


@pytest.fixture(scope="module")
def tallies(tmp_path_factory) -> tuple[dict[str, harness.Tally], Path]:
    folder = tmp_path_factory.mktemp("findings")
    found = fuzz(
        list(planted.FORMATS.values()), SEED, PLANTED_INPUTS * len(planted.FORMATS), folder
    )
    return {tally.format: tally for tally in found}, folder


@pytest.mark.parametrize(
    ("name", "problem"),
    [
        ("read_with_traceback", "KeyError: 'planted'"),
        ("read_anonymously", "does not name the file"),
        ("read_to_nan", "AssertionError"),
        ("read_and_die", "the process ended (exit code 11)"),
        ("read_too_much", "MemoryError"),
    ],
)
def test_planted_faults_are_found_and_saved(tallies, name, problem):
    tally, folder = tallies[0][name], tallies[1]
    kind = planted.FORMATS[name]
    draws = [
        harness.input_rng(kind, SEED, i).randrange(planted.CONTENTS) for i in range(PLANTED_INPUTS)
    ]
    at = [i for i, byte in enumerate(draws) if byte == planted.PLANTED]
    assert len(tally.findings) == len(at) > 0
    assert tally.accepted == PLANTED_INPUTS - len(at)
    for index in at:
        saved = folder / f"{name}-{SEED}-{index}"
        assert problem in (saved / "finding.txt").read_text()
        assert (saved / "input.bin").read_bytes() == bytes([planted.PLANTED])


def test_hangs_end_and_are_found(tallies):
    tally = tallies[0]["read_forever"]
    assert tally.findings
    assert all("Hang" in finding for finding in tally.findings)
    assert tally.slowest > 0.9 * harness.MAX_SECONDS  # the timer is coarse


def test_a_process_that_does_not_react_is_killed(tmp_path, monkeypatch):
    monkeypatch.setattr(harness, "KILL_SECONDS", 2)
    (tally,) = fuzz([planted.SLEEPER], SEED, PLANTED_INPUTS, tmp_path)
    assert tally.findings
    assert all("no answer within 2 s" in finding for finding in tally.findings)
    assert tally.accepted + len(tally.findings) == PLANTED_INPUTS


def test_a_reader_without_faults_has_no_findings(tallies):
    tally = tallies[0]["read_well"]
    assert not tally.findings
    assert tally.accepted + tally.refused == tally.inputs == PLANTED_INPUTS
    assert tally.refused > 0
    lines = table(list(tallies[0].values())).splitlines()
    assert np.unique([len(line) for line in lines]).size == 1
    counts = (tally.inputs, tally.accepted, tally.refused, 0)
    assert lines[1].split()[:5] == ["read_well", *map(str, counts)]
